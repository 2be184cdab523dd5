"""Reading the files of a task folder: never outside it, never more than expected, never a crash."""

from __future__ import annotations

import json
import math
import os
import re
import reprlib
import tomllib
from collections.abc import Callable, Mapping
from datetime import date, time
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError
from yaml.composer import Composer
from yaml.constructor import SafeConstructor
from yaml.resolver import Resolver

from gem_terminal.errors import TaskError
from gem_terminal.tasks.digests import scan
from gem_terminal.tasks.task import Healthcheck
from gem_terminal.tasks.yaml_parser import YamlParser

MOST_BYTES = 1_000_000
"""Bytes that a file may have which is read as a whole: an instruction, a description, a script's first line."""

_MOST_NOTES = 100
_MOST_NODES = 50_000  # of a YAML file with its aliases written out
_MOST_BITS = 64
_DEEPEST = 40  # tables and lists within each other

_LONG_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){""" + str(_DEEPEST) + "}")

_shown = reprlib.Repr()
_shown.maxstring = _shown.maxother = 60


class Section(BaseModel):
    """A part of a file in one of the formats. Unknown keys are kept, for a note, and are no error."""

    model_config = ConfigDict(extra="allow", frozen=True, protected_namespaces=())


AnySection = TypeVar("AnySection", bound=Section)


class TaskFolder:
    """A task folder: its files, and what was passed over in reading them.

    Args:
        path: The folder.

    Attributes:
        path: The same, absolute and without links.
        digest: Hash of all that is in it.
        notes: What was passed over, in words, in the order met.

    Raises:
        TaskError: It cannot be read, or holds a link that leads out of it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()
        self.digest = scan(self.path)
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        """Keep a note, once; after a hundred only that there are more."""
        if len(self.notes) >= _MOST_NOTES:
            text = "More notes are left out."
        if text not in self.notes:
            self.notes.append(text)

    def fail(self, file: str, problem: str) -> NoReturn:
        """Raise the error of a file.

        Raises:
            TaskError: Always.
        """
        raise TaskError(f"{self.path / file}: {problem}")

    def has_file(self, file: str) -> bool:
        """Return whether there is a file of this name."""
        return self._inside(file).is_file()

    def has_folder(self, file: str) -> bool:
        """Return whether there is a folder of this name."""
        return self._inside(file).is_dir()

    def inside(self, written: str, *, below: str, named: str) -> Path:
        """Return the absolute path that a file of the task means by a relative one.

        Args:
            written: What is written.
            below: Folder that it is relative to, itself relative to the task's.
            named: File and field, for the error.

        Raises:
            TaskError: It leads out of the task folder, or cannot be a path.
        """
        if "\0" in written or "://" in written or written.startswith("git@"):
            raise TaskError(f"{named} is {written!r}; expected a path inside the task folder {self.path}.")
        path = Path(os.path.normpath(self.path / below / written))
        if not path.is_relative_to(self.path):
            raise TaskError(f"{named} is {written!r}, which is outside the task folder {self.path}; move it inside.")
        return path

    def text(self, file: str, *, most_bytes: int = MOST_BYTES) -> str:
        r"""Return a text file, without a byte order mark and with ``\n`` at the ends of its lines.

        Raises:
            TaskError: It is missing, too large, or no text in UTF-8.
        """
        data = self._bytes(file, most_bytes + 1)
        if len(data) > most_bytes:
            size = (self.path / file).stat().st_size
            self.fail(file, f"the file has {size:,} bytes; expected {most_bytes:,} at most.")
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            self.fail(file, f"byte {error.start} is no UTF-8; expected a text file in UTF-8.")
        if "\0" in text:
            self.fail(file, "the file has a zero byte; expected a text file in UTF-8.")
        return text.replace("\r\n", "\n")

    def first_line(self, file: str) -> str:
        r"""Return the first line of a script, of at most 10,000 bytes, without its ``\n``; it need not be UTF-8.

        Raises:
            TaskError: It cannot be read.
        """
        return self._bytes(file, 10_000).split(b"\n", 1)[0].decode("utf-8", "replace")

    def yaml(self, file: str, *, strings: bool = False) -> Any:
        """Return what a YAML file says.

        Args:
            file: Its name.
            strings: Whether all scalars stay as they are written, as in Compose files, where ``yes`` is a text.

        Raises:
            TaskError: It cannot be read, or would grow beyond measure by its aliases.
        """
        return self._parsed(file, "YAML", lambda text: _load_yaml(text, _StringLoader if strings else _Loader))

    def toml(self, file: str) -> dict[str, Any]:
        """Return what a TOML file says.

        Raises:
            TaskError: It cannot be read.
        """
        parsed: dict[str, Any] = self._parsed(file, "TOML", _load_toml)
        return parsed

    def json(self, file: str) -> Any:
        """Return what a JSON file says.

        Raises:
            TaskError: It cannot be read.
        """
        return self._parsed(file, "JSON", json.loads)

    def checked(self, model: type[AnySection], data: Any, file: str) -> AnySection:
        """Return data of a file as a model, and note the keys that it does not know.

        Raises:
            TaskError: A field is missing or wrong; names the first of them.
        """
        if not isinstance(data, dict):
            self.fail(file, f"has {_shown.repr(data)}; expected fields with their values.")
        try:
            section = model.model_validate(data)
        except ValidationError as error:
            self.fail(file, _first_problem(error, data))
        for key in _unknown_keys(section):
            self.note(f"{file}: '{key[:100]}' is not known and has no effect.")
        return section

    def _inside(self, file: str) -> Path:
        path = self.path / file
        if not Path(os.path.realpath(path)).is_relative_to(self.path):
            self.fail(file, "leads out of the task folder; copy the file into it.")
        return path

    def _bytes(self, file: str, count: int) -> bytes:
        path = self._inside(file)
        try:
            with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as opened:
                return opened.read(count)
        except FileNotFoundError:
            self.fail(file, "the file is missing.")
        except OSError as error:
            self.fail(file, f"the file cannot be read: {error.strerror}.")

    def _parsed(self, file: str, language: str, parse: Callable[[str], Any]) -> Any:
        text = self.text(file)
        try:
            parsed = parse(text)
            _check_values(parsed)
        except TaskError as error:
            self.fail(file, str(error))
        except RecursionError:
            self.fail(file, f"is nested too deeply; expected {_DEEPEST} levels at most.")
        # PyYAML lets KeyError, IndexError, AttributeError and more out of tags such as `!!bool x`.
        except Exception as error:  # noqa: BLE001
            problem = " ".join(str(error).split())[:300]
            self.fail(file, f"is no valid {language}: {problem or type(error).__name__}.")
        return parsed


class _Loader(Composer, YamlParser, SafeConstructor, Resolver):
    """Stops when there is too much of it, while it is being read.

    libyaml splits the text, faster than Python does; the composer is Python's, since the other cannot be stopped.
    """

    _count = 0
    _depth = 0

    def __init__(self, text: str) -> None:
        YamlParser.__init__(self, text)
        Composer.__init__(self)
        SafeConstructor.__init__(self)
        Resolver.__init__(self)

    def compose_node(self, parent: Any, index: Any) -> Any:
        self._count += 1
        self._depth += 1
        _check_nodes(self._count, self._depth)
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


class _StringLoader(_Loader):
    """Leaves every scalar as it is written, but for an empty one and merge keys."""


_StringLoader.yaml_implicit_resolvers = {
    first: [one for one in resolvers if one[0] in ("tag:yaml.org,2002:null", "tag:yaml.org,2002:merge")]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}


def _load_yaml(text: str, loader_class: type[_Loader]) -> Any:
    """Load one document; its size with all aliases written out is known before anything is made of it."""
    loader = loader_class(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _size(node, {})
        return loader.construct_document(node)
    finally:
        loader.dispose()


def _check_nodes(count: int, depth: int) -> None:
    if depth > _DEEPEST:
        raise TaskError(f"is nested too deeply; expected {_DEEPEST} levels at most.")
    if count > _MOST_NODES:
        raise TaskError(f"has more than {_MOST_NODES:,} values, aliases written out.")


def _load_toml(text: str) -> dict[str, Any]:
    # The library takes time to the square of a key's parts.
    if _LONG_KEY.search(text):
        raise TaskError(f"has a key of more than {_DEEPEST} parts; expected fewer.")
    return tomllib.loads(text)


def _size(node: yaml.Node, known: dict[int, int], depth: int = 1) -> int:
    _check_nodes(0, depth)
    if id(node) in known:
        if not known[id(node)]:
            raise TaskError("has an alias that holds itself.")
        return known[id(node)]
    known[id(node)] = 0  # while it is being counted
    parts: list[yaml.Node] = []
    if isinstance(node, yaml.SequenceNode):
        parts = node.value
    elif isinstance(node, yaml.MappingNode):
        parts = [part for pair in node.value for part in pair]
    total = 1 + sum(_size(part, known, depth + 1) for part in parts)
    _check_nodes(total, depth)
    known[id(node)] = total
    return total


def _first_problem(error: ValidationError, data: Any) -> str:
    """Return the first field that is wrong, what it is, and all that it could be."""
    problems = error.errors(include_url=False, include_context=False)
    paths = [_path_in(data, problem["loc"], missing=problem["type"] == "missing") for problem in problems]
    field = ".".join(paths[0])[:200] or "the whole"
    here = [problem for problem, path in zip(problems, paths, strict=True) if path == paths[0]]
    more = f" Fields that are wrong beside it: {len(set(paths)) - 1}." if len(set(paths)) > 1 else ""
    if here[0]["type"] == "missing":
        return f"the field '{field}' is missing.{more}"
    expected = " or ".join(dict.fromkeys(problem["msg"].removeprefix("Value error, ") for problem in here))
    return f"'{field}' is {_shown.repr(here[0]['input'])}: {expected}.{more}"


def _path_in(data: Any, location: tuple[int | str, ...], *, missing: bool) -> tuple[str, ...]:
    """Return a location without the names of types, which pydantic puts there for each member of a union."""
    path = []
    for number, part in enumerate(location):
        if _has(data, part):
            data = data[part]
        elif not (missing and number == len(location) - 1):
            continue
        path.append(str(part))
    return tuple(path)


def _has(data: Any, part: int | str) -> bool:
    if isinstance(data, list):
        return isinstance(part, int) and part < len(data)
    return isinstance(data, dict) and part in data


def _unknown_keys(section: Section, prefix: str = "") -> list[str]:
    keys = [f"{prefix}{key}" for key in section.model_extra or {} if not key.startswith("x-")]
    for name in type(section).model_fields:
        value = getattr(section, name)
        if isinstance(value, Section):
            keys += _unknown_keys(value, f"{prefix}{name}.")
        elif isinstance(value, list):
            for number, part in enumerate(value):
                if isinstance(part, Section):
                    keys += _unknown_keys(part, f"{prefix}{name}.{number}.")
    return keys


def _check_values(value: Any, depth: int = 0) -> None:
    """See that a value is nested within reason, and that its numbers can be written."""
    _check_nodes(0, depth)
    if isinstance(value, Mapping):
        for key, part in value.items():
            _check_values(key, depth + 1)
            _check_values(part, depth + 1)
    elif isinstance(value, (list, tuple, set)):
        for part in value:
            _check_values(part, depth + 1)
    elif isinstance(value, int) and value.bit_length() > _MOST_BITS:
        raise TaskError(f"has a number of {value.bit_length():,} bits; expected {_MOST_BITS} at most.")


def plain(value: Any) -> Any:
    """Return what a file says as JSON has it: dates as text, and numbers that are none as text."""
    if isinstance(value, Mapping):
        return {str(key): plain(part) for key, part in value.items()}
    if isinstance(value, (list, tuple, set)):
        return [plain(part) for part in value]
    if isinstance(value, (date, time)):
        return value.isoformat()
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return value
    return str(value)


def shell_check(command: str, *, shell: str = "sh", **timing: Any) -> Healthcheck:
    """Return a healthcheck that runs a line in a shell."""
    return Healthcheck(command=(shell, "-c", command), **timing)


def command_of(folder: TaskFolder, file: str, at: str, *, default: str = "bash") -> tuple[str, ...]:
    """Return the words that run a script at a path in a machine, whatever its permissions: as its first line says.

    Raises:
        TaskError: The script cannot be read.
    """
    line = folder.first_line(file)
    if line.endswith("\r"):
        folder.note(f"{file}: has the line ends of Windows, which a shell stumbles over.")
    words = line.removeprefix("#!").split(maxsplit=1) if line.startswith("#!") else []
    return (*(words or [default]), at) if "\0" not in line else (default, at)


def read_weights(folder: TaskFolder) -> dict[str, float]:
    """Return the weights of tests by name, of ``test_weights.json`` or ``tests/test_weights.json``; empty without one.

    What is no number of at least 0 is passed over, with a note: such files are about, and their other weights count.

    Raises:
        TaskError: The file is no JSON object.

    Source: the file that the peer's tasks have, and Danau5tin/terminal-bench-rl.
    """
    for file in ("test_weights.json", "tests/test_weights.json"):
        if not folder.has_file(file):
            continue
        data = folder.json(file)
        if not isinstance(data, dict):
            folder.fail(file, f"has {_shown.repr(data)}; expected an object of weights by the names of tests.")
        weights = {}
        for name, weight in data.items():
            good = isinstance(weight, (int, float)) and not isinstance(weight, bool) and 0 <= weight <= 1e9
            if good:
                weights[name] = float(weight)
            else:
                folder.note(f"{file}: the weight of {name[:100]!r} is {_shown.repr(weight)} and has no effect.")
        return weights
    return {}
