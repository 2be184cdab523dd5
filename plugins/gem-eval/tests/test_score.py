"""``gem score``: graders of all kinds, what is written, what goes on after an interrupt, and what cannot be forged."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from indexed_runs import verdicts, write_index

import gem_core as gem
import gem_eval
from gem_core import Episode, Transition
from gem_core.cli import cli
from gem_core.errors import ArgumentError, RequestError
from gem_core.records import read_episodes, write_episodes
from gem_eval.scoring.grading import find_grader
from gem_eval.scoring.judge import asked, model_judge

ID = "game:GuessTheNumber-v0-hard"


def call(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["score", *map(str, arguments)])


def guess(observation: Any, context: Any) -> str:
    return context.sample_random_action()


@pytest.fixture(scope="module")
def episodes() -> list[Episode]:
    return list(gem.rollout(gem.make(ID), guess, episodes=6, seed=3))


@pytest.fixture
def played(tmp_path: Path, episodes: list[Episode]) -> Path:
    path = tmp_path / "run.jsonl"
    write_episodes(path, episodes)
    return path


@pytest.mark.parametrize(
    ("returned", "value", "metrics"),
    [
        (True, 1.0, {}),
        (0.25, 0.25, {}),
        (np.bool_(True), 1.0, {}),
        (np.float32(0.25), 0.25, {}),
        ({"short": False, "n": 3}, 0.0, {"short": 0.0, "n": 3.0}),
        (None, None, {}),
    ],
)
def test_a_grader_returns_verdicts_numbers_or_several(played: Path, returned: Any, value: Any, metrics: Any) -> None:
    """Plain or as a coroutine; the record is never changed."""
    before = played.read_bytes()

    async def later(episode: Episode) -> Any:
        return returned

    for grader in (lambda episode: returned, later):
        graded = gem_eval.score(played, grader, name="mine", overwrite=True).graded
        assert len(graded) == 6
        assert {(each.value, tuple(each.metrics.items())) for each in graded.values()} == {
            (value, tuple(metrics.items()))
        }
    assert played.read_bytes() == before


@pytest.mark.parametrize("returned", ["yes", float("nan"), {}, {"a": "b"}, [1]])
def test_what_is_no_grade_is_an_error_and_never_0(played: Path, returned: Any) -> None:
    """So is a grader that raises."""
    found = gem_eval.score(played, lambda episode: returned, name="mine")
    assert len(found.errors) == 6
    assert {each.value for each in found.graded.values()} == {None}
    assert found.tasks[0].new is None


def test_old_and_new_verdicts_are_compared(
    played: Path, episodes: list[Episode], monkeypatch: Any, tmp_path: Path
) -> None:
    """Those that changed are listed with their numbers; an episode that cannot be read is an error of its own."""
    (tmp_path / "graders.py").write_text("def odd(episode): return episode.turns % 2 == 1")
    monkeypatch.chdir(tmp_path)
    changed = [
        number
        for number, episode in enumerate(episodes, start=1)
        if episode.success is not None and episode.success != (episode.turns % 2 == 1)
    ]
    told = json.loads(call(played, "--grader", "graders:odd", "--json").output)
    assert [each["episode"] for each in told["changed"]] == changed
    assert told["scores"][0]["changed"] == len(changed)
    assert f"episode {changed[0]}: " in call(played, "--grader", "graders:odd").output
    run = write_index(tmp_path / "run", verdicts("10"))
    assert len(gem_eval.score(run, lambda episode: True).errors) == 2


def test_an_episode_without_a_verdict_has_none_to_change(tmp_path: Path) -> None:
    """And one for which the grader fails is an error, not one that it cannot tell."""
    write_episodes(
        tmp_path / "run.jsonl", [Episode("x:Y", 1, "?", {}, [Transition("?", gem.Response("!"), 0, True, False, {})])]
    )
    assert gem_eval.score(tmp_path / "run.jsonl", lambda episode: True).changed == []
    (task,) = gem_eval.score(tmp_path / "run.jsonl", lambda episode: 1 / 0, name="fails").tasks
    assert (task.unknown, task.errors) == (0, 1)


def test_scores_go_on_after_an_interrupt_and_failures_are_tried_again(played: Path) -> None:
    """What was graded is kept, also behind a line that was torn."""
    seen: list[int] = []

    def grade(episode: Episode) -> float:
        seen.append(episode.turns)
        if len(seen) == 2:
            raise ValueError("just now")
        if len(seen) == 4:
            raise KeyboardInterrupt
        return 0.5

    with pytest.raises(KeyboardInterrupt):
        gem_eval.score(played, grade)
    path = played.with_suffix(".scores") / "grade.jsonl"
    with path.open("ab") as file:
        file.write(b'{"episode": 4, "rep')
    found = gem_eval.score(played, grade)
    assert (len(seen), len(found.graded), found.errors) == (4 + 4, 6, {})
    assert gem_eval.score(played, grade).graded == found.graded
    assert len(seen) == 4 + 4


def test_the_environment_grades_again_without_the_agent(played: Path) -> None:
    """Replays that go as recorded change nothing; what goes another way is named."""
    result = call(played, "--grader", "env")
    assert (result.exit_code, "verdict" in result.output) == (0, False)
    assert {each.note for each in gem_eval.score(played, "env").graded.values()} == {None}
    output = call(played, "--grader", "env", "--set", "max_turns=2", "--name", "two").output
    assert "episode 1: not as recorded: the first observation" in output


def test_runs_are_compared_by_scores(played: Path, tmp_path: Path) -> None:
    """Those of a name that both have."""
    other = tmp_path / "other.jsonl"
    write_episodes(other, read_episodes(played))
    gem_eval.score(played, lambda episode: True, name="mine")
    with pytest.raises(ArgumentError, match="'mine'"):
        gem_eval.compare(played, other, scores="mine")
    gem_eval.score(other, lambda episode: False, name="mine")
    found = gem_eval.compare(played, other, scores="mine")
    assert (found.overall.a, found.overall.b, found.overall.only_a) == (1, 0, 6)


class Examiner:
    """A model that says what a test wants."""

    def __init__(self, *replies: Any) -> None:
        self.replies = list(replies)
        self.asked: list[str] = []

    async def __call__(self, observation: Any, context: Any) -> str:
        self.asked.append(observation)
        reply = self.replies[(len(self.asked) - 1) % len(self.replies)]
        if isinstance(reply, Exception):
            raise reply
        return str(reply)


def test_a_judge_passes_fails_or_cannot_tell(played: Path) -> None:
    """By the last line of its reply, whose end is kept."""
    model = Examiner("Fine.\nVERDICT: PASS", "**VERDICT: FAIL**", "VERDICT: UNKNOWN")
    found = gem_eval.score(played, model_judge(model), max_concurrency=1)
    assert [each.value for each in found.graded.values()] == [1, 0, None] * 2
    assert found.graded[1].note == "Fine.\nVERDICT: PASS"
    assert (found.tasks[0].new.mean, found.tasks[0].unknown) == (0.5, 2)


def test_a_judge_that_fails_is_an_error_of_that_episode(played: Path) -> None:
    """As one that does not answer, or gives no verdict."""
    model = Examiner(RequestError("no route"), "VERDICT: PASS")
    found = gem_eval.score(played, model_judge(model), max_concurrency=1)
    assert list(found.errors.values()) == ["the judge gave no verdict: no route"] * 3


def test_a_long_transcript_keeps_its_beginning_and_its_end() -> None:
    """What is left out is said."""
    turns = [Transition("o" * 9000, gem.Response(f"action {n}"), 0.0, False, False, {}) for n in range(40)]
    question = json.dumps(asked(Episode("x:Y", 1, "The task.", {}, turns, "The end."), "Did it?")[1])
    assert len(question) < 120_000
    assert "The task." in question
    assert "action 39" in question
    assert '{"left out": "' in question


def test_graders_that_do_not_fit_are_refused(played: Path) -> None:
    """As those of that name with other settings, whose scores would be mixed."""
    with pytest.raises(ArgumentError, match="module:function"):
        find_grader("nothing")
    with pytest.raises(ArgumentError, match="rubric"):
        find_grader("env", rubric="Be kind.")
    gem_eval.score(played, "env")
    with pytest.raises(ArgumentError, match="--overwrite"):
        gem_eval.score(played, "env", kwargs={"max_turns": 3})
    assert gem_eval.score(played, "env", kwargs={"max_turns": 3}, overwrite=True).graded[1].note
    pytest.importorskip("gem_openai")
    judge = find_grader("openai:gpt/5", rubric="Be kind.", options={"base_url": "http://localhost:1/v1"})
    assert (judge.name, judge.described["rubric"]) == ("openai-gpt-5", "Be kind.")
