"""For authors of code:Sample, after a change of ``code_problems``: write its data, sample.jsonl of gem-code.

``python scripts/code_sample.py`` writes plugins/gem-code/gem_code/data/sample.jsonl. A test compares the two. Expected
results are what the reference programs give.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest import mock

from code_problems import choices, functions, functions_harder, graphs, lines, structures

if TYPE_CHECKING:
    from code_problems.problem import Problem

TARGET = Path(__file__).resolve().parent.parent / "plugins" / "gem-code" / "gem_code" / "data" / "sample.jsonl"
PROBLEMS: list[Problem] = [
    problem
    for module in (lines, structures, graphs, choices, functions, functions_harder)
    for problem in module.PROBLEMS
]


def main() -> None:
    """Write the file."""
    TARGET.write_text(as_text(), encoding="utf-8")
    print(f"{len(PROBLEMS)} problems, {TARGET.stat().st_size:,} bytes in {TARGET}")


def rows() -> Iterator[dict[str, Any]]:
    """Yield the rows, easy problems first."""
    for problem in sorted(PROBLEMS, key=lambda problem: problem.level):
        yield {
            "id": problem.id,
            "level": problem.level,
            "problem": problem.statement.strip(),
            "tests": written_tests(problem),
            "entry_point": problem.function,
            "solution": problem.reference,
        }


def as_text() -> str:
    """Return the whole file."""
    return "".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows())


def written_tests(problem: Problem) -> str:
    """Return the tests of a problem in the form in which a data set has them."""
    if problem.function is None:
        outputs = [printed(problem.reference, stdin) for stdin in problem.inputs]
        return json.dumps({"inputs": list(problem.inputs), "outputs": outputs})
    space: dict[str, Any] = {}
    exec(problem.reference, space)
    name = "candidate" if problem.check_form else problem.function
    statements = []
    for arguments in problem.calls:
        written = ", ".join(map(repr, arguments))
        statements.append(f"assert {name}({written}) == {space[problem.function](*arguments)!r}")
    source = "\n".join([*statements, *problem.more.splitlines()]) + "\n"
    if not problem.check_form:
        return source
    indented = "".join(f"    {line}\n" if line else "\n" for line in source.splitlines())
    return f"def check(candidate):\n{indented}"


def printed(program: str, stdin: str) -> str:
    """Return what one of our own programs prints."""
    output = io.StringIO()
    reader = io.StringIO(stdin)

    def read_line(prompt: str = "") -> str:
        line = reader.readline()
        if not line:
            raise EOFError
        return line.removesuffix("\n")

    with redirect_stdout(output), mock.patch("sys.stdin", reader), mock.patch("builtins.input", read_line):
        exec(compile(program, "<reference>", "exec"), {"__name__": "__main__"})
    return output.getvalue()


if __name__ == "__main__":
    main()
