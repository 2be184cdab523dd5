r"""Questions about pictures that are drawn for them: how many shapes, which shape, which colour."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any

import gem_core as gem
from gem_core.env import Content
from gem_core.errors import ArgumentError
from gem_core.parsing import extract_last_boxed_answer
from gem_core.types import ResetResult, StepResult

if TYPE_CHECKING:
    from gymnasium import spaces
    from PIL.Image import Image

_COLOURS = {"red": (220, 40, 40), "green": (40, 160, 60), "blue": (50, 80, 220), "yellow": (235, 190, 30)}
_CORNERS = {"circle": 0, "square": 4, "triangle": 3}
_MOST = 4
_SIDE, _CELL = 64, 32

_QUESTIONS = {
    "number": ("How many shapes are in the picture?", tuple(str(number) for number in range(1, _MOST + 1))),
    "colour": ("What colour are the shapes: red, green, blue or yellow?", tuple(_COLOURS)),
    "shape": ("What are they: circle, square or triangle?", tuple(_CORNERS)),
}


class ShapesEnv(gem.Env):
    r"""A picture of one to four circles, squares or triangles of one colour, and a question about it: a single turn.

    The right answer in ``\boxed{}`` has reward 1, all else 0. A random action is a possible answer of the question, so
    ``"random"`` shows what an answer looks like, and nothing of what is in the picture.

    Args:
        questions: Which are asked: ``"number"``, ``"colour"``, ``"shape"``.

    Raises:
        ArgumentError: An unknown question, or none.
    """

    def __init__(self, questions: tuple[str, ...] | list[str] = tuple(_QUESTIONS)) -> None:
        super().__init__()
        if not questions or not set(questions) <= set(_QUESTIONS):
            raise ArgumentError(f"questions are some of {', '.join(_QUESTIONS)}, not {questions!r}")
        self._questions = list(questions)
        self._question, self._answer = self._questions[0], ""

    @cached_property
    def observation_space(self) -> spaces.Space[Any]:  # type: ignore[override]
        """Content parts."""
        return Content()

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Draw a picture, and ask."""
        super().reset(seed=seed, options=options)
        number = int(self.np_random.integers(1, _MOST + 1))
        colour = list(_COLOURS)[self.np_random.integers(len(_COLOURS))]
        shape = list(_CORNERS)[self.np_random.integers(len(_CORNERS))]
        image = self._draw(number, colour, shape)
        self._question = self._questions[self.np_random.integers(len(self._questions))]
        self._answer = {"number": str(number), "colour": colour, "shape": shape}[self._question]
        text = f"{_QUESTIONS[self._question][0]} Answer inside \\boxed{{}}."
        return [{"type": "image", "image": image}, {"type": "text", "text": text}], {}

    def step(self, action: str) -> StepResult:
        """Compare the answer."""
        right = (extract_last_boxed_answer(action) or "").lower() == self._answer
        return gem.TERMINAL_STATE, float(right), True, False, {"correct": right}

    def sample_random_action(self) -> str:
        """Return a possible answer of the question."""
        answers = _QUESTIONS[self._question][1]
        return f"\\boxed{{{answers[self.action_random.integers(len(answers))]}}}"

    def gold_action(self) -> str:
        """Return the right answer."""
        return f"\\boxed{{{self._answer}}}"

    def _draw(self, number: int, colour: str, shape: str) -> Image:
        """Draw shapes of different sizes and angles, each in a quarter of the picture."""
        from PIL import Image, ImageDraw

        image = Image.new("RGB", (_SIDE, _SIDE), (245, 245, 240))
        draw = ImageDraw.Draw(image)
        for cell in self.np_random.permutation((_SIDE // _CELL) ** 2)[:number].tolist():
            radius = int(self.np_random.integers(9, 13))
            row, column = divmod(cell, _SIDE // _CELL)
            x, y = (_CELL * place + self.np_random.integers(radius, _CELL - radius + 1) for place in (column, row))
            angle, corners = self.np_random.uniform(0, 2 * math.pi), _CORNERS[shape]
            if corners:
                turns = [angle + 2 * math.pi * corner / corners for corner in range(corners)]
                points = [(x + radius * math.cos(turn), y + radius * math.sin(turn)) for turn in turns]
                draw.polygon(points, fill=_COLOURS[colour])
            else:
                draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=_COLOURS[colour])
        return image
