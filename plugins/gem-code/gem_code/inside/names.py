"""Whose a name is that tests use and do not define: Python's, its library's or the program's; runs in the sandbox."""

from __future__ import annotations

import ast
import importlib
import re
import symtable
import sys
from collections.abc import Iterable
from typing import Any

from gem_code.inside.codec import PLAIN

_PACKAGES = {"np": "numpy", "pd": "pandas", "nx": "networkx"}
_PACKAGES |= {name: name for name in ("numpy", "pandas", "networkx", "scipy", "sympy", "sklearn", "torch", "pytest")}
"""Packages beside the standard library, by the names that tests have for them."""

_PLACES = [
    "math",
    "collections",
    "itertools",
    "functools",
    "heapq",
    "bisect",
    "copy",
    "typing",
    "datetime",
    "decimal",
    "fractions",
]
"""Modules whose names tests use bare, as ``Counter``."""


def from_library(name: str, tree: ast.Module) -> list[Any]:
    """Return what the standard library, or a package, has under a name and the tests can mean; at most one value.

    Raises:
        ImportError: It is the name of a package that is not installed.
    """
    nodes = list(ast.walk(tree))
    of_name = [node for node in nodes if isinstance(node, ast.Attribute) and getattr(node.value, "id", None) == name]
    called = any(isinstance(node, ast.Call) and _called(node) == name for node in nodes)
    found = []
    if of_name and name in _PACKAGES:
        return [importlib.import_module(_PACKAGES[name])]
    if of_name and name in sys.stdlib_module_names:
        found.append(importlib.import_module(name))
    if not name.startswith("_"):
        found += [vars(place)[name] for place in map(importlib.import_module, _PLACES) if name in vars(place)]
    # An exception is of no use to a program that wants to pass, and may bear the name of one of its own.
    found = [value for value in found if not (isinstance(value, type) and issubclass(value, BaseException))]
    fits = [value for value in found if all(hasattr(value, node.attr) for node in of_name)]
    return [value for value in fits if callable(value) or not called][:1]


def asked_of_the_program(
    tree: ast.Module, unknown: set[str], own: set[str], entry: str | None, prompt: str | None
) -> set[str]:
    """Return which of the names that the tests use and do not define are the program's.

    Those of Python and of its library are not: they judge what is tested, and no program may put its own in their
    place. The program's are the function under test, what the question defines, and, if the tests use no other name,
    what they call with plain values.
    """
    asked = unknown - own | {name for name in unknown if re.search(rf"\b(?:def|class) {name}\b", prompt or "")}
    if asked or entry:
        return asked | ({entry} if entry else set())
    helpers = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    tests = [node for node in tree.body if isinstance(node, ast.FunctionDef) and is_test(node)]
    bodies = [*tests, *(node for node in tree.body if not isinstance(node, helpers))]
    nodes = [node for body in bodies for node in ast.walk(body)]
    asserted = [node.test for node in nodes if isinstance(node, ast.Assert)]
    handed_over = [node for node in nodes if isinstance(node, ast.Call) and _called(node) not in {None, *unknown}]
    kinds = {kind.__name__ for kind in PLAIN} & unknown
    tested = unknown - kinds
    # What makes a value, as list, is what is tested only where nothing else can be.
    return (
        _innermost([*asserted, *handed_over], tested)
        or _innermost(bodies, tested)
        or _innermost([*asserted, *handed_over], kinds)
        or _innermost(bodies, kinds)
    )


def global_names(source: str) -> tuple[set[str], set[str]]:
    """Return the names of the module that code uses, and those that it defines; those of its functions are others."""
    return _names_in(symtable.symtable(source, "<tests>", "exec"))


def _names_in(table: symtable.SymbolTable) -> tuple[set[str], set[str]]:
    used: set[str] = set()
    defined: set[str] = set()
    for symbol in table.get_symbols():
        if table.get_type() == "module" or symbol.is_global():
            if symbol.is_assigned() or symbol.is_imported() or symbol.is_namespace():
                defined.add(symbol.get_name())
            elif symbol.is_referenced():
                used.add(symbol.get_name())
    for child in table.get_children():
        more = _names_in(child)
        used, defined = used | more[0], defined | more[1]
    return used, defined


def _called(node: ast.Call) -> str | None:
    return node.func.id if isinstance(node.func, ast.Name) else None


def _innermost(places: Iterable[ast.AST], names: set[str]) -> set[str]:
    """Return those of some names that are called, and in whose arguments none of them is."""
    calls = [
        node for place in places for node in ast.walk(place) if isinstance(node, ast.Call) and _called(node) in names
    ]
    inner = {id(call) for call in calls}
    return {
        str(_called(call))
        for call in calls
        if not any(id(node) in inner for node in ast.walk(call) if node is not call)
    }


def is_test(node: ast.FunctionDef) -> bool:
    """Tell ``check(candidate)`` and pytest's ``test_…()`` from helpers."""
    count = len(node.args.args)
    return (node.name == "check" and count == 1) or (node.name.startswith("test") and count == 0)
