r"""``Form``: what stands around an answer as a task reads it, as ``\boxed{`` and ``}``."""

from __future__ import annotations

import re
from typing import NamedTuple

from gem_core.parsing import extract_code_blocks, extract_last_boxed_answer
from gem_core.tools import CALL_OPEN

_LAST_TAG = re.compile(r"</([A-Za-z][\w-]*+)>\s*+\Z")
_FINISH = re.compile(r"<(?:finish|done|submit|exit|stop)\s*/>")
_SHELLS = ("bash", "sh", "shell", "command", "terminal")


class Form(NamedTuple):
    """What stands before and behind an answer."""

    opening: str = ""
    closing: str = ""

    @classmethod
    def of_example(cls, example: str) -> Form:
        """Return the form of a valid response; the plain form where it has none, or calls a tool."""
        if CALL_OPEN in example:
            return cls()
        blocks = extract_code_blocks(example)
        if blocks:
            return cls(f"```{blocks[-1].language}\n", "\n```")
        tag = _LAST_TAG.search(example)
        if tag and f"<{tag[1]}" in example:
            return cls(f"<{tag[1]}>", f"</{tag[1]}>")
        return BOXED if extract_last_boxed_answer(example) is not None else cls()

    @property
    def is_code(self) -> bool:
        """Whether the answer is a program."""
        return self.opening.startswith("```") and not self.is_shell

    @property
    def is_shell(self) -> bool:
        """Whether the answer is a command for a shell."""
        return self.opening.strip("`<>\n") in _SHELLS

    def around(self, answer: str) -> str:
        """Return a response with the answer in its place."""
        return f"{self.opening}{answer}{self.closing}"

    def content(self, response: str) -> str:
        """Return the answer that a response in this form holds."""
        start = response.rfind(self.opening) if self.opening else -1
        text = response[start + len(self.opening) :] if start >= 0 else response
        return text.strip().removesuffix(self.closing.strip()).strip() if start >= 0 else text.strip()


RAW = Form()
BOXED = Form("\\boxed{", "}")
TAGGED = Form("<answer>", "</answer>")


def form_of_words(text: str) -> Form | None:
    """Return the form that a task's words ask for; None where they name none."""
    if "<answer>" in text:
        return TAGGED
    return BOXED if "\\boxed" in text else None


def finish_of(text: str) -> str | None:
    """Return the response by which an agent says that it is done, as ``<finish/>``, where a task's words name one."""
    found = _FINISH.search(text)
    return None if found is None else found[0]


def content_of(response: str) -> str:
    """Return the answer that a response holds."""
    return Form.of_example(response).content(response)
