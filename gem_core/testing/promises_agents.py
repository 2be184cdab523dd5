"""Promises about several agents: who acts and hears what, what each earned, and who has left."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, cast

from gem_core.env.base import Env
from gem_core.env.seeding import stable_hash
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import ArgumentError
from gem_core.testing.comparing import differences, plain, record_of
from gem_core.testing.contract import promise
from gem_core.testing.findings import shown
from gem_core.testing.joint import acting, fitted, seats_of
from gem_core.testing.subject import PlainResult, Subject
from gem_core.types import Response


@promise(
    "set possible_agents in the class or the constructor, and write the same names into the record as seats.",
    of="several",
)
def seats(subject: Subject) -> Iterator[str]:
    """The possible agents have names that differ, always the same ones, and they are the seats of the record."""
    env = subject.new()
    names = list(seats_of(env))
    if not names or not all(isinstance(name, str) and name for name in names) or len(set(names)) < len(names):
        yield f"possible_agents is {shown(names)}"
    recipe = cast("Env", env.unwrapped).spec
    if recipe is not None and recipe.record is not None and list(recipe.record.seats) != names:
        yield f"possible_agents is {shown(names)}, and the seats of the record are {shown(list(recipe.record.seats))}"
    for where, _ in subject.calls_of(env):
        if list(seats_of(env)) != names:
            yield f"possible_agents is {shown(names)}, and after {where} {shown(list(seats_of(env)))}"
            return


@promise("leave reset and step to MultiAgentEnv, and say who acts by agent_selector.", of="several")
def turns(subject: Subject) -> Iterator[str]:
    """Observations are of those who act, rewards and infos also of those who ended, and flags of all who took part."""
    for moment in _moments(subject):
        hearers = moment.acting | moment.ended_now
        for name, agents in (
            ("observations", moment.acting),
            ("infos", hearers),
            ("rewards", hearers),
            ("terminations", moment.part),
            ("truncations", moment.part),
        ):
            given = moment.parts.get(name)
            if given is not None and set(given) != agents:
                yield f"{moment.where} gave {name} of {_listed(given)}, not of {_listed(agents)}"


@promise("let process_actions say who ended, and let MultiAgentEnv take them out.", of="several")
def leaving(subject: Subject) -> Iterator[str]:
    """Who ends is told so once, with final_obs, and never acts again; until all have ended, somebody acts."""
    for moment in _moments(subject):
        for agent, info in moment.parts["infos"].items():
            if ("final_obs" in info) != (agent in moment.ended_now):
                ends = "ends" if agent in moment.ended_now else "does not end"
                yield f"{moment.where}: {agent!r} {ends} then, and the keys of its info are {_listed(info)}"
        for agent in sorted(moment.ended_before):
            if agent in moment.acting or agent not in moment.ended:
                yield f"{moment.where}: {agent!r} had ended, and takes part again"
        left = moment.part - moment.ended
        if moment.agents != left:
            yield f"{moment.where}: agents are {_listed(moment.agents)}, and those who have not ended {_listed(left)}"
        if left and not moment.acting:
            yield f"{moment.where}: nobody acts, and {_listed(left)} have not ended"


@promise("return each reward once from process_actions, and leave cumulative alone.", of="several")
def accounting(subject: Subject) -> Iterator[str]:
    """What step gave an agent in an episode is its cumulative reward at the end, and nobody earns after its own end."""
    given: dict[str, float] = {}
    has_ended = False
    for moment in _moments(subject):
        if "rewards" not in moment.parts:
            given = {}
            continue
        for agent, reward in moment.parts["rewards"].items():
            given[agent] = given.get(agent, 0.0) + reward
            if reward and agent in moment.ended_before:
                yield f"{moment.where} rewarded {agent!r}, which had ended"
        if moment.part - moment.ended:
            continue
        has_ended = True
        for agent in moment.part | set(moment.cumulative):
            total, gave = moment.cumulative.get(agent, math.nan), given.get(agent, 0.0)
            if not math.isclose(total, gave, rel_tol=1e-9, abs_tol=1e-9):
                yield f"{moment.where}: step gave {agent!r} {gave:g} in all, and its cumulative reward is {total:g}"
    if not has_ended:
        subject.notes.append(f"accounting: no episode ended within {subject.limits.max_turns} turns")


@promise("leave step to MultiAgentEnv, which checks the actions before process_actions is called.", of="several")
def refused_actions(subject: Subject) -> Iterator[str]:
    """A step with an action that is missing, unwanted or no text raises ArgumentError and changes nothing."""
    for number, script in enumerate(subject.scripts):
        env = subject.new()
        found: list[PlainResult] = [record_of(subject.reset(env, script.seed))]
        for planned in script.actions:
            action = cast("Mapping[str, str]", fitted(env, planned))
            for what, wrong in _wrong_actions(env, action):
                try:
                    subject.step(env, wrong)
                except ArgumentError:
                    continue
                yield f"step took {what}, where it needs those of {_listed(action)}"
                return
            result = subject.step(env, action)
            found.append(record_of(result))
            if result[2] or result[3]:
                break
        if subject.recorded is not None:
            what = f"with seed {script.seed}, the episode in which wrong actions were refused differs"
            yield from differences(what, subject.recorded[number], found)


_THINKING = ("<think>{0}</think>{1}", "{0}</think>{1}", "{1}<think>{0}")
"""How a response shows what was thought: in a block, in one that the prompt opened, and in one that is never closed."""


@promise(
    "show others what you extract of a response, with gem_core.parsing.without_thinking where all of it is said.",
    of="several",
)
def reasoning(subject: Subject) -> Iterator[str]:
    """What an agent thinks reaches nobody else: no observation and no info of another shows it."""
    env = subject.new()
    marks = {agent: f"thought{stable_hash(subject.limits.seed, agent)}" for agent in seats_of(env)}
    for form, script in product(_THINKING, subject.scripts):
        subject.reset(env, script.seed)
        for planned in script.actions:
            action = cast("Mapping[str, str]", fitted(env, planned))
            observations, *_, terminated, truncated, info = subject.step(
                env,
                {who: Response(form.format(marks[who], text), reasoning=marks[who]) for who, text in action.items()},
            )
            for reader, (author, mark) in product({**observations, **info["agents"]}, marks.items()):
                seen = plain([observations.get(reader), info["agents"].get(reader)])
                if author != reader and mark in repr(seen).lower():
                    yield f"{reader!r} was shown what {author!r} thought, in the form {form}"
                    return
            if terminated or truncated:
                break


@dataclass(frozen=True)
class _Moment:
    """What a reset or a step returned, and who took part then.

    Args:
        where: The call.
        parts: What it returned, by name; of a reset ``observations`` and ``infos``.
        part: Everyone who has taken part in the episode.
        ended_before: Those of them who had ended before the call.
        ended: Those whose flags say that they have ended.
        agents: Those who take part.
        acting: Those who act next.
        cumulative: The environment's sums of rewards.
    """

    where: str
    parts: Mapping[str, Mapping[str, Any]]
    part: frozenset[str]
    ended_before: frozenset[str]
    ended: frozenset[str]
    agents: frozenset[str]
    acting: frozenset[str]
    cumulative: Mapping[str, float]

    @property
    def ended_now(self) -> frozenset[str]:
        """Those who ended in this step."""
        return self.ended - self.ended_before


def _moments(subject: Subject) -> Iterator[_Moment]:
    """Play all scripts and keep account of who takes part."""
    env = subject.new()
    part: frozenset[str] = frozenset()
    before: frozenset[str] = frozenset()
    for where, (observations, *middle, info) in subject.calls_of(env):
        parts = {"observations": observations, "infos": info["agents"]}
        flags = {name: info.get(name, {}) for name in ("terminations", "truncations")}
        if middle:
            parts |= {"rewards": middle[0], **flags}
        else:
            part = before = frozenset()
        ended = frozenset(agent for each in flags.values() for agent, flag in each.items() if flag)
        agents, cumulative = env.get_wrapper_attr("agents"), env.get_wrapper_attr("cumulative")
        part |= {*agents, *ended}
        yield _Moment(where, parts, part, before, ended, frozenset(agents), frozenset(acting(env)), dict(cumulative))
        before |= ended


def _wrong_actions(env: AnyEnv, action: Mapping[str, str]) -> Iterator[tuple[str, Any]]:
    some = next(iter(action))
    yield f"no action of {some!r}", {agent: text for agent, text in action.items() if agent != some}
    yield f"None as the action of {some!r}", {**action, some: None}
    for other in ("nobody at all", *seats_of(env)):
        if other not in action:
            yield f"an action of {other!r}", {**action, other: "hello"}


def _listed(names: Any) -> str:
    return ", ".join(map(repr, sorted(names))) or "nobody"
