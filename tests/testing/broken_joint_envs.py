"""One environment of several agents for each promise of all environments, which breaks it for some agent."""

from __future__ import annotations

import itertools
import os
import random
import secrets
from typing import Any, ClassVar

from joint_envs import GoodJointEnv, breaks

from gem_core import AgentSelector
from gem_core.env.spaces import Text


@breaks("construct")
class UnmakeableEnv(GoodJointEnv):
    """Its constructor fails; the other promises are not tried."""

    def __init__(self) -> None:
        raise ValueError("no luck")


@breaks("runs")
class RaisingEnv(GoodJointEnv):
    """It reads numbers only."""

    def parse(self, action: str) -> int | None:
        return int(action)


@breaks("episode")
class FourValuesEnv(GoodJointEnv):
    """Its step forgets the truncations."""

    def step(self, actions: Any) -> Any:
        observations, rewards, terminations, _, infos = super().step(actions)
        return observations, rewards, terminations, infos


@breaks("episode")
class SingleFlagEnv(GoodJointEnv):
    """Its step says by one flag for all that it is over."""

    def step(self, actions: Any) -> Any:
        observations, rewards, terminations, _, infos = super().step(actions)
        return observations, rewards, all(terminations.values()), False, infos


@breaks("episode")
class FlagsOfTheEndedEnv(GoodJointEnv):
    """It gives only the flags that are set."""

    def step(self, actions: Any) -> Any:
        *first, truncations, infos = super().step(actions)
        return *first, {agent: flag for agent, flag in truncations.items() if flag}, infos


@breaks("types", "hostile-actions")
class PartsForGreenEnv(GoodJointEnv):
    """It shows one agent content parts, which are not in that one's space."""

    def observe(self, agent: str) -> Any:
        text = super().observe(agent)
        return [{"type": "text", "text": text}] if agent == "green" else text

    def told(self) -> dict[str, Any]:
        return {agent: {} for agent in self.possible_agents}


@breaks("reset-signature")
class KeywordResetEnv(GoodJointEnv):
    """Its reset takes nothing by position."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:  # type: ignore[override]
        return super().reset(seed, options)


class _UniqueText(Text):
    __eq__ = object.__eq__
    __hash__ = object.__hash__


@breaks("spaces")
class UniqueSpaceEnv(GoodJointEnv):
    """The spaces of two instances are never equal."""

    def observation_space(self, agent: str) -> Any:
        return _UniqueText()


@breaks("end-flags")
class BothFlagsEnv(GoodJointEnv):
    """Agents end with both flags."""

    def process_actions(self, actions: dict[str, str]) -> Any:
        rewards, terminations, _, infos = super().process_actions(actions)
        return rewards, terminations, terminations, infos


@breaks("info-json")
class TupleInfoEnv(GoodJointEnv):
    """Its first info holds a tuple."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        observations, infos = super().reset(seed, options)
        return observations, {agent: {**info, "range": (1, self.limit)} for agent, info in infos.items()}


@breaks("info-keys")
class WordyCorrectEnv(GoodJointEnv):
    """It says in words whether the answer of one agent was correct."""

    def process_actions(self, actions: dict[str, str]) -> Any:
        *result, infos = super().process_actions(actions)
        if "blue" in actions:
            infos["blue"]["correct"] = "yes"
        return *result, infos


@breaks("suffix")
class WrongSuffixEnv(GoodJointEnv):
    """The suffix of one agent is not the end of its observation."""

    def told(self) -> dict[str, Any]:
        told = super().told()
        told["green"]["suffix"] = "Nothing new."
        return told


@breaks("fresh-objects")
class SharedListEnv(GoodJointEnv):
    """It hands out its own list of guesses."""

    def told(self) -> dict[str, Any]:
        return {agent: {**info, "guesses": self.guesses} for agent, info in super().told().items()}


@breaks("fresh-objects")
class OwnFlagsEnv(GoodJointEnv):
    """It hands out its own flags."""

    def step(self, actions: Any) -> Any:
        observations, rewards, _, truncations, infos = super().step(actions)
        return observations, rewards, self.terminations, truncations, infos


@breaks("step-after-end")
class ForgivingEnv(GoodJointEnv):
    """It answers a step outside an episode instead of refusing it."""

    def step(self, actions: Any) -> Any:
        return super().step(actions) if self.acting else ({}, {}, {}, {}, {})


@breaks("close-twice")
class OneCloseEnv(GoodJointEnv):
    """Its close cannot be repeated."""

    def close(self) -> None:
        del self.__dict__["secret"]


@breaks("concurrency")
class OddConcurrencyEnv(GoodJointEnv):
    """Its concurrency is none of the four."""

    concurrency = "sometimes"  # type: ignore[assignment]


@breaks("determinism")
class EntropyEnv(GoodJointEnv):
    """Its hints carry a number of the operating system's."""

    def hint(self, actions: dict[str, str]) -> str:
        return f"{super().hint(actions)} {secrets.randbits(60)}"


