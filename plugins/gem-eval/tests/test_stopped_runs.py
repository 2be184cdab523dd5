"""Runs that stop: by errors, by limits; and what they count when they go on."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import pytest

import gem_core as gem
from gem_core import Response
from gem_core.errors import ArgumentError, RequestError
from gem_core.rollouts import Context
from gem_eval import Limits, Suite, evaluate
from gem_eval.running.evaluation import TooManyErrorsError

ROWS = [{"question": f"{number}?", "answer": "1"} for number in range(40)]


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    gem.register("stoptest:Rows", "gem_core:DatasetEnv", rows=ROWS)


def suite(limit: int = 40) -> Suite:
    return Suite.model_validate({"name": "test", "tasks": [{"id": "stoptest:Rows", "limit": limit}]})


def answers(observation: str) -> Response:
    """Each answer takes 12 tokens."""
    return Response("\\boxed{1}", usage={"prompt_tokens": 10, "completion_tokens": 2})


def fails(observation: str) -> str:
    raise RequestError("no answer", cause="server")


def test_the_threshold_alone_stops_a_run_in_which_everything_fails() -> None:
    """However many faults come in a row."""
    with pytest.raises(TooManyErrorsError, match="20 of 20 episodes had an error"):
        evaluate(suite(), {"a": fails}, out="stopped")
    run = evaluate(suite(), {"a": fails}, out="run", error_threshold=1.0)
    assert [row.cause for row in run.rows] == ["server"] * 40


def test_what_was_played_again_counts_against_a_limit_of_the_run() -> None:
    """It was paid for."""

    def guesses(observation: str, context: Context) -> Response:
        return Response(context.sample_random_action(), usage={"prompt_tokens": 10, "completion_tokens": 2})

    game = Suite.model_validate({"name": "test", "tasks": [{"id": "game:Mastermind-v0-hard", "episodes": 2}]})
    for limit in (24, 60, 60):
        run = evaluate(game, {"a": guesses}, out="run", max_concurrency=1, limits=Limits(run_tokens=limit))
    assert sum((row.tokens_in or 0) + (row.tokens_out or 0) for row in [*run.rows, *run.superseded]) == 60


CODE = {
    "stoptest_env.py": "import gem_core\nfrom stoptest_helper import ROWS\n\nEnv = gem_core.DatasetEnv\n",
    "stoptest_helper.py": "ROWS = []\n",
    "stoptest_agent.py": """
from gem_core import Response

def act(observation):
    return Response("1", usage={"prompt_tokens": 10, "completion_tokens": 2})
""",
}


@pytest.mark.parametrize(
    ("file", "told"),
    [
        ("stoptest_helper.py", "the code of stoptest_env (the task stoptest:Code)"),
        ("stoptest_agent.py", "the code of stoptest_agent (the model stoptest_agent:act)"),
    ],
)
def test_a_run_does_not_go_on_quietly_with_other_code(monkeypatch: pytest.MonkeyPatch, file: str, told: str) -> None:
    """Of an environment, with what it imports from its folder, or of an agent; and leaves nothing behind."""
    for name, source in CODE.items():
        Path(name).write_text(source)
        monkeypatch.delitem(sys.modules, name.removesuffix(".py"), raising=False)
    monkeypatch.syspath_prepend(".")
    gem.register("stoptest:Code", "stoptest_env:Env", rows=ROWS[:4])
    arguments: Any = (["stoptest:Code"], "stoptest_agent:act")
    first = evaluate(*arguments, limits=Limits(run_tokens=1), max_concurrency=1)
    Path(file).write_text(f"{CODE[file]}# changed\n")
    with pytest.raises(ArgumentError, match=rf"1 of 4 episodes are there, .*: {re.escape(told)}\. --go-on-anyway"):
        evaluate(*arguments)
    run = evaluate(*arguments, go_on_anyway=True)
    assert (run.path, len(run.rows), run.info["sessions"][-1]["changed"]) == (first.path, 4, [told])


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"limits": Limits(episode_tokens=500)}, "limits.episode_tokens 5 and 500"),
        ({"epochs": 2}, "epochs 1 and 2"),
        ({"kwargs": {"prompt_template": "{question}"}}, "task.stoptest:Rows.kwargs.prompt_template"),
        ({"limit": 3}, "task.stoptest:Rows.rows 2 and 3"),
        ({"perturb": ["typos"]}, "models"),
    ],
)
def test_another_run_in_the_folder_is_told_by_what_differs(changes: Any, told: str) -> None:
    """By name, with the value of both; limits of the run may differ."""
    given: Any = {"out": "run", "limits": Limits(episode_tokens=5)}
    evaluate(suite(2), {"a": answers}, **{**given, "limits": Limits(episode_tokens=5, run_tokens=12)})
    with pytest.raises(ArgumentError) as caught:
        evaluate(suite(2), {"a": answers}, **{**given, **changes})
    assert told in str(caught.value)
    assert len(evaluate(suite(2), {"a": answers}, **given).rows) == 2


def test_a_run_that_cannot_begin_leaves_no_folder() -> None:
    """Whether a price is missing or an agent cannot be prepared."""

    class Unready:
        def prepare(self) -> None:
            raise ArgumentError("no key")

        def __call__(self, observation: str) -> str:
            return observation

    with pytest.raises(ArgumentError, match="there is no price"):
        evaluate(suite(), {"a": answers}, limits=Limits(run_cost=1.0))
    with pytest.raises(ArgumentError, match="no key"):
        evaluate(suite(), {"a": Unready()})
    assert list(Path().glob("runs/*")) == []
