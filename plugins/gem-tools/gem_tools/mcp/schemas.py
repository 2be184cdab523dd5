"""Holds arguments to the JSON Schemas of servers, which are not to be trusted.

A schema costs bounded time and fetches nothing. Where it cannot be used (it is wrong, refers to somewhere else, or asks
for too much work), the arguments go to the server as they are: it has to check them anyway.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import re2  # type: ignore[import-untyped]
from jsonschema import Draft202012Validator, ValidationError  # type: ignore[import-untyped]
from jsonschema.validators import extend, validator_for  # type: ignore[import-untyped]
from referencing import Registry

from gem_core.errors import ArgumentError
from gem_tools.mcp.messages import shortened

MAX_ARGUMENT_CHARS = 5_000_000
MAX_DEPTH = 60
MAX_INTEGER_BITS = 10_000
MAX_SCHEMA_CHARS = 200_000
MAX_STEPS = 50_000
"""Keywords that are applied in one check; a schema of references to references doubles them with each."""

CHECK_S = 1.0
"""Time limit of a check, in seconds."""

_SHOWN = 5
_SURROGATE = re.compile("[\ud800-\udfff]")


class _TooMuch(Exception):
    """A check that is given up."""


class ArgumentChecker:
    """Checks the arguments of one tool.

    Args:
        schema: What the server says of them.
    """

    def __init__(self, schema: Mapping[str, Any]) -> None:
        self.problem: str | None = None
        """Why the schema cannot be used, in words; None as long as it can."""
        self._validator: Any = None
        try:
            if len(json.dumps(schema)) > MAX_SCHEMA_CHARS:
                self.problem = f"the schema is over {MAX_SCHEMA_CHARS:,} characters long"
            else:
                # Without a registry, references to addresses would be fetched.
                self._validator = _bounded(schema)(_without_dialects(dict(schema)), registry=Registry())
        except (TypeError, ValueError, RecursionError) as error:
            self.problem = f"the schema is not JSON: {shortened(str(error))}"

    def check(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Return the arguments, as plain JSON.

        Raises:
            ArgumentError: They are not of the schema, or cannot be sent; the message is for the agent.
        """
        plain = dict(arguments)
        check_plain(plain)
        if self._validator is None:
            return plain
        budget = _Budget()
        try:
            with budget:
                found = list(itertools.islice(self._validator.iter_errors(plain), _SHOWN + 1))
        except Exception as error:  # noqa: BLE001 - a wrong schema fails in any way: the fault of the server
            self.problem = f"{type(error).__name__}: {shortened(str(error))}"
            return plain
        if found:
            lines = [_told(error) for error in found[:_SHOWN]]
            if len(found) > _SHOWN:
                lines.append("and more")
            raise ArgumentError("; ".join(lines))
        return plain


def check_plain(value: object) -> None:
    """Raise where arguments cannot be sent: too long, too deep, or not to be written as JSON.

    Raises:
        ArgumentError: The message is for the agent.
    """
    length = 0
    waiting: list[tuple[object, int]] = [(value, 0)]
    while waiting:
        item, depth = waiting.pop()
        if isinstance(item, Mapping):
            waiting += [(part, depth + 1) for pair in item.items() for part in pair]
        elif isinstance(item, list | tuple):
            waiting += [(part, depth + 1) for part in item]
        else:
            _check_scalar(item)
        length += len(item) if isinstance(item, str) else 1
        if depth > MAX_DEPTH:
            raise ArgumentError(f"They are nested more than {MAX_DEPTH} deep.")
        if length > MAX_ARGUMENT_CHARS:
            raise ArgumentError(f"They are over {MAX_ARGUMENT_CHARS:,} characters long.")


def _check_scalar(item: object) -> None:
    if isinstance(item, str):
        if not item.isascii() and _SURROGATE.search(item):
            raise ArgumentError("They hold broken Unicode: half of a character that takes two.")
    elif isinstance(item, float) and not math.isfinite(item):
        raise ArgumentError(f"They hold {item}, which JSON has no number for.")
    elif isinstance(item, int) and item.bit_length() > MAX_INTEGER_BITS:
        raise ArgumentError("They hold a number of thousands of digits.")
    elif item is not None and not isinstance(item, bool | int | float):
        raise ArgumentError(f"They hold {type(item).__name__}, which is not JSON.")


