"""The one loop that joins an agent to environments."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, cast

from gem_core import __version__
from gem_core.agents.asking import Asking, Outcome
from gem_core.agents.base import Agent, Context, as_agent, prepare_agent
from gem_core.episodes import Episode, Transition
from gem_core.errors import ArgumentError, ContextOverflowError, RequestError
from gem_core.plans import Draw, DrawSource, PlanItem, count_plan, cover_plan
from gem_core.registry import make_vec, registry
from gem_core.types import TERMINAL_STATE, Info, Observation, Response
from gem_core.vector.base import VectorEnv, new_source
from gem_core.vector.sync import SyncVectorEnv
from gem_core.wrapper import AnyEnv

DEFAULT_EPISODES = 10


def rollout(
    env: VectorEnv | AnyEnv | str | Sequence[str],
    agent: Any,
    *,
    plan: Iterable[PlanItem] | None = None,
    episodes: int | None = None,
    seed: int | None = None,
) -> Iterator[Episode]:
    """Let an agent act, and yield each episode as it finishes.

    The episodes are fixed before they start: the same plan and seed give the same ones, whatever the number of slots.
    A plain agent is asked for one slot after another; an asynchronous one for each slot as soon as it is ready, so that
    a slow answer holds up nothing but its own slot.

    Args:
        env: A vector environment, an environment, an id or several. What was made here is closed at the end; what was
            given is left open.
        agent: Called as ``agent(observation, context)``, or with the observation alone; plain or a coroutine function.
            It returns a ``str`` or a ``Response``.
        plan: What episodes start from; see ``gem_core.plans``.
        episodes: Instead of a plan, the number of episodes for each environment; a data set gives its first rows. With
            neither, the vector environment's own plan is taken from the beginning; where it has none, each row of a
            data set once, and ten episodes of an environment without rows.
        seed: Seed of the run; None takes the vector environment's, or draws one.

    Yields:
        Episodes in order of completion. One whose reset failed has no transitions and an ``error``.

    Raises:
        AgentError: The agent cannot be called, or does not return text.
        ArgumentError: Both a plan and a number of episodes are given.
        FaultBudgetError: Environments fail again and again.
    """
    if plan is not None and episodes is not None:
        raise ArgumentError("give either a plan or a number of episodes, not both")
    if episodes is not None and (not isinstance(episodes, int) or episodes < 0):
        raise ArgumentError(f"episodes must be a whole number from 0 up, not {episodes!r}")
    return _run(env, as_agent(agent), plan, episodes, seed)


def default_plan(vector: VectorEnv, episodes: int | None = None) -> list[PlanItem]:
    """Return the plan of ``rollout`` without one: rows in order for data sets, a number of episodes for the rest."""
    items: list[list[PlanItem]] = []
    for env_id in vector.all_ids:
        rows = vector.num_tasks(env_id)
        if rows is not None:
            items.append(cover_plan(env_id, rows, episodes=episodes))
        else:
            items.append(count_plan([env_id], DEFAULT_EPISODES if episodes is None else episodes))
    # Taken in turn, so that a run that is stopped has some of each.
    longest = max(map(len, items), default=0)
    return [plan[index] for index in range(longest) for plan in items if index < len(plan)]


def _run(
    env: VectorEnv | AnyEnv | str | Sequence[str],
    agent: Agent,
    plan: Iterable[PlanItem] | None,
    episodes: int | None,
    seed: int | None,
) -> Iterator[Episode]:
    vector, made_here = _as_vector(env, seed)
    asking = Asking(agent)
    running: dict[int, _Running] = {}
    try:
        prepare_agent(agent)
        observations, infos = vector.begin(_source(vector, plan, episodes, seed))
        for slot, (observation, info) in enumerate(zip(observations, infos, strict=True)):
            yield from _started(vector, running, slot, observation, info)
        for slot, current in running.items():
            asking.ask(slot, current.observation, current.context)
        while running:
            answers = asking.answers()
            yield from _stepped(vector, running, answers)
            for slot in answers:
                if slot in running:
                    asking.ask(slot, running[slot].observation, running[slot].context)
    finally:
        asking.close()
        if made_here:
            vector.close()


def _source(vector: VectorEnv, plan: Iterable[PlanItem] | None, episodes: int | None, seed: int | None) -> DrawSource:
    if plan is None and episodes is None and vector.own_source.planned:
        return vector.own_source.restarted(seed)
    return new_source(default_plan(vector, episodes) if plan is None else plan, vector.seed if seed is None else seed)


def _stepped(vector: VectorEnv, running: dict[int, _Running], answers: Mapping[int, Outcome]) -> Iterator[Episode]:
    """Step the slots whose agent has answered; yield the episodes that ended."""
    responses = {slot: answer for slot, answer in answers.items() if isinstance(answer, Response)}
    step = vector.step(responses)
    for place, (slot, answer) in enumerate(responses.items()):
        observation, info = step.observations[place], step.infos[place]
        reward, current = float(step.rewards[place]), running[slot]
        terminated, truncated = bool(step.terminated[place]), bool(step.truncated[place])
        if not (terminated or truncated):
            current.add(answer, reward, False, False, observation, info)
            continue
        current.add(answer, reward, terminated, truncated, info.pop("final_obs"), info.pop("final_info"))
        del running[slot]
        yield current.episode
        yield from _started(vector, running, slot, observation, info)
    for slot, failure in answers.items():
        if isinstance(failure, RequestError):
            episode = running.pop(slot).give_up(failure)
            fault = None if isinstance(failure, ContextOverflowError) else str(failure)
            observation, info = vector.give_up(slot, fault)
            yield episode
            yield from _started(vector, running, slot, observation, info)


class _Running:
    """An episode that is under way in a slot."""

    def __init__(self, vector: VectorEnv, slot: int, draw: Draw, observation: Observation, info: Info) -> None:
        self.episode = new_episode(vector.describe(slot), draw, observation, info)
        self.observation = observation
        self.context = Context(
            episode=f"{draw.key}.{draw.repeat}",
            env_id=self.episode.id,
            group=draw.item.group,
            turn=0,
            info=info,
            tools=info.get("tools", []),
            transitions=self.episode.transitions,
            _sample=lambda: vector.sample_random_action(slot),
        )

    def add(
        self, answer: Response, reward: float, terminated: bool, truncated: bool, observation: Observation, info: Info
    ) -> None:
        self.episode.transitions.append(Transition(self.observation, answer, reward, terminated, truncated, info))
        self.observation = self.episode.final_observation = observation
        self.context.turn += 1
        self.context.info = info

    def give_up(self, error: RequestError) -> Episode:
        """End the episode because its agent could not be asked, or its history has grown too long; return it."""
        reported: Info = {"error": {"kind": "agent", "message": str(error)}}
        if isinstance(error, ContextOverflowError):
            reported = {"context_overflow": True}
        if self.episode.transitions:
            last = self.episode.transitions[-1]
            last.truncated, last.info = True, {**last.info, **reported}
        else:
            self.episode.info = {**self.episode.info, **reported}
        return self.episode


def _started(
    vector: VectorEnv, running: dict[int, _Running], slot: int, observation: Observation, info: Info
) -> Iterator[Episode]:
    """Note the episode that began in a slot; yield those whose reset failed before it."""
    for failed in info.pop("failed_resets", ()):
        draw: Draw = failed["draw"]
        described = {"id": draw.item.id or vector.ids[slot] or "unknown", "kwargs": dict(draw.item.kwargs)}
        reported = {"seed": draw.seed, "error": failed["error"]}
        if draw.item.group is not None:
            reported["group"] = draw.item.group
        yield new_episode(described, draw, TERMINAL_STATE, reported)
    draw_or_none = vector.draw_of(slot)
    if draw_or_none is not None:
        running[slot] = _Running(vector, slot, draw_or_none, observation, info)


def new_episode(described: dict[str, Any], draw: Draw, observation: Observation, info: Info) -> Episode:
    """Return the record of an episode that begins.

    Args:
        described: ``id``, ``kwargs`` and ``wrappers`` of its environment.
        draw: What it starts from.
        observation: What ``reset`` returned, with ``info``.
        info: See above.
    """
    return Episode(
        id=described["id"],
        seed=draw.seed,
        observation=observation,
        info=info,
        final_observation=observation,
        kwargs=described["kwargs"],
        wrappers=described.get("wrappers", []),
        tools=[tool["function"]["name"] for tool in info.get("tools", [])],
        options=draw.item.options,
        group=draw.item.group,
        key=draw.key,
        repeat=draw.repeat,
        versions=_versions(described["id"]),
    )


def _versions(env_id: str) -> dict[str, str]:
    provider = registry().provider(env_id)
    versions = {"gem-core": __version__}
    if provider is not None:
        versions[provider.distribution] = provider.version
    return versions


def _as_vector(env: VectorEnv | AnyEnv | str | Sequence[str], seed: int | None) -> tuple[VectorEnv, bool]:
    if isinstance(env, VectorEnv):
        return env, False
    if isinstance(env, str) or (isinstance(env, Sequence) and all(isinstance(name, str) for name in env)):
        return make_vec(env, seed=seed), True
    return SyncVectorEnv.around(cast("AnyEnv", env), seed=seed, keep_open=True), True
