"""The problems that ship with the plugin: many forms, proven answers, the same everywhere."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections import Counter
from importlib.resources import files
from pathlib import Path

import pytest

import gem_core as gem
from gem_core.agents import RandomAgent
from gem_math import grade
from gem_math.grading import formulas
from gem_math.grading.compare import Comparison
from gem_math.grading.readings import readings
from gem_math.grading.text import clean

SCRIPTS = Path(__file__).resolve().parents[3] / "scripts"
ROWS = [json.loads(line) for line in (files("gem_math") / "data" / "sample.jsonl").read_text().splitlines()]


def test_there_are_enough_problems_of_many_forms():
    """At least 200 problems, no two alike, with every form that the issue names."""
    assert len(ROWS) >= 200
    assert len({row["problem"] for row in ROWS}) == len({row["id"] for row in ROWS}) == len(ROWS)
    forms = {"integer", "fraction", "decimal", "percentage", "unit", "interval", "set", "tuple", "matrix", "equation"}
    assert forms | {"choice", "text"} <= set(Counter(row["form"] for row in ROWS))


def test_the_rows_never_change_unnoticed():
    """Other rows are another environment: a change here asks for a new version of the id."""
    digest = hashlib.sha256(json.dumps(ROWS).encode()).hexdigest()
    assert digest[:16] == "0c83feec707a4ff6"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["id"])
def test_gold_answer_is_right_and_the_next_is_not(row: dict[str, str]):
    """Each answer is right when it is compared part by part, and wrong for the problem five rows on."""
    golds, answers = readings(clean(row["answer"]), clean(row["answer"]))
    assert Comparison(formulas).same(golds[0], answers[0])
    other = ROWS[(ROWS.index(row) + 5) % len(ROWS)]["answer"]
    # Letters of choices stand side by side in two families.
    alike = {"B": r"\text{(B)}", "C": r"\text{(C)}", "A": r"\text{(A)}", "D": r"\text{(D)}"}.get(row["answer"]) == other
    assert grade(f"\\boxed{{{other}}}", row["answer"], timeout_s=20).correct is alike


def test_every_episode_of_a_random_agent_is_graded():
    """A covering run meets every problem once, without an error, and a random answer is rarely right."""
    episodes = list(gem.rollout("math:Sample", RandomAgent(), seed=3))
    infos = [episode.transitions[-1].info for episode in episodes]
    assert len(infos) == len(ROWS)
    assert not any("error" in info for info in infos)
    assert sum(info["correct"] for info in infos) < len(ROWS) / 10


def test_the_script_writes_the_rows() -> None:
    """From its families, each of which proves its answers."""
    if not SCRIPTS.is_dir():
        pytest.skip("the scripts are not beside the plugin")
    code = "import json, math_sample\nprint(json.dumps(list(math_sample.text_rows())))"
    done = subprocess.run([sys.executable, "-c", code], cwd=SCRIPTS, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == ROWS
