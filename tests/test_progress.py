"""How far a run is: on standard error, or told to a function."""

from __future__ import annotations

import os
import pty
import select
import subprocess
import sys
from pathlib import Path

import pytest  # noqa: TC002 - as in every other test
from toys import sampling_agent

import gem_core as gem
from gem_core import progress
from gem_core.records.plans import PlanItem

COUNTDOWN = "toy:Countdown-v0"

PROGRAM = """
import gem_core as gem
from toys import register_toys, sampling_agent
register_toys()
for episode in gem.rollout("toy:Countdown-v0", sampling_agent, episodes=3, seed=0, progress=True):
    print("episode", episode.key)
"""


def test_lines_go_to_standard_error_where_that_is_no_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Now and then; standard output is the caller's."""
    monkeypatch.setattr(progress, "LINE_EVERY_S", -1.0)
    list(gem.rollout(COUNTDOWN, sampling_agent, episodes=2, seed=0, progress=True))
    plan = iter([PlanItem()] * 2)
    list(gem.rollout(COUNTDOWN, sampling_agent, plan=plan, seed=0, progress=True))
    captured = capsys.readouterr()
    assert captured.out == ""
    counted = ["0 of 2 episodes", "1 of 2 episodes", "2 of 2 episodes", "0 episodes", "1 episodes", "2 episodes"]
    assert captured.err.splitlines() == [f"gem: {line}" for line in counted]


def test_a_bar_in_a_terminal_leaves_standard_output_alone(tmp_path: Path) -> None:
    """What is printed meanwhile goes where it was sent."""
    leader, follower = pty.openpty()
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parent), "TERM": "xterm"}
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM], env=env, cwd=tmp_path, stdout=subprocess.PIPE, stderr=follower, text=True
    )
    os.close(follower)
    shown = b""
    try:
        while select.select([leader], [], [], 60)[0]:
            shown += os.read(leader, 65536)
    except OSError:  # how Linux reports that the other end is closed
        pass
    out, _ = process.communicate(timeout=60)
    os.close(leader)
    assert process.returncode == 0
    assert out == "episode 0\nepisode 1\nepisode 2\n"
    assert b"episodes" in shown
    assert b"3/3" in shown


def test_episodes_that_were_there_are_over() -> None:
    """A run that is resumed goes on where it was."""
    first = list(gem.rollout(COUNTDOWN, sampling_agent, episodes=3, seed=0))[:2]
    told: list[tuple[int, int | None]] = []
    plan = [PlanItem(), PlanItem(), PlanItem(repeat=2)]
    list(gem.rollout(COUNTDOWN, sampling_agent, plan=plan, resume=first, progress=lambda *each: told.append(each)))
    assert told == [(2, 4), (3, 4), (4, 4)]
    told.clear()
    list(gem.rollout(COUNTDOWN, sampling_agent, plan=iter(plan), progress=lambda *each: told.append(each)))
    assert told == [(done, None) for done in range(5)]
