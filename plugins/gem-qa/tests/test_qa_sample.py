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


SCRIPTS: dict[str, list[tuple[str, str]]] = {
    "drifted apart": [("continents drift Wegener", r"from which they came (\w+)")],
    "marble lions": [("Alhambra Court of the Lions", r"carried by (\d+) marble lions")],
    "closest friend of Adam Smith": [
        ("closest friend of Adam Smith", r"(\w+ \w+) was his closest friend"),
        ("{} philosopher born", r"{} was a Scottish philosopher, born in \w+ in (\d+)"),
    ],
    "dome of the church": [
        ("Justinian emperor Constantinople", r"He had ([A-Z]\w+ [A-Z]\w+) built"),
        ("{} dome", r"Its dome is (\d+) metres wide"),
    ],
    "captain of the ship": [
        ("Titanic survivors saved", r"the (RMS \w+) saved"),
        ("{} captain", r"Under captain (\w+ \w+)"),
    ],
    "Clyde Tombaugh discovered": [
        ("Clyde Tombaugh discovered", r"There he discovered (\w+)"),
        ("{} largest moon", r"Its largest moon, (\w+)"),
    ],
    "Girl with a Pearl Earring hangs": [
        ("Girl with a Pearl Earring museum", r"left it to the (\w+)"),
        ("{} house built", r"built from 1636 to 1641 by (\w+ van \w+)"),
    ],
}
"""For words of a question: what to search for, and where the next word to search for, or the answer, stands."""


class ScriptedReader:
    """Searches, reads what was found, searches for that, and answers; it knows nothing but where to look."""

    def __init__(self) -> None:
        self.script: list[tuple[str, str]] = []

    def __call__(self, observation: str, context: Any) -> str:
        """Return the next search, or the answer."""
        if context.turn == 0:
            self.script = next(script for words, script in SCRIPTS.items() if words in observation)
            self.found = ""
        else:
            match = re.search(self.script[context.turn - 1][1].format(self.found), observation)
            assert match is not None, observation
            self.found = match[1]
        if context.turn == len(self.script):
            return f"So it is <answer>{self.found}</answer>"
        return f"<search>{self.script[context.turn][0].format(self.found)}</search>"


def test_scripted_agent_solves_questions_in_several_turns(index_cache: Path) -> None:
    """With the search tool alone: two turns for one hop, three for two."""
    for words, script in SCRIPTS.items():
        (index,) = (number for number, row in enumerate(ROWS) if words in row["question"])
        plan = [gem.PlanItem(options={"index": index})]
        (episode,) = gem.rollout(make_searching(index_cache), ScriptedReader(), plan=plan)
        turns = episode.transitions
        assert (len(turns), turns[-1].reward, turns[-1].info["correct"]) == (len(script) + 1, 1.0, True), words
        assert len(script) == ROWS[index]["hops"]
        visited = [[result["id"] for result in turn.info["tool"]["results"]] for turn in turns[:-1]]
        assert all(name in found for name, found in zip(ROWS[index]["articles"], visited, strict=True))


def test_sample_runs_from_the_command_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Each row once by default; a random agent gives answers of other rows."""
    from gem_core.cli import main

    out = tmp_path / "run.jsonl"
    with pytest.raises(SystemExit) as caught:
        main(["run", "qa:Sample", "--agent", "random", "--num-envs", "8", "--seed", "1", "--out", str(out)])
    assert not caught.value.code
    assert str(len(ROWS)) in capsys.readouterr().out
    episodes = list(gem.read_episodes(out))
    assert sorted(episode.info["task_id"] for episode in episodes) == sorted(row["id"] for row in ROWS)
