"""Small environments, tools and agents that the core's tests share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pydantic

import gem_core as gem
from gem_core.types import ResetResult, StepResult


class CountdownEnv(gem.Env):
    """Ends after as many turns as the first observation says; the reward of a turn is its number."""

    def __init__(self, longest: int = 4, fail: str = "", fail_seeds: tuple[int, ...] = ()) -> None:
        super().__init__()
        self.longest = longest
        self.fail = fail
        self.fail_seeds = fail_seeds
        self.left = self.turn = 0
        self.closed = 0

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        super().reset(seed=seed)
        self._fail_in("reset")
        self.left, self.turn = int(self.np_random.integers(1, self.longest + 1)), 0
        if options and "left" in options:
            self.left = options["left"]
        return self._observed("Count down.\n")

    def step(self, action: str) -> StepResult:
        self._fail_in("step")
        self.turn += 1
        self.left -= 1
        observation, info = self._observed(f"You said {action[:20]!r}.\n")
        over = self.left <= 0
        if over:
            info["correct"] = action.endswith("!")
        return observation, float(self.turn), over, False, info

    def sample_random_action(self) -> str:
        return str(int(self.action_random.integers(1000)))

    def close(self) -> None:
        self.closed += 1

    def _fail_in(self, where: str) -> None:
        if self.fail == where and (not self.fail_seeds or self.np_random_seed in self.fail_seeds):
            raise RuntimeError(f"broken in {where}")
        if self.fail == f"exit in {where}":
            raise SystemExit(3)

    def _observed(self, feedback: str) -> ResetResult:
        suffix = f"Left: {self.left}."
        return feedback + suffix, {"feedback": feedback, "suffix": suffix}


class EchoEnv(gem.Env):
    """Repeats what it is told, without feedback and suffix, until it is told 'stop'."""

    answer_fences = ("text",)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        super().reset(seed=seed)
        return "Say something.", {}

    def step(self, action: str) -> StepResult:
        return f"Heard: {action}", 0.0, action == "stop", False, {}


class Calculator(gem.Tool):
    """Adds or divides two numbers."""

    name = "calculator"
    description = "Adds or divides two numbers."
    concurrency = "inline"

    class Parameters(pydantic.BaseModel):
        """Two numbers and what to do with them."""

        left: float
        right: float
        operation: str = "add"

    def call(self, arguments: Parameters, session: Any) -> str:
        if arguments.operation == "divide":
            return str(arguments.left / arguments.right)
        return str(arguments.left + arguments.right)


class Notebook(gem.Tool):
    """Keeps lines for the episode; has a text form and a session."""

    name = "note"
    description = "Writes a line into the notebook and shows it all."
    fences = ("note",)
    concurrency = "inline"

    class Parameters(pydantic.BaseModel):
        """One line."""

        line: str

    def __init__(self) -> None:
        self.opened = self.closed = 0

    def open(self) -> list[str]:
        self.opened += 1
        return []

    def close(self, session: list[str]) -> None:
        self.closed += 1

    def call(self, arguments: Parameters, session: list[str]) -> gem.ToolResult:
        session.append(arguments.line)
        return gem.ToolResult("\n".join(session), info={"lines": len(session)})


class AsyncNotebook(Notebook):
    """The same, written as coroutines."""

    async def open(self) -> list[str]:  # type: ignore[override]  # a coroutine is allowed in its place
        return Notebook.open(self)

    async def close(self, session: list[str]) -> None:  # type: ignore[override]  # as above
        Notebook.close(self, session)

    async def call(self, arguments: Any, session: list[str]) -> gem.ToolResult:  # type: ignore[override]  # as above
        return Notebook.call(self, arguments, session)


def sampling_agent(observation: gem.Observation, context: Any) -> str:
    """Answer with a sampled action."""
    return str(context.sample_random_action())


def by_key(episodes: Iterable[gem.Episode]) -> list[gem.Episode]:
    """Return episodes in the order of their plan."""
    return sorted(episodes, key=lambda episode: (int(episode.key), episode.repeat))


def register_toys() -> None:
    """Register the environments above."""
    gem.register("toy:Countdown-v0", CountdownEnv)
    gem.register("toy:Echo-v0", EchoEnv)
    rows = [{"question": f"{number}+1", "answer": str(number + 1), "name": f"row-{number}"} for number in range(7)]
    gem.register("toy:Sums-v0", "gem_core:DatasetEnv", rows=rows)
