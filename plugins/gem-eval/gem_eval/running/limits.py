"""Limits of an episode and of a run, and the agent that holds a model to them."""

from __future__ import annotations

import asyncio
import inspect
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from gem_core import Observation, Response
from gem_core.errors import ArgumentError, EpisodeLimitError
from gem_core.rollouts import Agent, Context, is_asynchronous

if TYPE_CHECKING:
    from gem_eval.running.prices import Price

_FORWARDED = ("prepare", "close", "aclose", "interactive", "max_concurrency", "reads", "system", "native_tools")

RUN_LIMITS = ("run time", "run tokens", "run cost")
"""Reasons of episodes that were cut off since the whole run had reached a limit: a resumed run plays them again."""


@dataclass(frozen=True)
class Limits:
    """What an episode and a run may take; None for no limit. Each is checked before a model is asked.

    What models in other roles take, as a simulated user, is not counted.

    Args:
        episode_time: Seconds from the first question of an episode; an open request is given up.
        episode_tokens: Tokens read and written.
        episode_cost: US dollars.
        run_time: Seconds of this session of the run; open requests are given up.
        run_tokens: Tokens of the whole run.
        run_cost: US dollars of the whole run.
    """

    episode_time: float | None = None
    episode_tokens: int | None = None
    episode_cost: float | None = None
    run_time: float | None = None
    run_tokens: int | None = None
    run_cost: float | None = None

    def __post_init__(self) -> None:
        for name, limit in vars(self).items():
            if limit is not None and not limit > 0:
                raise ArgumentError(f"{name} must be above 0, not {limit!r}")

    @property
    def of_cost(self) -> bool:
        """Whether a price is needed."""
        return self.episode_cost is not None or self.run_cost is not None


@dataclass
class Meter:
    """What an episode has taken, or a run.

    Args:
        started: When it began, on ``time.monotonic()``.
        tokens: Tokens read and written.
        cost: US dollars; None without a price.
        model_seconds: Seconds in which the model was asked.
    """

    started: float = field(default_factory=time.monotonic)
    tokens: int = 0
    cost: float | None = None
    model_seconds: float = 0.0

    def add(self, usage: Mapping[str, Any], price: Price | None) -> None:
        """Count what a response took."""
        for name in ("prompt_tokens", "completion_tokens"):
            count = usage.get(name)
            self.tokens += count if type(count) is int and count > 0 else 0
        if price is not None:
            self.cost = (self.cost or 0.0) + price.of(usage)


class RunMeter:
    """What the whole run has taken, and the meters of the episodes under way.

    Args:
        limits: The limits.
        tokens: Tokens of earlier sessions of the run.
        cost: Their cost in US dollars.
    """

    def __init__(self, limits: Limits, tokens: int = 0, cost: float = 0.0) -> None:
        self.limits = limits
        self.total = Meter(tokens=tokens, cost=cost)
        self.episodes: dict[str, Meter] = {}

    def reached(self) -> str | None:
        """Return the limit of the run that has been reached, as ``"run time"``."""
        kind = self._reached("run", self.total)
        return None if kind is None else f"run {kind}"

    def check(self, meter: Meter) -> None:
        """Raise an error where an episode, or the run, has reached a limit.

        Raises:
            EpisodeLimitError: It has.
        """
        if (reached := self.reached()) is not None:
            raise EpisodeLimitError(f"the {reached} is used up", limit=reached)
        if (kind := self._reached("episode", meter)) is not None:
            limit = "token budget" if kind == "tokens" else kind
            raise EpisodeLimitError(f"the {kind} of the episode is used up", limit=limit)

    def _reached(self, scope: str, meter: Meter) -> str | None:
        taken = {"time": time.monotonic() - meter.started, "tokens": meter.tokens, "cost": meter.cost or 0.0}
        for kind, amount in taken.items():
            limit = getattr(self.limits, f"{scope}_{kind}")
            if limit is not None and amount >= limit:
                return kind
        return None

    def deadline(self, meter: Meter) -> tuple[float | None, str]:
        """Return when an open request is given up, on ``time.monotonic()``, and the limit that says so."""
        limits = {"time": (meter, self.limits.episode_time), "run time": (self.total, self.limits.run_time)}
        ends = [(each.started + seconds, name) for name, (each, seconds) in limits.items() if seconds is not None]
        return min(ends, default=(None, ""))


class MeteredAgent:
    """An agent that is held to limits, and whose usage is counted.

    Args:
        agent: The agent.
        meter: Meter of the run.
        price: What its tokens cost; None where that is not known.
    """

    def __init__(self, agent: Agent, meter: RunMeter, price: Price | None = None) -> None:
        self._agent, self._meter, self._price = agent, meter, price

    def __getattr__(self, name: str) -> Any:
        if name not in _FORWARDED:
            raise AttributeError(name)
        return getattr(self._agent, name)

    def __call__(self, observation: Observation, context: Context) -> Any:
        """Return the agent's answer.

        Raises:
            EpisodeLimitError: A limit is reached.
        """
        meter, asked = self._begin(context), time.monotonic()
        return self._note(meter, asked, self._agent(observation, context))

    def _begin(self, context: Context) -> Meter:
        """Check the limits; return the meter of the episode."""
        meter = self._meter.episodes.setdefault(context.episode, Meter())
        self._meter.check(meter)
        return meter

    def _note(self, meter: Meter, asked: float, answer: Any) -> Any:
        meter.model_seconds += time.monotonic() - asked
        usage = answer.usage if isinstance(answer, Response) else None
        if usage is not None:
            meter.add(usage, self._price)
            self._meter.total.add(usage, self._price)
        return answer


class AsyncMeteredAgent(MeteredAgent):
    """``MeteredAgent`` around an agent that answers later."""

    async def __call__(self, observation: Observation, context: Context) -> Any:
        """Return the agent's answer; see ``MeteredAgent``."""
        meter, asked = self._begin(context), time.monotonic()
        deadline, limit = self._meter.deadline(meter)
        answer: Any = self._agent(observation, context)
        if inspect.isawaitable(answer):
            try:
                async with asyncio.timeout(None if deadline is None else max(deadline - asked, 0.0)):
                    answer = await answer
            except TimeoutError:
                if deadline is None or time.monotonic() < deadline:
                    raise  # the agent's own
                raise EpisodeLimitError(f"no answer before the {limit} was used up", limit=limit) from None
        return self._note(meter, asked, answer)


def metered(agent: Agent, meter: RunMeter, price: Price | None = None) -> MeteredAgent:
    """Return an agent that is held to limits; see ``MeteredAgent``."""
    return (AsyncMeteredAgent if is_asynchronous(agent) else MeteredAgent)(agent, meter, price)
