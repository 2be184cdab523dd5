"""What a problem of code:Sample consists of."""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import dedent
from typing import Any


@dataclass(frozen=True)
class Problem:
    """A problem, its tests, and programs that are right and wrong.

    Args:
        id: Its name in the data set.
        level: 1 to 3, as in easy to hard.
        statement: What is asked.
        reference: A program that is right.
        wrong: Programs that are not, by the mistake in each.
        inputs: Standard input of each test; empty for a function.
        function: Name of the function; None for a whole program.
        calls: Arguments of each call of the function.
        more: Tests of the function that are more than a call and its result, as Python code.
        check_form: Whether the tests are a ``check(candidate)``, as in HumanEval; else plain assertions, as in MBPP.
    """

    id: str
    level: int
    statement: str
    reference: str
    wrong: Mapping[str, str]
    inputs: Sequence[str] = ()
    function: str | None = None
    calls: Sequence[tuple[Any, ...]] = ()
    more: str = ""
    check_form: bool = True


def text(source: str) -> str:
    """Return a block of text without the indentation that it has in its file."""
    return dedent(source).strip("\n") + "\n"


def numbers(seed: int, count: int, low: int, high: int) -> list[int]:
    """Return whole numbers, the same ones for the same seed."""
    generator = random.Random(seed)
    return [generator.randint(low, high) for _ in range(count)]


def row(values: Sequence[object]) -> str:
    """Return values as one line."""
    return " ".join(map(str, values))


def letters(seed: int, count: int, alphabet: str) -> str:
    """Return random letters, the same ones for the same seed."""
    return "".join(random.Random(seed).choices(alphabet, k=count))
