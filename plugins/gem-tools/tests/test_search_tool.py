"""The tool ``search``: around a task, its options, how passages are shown, and the articles that come with it."""

from __future__ import annotations

import json
import os
import pickle
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gem_core as gem
from gem_core.data import DatasetEnv
from gem_core.errors import ArgumentError
from gem_core.parsing import extract_code_blocks
from gem_core.testing import check_plugin, check_tool
from gem_core.tools import ToolEnv
from gem_tools import search as package
from gem_tools.search.passages import MAX_QUERY_CHARS, Passage, cleaned_query, rendered
from gem_tools.search.status import status
from gem_tools.search.tool import LocalSearch, make_search

ROWS = [{"question": "Where was the captain of HMS Endeavour killed?", "answer": "Kealakekua Bay"}]
GUIDE = Path(__file__).parents[3] / "docs" / "search.md"


@pytest.fixture(autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the user's own cache out of it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
    monkeypatch.delenv("SEARCH_URL", raising=False)


def env_with(*tools: Any) -> ToolEnv:
    env = ToolEnv(DatasetEnv(ROWS), list(tools) or ["search"])
    env.reset(seed=1)
    return env


@pytest.mark.parametrize(
    "action",
    [
        "<search>Fram</search>",
        '<tool_call>{"name": "search", "arguments": {"query": "Fram"}}</tool_call>',
        gem.Response(
            "",
            tool_calls=[
                {"id": "c1", "type": "function", "function": {"name": "search", "arguments": '{"query": "Fram"}'}}
            ],
        ),
    ],
    ids=["tag", "json", "native"],
)
def test_it_works_at_once_by_its_name(action: str) -> None:
    """With the articles that come with the plugin, however it is called."""
    observation, _, terminated, _, info = env_with().step(action)
    assert "[1] Fram (ship)\n" in str(observation)
    assert not terminated
    assert info["tool"]["arguments"] == {"query": "Fram"}
    assert (info["tool"]["engine"], info["tool"]["results"][0]["id"]) == ("local", "fram-ship")
    json.dumps(info["tool"], allow_nan=False)


def test_what_is_wrong_with_a_query_is_told() -> None:
    """An empty one has failed; one that finds nothing has not; of a very long one the first part is used."""
    env = env_with()
    assert env.step("<search>\x00 \n</search>")[4]["tool"]["failed"]
    observation, *_, info = env.step("<search>zzyzx</search>")
    assert "zzyzx" in str(observation)
    assert not info["tool"]["failed"]
    observation = str(env.step(f"<search>Fram {'word ' * 1_000_000}</search>")[0])
    assert "first 1000 characters" in observation
    assert "[1] Fram (ship)\n" in observation


def test_two_searches_have_names_of_their_own(tmp_path: Path) -> None:
    """Each with its own tag and corpus."""
    corpus = tmp_path / "own.jsonl"
    corpus.write_text('{"title": "Own", "text": "Fram is a name."}\n')
    env = env_with("search", ("search", {"name": "notes", "corpus": str(corpus), "description": "Finds your notes."}))
    assert "[1] Own\nFram is a name." in str(env.step("<notes>Fram</notes>")[0])
    assert "[1] Fram (ship)" in str(env.step("<search>Fram</search>")[0])
    assert [schema["function"]["name"] for schema in env.reset(seed=1)[1]["tools"]] == ["search", "notes"]


def test_its_words_can_be_replaced_and_it_survives_pickling() -> None:
    """In another process a tool is made again from its options."""
    assert make_search(description="Mine.").instructions() == "- search: Mine. Call it with <search>query</search>"
    tool = make_search(top_k=7, instructions="- Write <search>words</search>.")
    copied = pickle.loads(pickle.dumps(tool))
    assert isinstance(tool, LocalSearch)
    assert copied.index is tool.index
    assert (copied.top_k, copied.instructions()) == (7, "- Write <search>words</search>.")
    assert len(pickle.dumps(tool)) < 1000


def test_a_large_corpus_is_searched_in_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small one in place: its search takes less than starting a thread."""
    assert make_search().concurrency == "inline"
    monkeypatch.setattr("gem_tools.search.tool._FEW", 10)
    assert make_search().concurrency == "thread"


@pytest.mark.parametrize(
    "options",
    [
        {"top_k": 0},
        {"max_chars": 3},
        {"engine": "serpr"},
        {"engine": "local", "url": "http://x.example"},
        {"url": "http://x.example", "corpus": "y"},
        {"engine": "retrieve"},
        {"url": "ftp://x.example"},
        {"url": "http://x.example:99999"},
        {"url": "http://x.example", "timeout_s": 0},
        {"url": "http://x.example", "max_retries": -1},
        {"instructions": "a\nb"},
    ],
)
def test_options_that_cannot_be_right_are_refused(options: dict[str, Any]) -> None:
    """When the tool is made."""
    with pytest.raises(ArgumentError):
        make_search(**options)


@pytest.mark.thorough
def test_the_tool_keeps_its_promises() -> None:
    """Those of every tool, and of every plugin."""
    assert check_tool("search", {"query": "white rhino"})
    assert check_plugin("tools")


def test_the_doctor_is_told_which_engines_can_be_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the value of a key or address."""
    monkeypatch.setenv("SERPER_API_KEY", "pssst")
    monkeypatch.setenv("SEARCH_URL", "http://user:pssst@localhost")
    assert status()["serper"] == "SERPER_API_KEY is set"
    assert "pssst" not in str(status())


def test_listing_imports_nothing_heavy() -> None:
    """Neither numpy nor bm25s nor aiohttp."""
    code = "import sys, gem_tools._plugin as p; list(p.gem_register_tools()); list(p.gem_add_commands()); "
    code += "print({'numpy', 'bm25s', 'aiohttp', 'pydantic'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "set()\n"


def test_the_example_of_the_guide_runs(tmp_path: Path) -> None:
    """And solves its task in two searches."""
    code = next(
        block.code for block in extract_code_blocks(GUIDE.read_text("utf-8"), "python") if "search" in block.code
    )
    environment = {"XDG_CACHE_HOME": str(tmp_path), "PATH": ""}
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.stderr == ""
    assert "[1] HMS Endeavour" in done.stdout
    assert done.stdout.endswith("\n1.0\n")


# Passages and queries.

PASSAGES = [
    Passage("a", "First", "one two three"),
    Passage("b", "", "four " * 100, 1.0),
    Passage("c", "Third", "", None, "http://x.example"),
]


def test_passages_are_numbered_and_the_longest_is_cut_first() -> None:
    """At the end of a word; the short ones stay whole."""
    text = rendered(PASSAGES, 140)
    assert text.startswith("[1] First\none two three\n\n[2] Without a title\nfour four ")
    assert text.endswith(" four…\n\n[3] Third (http://x.example)\n")
    assert 130 < len(text) <= 140


def test_what_does_not_fit_at_all_is_left_out() -> None:
    """The last passages first."""
    text = rendered([Passage("", f"Title {number}", "word " * 50) for number in range(10)], 120)
    assert text.startswith("[1] Title 0\nword")
    assert "[2]" in text
    assert "[3]" not in text


@given(
    st.lists(
        st.builds(Passage, st.text(), st.text(max_size=300), st.text(max_size=600), st.none(), st.text()), max_size=5
    ),
    st.integers(40, 900),
)
def test_no_result_is_longer_than_its_budget(passages: list[Passage], max_chars: int) -> None:
    """Whatever the passages hold."""
    assert len(rendered(passages, max_chars)) <= max_chars


@pytest.mark.parametrize(
    ("text", "query"),
    [
        ("  two\n\twords ", ("two words", False)),
        ("a\x00b\x1bc", ("a b c", False)),
        ("\ud800x", ("\ufffdx", False)),
        ("\n", ("", False)),
        ("w" * MAX_QUERY_CHARS, ("w" * MAX_QUERY_CHARS, False)),
        ("w" * 5_000_000, ("w" * MAX_QUERY_CHARS, True)),
        (" " * 5_000_000 + "end", ("end", False)),
    ],
)
def test_queries_become_one_clean_line(text: str, query: tuple[str, bool]) -> None:
    """Of a bounded length; the agent is told if more was written."""
    assert cleaned_query(text) == query


# The articles.


def test_the_articles_are_in_good_form() -> None:
    """Short, each with an id of its own, found by its title, and most name another."""
    lines = Path(os.path.dirname(package.__file__), "articles.jsonl").read_text("utf-8").splitlines()
    articles = [json.loads(line) for line in lines]
    assert len({article["title"] for article in articles}) == len(articles) == 200
    assert [article["id"] for article in articles] == sorted({article["id"] for article in articles})
    for article in articles:
        assert set(article) == {"id", "title", "text"}
        assert 3 <= len(re.findall(r"[.!?](?: |$)", article["text"])) <= 8, article["id"]
        assert 35 <= len(article["text"].split()) <= 110, article["id"]
    tool = make_search(top_k=1)
    assert isinstance(tool, LocalSearch)
    assert [a["title"] for a in articles if tool.index.search(a["title"], 1)[0].id != a["id"]] == []
    titles = {article["title"].partition(" (")[0] for article in articles}
    assert sum(any(t in a["text"] for t in titles - {a["title"].partition(" (")[0]}) for a in articles) > 170
