"""``gem run`` with ``--resume``, and with environments that fail."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
from command_calls import RunGem, subprocess_gem

import gem_core as gem
from gem_core.records.files import read_episodes

COUNTDOWN = "toy:Countdown-v0"
SUMS = "toy:Sums-v0"

STOPPED_AGENT = """
import os, signal
from pathlib import Path
# Where the tests run in the background of a shell, they inherit that Ctrl-C is ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
seen = set()
def act(observation, context):
    seen.add(context.episode)
    if len(seen) > 3 and Path("stop").exists():
        os.kill(os.getpid(), signal.SIGINT)
    return context.sample_random_action()
"""

FAILING_AGENT = """
from pathlib import Path
from gem_core.errors import RequestError
def act(observation, context):
    if Path("down").exists() and context.episode in ("1.0", "2.0"):
        raise RequestError("the server is down")
    return "a!"
"""


def by_key(path: str | Path) -> list[gem.Episode]:
    return sorted(read_episodes(path), key=lambda episode: int(episode.key))


@pytest.mark.parametrize("how", ["SIGINT", "SIGTERM"])
def test_an_interrupted_run_says_how_to_go_on_and_then_does(how: str, tmp_path: Path) -> None:
    """The last line is a command; what it completes is the run in one go, and its table counts all episodes."""
    (tmp_path / "mine.py").write_text(STOPPED_AGENT.replace("os.getpid(), signal.SIGINT", f"os.getpid(), signal.{how}"))
    (tmp_path / "stop").touch()
    options = ["-n", "20", "-k", "2", "-w", "episode_stats", "-t", "9", "-a", "mine:act"]
    typed = ["run", "toy:Count*", *options, "--seed", "5", "-o", "a b.jsonl"]
    stopped = subprocess_gem(*typed, cwd=tmp_path)
    assert stopped.returncode == 130
    count = int(re.findall(r"gem: interrupted after (\d+) of 20 episodes\n", stopped.stderr)[0])
    assert 0 < count < 20
    last = stopped.stderr.splitlines()[-1].removeprefix("gem: go on with: ")
    assert shlex.split(last) == ["gem", *typed, "--resume", "a b.jsonl"]
    (tmp_path / "stop").unlink()
    resumed = subprocess_gem(*shlex.split(last)[1:], cwd=tmp_path)
    assert (resumed.returncode, resumed.stderr) == (0, "")
    assert resumed.stdout.splitlines()[1].split()[:2] == [COUNTDOWN, "20"]
    assert f"{20 - count} episodes in " in resumed.stdout
    assert f"(seed 5), added to the {count} in a b.jsonl" in resumed.stdout
    whole = subprocess_gem("run", COUNTDOWN, *options, "--seed", "5", "--out", "whole.jsonl", cwd=tmp_path)
    assert whole.returncode == 0
    assert by_key(tmp_path / "a b.jsonl") == by_key(tmp_path / "whole.jsonl")


def test_errors_and_damaged_lines_are_run_again_and_leave_the_file(run_gem: RunGem) -> None:
    """One episode for each place; the permissions of the file stay as they are, and nothing else is left behind."""
    Path("failing.py").write_text(FAILING_AGENT)
    Path("down").touch()
    first = run_gem("run", COUNTDOWN, "-n", "5", "-k", "1", "-a", "failing:act", "-s", "1", "-o", "a.jsonl")
    assert first.code == 1
    Path("a.jsonl").write_bytes(Path("a.jsonl").read_bytes()[:-30])
    Path("a.jsonl").chmod(0o640)
    Path("down").unlink()
    again = run_gem("run", COUNTDOWN, "-n", "5", "-a", "failing:act", "--resume", "a.jsonl", "--json")
    assert (again.code, again.err) == (0, "gem: 3 episodes with an error or cut off: run again\n")
    report = json.loads(again.out)
    assert (report["environments"][0]["episodes"], report["environments"][0]["errors"], report["seed"]) == (5, 0, 1)
    assert Path("a.jsonl").stat().st_mode & 0o777 == 0o640
    assert [(episode.key, episode.error) for episode in by_key("a.jsonl")] == [(str(key), None) for key in range(5)]
    assert sorted(path.name for path in Path().iterdir() if path.name.startswith("a.")) == ["a.jsonl"]


def test_another_run_is_refused_and_the_file_left_as_it_is(run_gem: RunGem) -> None:
    """Other environments, fewer episodes; even where errors would be taken out."""
    Path("failing.py").write_text(FAILING_AGENT)
    Path("down").touch()
    run_gem("run", COUNTDOWN, SUMS, "-n", "4", "-a", "failing:act", "-s", "1", "-o", "a.jsonl")
    content = Path("a.jsonl").read_bytes()
    for arguments in ([SUMS, COUNTDOWN, "-n", "4"], [COUNTDOWN, SUMS, "-n", "2"], [COUNTDOWN, SUMS, "-n4", "-s2"]):
        refused = run_gem("run", *arguments, "-a", "failing:act", "--resume", "a.jsonl")
        assert (refused.code, refused.out, refused.err.count("\n")) == (2, "", 1)
        assert Path("a.jsonl").read_bytes() == content
    Path("empty.jsonl").touch()
    run_gem("run", COUNTDOWN, "-n", "1", "-s", "7", "--resume", "empty.jsonl")
    assert [episode.run_seed for episode in by_key("empty.jsonl")] == [7]


def test_an_exception_in_an_environment_names_file_and_line(run_gem: RunGem) -> None:
    """In the record, and on standard error for the first that failed, wherever the environment ran."""
    Path("fragile_env.py").write_text(
        "from echo_env import EchoEnv\nclass FragileEnv(EchoEnv):\n    def step(self, action):\n        return {}[1]\n"
    )
    gem.register("fragile:Env-v0", "fragile_env:FragileEnv")
    done = run_gem("run", "fragile:Env-v0", "-n", "2", "--backend", "process", "-o", "a.jsonl")
    frame = "fragile_env.py:4, in step: return {}[1]"
    assert [episode.error["frames"] for episode in by_key("a.jsonl") if episode.error] == [[frame]] * 2
    assert done.code == 1
    assert done.err.splitlines()[-1].strip() == frame


SETTING = ("-a", "mine:act", "--set", "longest=3", "-w", "concat:max_turns=2", "-t", "9")


@pytest.mark.parametrize(
    ("other", "told"),
    [
        (["-a", "random"], '["mine:act"], and now it is ["random"]'),
        (["--set", "longest=4"], '"arguments": {"longest": 4}'),
        (["-w", "concat:max_turns=3"], '["concat", {"max_turns": 2}]'),
        (["-t", "8"], '"max_turns": 8'),
    ],
)
def test_a_resumed_run_is_not_mixed_with_another(run_gem: RunGem, other: list[str], told: str) -> None:
    """Another agent, argument or wrapper is refused, with what differs; the same options go on."""
    Path("mine.py").write_text("def act(observation, context): return context.sample_random_action()\n")
    assert run_gem("run", COUNTDOWN, "-s", "1", *SETTING, "-n", "2", "-o", "a.jsonl").code == 0
    content = Path("a.jsonl").read_bytes()
    kept = [word for pair in zip(SETTING[::2], SETTING[1::2], strict=True) if pair[0] != other[0] for word in pair]
    refused = run_gem("run", COUNTDOWN, "-n", "4", *kept, *other, "--resume", "a.jsonl")
    assert (refused.code, refused.out, refused.err.count("\n")) == (2, "", 1)
    assert told in refused.err
    assert Path("a.jsonl").read_bytes() == content
    assert run_gem("run", COUNTDOWN, "-n", "4", *SETTING, "--resume", "a.jsonl").code == 0
    assert len(by_key("a.jsonl")) == 4
