"""An environment of three agents that keeps every promise, and some that break one about agents."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from gem_core import AgentSelector, EnvSpec, MultiAgentEnv, extract_last_boxed_answer

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
        self.agent_selector.order = [str(name) for name in self.np_random.permutation(self.possible_agents)]
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


breaks("seats")(EnvSpec(id="check:Seats-v0", entry_point=GoodJointEnv, seats=("red", "green")))


@breaks("turns")
class RewardsForAllEnv(GoodJointEnv):
    """It gives everyone a reward in each step."""

    def step(self, actions: Any) -> Any:
        observations, rewards, *rest = super().step(actions)
        return observations, {**dict.fromkeys(self.terminations, 0.0), **rewards}, *rest


@breaks("leaving")
class NoFinalObsEnv(GoodJointEnv):
    """It keeps the last observation of who ends to itself."""

    def step(self, actions: Any) -> Any:
        result = super().step(actions)
        for info in result[-1].values():
            info.pop("final_obs", None)
        return result


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


@breaks("types", "hostile-actions")
class PartsForGreenEnv(GoodJointEnv):
    """It shows one agent content parts, which are not in that one's space."""

    def observe(self, agent: str) -> Any:
        text = super().observe(agent)
        return [{"type": "text", "text": text}] if agent == "green" else text

    def told(self) -> dict[str, Any]:
        return {agent: {} for agent in self.possible_agents}


@breaks("interleaving")
class SharedSelectorEnv(GoodJointEnv):
    """All instances have one selector, as one has who makes it in the body of the class."""

    shared_selector = AgentSelector()

    def __init__(self) -> None:
        super().__init__()
        self.agent_selector = self.shared_selector


@breaks("hostile-actions")
class BlueDigitsEnv(GoodJointEnv):
    """It believes, of the last agent alone, that what isdigit() is a number; who cannot be read ends it for all."""

    def process_actions(self, actions: dict[str, str]) -> Any:
        answer = actions.get("blue", "").removeprefix("\\boxed{").removesuffix("}")
        if answer.isdigit():
            int(answer)
        rewards, terminations, *rest = super().process_actions(actions)
        return rewards, dict.fromkeys(terminations, True) if self.unread else terminations, *rest
