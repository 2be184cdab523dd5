"""Measure an environment: time of steps and resets, tokens, rewards, and groups without a difference."""

from __future__ import annotations

import importlib
import itertools
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import gem_core as gem
from gem_core import Episode
from gem_core.env import texts_of
from gem_core.errors import ArgumentError, MissingRequirementError
from gem_core.making import WrapperChoice
from gem_core.records import group_plan
from gem_core.registry import load_entry_point
from gem_core.rollouts import Agent, default_plan

if TYPE_CHECKING:
    from gem_eval.measuring.memory import Memory

_CHARACTERS = 4
_FEW_VALUES = 10

CountTokens = Callable[[str], int]


class Bin(NamedTuple):
    """A bar of a histogram: how many values are from ``low`` up to ``high``, which are equal for a single value."""

    low: float
    high: float
    number: int


class Groups(NamedTuple):
    """Groups of episodes that started alike.

    Args:
        number: Groups of at least two episodes without an error.
        equal: Share of those whose returns are all equal, from which group-relative advantages learn nothing.
        zero: Share of those whose returns are all 0.
        one: Share of those whose returns are all 1.
    """

    number: int
    equal: float | None
    zero: float | None
    one: float | None


class Times(NamedTuple):
    """Durations of calls, in seconds: their 50th and 99th percentile, and how many were measured."""

    p50: float | None
    p99: float | None
    calls: int


_UNTIMED = Times(None, None, 0)
_USAGE = ("prompt_tokens", "completion_tokens")


