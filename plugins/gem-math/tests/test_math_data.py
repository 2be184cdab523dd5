"""Real data sets, where a copy lies beside the repository: every gold answer is right for its row, and for no other.

The folder is named by ``GEM_SHARED_DATA``, or is ``shared/data`` beside the repository.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from gem_math import MathEnv, grade
from gem_math.grading import formulas, gold_texts
from gem_math.grading.compare import Comparison
from gem_math.grading.readings import readings
from gem_math.grading.text import clean

_PARENTS = Path(__file__).resolve().parents
_FOLDERS = [Path(os.environ.get("GEM_SHARED_DATA", "")), *(parent / "shared" / "data" for parent in _PARENTS)]
DATA = next((folder / "math" for folder in _FOLDERS if (folder / "math").is_dir()), None)
SETS = {"gsm8k": "answer", "aime24": "answer", "amc23": "answer", "olympiadbench": "final_answer"}
pytestmark = pytest.mark.skipif(DATA is None, reason="the data sets are not here: set GEM_SHARED_DATA to their folder")

# Gold answers that no grader can compare with another one but as text.
UNREADABLE = {"$t(0,4]$": "an interval with a stray t in front of it"}
# Gold answers of two rows that mean the same though they are written in another way.
COINCIDENCES = {("3", "$k=3$")}


def golds(name: str) -> list[Any]:
    """Return the gold answers of a data set, as its environment has them."""
    if DATA is None:
        return []
    env = MathEnv(dataset_name=DATA / f"{name}.jsonl", answer_key=SETS[name])
    return [env.gold(row) for row in env.rows]


def text_of(gold: Any) -> str:
    """Return a gold answer as a model would write it."""
    return str(gold[0] if isinstance(gold, list) else gold)


@pytest.mark.parametrize("name", SETS)
def test_gold_answer_is_right_for_its_row(name: str):
    """As it is written, and compared part by part, without the short cut for what is spelled alike."""
    wrong = []
    for gold in golds(name):
        right = grade(f"\\boxed{{{text_of(gold)}}}", gold, timeout_s=20).correct
        gold_forms, answer_forms = readings(clean(gold_texts(gold)[0]), clean(text_of(gold)))
        if not right or (
            text_of(gold) not in UNREADABLE and not Comparison(formulas).same(gold_forms[0], answer_forms[0])
        ):
            wrong.append(gold)
    assert wrong == []


@pytest.mark.few(2)
@pytest.mark.parametrize("name", SETS)
def test_gold_answer_is_wrong_for_other_rows(name: str):
    """Of rows that are 1 and 31 further on, unless these have the same answer."""
    found = []
    answers = golds(name)
    for index, gold in enumerate(answers):
        for distance in (1, 31):
            other = text_of(answers[(index + distance) % len(answers)])
            if other.strip("$ ") == text_of(gold).strip("$ "):
                continue
            if grade(f"\\boxed{{{other}}}", gold, timeout_s=20).correct:
                found.append((text_of(gold), other))
    assert set(found) - COINCIDENCES == set()
