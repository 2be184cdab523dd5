"""The forms that an answer may have."""

from __future__ import annotations

from dataclasses import dataclass

from gem_math.grading.quantities import Leaf, Unit
from gem_math.grading.text import is_name, plain_name


@dataclass(frozen=True)
class Words:
    """Text, compared word by word.

    Args:
        words: In lower case, with # for each formula.
        text: As it was written.
        formulas: What stands among the words, in order.
    """

    words: str
    text: str
    formulas: tuple[Form, ...] = ()


@dataclass(frozen=True)
class Choice:
    """A letter of a multiple choice, or another label of one letter, and what stands behind it."""

    letter: str
    rest: Form | None


@dataclass(frozen=True)
class Parts:
    """Several things.

    Args:
        kind: Its brackets, as ``[)``, where they stand in order: a tuple, vector or interval; or "list" or "or" side by
            side, "set", "union", "ratio", "matrix" of rows, "row".
        items: The things.
        text: LaTeX of a matrix, and the text of a ratio.
    """

    kind: str
    items: tuple[Form, ...]
    text: str = ""


@dataclass(frozen=True)
class Equality:
    """A name and its value or set; or, with an empty name, two sides that are equal.

    Args:
        name: The name.
        value: What stands behind the last sign.
        steps: What stands before it, as in x = 2 + 3 = 5.
        sides: LaTeX of the first and last side, for an equation that may be moved and multiplied.
    """

    name: str
    value: Form
    steps: tuple[Form, ...] = ()
    sides: tuple[str, str] | None = None


@dataclass(frozen=True)
class Inequality:
    """A chain of inequalities; ``unit`` is that of its numbers."""

    sides: tuple[str, ...]
    signs: tuple[str, ...]
    text: str
    unit: Unit | None = None


@dataclass(frozen=True)
class Congruence:
    """What a whole number leaves when it is divided: 3 modulo 7; ``least`` is the residue from 0 on."""

    name: str
    residue: Form
    least: Form
    modulus: Form


@dataclass(frozen=True)
class Cases:
    """Values, each with the condition under which it holds, or None."""

    rows: tuple[tuple[Form, Form | None], ...]


@dataclass(frozen=True)
class Opaque:
    """What is none of these, and whether there are words in it, which say nothing to a computer algebra system."""

    text: str
    has_words: bool = False


Form = Leaf | Words | Choice | Parts | Equality | Inequality | Congruence | Cases | Opaque


def spread(form: Form) -> tuple[Form, ...]:
    """Return the things that stand side by side; what is one thing, alone."""
    return form.items if isinstance(form, Parts) and form.kind in {"list", "or"} else (form,)


def is_region(form: Form) -> bool:
    """Whether a form says where a letter lies, as no other does."""
    if isinstance(form, Parts) and form.kind in {"list", "or"}:
        return any(map(is_region, form.items))
    return isinstance(form, Inequality) or (isinstance(form, Parts) and form.kind == "union")


def is_interval(form: Form) -> bool:
    """Whether a pair in brackets is no point."""
    if not isinstance(form, Parts) or len(form.items) != 2:
        return False
    return form.kind in {"[)", "(]", "[]"} or any(isinstance(end, Leaf) and "infty" in end.text for end in form.items)


def name_of(form: Form) -> str:
    """Return the name of what lies somewhere; nothing where there is none, or a formula."""
    if isinstance(form, Inequality):
        names = [side for side in (form.sides[1:2] if len(form.sides) > 2 else form.sides) if is_name(side)]
        return plain_name(names[0]) if len(names) == 1 and "|" not in names[0] else ""
    found = {name_of(item) for item in form.items} if isinstance(form, Parts) and form.items else {""}
    return found.pop() if len(found) == 1 else ""
