"""A small environment that keeps every promise, and the listing of the paper, which does not."""

from __future__ import annotations

import re
from functools import cached_property
from typing import Any

from gem_core import Env, extract_last_boxed_answer
from gem_core.env.base import AsyncEnv
from gem_core.env.spaces import Content


class GoodEnv(Env):
    """Guess a whole number in a few turns, with state, a board at the end of each observation, and sampling."""

    def __init__(self, limit: int = 10, max_turns: int = 4) -> None:
        self.limit = limit
        self.max_turns = max_turns
        self.secret = 0
        self.guesses: list[int] = []

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.secret = int(self.np_random.integers(1, self.limit + 1))
        self.guesses = []
        return self.answer(f"Guess a number from 1 to {self.limit}, as \\boxed{{7}}.\n")

    def step(self, action: str) -> Any:
        guess = self.parse(action)
        self.guesses.append(0 if guess is None else guess)
        won = guess == self.secret
        over = won or len(self.guesses) >= self.max_turns
        # A little noise that comes from the task's own generator, so that state without generators is seen.
        feedback = f"{self.hint(guess)} Omen: {int(self.np_random.integers(1000))}.\n"
        observation, info = self.answer(feedback)
        info["parsed_action"] = guess
        if over:
            info["correct"] = won
        return observation, float(won), over, False, info

    def answer(self, feedback: str) -> tuple[str, dict[str, Any]]:
        suffix = f"Guesses so far: {self.guesses}."
        return feedback + suffix, {"feedback": feedback, "suffix": suffix}

    def hint(self, guess: int | None) -> str:
        if guess is None:
            return "That was no number in range."
        return "Right." if guess == self.secret else f"It is {'higher' if guess < self.secret else 'lower'}."

    def parse(self, action: str) -> int | None:
        content = extract_last_boxed_answer(action)
        if content is None or not re.fullmatch("[0-9]{1,9}", content):
            return None
        return int(content) if 1 <= int(content) <= self.limit else None

    def sample_random_action(self) -> str:
        return f"\\boxed{{{int(self.action_random.integers(1, self.limit + 1))}}}"


class GoodAsyncEnv(AsyncEnv):
    """The same game, written as coroutines."""

    def __init__(self) -> None:
        self.game = GoodEnv()

    async def reset_async(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        await super().reset_async(seed)
        self.game._np_random = self.np_random
        self.game.secret = int(self.np_random.integers(1, self.game.limit + 1))
        self.game.guesses = []
        return self.game.answer("Guess.\n")

    async def step_async(self, action: str) -> Any:
        return self.game.step(action)

    def sample_random_action(self) -> str:
        return f"\\boxed{{{int(self.action_random.integers(1, self.game.limit + 1))}}}"


class ThreadEnv(GoodEnv):
    """The same game, run as if it blocked."""

    concurrency = "thread"


class PictureEnv(GoodEnv):
    """The same game, with a picture in every observation."""

    @cached_property
    def observation_space(self) -> Content:
        return Content()

    def answer(self, feedback: str) -> Any:
        from PIL import Image

        picture = Image.new("L", (2, 2), color=len(self.guesses))
        suffix = [{"type": "image", "image": picture}]
        return [{"type": "text", "text": feedback}, *suffix], {"feedback": feedback, "suffix": [dict(suffix[0])]}
