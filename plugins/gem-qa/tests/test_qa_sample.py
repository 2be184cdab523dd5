"""``qa:Sample``: its questions can be answered from the articles of gem-tools, and by an agent that searches them."""

from __future__ import annotations

import importlib.resources
import json
import re
from pathlib import Path
from typing import Any

import pytest

import gem_core as gem
from gem_qa import _plugin

ROWS = [
    json.loads(line)
    for line in (Path(_plugin.__file__).parent / "data" / "sample.jsonl").read_text("utf-8").splitlines()
]


@pytest.fixture(scope="module")
def articles() -> dict[str, dict[str, str]]:
    """The articles by id."""
    pytest.importorskip("gem_tools", reason="the articles come with gem-tools")
    text = importlib.resources.files("gem_tools.search").joinpath("articles.jsonl").read_text("utf-8")
    return {article["id"]: article for article in map(json.loads, text.splitlines())}


def stands_in(answers: list[str], text: str) -> bool:
    """Tell whether one of the answers stands in a text, as whole words."""
    return any(re.search(rf"(?<!\w){re.escape(answer)}(?!\w)", text, re.IGNORECASE) for answer in answers)


def test_there_are_enough_questions_and_no_two_alike() -> None:
    """At least 100, 35 of them in two hops; ids and questions are unique."""
    assert len(ROWS) >= 100
    assert sum(row["hops"] == 2 for row in ROWS) >= 35
    assert len({row["id"] for row in ROWS}) == len({row["question"] for row in ROWS}) == len(ROWS)
    for row in ROWS:
        assert set(row) == {"id", "question", "answers", "hops", "articles"}
        assert len(row["articles"]) == len(set(row["articles"])) == row["hops"]
        assert row["question"].endswith("?")


def test_no_question_gives_its_answer_away() -> None:
    """No accepted answer stands in it."""
    assert [row["id"] for row in ROWS if stands_in(row["answers"], row["question"])] == []


def test_every_answer_stands_in_the_last_article(articles: dict[str, dict[str, str]]) -> None:
    """The one that the question leads to."""
    wrong = [row["id"] for row in ROWS if not stands_in(row["answers"], articles[row["articles"][-1]]["text"])]
    assert wrong == []


def test_two_hops_need_two_articles(articles: dict[str, dict[str, str]]) -> None:
    """The answer is not in the first, which names what the last is about, or the other way round."""
    for row in ROWS:
        if row["hops"] == 1:
            continue
        first, last = (articles[name] for name in row["articles"])
        assert not stands_in(row["answers"], first["text"]), row["id"]
        names = re.findall(r"\w{4,}", last["title"]) + re.findall(r"\w{4,}", first["title"])
        assert any(name in first["text"] and name in last["text"] + last["title"] for name in names), row["id"]


def make_searching(cache: Path) -> Any:
    """Return the sample with the search tool around it."""
    return gem.make("qa:Sample", wrappers=[("search", {"cache_dir": str(cache)})])


@pytest.fixture(scope="module")
def index_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the index of the articles is kept."""
    pytest.importorskip("gem_tools", reason="the search tool comes with gem-tools")
    return tmp_path_factory.mktemp("index")


def test_search_finds_the_article_of_each_question_in_one_hop(index_cache: Path) -> None:
    """By BM25, the question as it stands: all 79 first of three; at least 95 in 100 among the three is the promise."""
    env = make_searching(index_cache)
    missed = []
    for index, row in enumerate(ROWS):
        env.reset(options={"index": index})
        found = [result["id"] for result in env.step(f"<search>{row['question']}</search>")[4]["tool"]["results"]]
        assert len(found) == 3
        if row["hops"] == 1 and row["articles"][0] not in found:
            missed.append(row["id"])
    assert len(missed) <= 0.05 * sum(row["hops"] == 1 for row in ROWS), missed
