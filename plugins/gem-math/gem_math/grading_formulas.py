r"""Reads a formula, in LaTeX or plain, into a tree that can be evaluated.

What it does not know, such as sums, integrals and infinity, it does not read at all.
"""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Any, NamedTuple

_MAX_NODES, _MAX_DEPTH = 600, 60

Tree = tuple[Any, ...]


class UnsupportedError(Exception):
    """The formula is none that can be evaluated here."""


_TOKEN = re.compile(
    r"\s*(?:(?P<number>\d+(?:\.\d*)?|\.\d+)|(?P<command>\\(?:[a-zA-Z]+|[{}|%$]))|(?P<letter>[a-zA-Z])"
    r"|(?P<sign>[-+*/^_(){}\[\]|!%=]))"
)
_GREEK = {
    "alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "iota", "kappa", "lambda", "mu", "nu", "xi",
    "rho", "sigma", "tau", "phi", "chi", "psi", "omega", "Gamma", "Delta", "Theta", "Lambda", "Sigma", "Phi", "Psi",
    "Omega", "ell",
}  # fmt: skip
_FUNCTIONS = {
    "sin", "cos", "tan", "cot", "sec", "csc", "arcsin", "arccos", "arctan", "sinh", "cosh", "tanh", "ln", "log", "exp",
    "lg",
}  # fmt: skip
_CLOSING = {"(": ")", "[": "]", "{": "}", r"\{": r"\}", r"\lfloor": r"\rfloor", r"\lceil": r"\rceil"}
_TIMES = {"*", r"\cdot", r"\times"}


class Formula(NamedTuple):
    """A formula that was read.

    Args:
        tree: Its parts.
        letters: Names of its variables.
        whole: Whether it only makes sense for whole numbers, as with factorials and floors.
        ambiguous_log: Whether it has logarithms without a base.
    """

    tree: Tree
    letters: frozenset[str]
    whole: bool
    ambiguous_log: bool


def read_formula(text: str) -> Formula | None:
    """Return a formula, or None where this module cannot read all of the text."""
    try:
        return _Reader(text).read()
    except (UnsupportedError, RecursionError):
        return None


