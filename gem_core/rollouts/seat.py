"""``RunningSeat``: one agent's side of a running episode: its record, its conversation and its context."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from gem_core import __version__
from gem_core.errors import AgentError
from gem_core.records.conversation import CONCAT_WITH_ACTION, Conversation
from gem_core.records.episode import Episode, Transition
from gem_core.records.plans import EpisodeStart
from gem_core.registry.lookup import registry
from gem_core.rollouts.agent import AgentTraits, Context
from gem_core.types import Info, Observation, Response


class RunningSeat:
    """The present episode of one agent, alone in its environment or at a seat among others.

    Args:
        episode: The record, with its first observation; turns are added to it.
        traits: The agent's attributes, which decide what it is sent.
        draw_action: Returns a valid random action.
    """

    def __init__(self, episode: Episode, traits: AgentTraits, draw_action: Callable[[], str]) -> None:
        info = episode.info
        self.episode = episode
        self.episode.reads = _what_to_read(traits, info)
        self.episode.system = traits.system
        self.episode.native_tools = traits.native_tools and bool(info.get("tools"))
        self.conversation = Conversation(episode)
        self.response = Response()
        """The last response that the environment was sent."""
        self.context = Context(
            episode=f"{episode.key}.{episode.repeat}",
            env_id=episode.id,
            group=episode.group,
            turn=0,
            info=info,
            tools=info.get("tools", []),
            transitions=episode.transitions,
            system=self.conversation.system,
            draw_action=draw_action,
            read_messages=self.conversation.messages,
            seat=episode.seat,
            read_observation=partial(getattr, episode, "final_observation"),  # a copy of the seat reads its own
            view=info.get("view"),
        )

    async def take(self, answer: Any) -> Response:
        """Return what the agent answered, a coroutine's result included, as the response of this turn.

        Raises:
            AgentError: It is no text, or the coroutine was cancelled by the agent itself.
        """
        if inspect.isawaitable(answer):
            try:
                answer = await answer
            except asyncio.CancelledError:
                task = asyncio.current_task()
                if task is not None and task.cancelling():
                    raise
                raise AgentError("the agent's coroutine was cancelled; an agent must not cancel its own task") from None
        if not isinstance(answer, str):
            raise AgentError(f"an agent returns a str or a Response, and this one returned {type(answer).__name__}")
        self.response = Response.of(answer)
        return self.response

    def add(self, reward: float, terminated: bool, truncated: bool, observation: Observation, info: Info) -> None:
        """Add the turn in which ``response`` was sent."""
        episode = self.episode
        answered = episode.final_observation
        episode.transitions.append(Transition(answered, self.response, reward, terminated, truncated, info))
        episode.final_observation = observation
        self.context.turn += 1
        self.context.info = info

    def cut_off(self, reported: Info) -> None:
        """End the episode between two turns, with the reason in its last info."""
        episode = self.episode
        if episode.transitions:
            last = episode.transitions[-1]
            last.truncated, last.info = True, {**last.info, **reported}
        else:
            episode.info = {**episode.info, **reported}


def _what_to_read(traits: AgentTraits, info: Info) -> str:
    """Return the ``reads`` of an episode: the agent's own, unless a view was named."""
    if info.get("view") is not None:
        return "observation"
    if traits.reads is not None:
        return traits.reads
    return CONCAT_WITH_ACTION if info.get("tools") else "observation"


def new_episode(described: Mapping[str, Any], start: EpisodeStart, observation: Observation, info: Info) -> Episode:
    """Return the record of an episode that begins, for an agent that reads observations.

    Args:
        described: ``id``, ``kwargs``, ``wrappers`` and, if it has one, ``return_range`` of its environment.
        start: The episode's start.
        observation: The observation that ``reset`` returned.
        info: The info that ``reset`` returned.
    """
    tools = [tool["function"]["name"] for tool in info.get("tools", [])]
    return Episode(
        **common_fields(described, start),
        observation=observation,
        info=info,
        final_observation=observation,
        tools=tools,
        reads="observation",
        agent=start.item.agent,
        return_range=described.get("return_range"),
    )


def common_fields(described: Mapping[str, Any], start: EpisodeStart) -> dict[str, Any]:
    """Return the fields that the records of one agent and of several have in common."""
    return {
        "id": described["id"],
        "seed": start.seed,
        "kwargs": described["kwargs"],
        "wrappers": described.get("wrappers", []),
        "options": start.item.options,
        "group": start.item.group,
        "key": start.key,
        "repeat": start.repeat,
        "run_seed": start.run_seed,
        "versions": _versions_of(described["id"]),
    }


def _versions_of(env_id: str) -> dict[str, str]:
    """Return the version of each distribution that takes part in an episode of an environment."""
    provider = registry().provider(env_id)
    versions = {"gem-core": __version__}
    if provider is not None:
        versions[provider.distribution] = provider.version
    return versions
