"""Read the tests of a row, in the forms that public data sets have them."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from gem_core.errors import GradingError

_FUNCTION_KEYS = ("fn_name", "func_name")


@dataclass(frozen=True)
class StdinTests:
    """Whole programs: what each reads from standard input, and what it is to print."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


@dataclass(frozen=True)
class CallTests:
    """A function by name: the arguments of each call, and what it is to return."""

    function: str
    inputs: tuple[list[Any], ...]
    outputs: tuple[Any, ...]


@dataclass(frozen=True)
class AssertionTests:
    """Python code with assertions.

    Args:
        source: Statements with ``assert``, or functions ``check(candidate)`` or ``test_…()`` of them.
        entry: Name of the function that ``check`` is called with; None where the tests name it themselves.
        prompt: What the program continues; it may be code with helpers that the tests use.
    """

    source: str
    entry: str | None = None
    prompt: str | None = None


Tests = StdinTests | CallTests | AssertionTests


def read_tests(tests: Any, *, entry: Any = None, prompt: Any = None) -> Tests:
    """Return the tests of a row.

    Args:
        tests: A mapping ``{"inputs": […], "outputs": […]}``, with ``"fn_name"`` where a function is called; a list of
            mappings ``{"input": …, "output": …}``, each with ``"fn_name"`` then; such a list under ``"test_cases"``;
            any of these as JSON text too; Python code with assertions; or a list of ``assert`` statements. The
            arguments of a function are a list, or a text with a line of JSON for each.
        entry: Name of the function under test, where the row has one.
        prompt: The question of the row.

    Raises:
        GradingError: They have none of these forms, or there are none.

    Source: the rows of TACO, APPS and CodeContests (the first form), of Prime Intellect's and LiveCodeBench's (the
    second), HumanEval and MBPP (the last two).
    """
    found = _from_json(tests) if isinstance(tests, str) else tests
    entry = None if entry is None else str(entry)
    prompt = prompt if isinstance(prompt, str) else None
    if isinstance(found, str):
        if not found.strip():
            raise GradingError("the tests are empty")
        return AssertionTests(found, entry, prompt)
    if isinstance(found, Mapping) and "inputs" not in found and not isinstance(found.get("test_cases"), str):
        found = found.get("test_cases", found)
    if isinstance(found, Mapping):
        return _from_mapping(found)
    if isinstance(found, Sequence) and found:
        if all(isinstance(item, str) for item in found):
            return AssertionTests("\n".join(found), entry, prompt)
        if all(isinstance(item, Mapping) for item in found):
            return _from_items(found, entry)
    if isinstance(found, Sequence) and not found:
        raise GradingError("there are no tests")
    raise GradingError(
        f"tests must be {{'inputs': […], 'outputs': […]}}, a list of {{'input', 'output'}}, or code with assertions, "
        f"not {_kind(found)}"
    )


def longest(tests: Tests, most: int | None) -> tuple[Tests, list[int]]:
    """Keep the tests with the longest inputs, in their order; return them and their indices in the row.

    Tests of assertions are kept as they are: they may build on each other.

    Source: gem-llm's CodeEnv, which keeps 12.
    """
    if isinstance(tests, AssertionTests):
        return tests, []
    indices = list(range(len(tests.inputs)))
    if most is not None and len(indices) > most:
        indices = sorted(sorted(indices, key=lambda index: -_length(tests.inputs[index]))[:most])
    kept_in = tuple(tests.inputs[index] for index in indices)
    kept_out = tuple(tests.outputs[index] for index in indices)
    kept: Tests = replace(tests, inputs=kept_in, outputs=kept_out)  # type: ignore[arg-type]
    return kept, indices


def _from_json(text: str) -> Any:
    """Return the mapping or list that a text is as JSON; the text itself where it is no JSON."""
    if not text.lstrip().startswith(("{", "[")):
        return text
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        # Code may begin with a bracket too; what was to be JSON is not mistaken for that.
        if text.lstrip().startswith(("{", "[{", '["', "['")) and "assert" not in text:
            raise GradingError(f"the tests are no JSON, and no code with assertions: {text[:80]!r}") from None
        return text


