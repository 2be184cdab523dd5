"""One environment for each promise that breaks it and, where it can be done, nothing else."""

from __future__ import annotations

import os
import random
import re
import secrets
import threading
from collections.abc import Callable
from typing import Any, ClassVar

from joint_toys import AuctionEnv
from reference_envs import GoodEnv

from gem_core import AgentSelector, EnvSpec
from gem_core.env.guard import Guard
from gem_core.env.spaces import Text
from gem_core.env.wrapper import Wrapper
from gem_core.errors import ResetNeededError

BROKEN: dict[Any, tuple[set[str], set[str]]] = {}
"""What makes each environment, the promises that it breaks, and those that it may break beside."""


def breaks(*slugs: str, may: tuple[str, ...] = ()) -> Callable[[Any], Any]:
    def enter(maker: Any) -> Any:
        BROKEN[maker] = set(slugs), set(may)
        return maker

    return enter


@breaks("construct")
class UnmakeableEnv(GoodEnv):
    """Its constructor fails."""

    def __init__(self) -> None:
        raise ValueError("no luck")


@breaks("episode")
class RaisingEnv(GoodEnv):
    """Its step raises, a function further in."""

    def step(self, action: str) -> Any:
        return self.answer_to(int(action))

    def answer_to(self, number: int) -> Any:
        return super().step(str(number))


class Altered(GoodEnv):
    """The good environment, whose results of a step or a reset are changed."""

    def __init__(self, step: Any = None, reset: Any = None) -> None:
        super().__init__()
        self.alter_step, self.alter_reset = step or (lambda *result: result), reset or (lambda *result: result)

    def step(self, action: str) -> Any:
        return self.alter_step(*super().step(action))

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        return self.alter_reset(*super().reset(seed, options))


# Four values, as in the old Gym.
breaks("episode")(Altered(lambda seen, reward, over, cut_off, info: (seen, reward, over, info)))
breaks("types", "hostile-actions", "gymnasium")(Altered(lambda seen, reward, *rest: (seen, float("nan"), *rest)))
breaks("info")(Altered(reset=lambda seen, info: (seen, {**info, "range": (1, 10)})))
breaks("info")(Altered(lambda *rest: (*rest[:4], {**rest[4], **({"correct": "yes"} if "correct" in rest[4] else {})})))
breaks("process-determinism")(Altered(reset=lambda seen, info: (f"Number {hash('number')}.", {})))
breaks("suffix")(
    Altered(
        lambda *rest: (*rest[:4], {**rest[4], "suffix": "Nothing new."}),
        lambda seen, info: (seen, {**info, "suffix": "Nothing new."}),
    )
)
# Cut off by the first answer that it cannot read, which Gymnasium does not allow.
breaks("gymnasium")(
    Altered(lambda seen, won, over, _, info: (seen, won, over, not over and info["parsed_action"] is None, info))
)


class _UniqueText(Text):
    __eq__ = object.__eq__
    __hash__ = object.__hash__


@breaks("spaces")
class UniqueSpaceEnv(GoodEnv):
    """The spaces of two instances are never equal."""

    def __init__(self) -> None:
        super().__init__()
        self.observation_space = _UniqueText()


@breaks("fresh-objects", may=("gymnasium",))
class SharedHistoryEnv(GoodEnv):
    """It gives its list away once, at reset, and goes on writing into it."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        observation, info = super().reset(seed)
        return observation, {**info, "guesses": self.guesses}


class ForgivingWrapper(Wrapper):
    """Answers a step outside an episode instead of refusing it."""

    def step(self, action: str) -> Any:
        try:
            return self.env.step(action)
        except ResetNeededError:
            return "over", 0.0, True, False, {}


@breaks("step-after-end")
def forgiving_env() -> Wrapper:
    return ForgivingWrapper(Guard(GoodEnv()))


@breaks("close-twice")
class OneCloseEnv(GoodEnv):
    """Its close cannot be repeated."""

    def close(self) -> None:
        del self.__dict__["secret"]


@breaks("concurrency")
class OddConcurrencyEnv(GoodEnv):
    """Its concurrency is none of the four."""

    concurrency = "sometimes"  # type: ignore[assignment]


@breaks("determinism", "gymnasium")
class LeftoverEnv(GoodEnv):
    """It counts steps over all episodes of an instance."""

    steps = 0

    def hint(self, guess: int | None) -> str:
        self.steps += 1
        return f"{super().hint(guess)} Step {self.steps}."


@breaks("interleaving", "fork")
class ClassStateEnv(GoodEnv):
    """It keeps the number to guess in its class."""

    shared: ClassVar[list[int]] = [0]

    @property
    def secret(self) -> int:
        return self.shared[0]

    @secret.setter
    def secret(self, value: int) -> None:
        self.shared[0] = value


@breaks("global-random")
class GlobalSeedEnv(GoodEnv):
    """It puts the global generator at a start that its own one decides: repeatable, and rude."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed, options)
        random.setstate(random.Random(int(self.np_random.integers(1000))).getstate())
        self.secret = random.randint(1, self.limit)
        return self.answer("Guess.\n")


