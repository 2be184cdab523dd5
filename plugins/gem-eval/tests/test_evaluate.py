"""An evaluation: what is played, what is recorded, and that a stopped run goes on to the same end."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import gem_core as gem
from gem_core import Response
from gem_core.errors import ArgumentError, RequestError
from gem_core.rollouts import Context
from gem_eval import Limits, Suite, compare, compute_scores, evaluate, open_run
from gem_eval.running.evaluation import EvaluationSession

GAME = "game:GuessTheNumber-v0-easy"
ROWS = [
    {"question": f"{number}+1?", "answer": str(number + 1), "level": number % 3, "id": f"q{number}"}
    for number in range(9)
]


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    gem.register("evaltest:Sums", "gem_core:DatasetEnv", rows=ROWS, id_key="id")


def right(observation: str) -> Response:
    """Answer a sum; every answer takes 12 tokens."""
    number = int(observation.partition("+")[0])
    return Response(f"\\boxed{{{number + 1}}}", usage={"prompt_tokens": 10, "completion_tokens": 2})


def wrong(observation: str) -> str:
    return "\\boxed{-1}"


def guesses(observation: str, context: Context) -> Response:
    return Response(context.sample_random_action(), usage={"prompt_tokens": 10, "completion_tokens": 2})


def suite(*tasks: dict[str, Any], **fields: Any) -> Suite:
    return Suite.model_validate({"name": "test", "tasks": list(tasks), **fields})


def told(run: Any) -> set[Any]:
    """What must be the same whenever a run was stopped: all but times."""
    return {
        json.dumps([row.id, row.model, row.row, row.epoch, row.success, run.episode(row).to_dict()], sort_keys=True)
        for row in run.rows
    }


def test_tasks_and_models_are_played_in_one_run() -> None:
    """Each row by each model, as often as there are epochs, and scored."""
    run = evaluate(suite({"id": "evaltest:Sums"}, epochs=2), {"a": right, "b": wrong})
    assert len(run.rows) == 9 * 2 * 2
    by_model = {score.model: score.mean for score in compute_scores(run.rows) if score.metric == "success"}
    assert by_model == {"a": 1.0, "b": 0.0}
    assert {row.row for row in run.rows} == {f"evaltest:Sums/q{number}" for number in range(9)}


def test_what_a_suite_says_is_said_by_arguments_too() -> None:
    """Of ids or of a suite; a name that is none is told the nearest."""
    run = evaluate(["evaltest:Sums"], {"a": right}, epochs=2, limit=3, where="level == 1", seed=4)
    assert sorted((row.row, row.epoch) for row in run.rows) == [
        (f"evaltest:Sums/q{number}", epoch) for number in (1, 4, 7) for epoch in (0, 1)
    ]
    assert run.info["seed"] == 4
    fewer = evaluate(suite({"id": "evaltest:Sums", "limit": 3}, epochs=2), {"a": right}, limit=1, epochs=1)
    assert len(fewer.rows) == 1
    with pytest.raises(ArgumentError, match=r"epoch: .*Did you mean 'epochs'"):
        evaluate(["evaltest:Sums"], {"a": right}, epoch=4)  # type: ignore[call-arg]


def test_two_runs_of_a_suite_have_the_same_rows_and_seeds() -> None:
    """Whatever else is played beside, so that runs are compared row by row."""
    one = evaluate(suite({"id": GAME, "episodes": 3}), {"a": guesses})
    two = evaluate(suite({"id": "evaltest:Sums"}, {"id": GAME, "episodes": 5}), {"a": guesses, "b": guesses})
    shared = {row.row for row in one.rows} & {row.row for row in two.rows}
    assert len(shared) == 3
    seeds = {(row.row, row.seed) for run in (one, two) for row in run.rows if row.row in shared}
    assert len(seeds) == 3


@pytest.mark.parametrize(
    ("choice", "chosen"),
    [
        ({"limit": 2}, ["q0", "q1"]),
        ({"sample_ids": ["q5", "q2", "q5"]}, ["q5", "q2"]),
        ({"where": "level == 2 and id != 'q8'"}, ["q2", "q5"]),
        ({"where": "level == 0", "limit": 1}, ["q0"]),
    ],
)
def test_rows_are_chosen(choice: dict[str, Any], chosen: list[str]) -> None:
    """By number, id or condition."""
    run = evaluate(suite({"id": "evaltest:Sums", **choice}), {"a": right}, max_concurrency=1)
    assert [row.row.partition("/")[2] for row in run.rows] == chosen


def test_a_role_is_given_to_environments_that_have_it() -> None:
    """As the judge of an environment whose keyword it is."""
    gem.register("evaltest:Judged", "gem_core:DatasetEnv", rows=ROWS[:1])
    run = evaluate(
        suite({"id": "evaltest:Judged"}, roles={"prompt_template": "Say {question}", "judge": "x"}), {"a": wrong}
    )
    assert run.episode(run.rows[0]).observation == "Say 0+1?"


def test_a_model_is_also_played_perturbed() -> None:
    """On the same rows and seeds, its wrappers between tools and views; the record can be compared."""
    tasks = suite({"id": "evaltest:Sums", "limit": 3, "tools": ["search"], "wrappers": ["concat"]})
    run = evaluate(tasks, {"a": right}, perturb=["tool_429:rate=1,typos"], out="run")
    stacks = {row.model: [name for name, _ in run.episode(row).wrappers] for row in run.rows}
    assert stacks == {"a": ["tools", "concat"], "a + tool_429:rate=1,typos": ["tools", "tool_429", "typos", "concat"]}
    plain, perturbed = ({(row.row, row.seed) for row in run.rows if row.model == name} for name in stacks)
    assert plain == perturbed
    assert compare("run").a.model == "a"
    with pytest.raises(ArgumentError, match="--out"):  # it goes on only with the same variants
        evaluate(tasks, {"a": right}, out="run")
    with pytest.raises(ArgumentError, match="name tools before it"):
        evaluate(["evaltest:Sums"], {"a": right}, perturb=["tool_429"])


def test_the_record_says_what_episodes_took() -> None:
    """Seconds, steps a second, tokens, and the share of rows from which GRPO learns nothing."""
    evaluate(suite({"id": "evaltest:Sums"}, epochs=2), {"a": right}, out="run")
    (taken,) = json.loads(Path("run/metrics.json").read_text())["times"]
    assert (taken["episodes"], taken["turns"], taken["tokens_in"], taken["tokens_out"]) == (18, 1, 10, 2)
    assert 0 < taken["env_seconds"]["p50"] <= taken["seconds"]["p99"]
    assert taken["steps_per_second"] > 0
    assert taken["equal_rows"] == 1.0


class Stopper:
    """An agent that interrupts the run at one of its answers."""

    def __init__(self, after: int) -> None:
        self.left = after

    def __call__(self, observation: str, context: Context) -> Response:
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        return guesses(observation, context)


@pytest.mark.parametrize("after", [0, 7])
def test_a_stopped_run_goes_on_to_the_same_end(after: int) -> None:
    """By the same call, whatever stopped it."""
    tasks = suite({"id": GAME, "episodes": 6}, epochs=2)
    whole = told(evaluate(tasks, {"a": guesses}, out="whole"))
    with pytest.raises(KeyboardInterrupt):
        evaluate(tasks, {"a": Stopper(after)}, out="stopped", max_concurrency=3)
    assert open_run("stopped").info["status"] == "stopped"
    run = evaluate(tasks, {"a": guesses}, out="stopped")
    assert told(run) == whole
    assert (run.info["status"], len(run.info["sessions"])) == ("finished", 2)


def test_the_same_call_finds_the_run_that_was_stopped() -> None:
    """And begins another once it is finished."""
    tasks = suite({"id": GAME, "episodes": 2})
    with pytest.raises(KeyboardInterrupt):
        evaluate(tasks, {"a": Stopper(1)})
    first = evaluate(tasks, {"a": guesses})
    assert len(list(Path("runs").iterdir())) == 1
    assert evaluate(tasks, {"a": guesses}).path != first.path


def test_an_index_that_was_damaged_is_read_again_once_it_is_mended() -> None:
    """What a session had read of it before it played counts no longer."""
    tasks = suite({"id": GAME, "episodes": 4})
    whole = told(evaluate(tasks, {"a": guesses}, out="run"))
    index = Path("run", "index.jsonl")
    first, _, *rest = index.read_bytes().splitlines(keepends=True)
    index.write_bytes(first + b"?\n" + b"".join(rest))
    session = EvaluationSession(tasks, {"a": guesses}, out="run")
    assert session.already_done() == 3
    assert list(session.play()) == []
    assert told(session.run) == whole


CHILD = """
import sys, time
import gem_core as gem
from gem_eval import Suite, evaluate

