"""The forms that an answer may have: a number, a list, a set, an interval, a relation, a matrix, words."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from gem_math.grading_formulas import Formula, read_formula
from gem_math.grading_units import Unit  # noqa: TC001  # dataclasses keep their annotations readable


@dataclass(frozen=True)
class Words:
    """Text, compared word by word."""

    words: str
    text: str


@dataclass(frozen=True)
class Choice:
    """A letter of a multiple choice, and what stands behind it."""

    letter: str
    rest: Form | None


@dataclass(frozen=True)
class Leaf:
    """A formula, with the unit behind it.

    Args:
        text: LaTeX of the formula.
        unit: What stands behind it.
        percent: Whether a per cent sign does.
        base: Base of the number's digits, where one is written.
    """

    text: str
    unit: Unit | None = None
    percent: bool = False
    base: int | None = None

    @cached_property
    def formula(self) -> Formula | None:
        """The formula, where it is one that can be evaluated here."""
        return read_formula(self.text)


@dataclass(frozen=True)
class Group:
    """Things in order between brackets: a tuple, a vector, an interval."""

    opening: str
    items: tuple[Form, ...]
    closing: str


@dataclass(frozen=True)
class Many:
    """Several things in no order: a set, or answers side by side."""

    items: tuple[Form, ...]
    is_set: bool = False


@dataclass(frozen=True)
class Union:
    """Sets put together."""

    parts: tuple[Form, ...]


@dataclass(frozen=True)
class Ratio:
    """Parts with colons between them."""

    parts: tuple[Form, ...]
    text: str


@dataclass(frozen=True)
class Assignment:
    """A name and its value; ``steps`` are the values between, as in x = 2 + 3 = 5."""

    name: str
    value: Form
    steps: tuple[Form, ...] = ()
    left: str = ""
    right: str = ""


@dataclass(frozen=True)
class Equation:
    """Two sides that are equal, the left one being no name."""

    left: str
    right: str
    value: Form
    steps: tuple[Form, ...] = ()


@dataclass(frozen=True)
class Inequality:
    """Where a variable lies: an interval, or a union of them."""

    name: str
    values: Form
    text: str = ""


@dataclass(frozen=True)
class Congruence:
    """What a whole number leaves when it is divided: 3 modulo 7; ``least`` is the residue from 0 on."""

    name: str
    residue: Form
    least: Form
    modulus: Form


@dataclass(frozen=True)
class Matrix:
    """Rows of things."""

    rows: tuple[tuple[Form, ...], ...]
    text: str


@dataclass(frozen=True)
class Cases:
    """Values, each with the condition under which it holds, or None."""

    rows: tuple[tuple[Form, Form | None], ...]


@dataclass(frozen=True)
class Opaque:
    """What is none of these.

    Args:
        text: LaTeX.
        has_words: Whether there are words in it, which are nothing for a computer algebra system.
        unreadable: Whether its brackets do not match, or there are too many parts.
    """

    text: str
    has_words: bool = False
    unreadable: bool = False


Form = (
    Congruence
    | Words
    | Choice
    | Leaf
    | Group
    | Many
    | Union
    | Ratio
    | Assignment
    | Equation
    | Inequality
    | Matrix
    | Cases
    | Opaque
)
