"""``gem run`` with ``--resume``, and on other backends."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
from command_calls import RunGem, subprocess_gem

import gem_core as gem
from gem_core.records.files import read_episodes, write_episodes
from gem_core.records.plain_json import ImageFolder

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
    stopped = subprocess_gem("run", "toy:Count*", *options, "--seed=5", "-oa b.jsonl", "--overwrite", cwd=tmp_path)
    assert stopped.returncode == 130
    count = int(re.findall(r"gem: interrupted after (\d+) of 20 episodes\n", stopped.stderr)[0])
    assert 0 < count < 20
    last = stopped.stderr.splitlines()[-1].removeprefix("gem: go on with: ")
    assert last == (
        "gem run 'toy:Count*' --agent mine:act --episodes 20 --num-envs 2 --max-turns 9 --wrappers episode_stats "
        "--resume 'a b.jsonl'"
    )
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


def test_the_speed_of_a_resumed_run_is_that_of_what_was_run_now(run_gem: RunGem) -> None:
    """Turns that were taken before have no part in it."""
    run_gem("run", COUNTDOWN, "-n", "5", "-o", "a.jsonl")
    done = run_gem("run", COUNTDOWN, "-n", "5", "--resume", "a.jsonl", "--json")
    (row,) = json.loads(done.out)["environments"]
    assert row["turns"] > 0
    assert row["turns_per_second"] == 0.0


def test_another_run_is_refused_and_the_file_left_as_it_is(run_gem: RunGem) -> None:
    """Other environments, fewer episodes; even where errors would be taken out."""
    Path("failing.py").write_text(FAILING_AGENT)
    Path("down").touch()
    run_gem("run", COUNTDOWN, SUMS, "-n", "4", "-a", "failing:act", "-s", "1", "-o", "a.jsonl")
    content = Path("a.jsonl").read_bytes()
    for arguments in ([SUMS, COUNTDOWN, "-n", "4"], [COUNTDOWN, SUMS, "-n", "2"]):
        refused = run_gem("run", *arguments, "-a", "failing:act", "--resume", "a.jsonl")
        assert (refused.code, refused.out, refused.err.count("\n")) == (2, "", 1)
        assert "it is of another run" in refused.err
    assert Path("a.jsonl").read_bytes() == content


def test_a_file_that_does_not_name_its_seed_is_refused(run_gem: RunGem) -> None:
    """As those of the form before."""
    run_gem("run", COUNTDOWN, "-n", "3", "-o", "a.jsonl")
    Path("a.jsonl").write_text(re.sub(r'"run_seed": \d+, ', "", Path("a.jsonl").read_text()))
    refused = run_gem("run", COUNTDOWN, "--resume", "a.jsonl")
    assert refused.code == 2
    assert "--resume: a.jsonl does not say from which seed its run was started" in refused.err


def test_an_empty_file_is_an_empty_beginning(run_gem: RunGem) -> None:
    """As a run leaves it that was stopped before its first episode was over."""
    Path("a.jsonl").touch()
    assert run_gem("run", COUNTDOWN, "-n", "3", "--resume", "a.jsonl").code == 0
    assert len(by_key("a.jsonl")) == 3


def test_images_of_the_episodes_stay(run_gem: RunGem) -> None:
    """They are neither read nor written."""
    run_gem("run", COUNTDOWN, "-n", "3", "-o", "a.jsonl", "-s", "1")
    pillow = pytest.importorskip("PIL.Image")
    episodes = by_key("a.jsonl")
    episodes[0].observation = [{"type": "image", "image": pillow.new("L", (2, 2), 7)}]
    episodes[1].info["error"] = episodes[1].transitions[-1].info["error"] = {"kind": "agent", "message": "down"}
    write_episodes("a.jsonl", episodes)
    images = {path: path.read_bytes() for path in ImageFolder.beside(Path("a.jsonl")).path.iterdir()}
    assert run_gem("run", COUNTDOWN, "-n", "3", "--resume", "a.jsonl").code == 0
    assert {path: path.read_bytes() for path in images} == images
    assert by_key("a.jsonl")[0].observation == episodes[0].observation


def test_a_run_that_fails_says_how_to_go_on_as_well(run_gem: RunGem) -> None:
    """Above the error, which stays the last line."""
    Path("raising.py").write_text(
        "def act(observation, context):\n    if context.episode == '2.0': raise ValueError('mine')\n    return 'a'\n"
    )
    failed = run_gem("run", COUNTDOWN, "-n", "4", "-k", "1", "-a", "raising:act", "-o", "a.jsonl")
    assert failed.code == 1
    go_on, error = failed.err.splitlines()
    assert go_on.endswith(f"gem run {COUNTDOWN} --agent raising:act --episodes 4 --num-envs 1 --resume a.jsonl")
    assert error.startswith("gem: ValueError: mine (raising.py:2, in act: ")


def test_every_backend_gives_the_same_episodes(run_gem: RunGem) -> None:
    """With an agent of a script, which stays in this process."""
    Path("sampling.py").write_text("def act(observation, context): return context.sample_random_action()\n")
    options = ["-n", "4", "-s", "3", "-a", "sampling:act", "-w", "episode_stats"]
    for name, more in (("plain.jsonl", []), ("other.jsonl", ["--backend", "process", "-k", "3"])):
        assert run_gem("run", COUNTDOWN, *options, *more, "-o", name).code == 0
    assert by_key("other.jsonl") == by_key("plain.jsonl")


def test_a_step_that_takes_too_long_is_an_error_of_its_episode(run_gem: RunGem) -> None:
    """What runs in place is put into a process that can be killed."""
    gem.register("slow:Stuck-v0", "stuck_env:StuckEnv")
    Path("saying.py").write_text("def act(observation): return 'a'\n")
    done = run_gem("run", "slow:Stuck-v0", "-n", "2", "--step-timeout", "0.5", "-a", "saying:act", "-o", "a.jsonl")
    assert done.code == 1
    error = {"kind": "timeout", "message": "a step or reset took longer than step_timeout, 0.5 s"}
    assert [episode.error for episode in by_key("a.jsonl")] == [error] * 2


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


FIRST = ("run", COUNTDOWN, "-s", "1", "-a", "mine:act", "--set", "longest=3", "-w", "concat:max_turns=2", "-t", "9")


@pytest.mark.parametrize(
    ("other", "told"),
    [
        (["-a", "random"], '["mine:act"], and now it is ["random"]'),
        (["--set", "longest=4"], '"arguments": {"longest": 4}'),
        (["--set", "longest=3", "--set", "fail=step"], "--set"),
        (["-w", "concat:max_turns=3", "-t", "9"], '["concat", {"max_turns": 2}]'),
        (["--max-turns", "9"], "--set, --wrappers"),
    ],
)
def test_a_resumed_run_is_not_mixed_with_another(run_gem: RunGem, other: list[str], told: str) -> None:
    """Another agent, argument or wrapper is refused, with what differs; the file stays as it is."""
    Path("mine.py").write_text("def act(observation, context): return context.sample_random_action()\n")
    assert run_gem(*FIRST, "-n", "2", "-o", "a.jsonl").code == 0
    content = Path("a.jsonl").read_bytes()
    refused = run_gem("run", COUNTDOWN, "-n", "4", *other, "--resume", "a.jsonl")
    assert (refused.code, refused.out, refused.err.count("\n")) == (2, "", 1)
    assert told in refused.err
    assert Path("a.jsonl").read_bytes() == content


@pytest.mark.parametrize("said", [[], list(FIRST[4:])], ids=["nothing said", "the same said"])
def test_a_resumed_run_is_what_its_file_says(run_gem: RunGem, said: list[str]) -> None:
    """Agent, arguments, wrappers and limits need not be said again; the result is the run in one go."""
    Path("mine.py").write_text("def act(observation, context): return context.sample_random_action()\n")
    assert run_gem(*FIRST, "-n", "5", "-o", "whole.jsonl").code == 0
    assert run_gem(*FIRST, "-n", "2", "-o", "a.jsonl").code == 0
    resumed = run_gem("run", COUNTDOWN, "-n", "5", *said, "--resume", "a.jsonl")
    assert (resumed.code, resumed.err) == (0, "")
    assert by_key("a.jsonl") == by_key("whole.jsonl")
    assert {episode.agent for episode in by_key("a.jsonl")} == {"mine:act"}


def test_a_file_of_an_earlier_version_wants_its_agent_named(run_gem: RunGem) -> None:
    """Its records do not name it, so nothing is taken for granted."""
    run_gem("run", COUNTDOWN, "-n", "2", "-o", "a.jsonl")
    Path("a.jsonl").write_text(Path("a.jsonl").read_text().replace('"agent": "random"', '"agent": null'))
    assert run_gem("run", COUNTDOWN, "-n", "3", "--resume", "a.jsonl").code == 2
    assert run_gem("run", COUNTDOWN, "-n", "3", "-a", "random", "--resume", "a.jsonl").code == 0
