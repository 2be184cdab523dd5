"""The other process is one, keeps its conversation to itself, and is replaced when it hangs or dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from broken_envs import ChattyEnv, OtherProcessEnv
from reference_envs import GoodEnv

from gem_core.testing import ContractError, check_env
from gem_core.testing.contract import NotTriedError
from gem_core.testing.helper import HelperError, OtherProcess, other_process
from gem_core.testing.serialization import guarded, recipe_of


@pytest.fixture
def helper() -> Iterator[OtherProcess]:
    helper = OtherProcess()
    yield helper
    helper.stop()


def request(env: GoodEnv, actions: tuple[str, ...] = ("\\boxed{1}",)) -> dict[str, Any]:
    return {"recipe": recipe_of(guarded(env)), "seed": 1, "state": None, "actions": actions}


def play(helper: OtherProcess, env: GoodEnv, limit_s: float = 60.0) -> list[dict[str, Any]]:
    return helper.play(request(env), step_timeout_s=limit_s, reset_timeout_s=60.0)


def test_one_process_serves_many_checks() -> None:
    check_env(GoodEnv)
    first = other_process().pid
    check_env(GoodEnv(limit=3))
    assert other_process().pid == first is not None


def test_it_plays_what_this_process_plays(helper: OtherProcess) -> None:
    env = guarded(GoodEnv())
    observation, info = env.reset(seed=1)
    step_observation, *_ = env.step("\\boxed{1}")
    first, second = play(helper, GoodEnv())
    assert (first["observation"], first["info"]) == (observation, info)
    assert second["observation"] == step_observation


def test_prints_do_not_disturb_it() -> None:
    """An environment that prints to standard output, even what looks like an answer, keeps its promises."""
    report = check_env(ChattyEnv, skip={"hostile-actions": "240 lines are enough"})
    assert "process-determinism" in report.kept


def test_hang_is_named_and_the_process_replaced(helper: OtherProcess) -> None:
    play(helper, GoodEnv())
    hung = helper.pid
    with pytest.raises(HelperError, match="it gave no answer within"):
        play(helper, OtherProcessEnv(os.getpid(), "hang"), limit_s=0.2)
    assert len(play(helper, GoodEnv())) == 2
    assert helper.pid != hung


@pytest.mark.parametrize(
    ("deed", "seen"), [("die", "the process ended with exit code 3"), ("leave", "it raised SystemExit: 4")]
)
def test_what_ends_the_process_breaks_the_promise(deed: str, seen: str) -> None:
    with pytest.raises(ContractError) as caught:
        check_env(OtherProcessEnv(os.getpid(), deed))
    broken = caught.value.report.broken
    assert set(broken) - {"hostile-actions"} == {"process-determinism", "state-process"}
    assert seen in broken["process-determinism"]


def test_killed_process_is_replaced(helper: OtherProcess) -> None:
    play(helper, GoodEnv())
    killed = helper.pid
    assert killed is not None
    process = helper._process
    assert process is not None
    os.kill(killed, signal.SIGKILL)
    process.wait()
    assert len(play(helper, GoodEnv())) == 2
    assert helper.pid != killed


def test_it_hashes_strings_differently() -> None:
    """The hash seed is another one, also where this process has a fixed one."""
    environment = {**os.environ, "PYTHONHASHSEED": "1"}
    script = (
        "from gem_core.testing.helper import _start; import pathlib\n"
        "p = _start(); p.stdout.readline()\n"
        "env = pathlib.Path(f'/proc/{p.pid}/environ')\n"
        "print('PYTHONHASHSEED=2' in env.read_text().split('\\0') if env.exists() else True); p.kill()"
    )
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True"


def test_arguments_that_json_cannot_keep_are_a_reason_to_skip() -> None:
    with pytest.raises(NotTriedError, match="its arguments cannot be handed to another process"):
        recipe_of(guarded(GoodEnv(limit=range(3))))  # type: ignore[arg-type]


def test_it_ends_with_its_parent() -> None:
    """When standard input ends, so does the process."""
    process = subprocess.run(
        [sys.executable, "-m", "gem_core.testing.other_process"],
        input="",
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert process.stdout == '{"ready": true}\n'
    assert process.stderr == ""
