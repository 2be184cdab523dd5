"""For authors of gem_math.grading: print which verdicts change without each reading, and put it into its page.

``python scripts/grader_readings.py [FOLDER]`` writes the table in docs/mathematics.md, in ten minutes. Its lines are
those of plugins/gem-math/tests/verdicts.txt; FOLDER has real data sets, whose gold answers and solutions are
responses too. A reading without which nothing changes should go.
"""

from __future__ import annotations

import json
import re
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from gem_math import grading
from gem_math.grading import formulas
from gem_math.grading.compare import Comparison
from gem_math.grading.readings import compare_texts
from gem_math.grading.structure import FORMS
from gem_math.grading.text import SPELLINGS

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "mathematics.md"
HEADING, END = "\n## What each reading is worth\n", "\n## Problems with figures"
LIMIT_S = 1
# Methods of Comparison, and what each returns when it is left out.
RULES: dict[str, tuple[str, bool | None]] = {
    "decimals of many places for numbers without end": ("rounded", None),
    "equations that contradict themselves": ("contradict", False),
    "equations turned, moved and multiplied": ("equations", False),
    "inequalities and intervals as sets": ("regions", False),
    "residues": ("congruences", False),
    "a ratio as a number": ("single", False),
    "named values as a tuple": ("named_parts", False),
    "values in any order": ("matched", False),
    "values with conditions": ("cases", False),
    "multiples of ratios": ("ratios", False),
    "letters of choices": ("choices", False),
    "words, and products of letters": ("words", False),
    "matrices as tuples": ("vectors", False),
}
DATA = {"aime24": ("answer", "solution"), "olympiadbench": ("final_answer", "solution")}


class Remembered:
    """The parser of formulas, which says the same of the same formulas."""

    def __init__(self) -> None:
        self.found: dict[Any, Any] = {}

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            key = name, repr(arguments)
            if key not in self.found:
                signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
                try:
                    self.found[key] = getattr(formulas, name)(*arguments)
                except Exception as error:  # noqa: BLE001  # the grammar and sympy raise whatever
                    self.found[key] = ValueError(str(error))
                finally:
                    signal.setitimer(signal.ITIMER_REAL, 0)
            if isinstance(self.found[key], ValueError):
                raise self.found[key]
            return self.found[key]

        return call

    def ask(self, request: dict[str, Any], limit_s: float) -> dict[str, Any]:
        """Compare in this process, in place of the pool."""
        parser: Any = self
        reward, note = compare_texts(request["gold"], request["answer"], False, parser)
        return {"reward": reward, "note": note}


def main() -> None:
    """Measure, print and write the table."""
    signal.signal(signal.SIGALRM, _late)
    vars(grading)["_pool"] = Remembered()
    sets = {"table": list(table()), "data": list(data(Path(sys.argv[1]))) if sys.argv[1:] else []}
    before = {name: verdicts(pairs) for name, pairs in sets.items()}
    rows = []
    for kind, name in readings():
        grading.is_readable.cache_clear()
        changed = [sum(map(bool.__ne__, before[each], verdicts(pairs))) for each, pairs in sets.items()]
        rows.append(f"| {kind} | {f'`{name}`' if chr(92) in name else name} | {changed[0]} | {changed[1]} |")
        sys.stdout.write(rows[-1] + "\n")
    told = f"""
Verdicts that change without each reading: of {len(sets["table"]):,} lines of the table of verdicts that the tests hold,
and of {len(sets["data"]):,} responses to real gold answers, which are each gold answer, the next one, and the last
formulas of a solution; made by `scripts/grader_readings.py`.

| | reading | table | real |
| --- | --- | --- | --- |
"""
    page, _, rest = PAGE.read_text("utf-8").partition(END)
    PAGE.write_text(page.partition(HEADING)[0] + HEADING + told + "\n".join(rows) + "\n" + END + rest, "utf-8")


def _late(*_: Any) -> None:
    raise TimeoutError


def table() -> Iterator[tuple[str, str]]:
    """Give gold answers and responses of the table of verdicts."""
    for line in (ROOT / "plugins/gem-math/tests/verdicts.txt").read_text("utf-8").splitlines():
        if line and not line.startswith("#"):
            gold, answer, _ = line.split(" ||| ")
            yield gold, answer[1:] if answer.startswith("!") else rf"\boxed{{{answer}}}"


def data(folder: Path) -> Iterator[tuple[str, str]]:
    """Give real gold answers, each with responses: itself, the next one, and the last formulas of a solution."""
    for name, (column, solution) in DATA.items():
        rows = [json.loads(line) for line in (folder / f"{name}.jsonl").read_text("utf-8").splitlines()]
        golds = [_first(row[column]) for row in rows]
        for row, gold, behind in zip(rows, golds, [*golds[1:], golds[0]], strict=True):
            solved = _first(row[solution])
            found = [gold, behind, *re.findall(r"\$([^$\n]{1,80})\$", solved)[-2:]]
            yield from ((gold, rf"\boxed{{{answer.strip('$')}}}") for answer in found)


def _first(value: Any) -> str:
    return str(value[0] if isinstance(value, list) else value)


def verdicts(pairs: list[tuple[str, str]]) -> list[bool]:
    """Grade each pair; what fails is wrong."""
    found = []
    for gold, response in pairs:
        try:
            found.append(grading.grade(response, gold).correct)
        except Exception:  # noqa: BLE001  # without a reading others may meet what they do not know
            found.append(False)
    return found


def readings() -> Iterator[tuple[str, str]]:
    """Give the kind and the name of each reading, which is left out until the next one is asked for."""
    for name, spelling in SPELLINGS.items():
        SPELLINGS[name] = lambda text: text
        yield "spelling", name
        SPELLINGS[name] = spelling
    for name, form in FORMS.items():
        FORMS[name] = lambda *_: None
        yield "form", name
        FORMS[name] = form
    for name, (method, nothing) in RULES.items():
        rule = getattr(Comparison, method)
        setattr(Comparison, method, lambda *_, nothing=nothing: nothing)
        yield "rule", name
        setattr(Comparison, method, rule)


if __name__ == "__main__":
    main()
