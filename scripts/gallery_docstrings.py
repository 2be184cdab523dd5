"""For gallery.py: read docstrings and signatures from source files, without importing what a page is about."""

from __future__ import annotations

import ast
import importlib.util
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

_SECTION = re.compile(r"^(Args|Raises|Returns|Source|Example|Yields):", re.MULTILINE)
_ARGUMENT = re.compile(r"^    (\*{0,2}\w+): (.*(?:\n(?:        .*|))*)", re.MULTILINE)
_ELSEWHERE = re.compile(r"(?:See|As for) `(\w+)`")


class Argument(NamedTuple):
    """An argument of a constructor.

    Args:
        name: Its name, with stars where it takes several.
        annotation: Its type, as in the source.
        default: Its default, as in the source; None where it has to be given.
        meaning: What the docstring says about it.
    """

    name: str
    annotation: str
    default: str | None
    meaning: str


class Described(NamedTuple):
    """What a class or function says about itself.

    Args:
        summary: First paragraph of the docstring.
        body: The other paragraphs, without sections.
        source: What it names as its source.
        arguments: The arguments, in order.
    """

    summary: str
    body: str
    source: str
    arguments: list[Argument]


@cache
def described(entry_point: str) -> Described:
    """Describe what ``"package.module:Name"`` points to."""
    module, _, name = entry_point.partition(":")
    node, module = _definition(module, name)
    text = ast.get_docstring(node) or ""
    parts = _SECTION.split(text)
    summary, _, body = parts[0].strip().partition("\n\n")
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    # What follows the arguments without an indent belongs to the body.
    listed, after = _indented(sections.get("Args", ""))
    meanings = {match[1]: _one_line(match[2]) for match in _ARGUMENT.finditer(listed)}
    source = _one_line(sections.get("Source", "").split("\n\n")[0])
    body = "\n\n".join(part.strip("\n") for part in (body, after) if part.strip())
    taken = [_with_meaning(argument, module) for argument in _arguments(node, meanings)]
    body = "\n\n".join(part for part in (body, *_said_elsewhere(node, module, summary, body)) if part)
    return Described(_one_line(summary), body.replace("``", "`").replace("::\n", ":\n"), source, taken)


def _said_elsewhere(node: ast.ClassDef | ast.FunctionDef, module: str, summary: str, body: str) -> Iterator[str]:
    """Yield what is said where a docstring refers to: by its first paragraph, or by deriving from it in silence."""
    named = re.findall(r"(?:See|Make an?) ``(\w+)``", summary)
    if isinstance(node, ast.ClassDef) and not body and not named:
        named = [base.id for base in node.bases if isinstance(base, ast.Name)]
    for name in named:
        if _find(module, name) is not None:
            yield described(f"{module}:{name}").body


def _with_meaning(argument: Argument, module: str) -> Argument:
    """Return an argument whose docstring refers to another class with what is said there."""
    other = _ELSEWHERE.match(argument.meaning)
    if other is None or _find(module, other[1]) is None:
        return argument
    there = described(f"{module}:{other[1]}").arguments
    return next((argument._replace(meaning=each.meaning) for each in there if each.name == argument.name), argument)


def _definition(module: str, name: str) -> tuple[ast.ClassDef | ast.FunctionDef, str]:
    found = _find(module, name)
    if found is None:
        raise SystemExit(f"there is no {name!r} in {module!r}; install the plugin that has it")
    return found


def _find(module: str, name: str) -> tuple[ast.ClassDef | ast.FunctionDef, str] | None:
    """Return the definition of a name, and the module that has it: this one, or one that it imports the name from."""
    found = importlib.util.find_spec(module)
    if found is None or found.origin is None:
        return None
    stub = Path(found.origin).with_suffix(".pyi")  # where a package names what it resolves on first use
    parsed = _parsed(str(stub) if stub.exists() else found.origin)
    for node in parsed.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            return node, module
    for each in ast.walk(parsed):
        if isinstance(each, ast.ImportFrom) and each.module and any(alias.name == name for alias in each.names):
            return _find(f"{module}.{each.module}" if each.level else each.module, name)
    return None


@cache
def _parsed(path: str) -> ast.Module:
    return ast.parse(Path(path).read_text(encoding="utf-8"))


def _indented(section: str) -> tuple[str, str]:
    """Split a section into its indented lines and the paragraphs after them."""
    lines = section.split("\n")
    end = next((number for number, line in enumerate(lines) if line and not line.startswith(" ")), len(lines))
    return "\n".join(lines[:end]), "\n".join(lines[end:])


def _arguments(node: ast.ClassDef | ast.FunctionDef, meanings: dict[str, str]) -> list[Argument]:
    makers = [each for each in node.body if isinstance(each, ast.FunctionDef) and each.name == "__init__"]
    if isinstance(node, ast.FunctionDef):
        makers = [node]
    if not makers:
        return []
    taken = makers[0].args
    plain = taken.posonlyargs + taken.args
    defaults: list[ast.expr | None] = [*[None] * (len(plain) - len(taken.defaults)), *taken.defaults]
    pairs = [*zip(plain, defaults, strict=True), *zip(taken.kwonlyargs, taken.kw_defaults, strict=True)]
    if isinstance(node, ast.ClassDef):
        pairs = pairs[1:]
    found = [
        Argument(
            arg.arg, _source(arg.annotation), None if default is None else _source(default), meanings.get(arg.arg, "")
        )
        for arg, default in pairs
    ]
    if taken.kwarg is not None:
        name = f"**{taken.kwarg.arg}"
        found.append(Argument(name, "", "", meanings.get(name, "")))
    return found


def _source(node: ast.expr | None) -> str:
    return "" if node is None else ast.unparse(node)


def _one_line(text: str) -> str:
    return " ".join(text.replace("``", "`").split())