class _Budget:
    """How much work is left for the check that is under way in this thread."""

    def __init__(self) -> None:
        self.steps, self.until = MAX_STEPS, time.monotonic() + CHECK_S

    def __enter__(self) -> None:
        _local.budget = self

    def __exit__(self, *_: object) -> None:
        del _local.budget

    def spend(self) -> None:
        self.steps -= 1
        if self.steps < 0 or time.monotonic() > self.until:
            raise _TooMuch("it takes too long to check")


_local = threading.local()

Keyword = Callable[[Any, Any, Any, Any], Iterator[ValidationError] | None]


def _bounded(schema: Mapping[str, Any]) -> Any:
    """Return the class that checks by the version of JSON Schema that a schema names, within bounds."""
    return _bounded_class(validator_for(dict(schema), default=Draft202012Validator))


@functools.cache
def _bounded_class(base: Any) -> Any:
    keywords = {name: _counted(function) for name, function in base.VALIDATORS.items()}
    keywords["pattern"] = _counted(_pattern)
    keywords["patternProperties"] = _counted(_pattern_properties)
    keywords["additionalProperties"] = _counted(_additional_properties)
    keywords["uniqueItems"] = _counted(_unique_items)
    # What these two need is found in ways that cannot be bounded from here.
    keywords["unevaluatedItems"] = keywords["unevaluatedProperties"] = _anything
    return extend(base, keywords)


def _without_dialects(schema: Any) -> Any:
    """Return a schema in which no part names a version of its own: the library would check that part without bounds."""
    if isinstance(schema, list):
        return [_without_dialects(item) for item in schema]
    if isinstance(schema, dict):
        return {k: _without_dialects(v) for k, v in schema.items() if k != "$schema" or not isinstance(v, str)}
    return schema


def _counted(function: Keyword) -> Keyword:
    def check(validator: Any, value: Any, instance: Any, schema: Any) -> Iterator[ValidationError]:
        _local.budget.spend()
        yield from function(validator, value, instance, schema) or ()

    return check


def _anything(validator: Any, value: Any, instance: Any, schema: Any) -> None:
    return None


def _pattern(validator: Any, value: Any, instance: Any, schema: Any) -> Iterator[ValidationError]:
    if isinstance(instance, str) and not _fits(value, instance):
        yield ValidationError(f"{shortened(repr(instance))} does not match {value!r}")


def _pattern_properties(validator: Any, value: Any, instance: Any, schema: Any) -> Iterator[ValidationError]:
    if isinstance(instance, dict):
        for pattern, below in value.items():
            for name, item in instance.items():
                if _fits(pattern, name):
                    yield from validator.descend(item, below, path=name, schema_path=pattern)


def _additional_properties(validator: Any, value: Any, instance: Any, schema: Any) -> Iterator[ValidationError]:
    if not isinstance(instance, dict):
        return
    patterns = list(schema.get("patternProperties", {}))
    known = schema.get("properties", {})
    more = [name for name in instance if name not in known and not any(_fits(p, name) for p in patterns)]
    if isinstance(value, dict):
        for name in more:
            yield from validator.descend(instance[name], value, path=name)
    elif value is False and more:
        names = ", ".join(repr(shortened(name, 80)) for name in more[:_SHOWN])
        there = ", ".join(map(repr, list(known)[:20]))
        yield ValidationError(f"there is no parameter {names}" + (f"; there are {there}" if there else ""))


def _unique_items(validator: Any, value: Any, instance: Any, schema: Any) -> Iterator[ValidationError]:
    wanted = value is True and isinstance(instance, list)
    if wanted and len({json.dumps(item, sort_keys=True) for item in instance}) < len(instance):
        yield ValidationError("an item is there twice")


def _fits(pattern: str, text: str) -> bool:
    """Search for a pattern; one that cannot be understood (as one that looks ahead) fits everything."""
    _local.budget.spend()
    try:
        # Linear in the text, and with bounded memory, whatever the pattern.
        return re2.search(pattern, text, _options()) is not None
    except re2.error:
        return True


@functools.cache
def _options() -> Any:
    options = re2.Options()
    options.log_errors = False
    options.max_mem = 1 << 20
    return options


def _told(error: ValidationError) -> str:
    where = ".".join(map(str, error.absolute_path))
    message = error.message
    if len(message) > 300:
        message = f"does not fit {error.validator!r}: {shortened(json.dumps(error.validator_value, default=str))}"
    return shortened(f"{where}: {message}" if where else message, 400)