@breaks("interleaving", "spawn")
class ClassStateEnv(GoodJointEnv):
    """It keeps the number to guess in its class."""

    shared: ClassVar[list[int]] = [0]

    @property
    def secret(self) -> int:
        return self.shared[0]

    @secret.setter
    def secret(self, value: int) -> None:
        self.shared[0] = value


@breaks("interleaving", "spawn", may=("state-instance",))
class SharedSelectorEnv(GoodJointEnv):
    """All instances have one selector, as one has who makes it in the body of the class."""

    shared_selector = AgentSelector()

    def __init__(self) -> None:
        super().__init__()
        self.agent_selector = self.shared_selector


@breaks("coroutines")
class OtherCoroutineEnv(GoodJointEnv):
    """Its step_async rewards every answer."""

    async def step_async(self, actions: Any) -> Any:
        observations, rewards, *rest = self.step(actions)
        return observations, {agent: reward + 1 for agent, reward in rewards.items()}, *rest


@breaks("process-determinism")
class HashEnv(GoodJointEnv):
    """Its first observation depends on how this process hashes strings."""

    def begin_episode(self, options: Any) -> Any:
        super().begin_episode(options)
        self.feedback = f"Number {hash('number')}."
        return self.told()


@breaks("global-random")
class GlobalSeedEnv(GoodJointEnv):
    """It seeds the global generator from its own: repeatable, and rude."""

    def begin_episode(self, options: Any) -> Any:
        random.setstate(random.Random(int(self.np_random.integers(1000))).getstate())
        return super().begin_episode(options)


@breaks("seed-stream")
class EpisodeCountEnv(GoodJointEnv):
    """The later episodes of a stream tell their number, so that their own seed does not replay them."""

    number = 0

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        self.number = self.number + 1 if seed is None else 0
        return super().reset(seed, options)

    def hint(self, actions: dict[str, str]) -> str:
        return f"Episode {self.number}."

    def _get_state(self) -> dict[str, Any]:
        return {**super()._get_state(), "number": self.number}

    def _set_state(self, state: dict[str, Any]) -> None:
        super()._set_state(state)
        self.number = state["number"]


@breaks("action-sampling", may=("state-instance",))
class TaskGeneratorSamplingEnv(GoodJointEnv):
    """It samples actions from the task's generator."""

    def sample_random_action(self, agent: str) -> str:
        return f"\\boxed{{{int(self.np_random.integers(1, self.limit + 1))}}}"


@breaks("valid-sample")
class InvalidSampleEnv(GoodJointEnv):
    """What it samples for one agent it does not understand itself."""

    def sample_random_action(self, agent: str) -> str:
        return super().sample_random_action(agent) if agent != "green" else "\\boxed{11}"


@breaks("response")
class ExactTypeEnv(GoodJointEnv):
    """It understands a str, and no kind of it."""

    def parse(self, action: str) -> int | None:
        return super().parse(action) if type(action) is str else None


@breaks("hostile-actions")
class BlueDigitsEnv(GoodJointEnv):
    """It believes, of the last agent alone, that what isdigit() is a number; who cannot be read ends it for all."""

    def process_actions(self, actions: dict[str, str]) -> Any:
        answer = actions.get("blue", "").removeprefix("\\boxed{").removesuffix("}")
        if answer.isdigit():
            int(answer)
        rewards, terminations, *rest = super().process_actions(actions)
        return rewards, dict.fromkeys(terminations, True) if self.unread else terminations, *rest


@breaks("state-json")
class LiveStateEnv(GoodJointEnv):
    """Its state is its own list, which goes on changing."""

    def _get_state(self) -> dict[str, Any]:
        return {**super()._get_state(), "guesses": self.guesses}


@breaks("state-instance", "state-process", "spawn")
class ForgetfulStateEnv(GoodJointEnv):
    """Its state lacks the guesses."""

    def _get_state(self) -> dict[str, Any]:
        return {**super()._get_state(), "guesses": []}


_KEPT: dict[int, dict[str, Any]] = {}
_TICKETS = itertools.count(os.getpid() << 20)


@breaks("state-process")
class TicketStateEnv(GoodJointEnv):
    """Its state is a ticket for what only this process keeps."""

    def _get_state(self) -> dict[str, Any]:
        ticket = next(_TICKETS)
        _KEPT[ticket] = super()._get_state()
        return {"ticket": ticket}

    def _set_state(self, state: dict[str, Any]) -> None:
        super()._set_state(_KEPT[state["ticket"]])


@breaks("spawn")
class WrongSpawnEnv(GoodJointEnv):
    """Its siblings have other arguments."""

    def spawn(self, same_state: bool = False, **overrides: Any) -> Any:
        return super().spawn(same_state, **{"limit": self.limit + 90, **overrides})