@breaks("seed-stream")
class EpisodeCountEnv(GoodEnv):
    """The later episodes of a stream tell their number, so that their own seed does not replay them."""

    number = 0

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed, options)
        self.number = self.number + 1 if seed is None else 0
        return self.answer(f"Episode {self.number}.\n")


@breaks("action-sampling", may=("fork",))
class TaskGeneratorSamplingEnv(GoodEnv):
    """It samples actions from the task's generator."""

    def sample_random_action(self) -> str:
        return f"\\boxed{{{int(self.np_random.integers(1, self.limit + 1))}}}"


@breaks("valid-sample")
class InvalidSampleEnv(GoodEnv):
    """It samples what it does not understand itself."""

    def sample_random_action(self) -> str:
        return "\\boxed{0}"


@breaks("hostile-actions")
class DigitsEnv(GoodEnv):
    """It believes that what isdigit() is a number: a superscript two is not, and 5,000 digits are too many."""

    def parse(self, action: str) -> int | None:
        content = action.removeprefix("\\boxed{").removesuffix("}")
        return int(content) if content.isdigit() and 1 <= int(content) <= self.limit else None


@breaks("fork")
class SharingForkEnv(GoodEnv):
    """Its forks write into its own list."""

    shared_by_forks = ("guesses",)


# Environments of several agents.


class Bids(AuctionEnv):
    """An auction of three agents that keeps every promise."""

    def __init__(self) -> None:
        super().__init__(["red", "green", "blue"], rounds=6)


breaks("seats")(EnvSpec(id="check:Seats-v0", entry_point=Bids, seats=("red", "green")))


@breaks("reasoning")
class ClosedBlocksEnv(Bids):
    """It takes out thinking between two tags, and forgets that a template may open the block."""

    def begin_episode(self, options: dict[str, Any] | None) -> None:
        super().begin_episode(options)
        self.said = ""

    def process_actions(self, actions: dict[str, str]) -> Any:
        self.said = " ".join(re.sub("(?s)<think>.{,99}(</think>|$)", "", action[:60]) for action in actions.values())
        return super().process_actions(actions)

    def observe(self, agent: str) -> str:
        return f"{super().observe(agent)}. Said: {self.said}"


@breaks("types", "hostile-actions")
class PartsForGreenEnv(Bids):
    """It shows one agent content parts, which are not in that one's space."""

    def observe(self, agent: str) -> Any:
        text = super().observe(agent)
        return [{"type": "text", "text": text}] if agent == "green" else text


@breaks("interleaving")
class SharedSelectorEnv(Bids):
    """All instances have one selector, as one has who makes it in the body of the class."""

    shared_selector = AgentSelector(["red", "green", "blue"])

    def __init__(self) -> None:
        super().__init__()
        self.agent_selector = self.shared_selector


@breaks("hostile-actions")
class BlueDigitsEnv(Bids):
    """It believes, of the last agent alone, that what isdigit() is a number."""

    def process_actions(self, actions: dict[str, str]) -> Any:
        if actions.get("blue", "").isdigit():
            int(actions["blue"])
        return super().process_actions(actions)


# Not in the table: these need more than check_env(maker).


class NullHangsEnv(GoodEnv):
    """It never answers a NUL byte, until the test lets it go."""

    concurrency = "thread"

    released = threading.Event()

    def step(self, action: str) -> Any:
        if "\x00" in action:
            self.released.wait()
        return super().step(action)


class BacktrackingEnv(GoodEnv):
    """It reads with a regular expression whose time grows with the square of the text."""

    def parse(self, action: str) -> int | None:
        re.search("<python>(.*?)</python>", action, re.DOTALL)
        return super().parse(action)


class DyingEnv(GoodEnv):
    """A NUL byte ends its process."""

    def parse(self, action: str) -> int | None:
        if "\x00" in action:
            os._exit(3)
        return super().parse(action)


class OtherProcessEnv(GoodEnv):
    """It behaves badly in every process but that in which it was first made."""

    def __init__(self, home: int, deed: str) -> None:
        super().__init__()
        self.home = home
        self.deed = deed

    def step(self, action: str) -> Any:
        if os.getpid() != self.home:
            if self.deed == "hang":
                threading.Event().wait()
            if self.deed == "die":
                os._exit(3)
            if self.deed == "leave":
                raise SystemExit(4)
        return super().step(action)


class UnrepeatableEnv(GoodEnv):
    """It draws from the operating system; its record says so."""

    def hint(self, guess: int | None) -> str:
        return f"{super().hint(guess)} {secrets.randbits(60)}"