@dataclass
class EnvMeasurement:
    """What was measured of one environment.

    Args:
        id: The environment.
        error: Why it could not be measured; None where it could.
        episodes: Those that were played, without those with an error.
        errors: Number of episodes with an error.
        reset: Durations of resets.
        step: Durations of steps.
        memory: What one more environment costs; None where that was not measured.
        tokens: What the agent was sent, in tokens for each episode.
        notes: What could not be measured, in a line each.
    """

    id: str
    error: str | None = None
    episodes: list[Episode] = field(default_factory=list)
    errors: int = 0
    reset: Times = _UNTIMED
    step: Times = _UNTIMED
    steps_per_second: float | None = None
    memory: Memory | None = None
    tokens: list[int] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def returns(self) -> list[float]:
        """The return of each episode."""
        return [episode.episode_return for episode in self.episodes]

    @property
    def rewards(self) -> list[float]:
        """The reward of each turn."""
        return [turn.reward for episode in self.episodes for turn in episode.transitions]

    @property
    def mean_return(self) -> float | None:
        """Mean return of an episode."""
        return _mean(self.returns)

    @property
    def mean_turns(self) -> float | None:
        """Mean number of turns of an episode."""
        return _mean([episode.turns for episode in self.episodes])

    @property
    def mean_tokens(self) -> float | None:
        """Mean number of tokens that the agent was sent in an episode."""
        return _mean(self.tokens)

    @property
    def groups(self) -> Groups:
        """The groups, by the items of the plan."""
        returns: dict[str, list[float]] = {}
        for episode in self.episodes:
            returns.setdefault(episode.key, []).append(episode.episode_return)
        groups = [each for each in returns.values() if len(each) > 1]
        if not groups:
            return Groups(0, None, None, None)
        equal = [each[0] for each in groups if len(set(each)) == 1]
        return Groups(
            len(groups), len(equal) / len(groups), equal.count(0.0) / len(groups), equal.count(1.0) / len(groups)
        )

    @property
    def success_rate(self) -> float | None:
        """Share of the episodes of which success is known that succeeded; None without such episodes."""
        known = [episode.success for episode in self.episodes if episode.success is not None]
        return sum(known) / len(known) if known else None

    @property
    def usage(self) -> dict[str, float] | None:
        """Mean number of tokens that a model read and wrote in an episode; None where no server reports them."""
        reported = [turn.action.usage for episode in self.episodes for turn in episode.transitions if turn.action.usage]
        if not reported:
            return None
        total = {name: sum(_count(usage.get(name)) for usage in reported) for name in _USAGE}
        return {name: count / len(self.episodes) for name, count in total.items()}

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as plain JSON; times in seconds, memory in bytes."""
        if self.error is not None:
            return {"id": self.id, "error": self.error}
        return {
            "id": self.id,
            "error": None,
            "episodes": len(self.episodes),
            "errors": self.errors,
            "turns": self.mean_turns,
            "success_rate": self.success_rate,
            "reset_s": self.reset._asdict(),
            "step_s": self.step._asdict(),
            "steps_per_second": self.steps_per_second,
            "memory": None if self.memory is None else self.memory._asdict(),
            "tokens": self.mean_tokens,
            "usage": self.usage,
            "rewards": [each._asdict() for each in histogram(self.rewards)],
            "returns": [each._asdict() for each in histogram(self.returns)],
            "groups": self.groups._asdict(),
            "notes": self.notes,
        }


def play(
    env: tuple[str, Mapping[str, Any]],
    agent: Agent,
    *,
    wrappers: Sequence[WrapperChoice],
    seed: int,
    groups: int,
    group_size: int,
    num_envs: int,
) -> Iterator[Episode]:
    """Play groups of episodes that start alike.

    Args:
        env: Id and keyword arguments.
        agent: Who acts.
        wrappers: Put around the environment.
        seed: Of the run.
        groups: Number of starts; of a data set the first rows, or all if there are fewer.
        group_size: Episodes of each.
        num_envs: Environments at once.

    Raises:
        GemError: The environment cannot be made.
    """
    with closing(gem.make_vec([env], num_envs, seed=seed, wrappers=wrappers)) as vector:
        rows = vector.num_tasks(*env)
        plan = default_plan(vector, groups if rows is None else min(rows, groups))
        yield from gem.rollout(vector, agent, plan=list(group_plan(plan, group_size)))


def measure_times(
    measured: EnvMeasurement,
    kwargs: Mapping[str, Any],
    wrappers: Sequence[WrapperChoice],
    limit_s: float,
    clock: Callable[[], float] = time.perf_counter,
) -> None:
    """Play the recorded actions again in one environment, one call after the other, and measure each.

    The first reset, which may load data, is left out.

    Args:
        measured: Holds the episodes; the times are put there.
        kwargs: Keyword arguments of the environment.
        wrappers: Put around it.
        limit_s: Seconds after which no further episode is begun.
        clock: Returns the time in seconds.
    """
    resets: list[float] = []
    steps: list[float] = []
    with closing(gem.make(measured.id, wrappers=wrappers, **kwargs)) as env:
        env.reset(seed=measured.episodes[0].seed, options=_options(measured.episodes[0]))
        started = clock()
        for episode in measured.episodes:
            if clock() - started > limit_s:
                break
            before = clock()
            env.reset(seed=episode.seed, options=_options(episode))
            resets.append(clock() - before)
            for turn in episode.transitions:
                before = clock()
                _, _, terminated, truncated, _ = env.step(turn.action)
                steps.append(clock() - before)
                if terminated or truncated:
                    break
    measured.reset, measured.step = times(resets), times(steps)
    total = sum(resets) + sum(steps)
    measured.steps_per_second = len(steps) / total if total > 0 and steps else None


def count_sent(episode: Episode, count_tokens: CountTokens) -> int:
    """Return how many tokens an agent was sent in an episode: of each turn, all that it was sent, history included."""
    sent = (episode.sent(turn) for turn in range(episode.turns))
    return sum(count_tokens(text) for observation in sent for text in texts_of(observation))


def token_counter(tokenizer: str | None) -> CountTokens:
    """Return what counts the tokens of a text.

    Args:
        tokenizer: ``"module:function"``, which returns the tokens of a text or their number; or the name of a tokenizer
            on the Hugging Face hub; None for a quarter of the characters, rounded up.

    Raises:
        ArgumentError: There is no such tokenizer.
        MissingRequirementError: The package ``transformers`` is not installed.
        EntryPointError: The module cannot be imported, or has no such function.
    """
    if tokenizer is None:
        return lambda text: math.ceil(len(text) / _CHARACTERS)
    if ":" in tokenizer:
        encode = load_entry_point(tokenizer, "--tokenizer")
    else:
        try:
            transformers: Any = importlib.import_module("transformers")
        except ImportError:
            raise MissingRequirementError(
                f"--tokenizer {tokenizer} needs the package transformers: 'pip install transformers'; or name a "
                "function as MODULE:FUNCTION"
            ) from None
        try:
            encode = transformers.AutoTokenizer.from_pretrained(tokenizer).encode
        except (OSError, ValueError) as error:
            raise ArgumentError(f"--tokenizer {tokenizer} cannot be loaded: {error}") from None

    def count(text: str) -> int:
        tokens = encode(text)
        return tokens if isinstance(tokens, int) else len(tokens)

    return count


def times(seconds: Sequence[float]) -> Times:
    """Return the 50th and 99th percentile of durations, by nearest rank."""
    ordered = sorted(seconds)
    if not ordered:
        return _UNTIMED
    p50, p99 = (ordered[math.ceil(len(ordered) * share) - 1] for share in (0.5, 0.99))
    return Times(p50, p99, len(ordered))


def histogram(values: Sequence[float]) -> list[Bin]:
    """Return a bar for each finite value where there are few, else ten of equal width."""
    counted = sorted(Counter(value for value in values if math.isfinite(value)).items())
    if len(counted) <= _FEW_VALUES:
        return [Bin(value, value, count) for value, count in counted]
    counts, edges = np.histogram([value for value in values if math.isfinite(value)], _FEW_VALUES)
    ends = itertools.pairwise(edges.tolist())
    return [Bin(low, high, int(count)) for (low, high), count in zip(ends, counts, strict=True)]


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


def _options(episode: Episode) -> dict[str, Any] | None:
    return dict(episode.options) if episode.options else None


def _count(tokens: object) -> int:
    return tokens if isinstance(tokens, int) else 0
