"""Natural Questions (open), development questions: what is right to itself, and what is wrong to others."""

from __future__ import annotations

from pathlib import Path

import pytest

import gem_core as gem
from gem_qa.answers import accepted_answers, exact_match, token_f1

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
