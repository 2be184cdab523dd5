"""Natural Questions (open), development questions: what is right to itself, and what is wrong to others."""

from __future__ import annotations

import itertools
from collections import defaultdict
from pathlib import Path

import pytest

import gem_core as gem
from gem_qa.answers import accepted_answers, exact_match, normalized, token_f1

PATH = Path(__file__).resolve().parents[3].parent / "shared" / "data" / "qa" / "nq_open_dev.jsonl"

pytestmark = pytest.mark.skipif(not PATH.is_file(), reason="there is no ../shared/data/qa/nq_open_dev.jsonl")


@pytest.fixture(scope="module")
def golds() -> list[list[str]]:
    """The accepted answers of each of the 3,610 rows."""
    env = gem.make("eval:QaOpen", dataset_name=str(PATH), split=None)
    return [accepted_answers(row["answer"]) for row in env.unwrapped.rows]


def test_every_gold_answer_is_right_to_itself(golds: list[list[str]]) -> None:
    """All 6,490 of them, and through the environment, one for each row; there are no exceptions."""
    assert (len(golds), sum(map(len, golds))) == (3610, 6490)
    assert all(exact_match(text, own) and token_f1(text, own) == pytest.approx(1.0) for own in golds for text in own)
    env = gem.make("eval:QaOpen", dataset_name=str(PATH), split=None)
    for index, own in enumerate(golds):
        env.reset(options={"index": index})
        assert env.step(f"<answer>{own[-1]}</answer>")[1] == 1.0


def test_gold_answers_are_wrong_to_the_next_row(golds: list[list[str]]) -> None:
    """Of 6,490, one is right: two questions in a row are about the 1980s."""
    following = [*golds[1:], golds[0]]
    right = [text for own, other in zip(golds, following, strict=True) for text in own if exact_match(text, other)]
    assert right == ["1980s"]


def test_rows_that_share_an_answer_share_it_truly(golds: list[list[str]]) -> None:
    """Of 6.5 million pairs, 1,965 do: 1,879 to the letter but for case, most often a year, and 86 but for marks."""

    def pairs(form: object) -> set[tuple[int, int]]:
        rows_of = defaultdict(set)
        for number, own in enumerate(golds):
            for text in own:
                rows_of[form(text)].add(number)  # type: ignore[operator]
        return {pair for rows in rows_of.values() for pair in itertools.combinations(sorted(rows), 2)}

    alike, same = pairs(normalized), pairs(lambda text: text.lower().strip())
    assert (len(alike), len(alike & same)) == (1965, 1879)
    letters = {pair for pair in alike - same if not _differ_in_marks_alone(golds, pair)}
    assert letters == set()


def _differ_in_marks_alone(golds: list[list[str]], pair: tuple[int, int]) -> bool:
    """Tell whether two rows have answers with the same letters and digits in the same order, articles apart."""

    def letters(text: str) -> str:
        words = "".join(letter if letter.isalnum() or letter.isspace() else "" for letter in text.lower()).split()
        return "".join(word for word in words if word not in ("a", "an", "the"))

    first, second = ({letters(text) for text in golds[row]} for row in pair)
    return bool(first & second)
