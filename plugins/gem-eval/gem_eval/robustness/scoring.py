"""Score an agent without and with disturbances on the same rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

import gem_core as gem
from gem_core import Episode
from gem_core.errors import ArgumentError
from gem_core.making import WrapperChoice
from gem_core.records import Range, group_plan, shared_range
from gem_core.registry import ToolSpec, registry
from gem_core.rollouts import Agent, default_plan
from gem_eval.robustness.flaky_agent import SERVER_FAULTS, FlakyAgent
from gem_eval.robustness.perturbation import NoToolsError, share
from gem_eval.scores import Metric, tells_success
from gem_eval.statistics import Estimate, mean, paired_difference
from gem_eval.turns import error_text

DEFAULT = ("tool_429", "tool_timeout", "cut_outputs", "distractor_tools", "renamed_parameters", "paraphrase", "typos")
"""The disturbances of an agent that are tried where none is named."""

UNDISTURBED = "none"
ALL = "all"


@dataclass(frozen=True)
class Disturbance:
    """What is done to an agent in one line of the table.

    Args:
        name: As it was named, ``"none"`` for nothing.
        wrappers: Put around each task, behind its tools and inside any view.
        server_faults: What happens to requests to the model server: names of ``SERVER_FAULTS`` with their options.
    """

    name: str
    wrappers: tuple[WrapperChoice, ...] = ()
    server_faults: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @classmethod
    def of(cls, name: str, choices: Iterable[tuple[str, dict[str, Any]]]) -> Disturbance:
        """Return a disturbance that consists of wrappers, tools and faults of the model server.

        Raises:
            ArgumentError: An option of a fault cannot be right.
            UnknownWrapperError: There is no wrapper or tool of a name.
        """
        wrappers, faults = [], {}
        for choice in choices:
            if choice[0] in SERVER_FAULTS:
                faults[choice[0]] = _checked_fault(*choice)
                continue
            if ":" not in choice[0]:
                registry().wrapper(choice[0])
            wrappers.append(choice)
        return cls(name, tuple(wrappers), faults)

    def around(self, agent: Agent, seed: int) -> Agent:
        """Return an agent whose model server fails as it should."""
        for fault, options in self.server_faults.items():
            agent = FlakyAgent(agent, fault, seed=seed, **options)
        return agent


@dataclass
class Disturbed:
    """The episodes of one environment under one disturbance.

    Args:
        id: The environment; ``"all"`` for the sum of several.
        disturbance: What was done.
        metric: ``"success"``, or ``"return"`` where the task does not tell success.
        rows: Values by row of the environment, one for each epoch that ended without an error.
        errors: Number of episodes with an error.
        first_error: What the first of them says.
        plain: The same rows without a disturbance; None for these themselves.
        ranges: The ranges that values of its environments can have; None for an unknown one.
    """

    id: str
    disturbance: Disturbance
    metric: Metric
    rows: dict[str, list[float]] = field(default_factory=dict)
    errors: int = 0
    first_error: str | None = None
    plain: Disturbed | None = None
    ranges: set[Range | None] = field(default_factory=set)

    @property
    def episodes(self) -> int:
        """Number of episodes with a score."""
        return sum(map(len, self.rows.values()))

    @property
    def score(self) -> Estimate | None:
        """The mean over rows; None without episodes."""
        rows = list(self.rows.values())
        return mean(rows, within=self.within) if rows else None

    @property
    def within(self) -> Range | None:
        """The range that values can have; None where it is not known."""
        values = [value for row in self.rows.values() for value in row]
        return shared_range(self.ranges, min(values), max(values)) if values else None

    @property
    def pairs(self) -> list[str]:
        """The rows that have values both with and without the disturbance."""
        return [] if self.plain is None else [row for row in self.plain.rows if row in self.rows]

    @property
    def difference(self) -> Estimate | None:
        """The score with the disturbance less that without it, over the rows that have both; None without such rows."""
        if self.plain is None or not self.pairs:
            return None
        disturbed, plain = ([of.rows[row] for row in self.pairs] for of in (self, self.plain))
        within = self.within if self.within == self.plain.within else None
        return paired_difference(disturbed, plain, within=within)

    def to_dict(self, model: str) -> dict[str, Any]:
        """Return the score and the difference as plain JSON."""
        none = {"mean": None, "stderr": None, "low": None, "high": None}
        difference = self.difference
        return {
            "id": self.id,
            "model": model,
            "perturbation": self.disturbance.name,
            "metric": self.metric,
            **(none if self.score is None else self.score._asdict()),
            "episodes": self.episodes,
            "rows": len(self.rows),
            "errors": self.errors,
            "difference": None if difference is None else {**difference._asdict(), "rows": len(self.pairs)},
        }


def score_disturbed(
    env: tuple[str, Mapping[str, Any]],
    agent: Agent,
    disturbances: Sequence[Disturbance],
    *,
    wrappers: Sequence[WrapperChoice],
    seed: int,
    limit: int | None = None,
    episodes: int = 10,
    epochs: int = 1,
    num_envs: int | None = None,
    on_episode: Callable[[Disturbance, Episode], None] = lambda disturbance, episode: None,
) -> Iterator[Disturbed]:
    """Let an agent act in an environment, without a disturbance and with each; the rows and their seeds are the same.

    Args:
        env: Id and keyword arguments.
        agent: Who acts.
        disturbances: One run each, after one without any.
        wrappers: Put around the environment in every run, tools first.
        seed: Of all runs.
        limit: Number of rows at most; None for all of a data set.
        episodes: Number of rows where there is no data set and no limit.
        epochs: How often each row is played.
        num_envs: Environments at once.
        on_episode: Called with each episode as it finishes.

    Yields:
        The episodes of each run.
    """
    plain: Disturbed | None = None
    for disturbance in (Disturbance(UNDISTURBED), *disturbances):
        stack = stacked(wrappers, disturbance.wrappers)
        with closing(gem.make_vec([env], num_envs or 1, seed=seed, wrappers=stack)) as vector:
            total = vector.num_tasks(*env)
            rows = limit or episodes if total is None else min(limit or total, total)
            plan = list(group_plan(default_plan(vector, rows), epochs))
            played = []
            for episode in gem.rollout(vector, disturbance.around(agent, seed), plan=plan):
                played.append(episode)
                on_episode(disturbance, episode)
        result = _collected(env[0], disturbance, played, plain)
        plain = plain or result
        yield result


def does_not_apply(
    env: tuple[str, Mapping[str, Any]], disturbance: Disturbance, wrappers: Sequence[WrapperChoice]
) -> str | None:
    """Return why a disturbance does not fit an environment, which has no tools; None if it does.

    The environment is made with it, and closed.

    Raises:
        GemError: The environment cannot be made, or a wrapper has no such option.
    """
    try:
        gem.make(env[0], wrappers=stacked(wrappers, disturbance.wrappers), **env[1]).close()
    except NoToolsError as error:
        return str(error)
    return None


def stacked(wrappers: Sequence[WrapperChoice], more: Sequence[WrapperChoice]) -> list[WrapperChoice]:
    """Return wrappers with more behind the last tool among them, so that they are inside any view."""
    last = max((place for place, choice in enumerate(wrappers) if _is_of_tools(choice)), default=-1)
    return [*wrappers[: last + 1], *more, *wrappers[last + 1 :]]


def in_all(results: Sequence[Disturbed]) -> list[Disturbed]:
    """Return the sum over environments, by disturbance, of those that were tried in each of them.

    It is empty for one environment, and where they are not scored by the same metric.
    """
    by_env: dict[str, list[Disturbed]] = {}
    for result in results:
        by_env.setdefault(result.id, []).append(result)
    if len(by_env) < 2 or len({result.metric for result in results}) > 1:
        return []
    sums: list[Disturbed] = []
    for disturbance in dict.fromkeys(result.disturbance.name for result in results):
        same = [result for result in results if result.disturbance.name == disturbance]
        if len(same) == len(by_env):
            total = Disturbed(ALL, same[0].disturbance, same[0].metric, errors=sum(each.errors for each in same))
            total.rows = {row: values for each in same for row, values in each.rows.items()}
            total.ranges = {each for result in same for each in result.ranges}
            total.plain = sums[0] if sums else None
            sums.append(total)
    return sums


def _collected(
    env_id: str, disturbance: Disturbance, episodes: Sequence[Episode], plain: Disturbed | None
) -> Disturbed:
    if plain is None:
        metric: Metric = "success" if tells_success(episodes) else "return"
    else:
        metric = plain.metric
    result = Disturbed(env_id, disturbance, metric, plain=plain)
    for episode in sorted(episodes, key=lambda each: (int(each.key), each.repeat)):
        value = episode.success if metric == "success" else episode.episode_return
        if episode.error is not None:
            result.errors += 1
            result.first_error = result.first_error or error_text(episode.error)
        elif value is not None:
            result.rows.setdefault(f"{env_id}/{episode.key}", []).append(float(value))
            result.ranges.add((0.0, 1.0) if metric == "success" else episode.return_range)
    return result


def _is_of_tools(choice: Any) -> bool:
    name = choice[0] if isinstance(choice, tuple) else choice
    if not isinstance(name, str) or ":" in name:
        return False
    return name == "tools" or isinstance(registry().wrapper(name), ToolSpec)


def _checked_fault(name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    unknown = [option for option in options if option not in ("rate", "retries")]
    if unknown:
        raise ArgumentError(f"{name} has no option {unknown[0]!r}; it takes rate and retries")
    share(options.get("rate", 0.0), f"the rate of {name}")
    retries = options.get("retries", 0)
    if type(retries) is not int or retries < 0:
        raise ArgumentError(f"the retries of {name} must be a whole number from 0 up, not {retries!r}")
    return dict(options)
