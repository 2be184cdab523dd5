"""gem bench-env: times, memory, tokens, rewards and groups of environments."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from perturbed import register

from gem_core import Episode, Response, Transition
from gem_core.cli import main
from gem_core.errors import GemError
from gem_eval.measuring.measure import (
    Bin,
    EnvMeasurement,
    Groups,
    Times,
    count_sent,
    histogram,
    measure_times,
    times,
    token_counter,
)
from gem_eval.measuring.memory import growth, measure_memory, resident_bytes

register()

ECHO = ("perturbed:Echo-v0", "--model", "perturbed:literal", "--no-memory")


class Outcome(NamedTuple):
    """What one call of the command did."""

    code: int
    out: str
    err: str


@pytest.fixture
def bench(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Call gem bench-env in this process, in a folder of its own."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> Outcome:
        with pytest.raises(SystemExit) as caught:
            main(["bench-env", *arguments])
        return Outcome(int(caught.value.code or 0), *capsys.readouterr())

    return call


def episode(key: str, *rewards: float, usage: dict[str, int] | None = None) -> Episode:
    turns = [Transition("abcd" * 5, Response("x", usage=usage), reward, False, False, {}) for reward in rewards]
    return Episode("perturbed:Echo-v0", 1, "abcd" * 5, {}, turns, key=key, reads="observation")


def test_all_figures_are_in_the_json(bench: Any) -> None:
    """Of an agent that solves each of three groups: times, tokens, rewards and groups."""
    outcome = bench(*ECHO, "--groups", "3", "--group-size", "2", "--json")
    assert outcome.code == 0
    (measured,) = json.loads(outcome.out)["environments"]
    assert (measured["episodes"], measured["errors"], measured["turns"], measured["success_rate"]) == (6, 0, 1.0, 1.0)
    assert measured["returns"] == measured["rewards"] == [{"low": 1.0, "high": 1.0, "number": 6}]
    assert measured["groups"] == {"number": 3, "equal": 1.0, "zero": 0.0, "one": 1.0}
    assert measured["tokens"] == 11  # of 42 characters
    assert measured["reset_s"]["calls"] == measured["step_s"]["calls"] == 6
    assert 0 < measured["step_s"]["p50"] <= measured["step_s"]["p99"]
    assert measured["memory"] is None


def test_the_table_and_the_bars_are_plain_lines(bench: Any) -> None:
    """A line for each environment, then a bar for each reward and return."""
    outcome = bench(*ECHO, "--groups", "3", "--group-size", "2")
    lines = outcome.out.splitlines()
    assert " ".join(lines[0].split()) == (
        "environment reset p50 p99 step p50 p99 steps/s memory turns tokens success return equal groups (all 0, all 1)"
    )
    assert lines[1].endswith("-    1.0      11     100%   1.000         100% of 3 (0%, 100%)")
    assert lines[3:] == [
        "perturbed:Echo-v0: 6 episodes",
        "  reward of a turn",
        f"    1  {'#' * 40}  6",
        "  return of an episode",
        f"    1  {'#' * 40}  6",
    ]


def test_what_cannot_run_is_named_and_the_others_are_measured(bench: Any) -> None:
    """The reason is on standard error, and the exit code says that something is missing."""
    outcome = bench(
        "perturbed:Needy-v0", "perturbed:Echo-v0", "--model", "perturbed:literal", "--no-memory", "--groups", "1"
    )
    assert outcome.code == 1
    assert outcome.out.splitlines()[1].startswith("perturbed:Echo-v0")
    assert outcome.err == "gem: perturbed:Needy-v0 is not measured: cannot run here: it is only listed\n"


def test_an_interrupt_prints_what_there_is(bench: Any) -> None:
    """The environments that were measured before are in the table."""
    outcome = bench(
        "perturbed:Echo-v0", "perturbed:Dice-v0", "--model", "perturbed:stops_when_reworded", "--no-memory",
        "--groups", "1",
    )  # fmt: skip
    assert outcome.code == 130
    assert outcome.out.splitlines()[1].startswith("perturbed:Echo-v0")
    assert "Dice" not in outcome.out
    assert outcome.err == "gem: interrupted after 1 of 2 environments\n"


def test_episodes_with_errors_are_left_out_and_told(bench: Any) -> None:
    """Where every episode fails, the first reason is told."""
    outcome = bench("perturbed:Echo-v0", "--model", "perturbed:never_answers", "--no-memory", "--groups", "1")
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err == (
        "gem: perturbed:Echo-v0 is not measured: every episode had an error; the first: agent: the server is gone\n"
    )
    outcome = bench("perturbed:Echo-v0", "--no-memory")  # with the random agent, for which it has no action
    assert "perturbed:Echo-v0 is not measured: Echo does not say what a valid action is" in outcome.err


def test_groups_without_a_difference_are_counted() -> None:
    """Equal, all 0 and all 1, over groups of at least two episodes."""
    measured = EnvMeasurement("x")
    for key, returns in {"0": (0, 0), "1": (1, 1), "2": (0.5, 0.5), "3": (0, 1), "4": (1,)}.items():
        measured.episodes += [episode(key, value) for value in returns]
    assert measured.groups == Groups(number=4, equal=0.75, zero=0.25, one=0.25)
    assert EnvMeasurement("x").groups == Groups(0, None, None, None)


def test_a_models_usage_is_a_mean_over_episodes() -> None:
    """As its server reports it; without reports there is none."""
    measured = EnvMeasurement("x", episodes=[episode("0", 0, 0, usage={"prompt_tokens": 7, "completion_tokens": 2})])
    measured.episodes.append(episode("1", 0))
    assert measured.usage == {"prompt_tokens": 7.0, "completion_tokens": 2.0}
    assert EnvMeasurement("x", episodes=[episode("0", 0)]).usage is None


def test_tokens_are_all_that_the_agent_is_sent() -> None:
    """Of an agent that reads messages, each turn counts the turns before it again."""
    count = token_counter(None)
    assert count_sent(episode("0", 0, 0), count) == 5 + 5
    chat = episode("0", 0, 0)
    chat.reads = "messages"
    assert count_sent(chat, count) == 5 + (5 + 1 + 5)


def test_a_tokenizer_is_a_function_of_the_users() -> None:
    """It returns tokens or their number; one that is not there is told."""
    assert token_counter("builtins:len")("four") == 4
    assert token_counter("builtins:list")("four") == 4
    with pytest.raises(GemError, match="--tokenizer"):
        token_counter("builtins:nothing")


def test_percentiles_are_measured_values() -> None:
    """The nearest rank of 50 and 99 percent."""
    assert times([float(number) for number in range(200, 0, -1)]) == Times(100.0, 198.0, 200)
    assert times([3.0]) == Times(3.0, 3.0, 1)
    assert times([]) == Times(None, None, 0)


def test_times_are_those_of_the_recorded_actions() -> None:
    """By a clock that ticks once each time it is read: each call takes one second, resets and steps apart."""
    ticks: Iterator[int] = iter(range(10_000))
    record = EnvMeasurement("perturbed:Echo-v0", episodes=[episode("0", 0, 0), episode("1", 0)])
    measure_times(record, {}, [], 1e9, clock=lambda: float(next(ticks)))
    assert (record.reset, record.step) == (Times(1.0, 1.0, 2), Times(1.0, 1.0, 2))  # the task ends after one turn
    assert record.steps_per_second == 0.5
    measure_times(record, {}, [], 2.5, clock=lambda: float(next(ticks)))
    assert record.reset.calls == 1


def test_few_values_have_a_bar_each_and_many_share_ten() -> None:
    """Every value is in one bar."""
    assert histogram([0.0, 1.0, 0.0]) == [Bin(0.0, 0.0, 2), Bin(1.0, 1.0, 1)]
    bins = histogram([float(number) for number in range(101)])
    assert [each.number for each in bins] == [10] * 9 + [11]
    assert (bins[0].low, bins[-1].high) == (0.0, 100.0)
    assert histogram([]) == []


def test_memory_is_the_growth_for_each_one_more() -> None:
    """The first, which loads what all share, does not count; it stops once the growth is large enough."""
    made: list[int] = []

    def make() -> object:
        made.append(1)
        return object()

    assert growth(make, lambda: 50_000_000 + 1_000_000 * len(made), 3.0, clock=lambda: 0.0) == (1_000_000, 17)
    assert growth(make, lambda: 7, 3.0, clock=iter([0.0, 4.0]).__next__) == (0.0, 4)
    assert resident_bytes() > 1_000_000


@pytest.mark.thorough
def test_memory_is_measured_in_a_process_of_its_own() -> None:
    """What cannot be made there, or be given to it, is told."""
    pytest.importorskip("gem_games", reason="its games are small; install plugins/gem-games")
    memory = measure_memory("game:GuessTheNumber-v0", {}, ["concat"], limit_s=0.1)
    assert 0 <= memory.bytes_each < 1_000_000
    assert memory.environments >= 4
    with pytest.raises(GemError, match="measuring memory failed: UnknownEnvError: no environment 'game:Nothing'"):
        measure_memory("game:Nothing", {}, [])
    with pytest.raises(GemError, match="its arguments are no plain JSON"):
        measure_memory("game:GuessTheNumber-v0", {"rows": object()}, [])