class _Reader:
    """Reads a formula by recursive descent."""

    def __init__(self, text: str) -> None:
        self.tokens: list[tuple[str, str, bool]] = []
        position = 0
        text = text.rstrip()
        while position < len(text):
            match = _TOKEN.match(text, position)
            if match is None:
                raise UnsupportedError
            kind = match.lastgroup or ""
            self.tokens.append((kind, match[kind], match.start(kind) > position))
            position = match.end()
        if len(self.tokens) > _MAX_NODES:
            raise UnsupportedError
        self.at = 0
        self.depth = 0
        self.bars = 0
        self.letters: set[str] = set()
        self.whole = False
        self.ambiguous_log = False

    def read(self) -> Formula:
        if not self.tokens:
            raise UnsupportedError
        tree = self.sum()
        if self.at < len(self.tokens):
            raise UnsupportedError
        return Formula(tree, frozenset(self.letters), self.whole, self.ambiguous_log)

    def next(self) -> str:
        return self.tokens[self.at][1] if self.at < len(self.tokens) else ""

    def kind(self) -> str:
        return self.tokens[self.at][0] if self.at < len(self.tokens) else ""

    def take(self, token: str | None = None) -> str:
        found = self.next()
        if not found or (token is not None and found != token):
            raise UnsupportedError
        self.at += 1
        return found

    def sum(self) -> Tree:
        self.depth += 1
        if self.depth > _MAX_DEPTH:
            raise UnsupportedError
        sign = -1 if self.next() == "-" else 1
        if self.next() in {"+", "-"}:
            self.take()
        terms = [self.product() if sign > 0 else ("-", self.product())]
        while self.next() in {"+", "-"}:
            sign = -1 if self.take() == "-" else 1
            terms.append(self.product() if sign > 0 else ("-", self.product()))
        self.depth -= 1
        return terms[0] if len(terms) == 1 else ("+", *terms)

    def product(self) -> Tree:
        tree = self.signed()
        while True:
            token = self.next()
            if token in _TIMES:
                self.take()
                tree = ("*", tree, self.signed())
            elif token in {"/", r"\div"}:
                self.take()
                tree = ("/", tree, self.signed())
            elif self.begins_factor():
                # Two numbers side by side are no product, but for a number before a bracket or a command.
                if self.kind() == "number" and self.tokens[self.at - 1][0] == "number":
                    raise UnsupportedError
                if self.kind() == "number" and self.tokens[self.at - 1][1] == "}" and not self.tokens[self.at][2]:
                    raise UnsupportedError
                tree = ("*", tree, self.power())
            else:
                return tree

    def begins_factor(self) -> bool:
        token = self.next()
        if token == "|":
            return self.bars == 0
        return self.kind() in {"number", "letter"} or token in {
            "(", "[", "{", r"\{", r"\frac", r"\sqrt", r"\pi", r"\binom", r"\lfloor", r"\lceil",
        } or (token[1:] in _FUNCTIONS or token[1:] in _GREEK if token.startswith("\\") else False)  # fmt: skip

    def signed(self) -> Tree:
        if self.next() in {"+", "-"}:
            return ("-", self.signed()) if self.take() == "-" else self.signed()
        return self.power()

    def power(self) -> Tree:
        tree = self.postfix(self.atom())
        if self.next() != "^":
            return tree
        self.take()
        if self.next() in {r"\circ", "{"} and self.is_degree():
            return self.postfix(("*", ("/", tree, ("n", Fraction(180))), ("pi",)))
        tree = ("^", tree, self.exponent())
        return self.postfix(tree)

    def is_degree(self) -> bool:
        names = [token[1] for token in self.tokens[self.at : self.at + 3]]
        if names[:1] == [r"\circ"]:
            self.at += 1
            return True
        if names == ["{", r"\circ", "}"]:
            self.at += 3
            return True
        return False

    def exponent(self) -> Tree:
        if self.next() in {"+", "-"}:
            return ("-", self.exponent()) if self.take() == "-" else self.exponent()
        tree = self.atom()
        if self.next() == "^":
            self.take()
            return ("^", tree, self.exponent())
        return tree

    def postfix(self, tree: Tree) -> Tree:
        while self.next() in {"!", "%", r"\%"}:
            if self.take() == "!":
                self.whole = True
                tree = ("!", tree)
            else:
                tree = ("/", tree, ("n", Fraction(100)))
        return tree

    def atom(self) -> Tree:
        kind, token = self.kind(), self.take()
        if kind == "number":
            return self.number(token)
        if kind == "letter":
            return self.letter(token)
        if token == "|" and self.bars == 0:
            self.bars += 1
            inner = self.sum()
            self.take("|")
            self.bars -= 1
            return ("abs", inner)
        return self.bracket(token) if token in _CLOSING else self.command(token)

    def command(self, token: str) -> Tree:
        if token in {r"\frac", r"\binom"}:
            self.whole = self.whole or token == r"\binom"
            return ("/" if token == r"\frac" else "binom", self.argument(), self.argument())
        if token == r"\sqrt":
            return self.root()
        if token == r"\pi":
            return ("pi",)
        name = token[1:]
        if name in _FUNCTIONS:
            return self.function(name)
        if name in _GREEK:
            return self.letter(token)
        raise UnsupportedError

    def bracket(self, opening: str) -> Tree:
        bars, self.bars = self.bars, 0
        inner = self.sum()
        self.take(_CLOSING[opening])
        self.bars = bars
        if opening in {r"\lfloor", r"\lceil"}:
            self.whole = True
            return ("floor" if opening == r"\lfloor" else "ceil", inner)
        return inner

    def number(self, token: str) -> Tree:
        if len(token) > 4000:
            raise UnsupportedError
        tree: Tree = ("n", Fraction(token.rstrip(".") if token.endswith(".") else token))
        following = self.next()
        if following in _MIXED and "." not in token and self.mixed():
            whole = tree
            self.take(r"\frac")
            return ("+", whole, ("/", self.argument(), self.argument()))
        return tree

    def mixed(self) -> bool:
        r"""Whether a fraction of plain numbers follows, as in 2\\frac{1}{3}."""
        names = [token[1] for token in self.tokens[self.at + 1 : self.at + 7]]
        if len(names) >= 6 and names[0] == names[3] == "{" and names[2] == names[5] == "}":
            return names[1].isdigit() and names[4].isdigit()
        return False

    def letter(self, token: str) -> Tree:
        if token == "e" and self.next() != "_":
            return ("e",)
        if token == "i" and self.next() != "_":
            return ("i",)
        name = token
        if self.next() == "_":
            self.take()
            if self.next() == "{":
                inside: list[str] = []
                self.take()
                while self.next() not in {"}", "{", ""}:
                    inside.append(self.take())
                self.take("}")
                name += "_" + "".join(inside)
            else:
                name += "_" + self.take()
        self.letters.add(name)
        return ("x", name)

    def root(self) -> Tree:
        index: Tree = ("n", Fraction(2))
        if self.next() == "[":
            self.take()
            index = self.sum()
            self.take("]")
        return ("root", self.argument(), index)

    def argument(self) -> Tree:
        """The argument of a command: a group, or a single sign."""
        if self.next() == "{":
            self.take()
            inner = self.sum()
            self.take("}")
            return inner
        kind, token = self.kind(), self.next()
        if kind == "number" and token.isdigit() and len(token) > 1:
            # \frac12: each digit is an argument of its own.
            self.tokens[self.at : self.at + 1] = [("number", digit, False) for digit in token]
        if kind in {"number", "letter"} or token in {"(", r"\pi", r"\sqrt"}:
            return self.atom()
        raise UnsupportedError

    def function(self, name: str) -> Tree:
        base: Tree | None = None
        power: Tree | None = None
        for _ in range(2):
            if self.next() == "_" and base is None and name == "log":
                self.take()
                base = self.argument()
            elif self.next() == "^" and power is None:
                self.take()
                power = self.argument() if self.next() != "-" else self.exponent()
        if name == "lg":
            name, base = "log", ("n", Fraction(10))
        if name == "log" and base is None:
            self.ambiguous_log = True
        if power in _INVERSE and name in {"sin", "cos", "tan"}:
            name, power = f"arc{name}", None
        elif power in _INVERSE:
            raise UnsupportedError
        inner = self.function_argument()
        tree: Tree = ("log", inner, base) if name == "log" else (name, inner)
        return ("^", tree, power) if power is not None else tree

    def function_argument(self) -> Tree:
        if self.next() in {"(", "[", "{"}:
            return self.power()
        # \sin 2x: factors up to the next sign or function.
        tree = self.signed() if self.next() in {"+", "-"} else self.power()
        while self.begins_factor() and self.next()[1:] not in _FUNCTIONS and self.next() not in {"(", "[", "|"}:
            tree = ("*", tree, self.power())
        if self.next() == "/" and self.at + 1 < len(self.tokens) and self.tokens[self.at + 1][0] == "number":
            self.take()
            tree = ("/", tree, self.power())
        return tree


_INVERSE = (("n", Fraction(-1)), ("-", ("n", Fraction(1))))
_MIXED = {r"\frac"}
