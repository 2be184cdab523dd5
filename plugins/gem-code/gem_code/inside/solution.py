"""Run a program under test and call its functions; runs inside the sandbox, with the standard library alone.

Standard input holds one JSON object: ``code``, the program; ``prompt``, what it continues, or null; ``entry``, the name
of its function, or null; ``calls``, a list of ``[name, arguments]``, the arguments encoded. Standard output gets one
line of JSON for the program, then one for each call, written as soon as it is known. What the program itself prints is
dropped. Nothing here is a secret, and nothing that the program might do to it gains more than a wrong answer.
"""

from __future__ import annotations

import ast
import io
import json
import os
import sys
import types
from typing import Any

from gem_code.inside.codec import NotDataError, decode, dumps, encode

_USUAL = """
import bisect, collections, functools, heapq, itertools, math, operator, random, re, string
from bisect import bisect_left, bisect_right
from collections import Counter, OrderedDict, defaultdict, deque
from functools import cache, cmp_to_key, lru_cache, reduce
from heapq import heapify, heappop, heappush
from itertools import accumulate, combinations, permutations, product
from math import ceil, comb, floor, gcd, inf, sqrt
from typing import *
"""
"""What sites import that ask for a class ``Solution``: answers to their problems leave it out."""


def main() -> None:
    """Read the work, do it, and end the process, whatever threads the program has left."""
    work = json.load(sys.stdin)
    output = os.dup(1)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1):
        os.dup2(nowhere, descriptor)
    sys.stdin, sys.stdout = io.StringIO(), os.fdopen(1, "w", encoding="utf-8", errors="replace", closefd=False)
    say = _Line(output)
    module = _loaded(work, say)
    if module is not None:
        for name, arguments in work["calls"]:
            say(_called(module, name, arguments))
    os._exit(0)


class _Line:
    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._write = os.write

    def __call__(self, text: str) -> None:
        left = memoryview((text + "\n").encode("ascii"))
        while left:
            left = left[self._write(self._descriptor, left) :]


def _loaded(work: dict[str, Any], say: _Line) -> types.ModuleType | None:
    """Return the module that the program makes; None, and say why, where it fails."""
    module = types.ModuleType("solution")
    sys.modules["solution"] = module
    if "class Solution" in work["code"]:
        exec(_USUAL, module.__dict__)
    try:
        pieces = _pieces(work["code"], work["prompt"], work["entry"])
    except (SyntaxError, ValueError, RecursionError, MemoryError, OverflowError) as error:
        say(json.dumps({"failed": "compile_error", "error": _told(error)}))
        return None
    try:
        for piece in pieces:
            exec(piece, module.__dict__)
    except MemoryError as error:
        say(json.dumps({"failed": "memory", "error": _told(error)}))
        return None
    except BaseException as error:  # noqa: BLE001 - whatever the program raises
        say(json.dumps({"failed": "runtime_error", "error": _told(error)}))
        return None
    say(json.dumps({"failed": None}))
    return module


def _pieces(code: str, prompt: str | None, entry: str | None) -> list[types.CodeType]:
    """Return what is to be run: the program, behind what it needs of a prompt that is code itself.

    A response may hold the whole function, or, as the completions of HumanEval, only what the prompt leaves open.
    """
    prelude = _parsed(prompt)
    if prelude is None or entry is None:
        return [compile(code, "<solution>", "exec", dont_inherit=True)]
    kept = (node for node in prelude.body if getattr(node, "name", None) != entry)
    prelude.body = [node for node in kept if not isinstance(node, ast.Expr)]  # prose may be an expression
    try:
        tree = ast.parse(code)
    except SyntaxError:
        completed = f"{prompt}\n{code}"
        if _parsed(completed) is None:
            raise
        return [compile(completed, "<solution>", "exec", dont_inherit=True)]
    # Compiled from its text, so that what the compiler says of it is said here.
    whole = compile(code, "<solution>", "exec", dont_inherit=True)
    if entry in _bound(tree) or _parsed(f"{prompt}\n{code}") is None:
        return [compile(prelude, "<prompt>", "exec", dont_inherit=True), whole]
    return [compile(f"{prompt}\n{code}", "<solution>", "exec", dont_inherit=True)]


def _parsed(code: str | None) -> ast.Module | None:
    if not code:
        return None
    try:
        return ast.parse(code)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None


def _bound(tree: ast.Module) -> set[str]:
    """Return the names that a module defines at its top."""
    names: set[str] = set()
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names |= {(alias.asname or alias.name) for alias in node.names}
        else:
            stored = (item for item in ast.walk(node) if isinstance(item, ast.Name))
            names |= {item.id for item in stored if isinstance(item.ctx, ast.Store)}
    return names


def _function(module: types.ModuleType, name: str) -> Any:
    """Return a function of the program, or a method of its class ``Solution``, as some sites ask for."""
    name = name.removeprefix("Solution().")
    found = module.__dict__.get(name)
    if found is None and isinstance(module.__dict__.get("Solution"), type):
        found = getattr(module.__dict__["Solution"](), name, None)
    return found


def _called(module: types.ModuleType, name: str, arguments: Any) -> str:
    before = json.dumps(arguments, separators=(",", ":"))
    try:
        positional, named = decode(arguments)
        function = _function(module, name)
        if function is None:
            raise NameError(f"the program defines no function {name!r}")
        result = encode(function(*positional, **named), opaque=True)
        answer: dict[str, Any] = {"r": result}
        after = dumps([positional, named], opaque=True)
        if after != before:
            answer["a"] = json.loads(after)
        return json.dumps(answer, separators=(",", ":"))
    except NotDataError as error:
        return json.dumps({"e": ["NotDataError", f"the program returned {error}, which is no plain data"]})
    except BaseException as error:  # noqa: BLE001 - whatever the program raises
        return json.dumps({"e": [type(error).__name__, _told(error)]})


def _told(error: BaseException) -> str:
    try:
        text = str(error)[:500]
    except BaseException:  # noqa: BLE001 - the program's own __str__
        text = ""
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
