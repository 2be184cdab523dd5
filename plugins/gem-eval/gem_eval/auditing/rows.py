"""Rows of a data set: gold answers that are missing, and questions that come twice."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from gem_core.data import DatasetEnv
from gem_core.records import to_plain
from gem_eval.auditing.results import Problem
from gem_eval.auditing.texts import normal

MOST_ROWS = 100_000
_MISSING = ("", "nan", "n/a", "null", "todo", "tbd")


class Asked(NamedTuple):
    """A row as it is asked.

    Args:
        name: Of the row.
        prompt: All that is asked.
        question: The column of the question alone.
        gold: The gold answer; None where there is none, empty where it is not known.
        malformed: Why the gold answer cannot be read; empty where it can.
    """

    name: str
    prompt: str
    question: str
    gold: str | None
    malformed: str = ""


def rows_of(env_id: str, env: Any) -> list[Asked] | None:
    """Return all rows of a data set; None for an environment of another kind."""
    task = env.unwrapped
    if not isinstance(task, DatasetEnv):
        return None
    found = []
    for index in range(min(task.num_tasks, MOST_ROWS)):
        row = task.rows[index]
        prompt = task.prompt(row)
        prompt = prompt if isinstance(prompt, str) else json.dumps(to_plain(prompt))  # images by their hash
        given, malformed = row.get(task.answer_key), ""
        if not _is_missing(given):
            try:
                task.gold_response(row)
            except Exception as error:  # noqa: BLE001 - third-party code may raise anything
                malformed = f"{type(error).__name__}: {error}"[:200]
        gold = None if _is_missing(given) else normal(str(given))
        found.append(Asked(f"{env_id}/{index}", prompt, str(row.get(task.question_key, "")), gold, malformed))
    return found


def _is_missing(gold: Any) -> bool:
    """Tell whether a gold answer is none: nothing, not a number, or a word that stands for a missing one."""
    if gold is None or gold != gold or (isinstance(gold, Sequence) and not gold):
        return True
    return normal(str(gold)) in _MISSING


def check_rows(asked: Sequence[Asked], *, fixed: bool) -> Iterator[Problem]:
    """Yield what is wrong with rows.

    Args:
        asked: The rows.
        fixed: Whether they are those of a data set; else they were generated, where the same may come twice.
    """
    of = f"of {len(asked)}"

    def problem(kind: str, found: Sequence[Asked], message: str, example: Callable[[Asked], str]) -> Problem:
        return Problem(kind, len(found) / len(asked), message, tuple(map(example, found[:3])))

    if empty := [each for each in asked if each.gold is None]:
        message = f"{len(empty)} {of} rows have no gold answer"
        yield problem("no gold", empty, message, lambda each: f"{each.name}: {each.question!r:.100}")
    if blank := [each for each in asked if not each.prompt.strip()]:
        yield problem("no question", blank, f"{len(blank)} {of} rows ask nothing", lambda each: each.name)
    if malformed := [each for each in asked if each.malformed]:
        message = f"{len(malformed)} {of} gold answers cannot be read"
        yield problem("no gold", malformed, message, lambda each: f"{each.name}: {each.malformed}")
    groups: dict[str, list[Asked]] = defaultdict(list)
    for each in asked:
        if each.prompt.strip():
            groups[normal(each.prompt).rstrip(" .?!")].append(each)
    twice = [group for group in groups.values() if len(group) > 1]
    differing = [group for group in twice if len({each.gold for each in group}) > 1]
    for kind, what, same in (
        ("conflict", "come again with another gold answer", differing),
        ("duplicates", "come more than once", [group for group in twice if group not in differing]),
    ):
        if same:
            share = sum(len(group) - 1 for group in same) / len(asked)
            shown = tuple(map(_repeated, same[:3]))
            yield Problem(kind, share, f"{len(same)} questions {what}", shown, fixed)


def _repeated(group: Sequence[Asked]) -> str:
    """Return two rows that ask the same, with their gold answers if these differ."""
    first = group[0]
    other = next((each for each in group if each.gold != first.gold), group[1])
    golds = f" with {first.gold!r:.30} and {other.gold!r:.30}" if other.gold != first.gold else ""
    return f"{first.name} and {other.name}: {first.question!r:.80}{golds}"