def _from_items(found: Sequence[Mapping[str, Any]], entry: str | None) -> Tests:
    """Return tests that are given one by one."""
    for index, item in enumerate(found):
        missing = [name for name in ("input", "output") if name not in item]
        if missing:
            keys = ", ".join(map(repr, item)) or "none"
            raise GradingError(f"test {index} has no {missing[0]!r}. Keys: {keys}")
    names = [_called_by(item) for item in found]
    kinds = {name is None for name in names}
    if len(kinds) > 1:
        raise GradingError("some of the tests call a function, and some run a program")
    tests = {"inputs": [item["input"] for item in found], "outputs": [item["output"] for item in found]}
    if names[0] is None:
        return _from_mapping(tests)
    functions = {name or entry for name in names}
    if len(functions) > 1:
        raise GradingError(f"the tests call several functions: {', '.join(sorted(map(repr, functions)))}")
    function = functions.pop()
    if not function:
        raise GradingError("the tests call a function, and name it neither in 'fn_name' nor in the row's 'entry_point'")
    return _from_mapping({**tests, "fn_name": function})


def _called_by(item: Mapping[str, Any]) -> str | None:
    """Return the function that a test calls, ``""`` where it does not say which; None where it runs a program."""
    kind = str(item.get("type") or item.get("testtype") or "")
    if kind.startswith("stdin"):
        return None
    metadata = item.get("metadata")
    named = [item, metadata] if isinstance(metadata, Mapping) else [item]
    name = next((each[key] for each in named for key in _FUNCTION_KEYS if each.get(key)), None)
    return str(name) if name is not None else "" if kind.startswith("function") else None


def _from_mapping(found: Mapping[str, Any]) -> Tests:
    if "inputs" not in found and "outputs" not in found and {"input", "output"} <= set(found):
        found = {**found, "inputs": found["input"], "outputs": found["output"]}
    missing = [name for name in ("inputs", "outputs") if name not in found]
    if missing:
        keys = ", ".join(map(repr, found)) or "none"
        raise GradingError(f"the tests have no {missing[0]!r}. Keys: {keys}")
    inputs, outputs = found["inputs"], found["outputs"]
    for name, side in (("inputs", inputs), ("outputs", outputs)):
        if isinstance(side, str) or not isinstance(side, Sequence):
            raise GradingError(f"the {name} of the tests must be a list, not {_kind(side)}")
    if len(inputs) != len(outputs):
        raise GradingError(f"the tests have {len(inputs)} inputs and {len(outputs)} outputs")
    if not inputs:
        raise GradingError("there are no tests")
    function = next((found[key] for key in _FUNCTION_KEYS if found.get(key)), None)
    if function:
        expected = [_written(there) if isinstance(here, str) else there for here, there in zip(inputs, outputs)]  # noqa: B905
        return CallTests(str(function), tuple(map(_arguments, inputs)), tuple(expected))
    return StdinTests(tuple(map(_text, inputs)), tuple(map(_text, outputs)))


def _arguments(value: Any) -> list[Any]:
    if isinstance(value, list | tuple):
        return list(value)
    if isinstance(value, str):
        with contextlib.suppress(ValueError, RecursionError):
            return [json.loads(line) for line in value.splitlines() if line.strip()]
    raise GradingError(
        "an input of a function's tests must be the list of its arguments, or a line of JSON for each, "
        f"not {_kind(value)}"
    )


def _written(value: Any) -> Any:
    """Return what JSON text says; any other value is itself."""
    if isinstance(value, str):
        with contextlib.suppress(ValueError, RecursionError):
            return json.loads(value)
    return value


def _text(value: Any) -> str:
    """Return an input or output, which some rows give as a list of lines."""
    if isinstance(value, str):
        return value
    if isinstance(value, list | tuple):
        return "\n".join(map(str, value))
    if value is None or isinstance(value, Mapping):
        raise GradingError(f"an input or output must be text or a list of lines, not {_kind(value)}")
    return str(value)


def _length(value: Any) -> int:
    return len(value) if isinstance(value, str) else len(repr(value))


def _kind(value: Any) -> str:
    return "nothing" if value is None else f"{type(value).__name__} ({str(value)[:40]!r})"