def guesses(observation, context):
    return context.sample_random_action()

tasks = Suite.model_validate({"name": "test", "tasks": [{"id": "game:GuessTheNumber-v0-easy", "episodes": 400}]})
evaluate(tasks, {"a": guesses}, out="run", on_episode=lambda row: print(row.number, flush=True))
"""


def test_a_killed_run_goes_on_to_the_same_end() -> None:
    """``kill -9`` at any moment loses nothing that was written."""
    at = 40
    tasks = suite({"id": GAME, "episodes": 400})
    child = subprocess.Popen([sys.executable, "-c", CHILD], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    with child, child.stdout as lines:
        for line in lines:
            if int(line) >= at:
                child.send_signal(signal.SIGKILL)
                break
    assert at <= len(open_run("run").rows) < 400

    def sampled(observation: str, context: Context) -> str:
        return context.sample_random_action()

    assert told(evaluate(tasks, {"a": sampled}, out="run")) == told(evaluate(tasks, {"a": sampled}, out="whole"))


def failing(cause: str, fails: set[str]) -> Any:
    def agent(observation: str) -> Response:
        if observation in fails:
            raise RequestError("no answer", cause=cause)
        return right(observation)

    return agent


def test_errors_are_left_out_and_played_again_when_asked() -> None:
    """They stay until then."""
    tasks = suite({"id": "evaltest:Sums"})
    run = evaluate(tasks, {"a": failing("rate_limit", {"3+1?"})}, out="run")
    (score,) = [score for score in compute_scores(run.rows) if score.metric == "success"]
    assert (score.mean, score.episodes, score.errors, score.with_errors) == (1.0, 8, 1, pytest.approx(8 / 9))
    assert [row.cause for row in run.rows if row.error] == ["rate_limit"]
    assert sum(row.error is not None for row in evaluate(tasks, {"a": right}, out="run").rows) == 1
    again = evaluate(tasks, {"a": right}, out="run", retry_errors=True)
    assert [row.success for row in again.rows] == [True] * 9


@pytest.mark.parametrize(
    ("limit", "reason"), [({"episode_tokens": 13}, "token budget"), ({"episode_cost": 1e-9}, "cost")]
)
def test_a_limit_of_an_episode_cuts_it_off(limit: dict[str, Any], reason: str) -> None:
    """It is truncated with its reason, counts as not solved, and is no error."""
    Path("prices.json").write_text('{"models": {"a": {"input": 1, "output": 1}}}')
    run = evaluate(
        suite({"id": "game:Mastermind-v0-hard", "episodes": 3}),
        {"a": guesses},
        limits=Limits(**limit),
        prices="prices.json",
    )
    assert {(row.cut_off, row.success, row.error) for row in run.rows} == {(reason, False, None)}
    assert {row.turns for row in run.rows} == {2 if reason == "token budget" else 1}


async def never(observation: str) -> str:
    await asyncio.Event().wait()
    return ""


@pytest.mark.parametrize(("limit", "reason"), [("episode_time", "time"), ("run_time", "run time")])
def test_a_limit_of_time_gives_up_an_open_request(limit: str, reason: str) -> None:
    """A server that hangs does not hold up the run."""
    run = evaluate(suite({"id": "evaltest:Sums", "limit": 2}), {"a": never}, limits=Limits(**{limit: 0.2}))
    assert {row.cut_off for row in run.rows} <= {reason}  # a busy machine may have played none
    assert run.info["status"] == ("stopped" if limit == "run_time" else "finished")


def test_a_limit_of_the_run_stops_it_and_a_higher_one_goes_on() -> None:
    """Episodes that it cut off are played again."""
    tasks = suite({"id": "game:Mastermind-v0-hard", "episodes": 6})
    run = evaluate(tasks, {"a": guesses}, out="run", limits=Limits(run_tokens=40), max_concurrency=2)
    assert run.info["reason"] == "run tokens"
    assert 0 < len(run.rows) < 6
    assert "run tokens" in {row.cut_off for row in run.rows}
    assert told(evaluate(tasks, {"a": guesses}, out="run")) == told(evaluate(tasks, {"a": guesses}, out="whole"))


def test_the_record_says_what_was_run() -> None:
    """Versions, seeds, rows, and nothing secret."""
    gem.register("evaltest:Keyed", "gem_core:DatasetEnv", rows=ROWS[:1])
    run = evaluate(suite({"id": "evaltest:Keyed"}), {"a": right})
    info = run.info
    assert info["versions"]["gem-core"] == gem.__version__
    assert (info["tasks"][0]["id"], info["tasks"][0]["rows"], info["tasks"][0]["rows_in_all"]) == (
        "evaltest:Keyed",
        1,
        1,
    )
    assert len(info["tasks"][0]["data_sha256"]) == 64
    assert (info["seed"], info["epochs"], info["episodes"], info["status"]) == (0, 1, 1, "finished")


@pytest.mark.parametrize(
    ("tasks", "message"),
    [
        ([{"id": GAME, "where": "level == 1"}], "where has no meaning there"),
        ([{"id": "evaltest:Sums", "where": "level > 7"}], "none of 9 rows is left"),
        ([{"id": "evaltest:Sums", "sample_ids": ["q77"]}], "q77"),
        ([{"id": GAME}, {"id": GAME, "limit": 3}], "two tasks are called"),
        ([{"id": "game:TicTacToe-v0"}], "several seats"),
    ],
)
def test_what_cannot_be_evaluated_is_said(tasks: list[dict[str, Any]], message: str) -> None:
    """And no folder is left."""
    with pytest.raises(ArgumentError, match=message):
        evaluate(suite(*tasks), {"a": guesses})
    assert not os.path.exists("runs")
