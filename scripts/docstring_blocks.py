"""For `make docs`, an extension of griffe: what mkdocstrings would not understand of our docstrings.

Blocks of code, which follow a line that ends with ``::``, become blocks of Markdown. A class that is called with its
fields, as a NamedTuple or a model of pydantic, has attributes where its docstring says ``Args:``. Formulas become
MathML, and names of pages become links.
"""

from __future__ import annotations

import ast
import re
import textwrap
from typing import Any

import griffe  # type: ignore[import-not-found]
from latex2mathml.converter import convert  # type: ignore[import-not-found]

BLOCK = re.compile(r"^(?P<indent> *)(?P<text>.*?):{2}\n\n?(?P<code>(?:(?P=indent) {4}.*\n?|[ ]*\n)+)", re.MULTILINE)
FORMULA = re.compile(r":math:`([^`]+)`")
PAGE = re.compile(r"``docs/([\w-]+\.md)``")


class DocstringBlocks(griffe.Extension):  # type: ignore[misc]
    """Rewrites docstrings before they are read."""

    def on_instance(self, *, obj: Any, **_: Any) -> None:
        """Rewrite the docstring of one module, class, function or attribute."""
        if obj.docstring:
            text = FORMULA.sub(
                lambda match: f"<span>{convert(match[1])}</span>", BLOCK.sub(fenced, obj.docstring.value)
            )
            obj.docstring.value = PAGE.sub(r"[\1](../\1)", text)

    def on_class_members(self, *, cls: Any, **_: Any) -> None:
        """Rewrite the docstring of a class without a constructor of its own, once its members are known."""
        if cls.docstring and "__init__" not in cls.members and not cls.decorators:
            cls.docstring.value = re.sub(r"^Args:$", "Attributes:", cls.docstring.value, flags=re.MULTILINE)


def fenced(match: re.Match[str]) -> str:
    """Return a block between fences, with what comes before it."""
    indent, text = match["indent"], match["text"]
    code = textwrap.dedent(match["code"]).strip("\n")
    before = f"{indent}{text}:\n\n" if text and text != "Example" else ""
    lines = [f"```{language_of(code)}", *code.splitlines(), "```"]
    return before + "".join(f"{indent}{line}".rstrip() + "\n" for line in lines) + "\n"


def language_of(code: str) -> str:
    """Return "python" for what is Python, "toml" for a table of TOML, otherwise "text"."""
    if re.match(r"\[[\w.\"-]+\]\n", code):
        return "toml"
    try:
        ast.parse(code)
    except SyntaxError:
        return "text"
    return "python"
