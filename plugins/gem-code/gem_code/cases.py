"""Read the tests of a row, in the forms that public data sets have them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from gem_core.errors import GradingError


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
            mappings ``{"input": …, "output": …}``; either as JSON text too; Python code with assertions; or a list of
            ``assert`` statements.
        entry: Name of the function under test, where the row has one.
        prompt: The question of the row.

    Raises:
        GradingError: They have none of these forms, or there are none.

    Source: the rows of TACO, APPS and CodeContests (the first form), HumanEval and MBPP (the last two).
    """
    found = _from_json(tests) if isinstance(tests, str) else tests
    entry = None if entry is None else str(entry)
    prompt = prompt if isinstance(prompt, str) else None
    if isinstance(found, str):
        if not found.strip():
            raise GradingError("the tests are empty")
        return AssertionTests(found, entry, prompt)
    if isinstance(found, Mapping):
        return _from_mapping(found)
    if isinstance(found, Sequence) and found:
        if all(isinstance(item, str) for item in found):
            return AssertionTests("\n".join(found), entry, prompt)
        if all(isinstance(item, Mapping) and {"input", "output"} <= set(item) for item in found):
            inputs, outputs = [item["input"] for item in found], [item["output"] for item in found]
            return _from_mapping({"inputs": inputs, "outputs": outputs})
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


def _from_mapping(found: Mapping[str, Any]) -> Tests:
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
    function = found.get("fn_name")
    if function:
        return CallTests(str(function), tuple(map(_arguments, inputs)), tuple(outputs))
    return StdinTests(tuple(map(_text, inputs)), tuple(map(_text, outputs)))


def _arguments(value: Any) -> list[Any]:
    if isinstance(value, list | tuple):
        return list(value)
    raise GradingError(f"an input of a function's tests must be the list of its arguments, not {_kind(value)}")


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
