"""gem audit: planted defects are found, sound environments stay without a problem, and harm is done to none."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import planted
import pytest

import gem_core as gem
import gem_eval
from gem_core.cli import main
from gem_core.errors import ArgumentError
from gem_eval.auditing.texts import holds

if TYPE_CHECKING:
    from gem_eval.auditing.results import EnvAudit

DEFECTS = planted.planted()
SLOW = {"shell", "exit-code", "shell-here"}
"""Those that start processes."""


def audited(name: str, entry: Any, options: dict[str, Any], **more: Any) -> EnvAudit:
    """Register an environment, and return what an audit finds."""
    env_id = f"audit-test:{name}"
    if env_id not in gem.list_envs("audit-test"):
        gem.register(env_id, entry, **options)
    (found,) = gem_eval.audit(env_id, **more)
    assert not found.failure
    return found


def kinds(found: EnvAudit) -> set[str]:
    """Return the kinds of problems that count."""
    return {problem.kind for problem in found.problems if problem.fails}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.thorough] if name in SLOW else []) for name in DEFECTS]
)
def test_planted_defects_are_found(name: str) -> None:
    """Each by the kind of problem that it is, with an example."""
    entry, options, kind = DEFECTS[name]
    found = audited(name, entry, options, limit=20 if name not in SLOW else 4)
    assert kind in kinds(found)
    assert found.fails()
    assert all(problem.examples for problem in found.problems if problem.kind == kind and problem.fails)


@pytest.mark.parametrize("name", list(planted.sound()))
def test_sound_environments_have_no_problem(name: str) -> None:
    """Whatever chance, options and passages there are."""
    found = audited(name, *planted.sound()[name])
    assert kinds(found) == set()


@pytest.mark.few(1)
@pytest.mark.parametrize("env_id", ["math:Sample", "game:Wordle-v0-easy", "game:TowerofHanoi-v0-easy"])
def test_our_own_are_sound(env_id: str) -> None:
    """Gold actions succeed in all rows, and no exploit in any."""
    (found,) = gem_eval.audit(env_id, limit=6)
    assert kinds(found) == set()
    assert found.rates["gold"].solved == found.rates["gold"].episodes == 6
    assert all(rate.solved == 0 for rate in found.rates.values() if rate.kind == "exploit")


def test_what_could_do_harm_is_not_run_on_this_machine() -> None:
    """Once a command has shown that no sandbox holds it, none of the others is sent."""
    planted.ShellHere.commands.clear()
    found = audited("harm", planted.ShellHere, {}, limit=1)
    assert "tamper" in kinds(found)
    commands = "\n".join(planted.ShellHere.commands)
    assert "written" in commands
    assert not any(word in commands for word in ("reward.txt", "conftest", "/usr/local/bin", "exit 0"))


def test_threshold_is_a_share(capsys: pytest.CaptureFixture[str]) -> None:
    """A problem of no larger share lets the command end well; without --threshold any is one too many."""
    gem.register("audit-test:one-empty", gem.DatasetEnv, rows=[*planted.ROWS, {"question": "Laos?", "answer": None}])
    for arguments, code in (([], 1), (["--threshold", "0.05"], 0)):
        with pytest.raises(SystemExit) as ended:
            main(["audit", "audit-test:one-empty", *arguments])
        assert ended.value.code == code
    assert "1 of 21 rows have no gold answer" in capsys.readouterr().out


def test_json_has_rates_and_problems(capsys: pytest.CaptureFixture[str]) -> None:
    """The whole of what the table shows, for a program."""
    gem.register("audit-test:json", gem.DatasetEnv, rows=planted.ROWS, grade="planted:accepts_nothing")
    with pytest.raises(SystemExit) as ended:
        main(["audit", "audit-test:json", "--limit", "5", "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert (ended.value.code, printed["sound"], printed["threshold"]) == (1, False, 0.0)
    (found,) = printed["environments"]
    null = found["policies"]["null"]
    assert (null["kind"], null["episodes"], null["rate"]) == ("exploit", 25, null["solved"] / 25)
    assert found["policies"]["gold"] == {"kind": "gold", "solved": 5, "episodes": 5, "rate": 1.0}
    assert {"null", "echo", "hedge"} >= {problem["kind"] for problem in found["problems"] if problem["fails"]}


def test_an_environment_that_cannot_be_made_is_not_sound(capsys: pytest.CaptureFixture[str]) -> None:
    """It is told why, and the others are audited all the same."""
    gem.register("audit-test:fine", gem.DatasetEnv, rows=planted.ROWS)
    gem.register("audit-test:missing", gem.DatasetEnv, dataset_name="missing.jsonl")
    with pytest.raises(SystemExit) as ended:
        main(["audit", "audit-test:missing", "audit-test:fine", "--limit", "2"])
    printed = capsys.readouterr().out
    assert ended.value.code == 1
    assert "not audited: " in printed
    assert printed.splitlines()[2].endswith("none")


def test_environments_of_several_agents_are_refused() -> None:
    """By name; a glob leaves them out."""
    with pytest.raises(ArgumentError, match="game:TicTacToe-v0 is for several agents"):
        gem_eval.audit("game:TicTacToe-v0")


def test_the_same_seed_finds_the_same() -> None:
    """Which rows are played, and by which variants, depends on the seed alone."""
    first, second = (gem_eval.audit("game:Mastermind-v0-easy", limit=9, seed=7)[0].to_dict() for _ in range(2))
    assert first == second


@pytest.mark.parametrize(
    ("text", "part", "held"),
    [("the 4 cows", "4", True), ("the 14 cows", "4", False), ("4.5 cows", "4", False), ("cows: 4.", "4", True),
     ("paris, france", "paris", True), ("parish", "paris", False), ("(-4)", "-4", True), ("x", "", False)],
)  # fmt: skip
def test_a_word_is_held_only_whole(text: str, part: str, held: bool) -> None:
    """A piece of a longer number or word is another one."""
    assert holds(text, part) is held
