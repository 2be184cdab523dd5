"""An environment of three agents that keeps every promise, and one for each promise that breaks it."""

from __future__ import annotations

import itertools
import os
import random
import re
import secrets
from collections.abc import Callable
from typing import Any, ClassVar

from gem_core import AgentSelector, EnvSpec, MultiAgentEnv, extract_last_boxed_answer
from gem_core.env.spaces import Text

BROKEN: dict[Any, tuple[set[str], set[str]]] = {}
"""What is checked, the promises that it breaks, and those that it may break beside."""


def breaks(*slugs: str, may: tuple[str, ...] = ()) -> Callable[[Any], Any]:
    def enter(target: Any) -> Any:
        BROKEN[target] = set(slugs), set(may)
        return target

    return enter


class GoodJointEnv(MultiAgentEnv):
    """Three guess a number, and who says 0 leaves; whoever is right ends it for all."""

    possible_agents = ("red", "green", "blue")

    def __init__(self, limit: int = 10, mode: Any = "sequential") -> None:
        super().__init__()
        self.limit = limit
        self.agent_selector = AgentSelector(mode=mode)
        self.secret = 0
        self.guesses: list[int] = []
        self.feedback = ""
        self.unread: list[str] = []

    def begin_episode(self, options: dict[str, Any] | None) -> Any:
        self.secret = int(self.np_random.integers(1, self.limit + 1))
        self.guesses, self.unread = [], []
        self.agent_selector.reorder([str(name) for name in self.np_random.permutation(self.possible_agents)])
        self.feedback = f"Guess from 1 to {self.limit}, as \\boxed{{7}}; \\boxed{{0}} leaves.\n"
        return self.told()

    def observe(self, agent: str) -> Any:
        return "".join(self.parts(agent))

    def parts(self, agent: str) -> tuple[str, str]:
        unread = "That was no number.\n" if agent in self.unread else ""
        return unread + self.feedback, f"Guesses so far: {self.guesses}."

    def told(self) -> dict[str, Any]:
        return {
            agent: dict(zip(("feedback", "suffix"), self.parts(agent), strict=True)) for agent in self.possible_agents
        }

    def process_actions(self, actions: dict[str, str]) -> Any:
        parsed = {agent: self.parse(action) for agent, action in actions.items()}
        self.unread = [agent for agent, guess in parsed.items() if guess is None]
        self.guesses += [guess or 0 for guess in parsed.values()]
        # A little noise that comes from the task's own generator, so that state without generators is seen.
        self.feedback = f"{self.hint(actions)} Omen: {int(self.np_random.integers(1000))}.\n"
        won = {agent: guess == self.secret for agent, guess in parsed.items()}
        over = any(won.values()) or len(self.guesses) >= 9
        rewards = {agent: float(won.get(agent, False)) - 0.25 for agent in self.agents}
        terminations = {agent: over or parsed.get(agent) == 0 for agent in self.agents}
        infos = {agent: told for agent, told in self.told().items() if agent in self.agents}
        for agent, guess in parsed.items():
            infos[agent] |= {"parsed_action": guess, "correct": won[agent]}
        return rewards, terminations, {}, infos

    def hint(self, actions: dict[str, str]) -> str:
        return "higher" if self.guesses[-1] < self.secret else "lower"

    def parse(self, action: str) -> int | None:
        content = extract_last_boxed_answer(action)
        return int(content) if content and re.fullmatch("[0-9]|10", content, re.ASCII) else None

    def sample_random_action(self, agent: str) -> str:
        return f"\\boxed{{{int(self.action_random.integers(0, self.limit + 1))}}}"

    def _get_state(self) -> dict[str, Any]:
        names = ("secret", "guesses", "feedback", "unread")
        return {name: list(value) if isinstance(value := getattr(self, name), list) else value for name in names}

    def _set_state(self, state: dict[str, Any]) -> None:
        self.secret, self.feedback = state["secret"], state["feedback"]
        self.guesses, self.unread = list(state["guesses"]), list(state["unread"])


# Promises about agents.

breaks("seats")(EnvSpec(id="check:Seats-v0", entry_point=GoodJointEnv, seats=("red", "green")))


@breaks("turns")
class RewardsForAllEnv(GoodJointEnv):
    """It gives everyone a reward in each step."""

    def step(self, actions: Any) -> Any:
        observations, rewards, *rest = super().step(actions)
        return observations, {**dict.fromkeys(self.terminations, 0.0), **rewards}, *rest


@breaks("turns", "leaving")
class FlagsOfTheActiveEnv(GoodJointEnv):
    """It forgets who has ended."""

    def step(self, actions: Any) -> Any:
        observations, rewards, terminations, truncations, infos = super().step(actions)
        flags = [{agent: each[agent] for agent in rewards} for each in (terminations, truncations)]
        return observations, rewards, *flags, infos


@breaks("leaving")
class NoFinalObsEnv(GoodJointEnv):
    """It keeps the last observation of who ends to itself."""

    def step(self, actions: Any) -> Any:
        result = super().step(actions)
        for info in result[-1].values():
            info.pop("final_obs", None)
        return result


@breaks("leaving", "turns", "accounting")
class LingeringEnv(GoodJointEnv):
    """It sets the flag itself of who leaves, who then stays."""

    def process_actions(self, actions: dict[str, str]) -> Any:
        rewards, terminations, *rest = super().process_actions(actions)
        if not all(terminations.values()):
            self.terminations |= {agent: True for agent, flag in terminations.items() if flag}
            terminations = {}
        return rewards, terminations, *rest


@breaks("accounting")
class DoublePayEnv(GoodJointEnv):
    """It returns rewards, and adds them up as well."""

    def process_actions(self, actions: dict[str, str]) -> Any:
        result = super().process_actions(actions)
        for agent, reward in result[0].items():
            self.cumulative[agent] += reward
        return result


@breaks("refused-actions")
class LenientEnv(GoodJointEnv):
    """It takes a missing action for an empty one."""

    def step(self, actions: Any) -> Any:
        return super().step({**dict.fromkeys(self.acting, ""), **actions})


@breaks("reasoning")
class EchoEnv(GoodJointEnv):
    """It shows to all how a response begins."""

    def hint(self, actions: dict[str, str]) -> str:
        return " ".join(action[:60] for action in actions.values())


@breaks("reasoning")
class ClosedBlocksEnv(GoodJointEnv):
    """It takes out thinking between two tags, and forgets that a template may open the block."""

    def hint(self, actions: dict[str, str]) -> str:
        return " ".join(re.sub("(?s)<think>.{,99}(</think>|$)", "", action[:60]) for action in actions.values())


@breaks("reasoning")
class InfoEchoEnv(GoodJointEnv):
    """It tells the others in their info what was said."""

    def process_actions(self, actions: dict[str, str]) -> Any:
        *result, infos = super().process_actions(actions)
        for info in infos.values():
            info["said"] = [action[:60] for action in actions.values()]
        return *result, infos


# Promises of all environments, each broken for one agent.


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
