r"""``AnswerForm``: the form in which a task expects answers, so that a person may type just ``25``."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

from gem_core.errors import SamplingNotSupported
from gem_core.parsing import extract_code_blocks, extract_last_boxed_answer
from gem_core.rollouts.agent import Context
from gem_core.tools.tool import CALL_OPEN
from gem_core.types import Observation

_BOX = "\\boxed{"
_MARKS = ("\\boxed", "<answer>", "</answer>")
_FENCES = ("```", "~~~")
_ONE_TAG = re.compile(r"\s*+<([A-Za-z][\w-]*+)(?:\s[^<>]*)?(?:/>|>.*</\1>)\s*+", re.DOTALL)
_LAST_TAG = re.compile(r"</([A-Za-z][\w-]*+)>\s*+\Z")


@dataclass(frozen=True)
class AnswerForm:
    r"""What stands around an answer, as ``\boxed{`` and ``}``; nothing where any text will do.

    Args:
        opening: What stands before the answer.
        closing: What stands after the answer.
    """

    opening: str = ""
    closing: str = ""

    @classmethod
    def of_task(cls, observation: Observation, context: Context) -> Self:
        """Return the form that an answer has in the present state of an episode."""
        try:
            return cls.of_example(context.sample_random_action())
        except SamplingNotSupported:
            first = context.transitions[0].observation if context.transitions else observation
            return cls.of_instructions(first) if isinstance(first, str) else cls()

    @classmethod
    def of_example(cls, example: str) -> Self:
        """Return the form of a valid action, such as ``sample_random_action`` gives; none if it calls a tool."""
        if CALL_OPEN in example:
            return cls()
        blocks = extract_code_blocks(example)
        if blocks:
            return cls(f"```{blocks[-1].language}\n", "\n```")
        tag = _LAST_TAG.search(example)
        start = example.rfind(f"<{tag[1]}>", 0, tag.start()) if tag else -1
        if tag and start >= 0:
            content = example[start + len(tag[1]) + 2 : tag.start()].strip()
            boxed = content.startswith(_BOX) and content.endswith("}")
            return cls(f"<{tag[1]}>{_BOX if boxed else ''}", f"{'}' if boxed else ''}</{tag[1]}>")
        return cls(_BOX, "}") if extract_last_boxed_answer(example) is not None else cls()

    @classmethod
    def of_instructions(cls, text: str) -> Self:
        """Return the form that a task's words ask for, where it cannot give an example."""
        if _BOX in text:
            return cls(_BOX, "}")
        return cls("<answer>", "</answer>") if "<answer>" in text else cls()

    def __bool__(self) -> bool:
        return bool(self.opening)

    def __str__(self) -> str:
        return f"{self.opening}…{self.closing}"

    def around(self, answer: str, tools: Iterable[str] = ()) -> str:
        """Return an answer in this form; one that is in a form already, or calls a tool, is left alone.

        Args:
            answer: What a person typed.
            tools: Names of the tools that may be called.
        """
        if not self or self._is_in(answer) or _calls(answer, tools):
            return answer
        return f"{self.opening}{answer}{self.closing}"

    def _is_in(self, answer: str) -> bool:
        if self.opening.startswith("```"):
            return any(fence in answer for fence in _FENCES)
        # A task may have actions in several tags, as a terminal's <finish/>.
        if self.opening.startswith("<") and _ONE_TAG.fullmatch(answer):
            return True
        return any(mark in answer for mark in (*_MARKS, self.opening.removesuffix(_BOX)) if mark)


def _calls(answer: str, tools: Iterable[str]) -> bool:
    names = list(tools)
    marks = (CALL_OPEN, *_FENCES, *(f"<{name}>" for name in names))
    return bool(names) and any(mark in answer for mark in marks)
