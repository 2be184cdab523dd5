"""The tool ``search``: around a task, its options, what the agent is told, and the articles that come with it."""

from __future__ import annotations

import asyncio
import json
import pickle
import re
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from search_server import Reply, serving

import gem_core as gem
from gem_core.data import DatasetEnv
from gem_core.errors import ArgumentError
from gem_core.testing import check_plugin, check_tool
from gem_core.tools import ToolEnv
from gem_tools import search as package
from gem_tools.search import status
from gem_tools.search.corpus import find_corpus
from gem_tools.search.services import SERVICES
from gem_tools.search.tool import LocalSearch, make_search

ROWS = [{"question": "Where was the captain of HMS Endeavour killed?", "answer": "Kealakekua Bay"}]


@pytest.fixture(autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Keep the user's own cache out of it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
    monkeypatch.delenv("SEARCH_URL", raising=False)
    return None


def env_with(*tools: Any, **options: Any) -> ToolEnv:
    env = ToolEnv(DatasetEnv(ROWS), list(tools) or ["search"], **options)
    env.reset(seed=1)
    return env


def test_it_works_at_once_by_its_name() -> None:
    """With the articles that come with the plugin; nothing is downloaded."""
    env = env_with()
    observation, _, terminated, _, info = env.step("I look it up. <search>HMS Endeavour</search> and more")
    assert str(observation).startswith("Output of search:\n[1] HMS Endeavour\nHMS Endeavour was the ship of James Cook")
    assert not terminated
    assert info["parsed_action"] == "I look it up. <search>HMS Endeavour</search>"
    assert info["tool"]["engine"] == "local"
    assert info["tool"]["results"][0]["id"] == "hms-endeavour"
    json.dumps(info["tool"], allow_nan=False)


def test_a_question_in_two_steps_is_solved_by_two_searches() -> None:
    """The first result names what the second search needs."""
    env = env_with()
    first = str(env.step("<search>HMS Endeavour captain voyage</search>")[0])
    assert "James Cook" in first
    second = str(env.step("<search>James Cook killed</search>")[0])
    assert "killed at Kealakekua Bay" in second
    assert env.step("\\boxed{Kealakekua Bay}")[1] == 1.0


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
def test_the_forms_of_a_call_mean_the_same(action: str) -> None:
    """A tag, a JSON call, and a native call of a chat server."""
    info = env_with().step(action)[4]
    assert info["tool"]["arguments"] == {"query": "Fram"}
    assert info["tool"]["results"][0]["id"] == "fram-ship"


@pytest.mark.parametrize("query", ["", " \n", "\x00"])
def test_an_empty_query_is_told(query: str) -> None:
    """As a call that failed."""
    info = env_with().step(f"<search>{query}</search>")
    assert "Error from search:\nThe query is empty. Write what you look for, in a few words." in str(info[0])


def test_finding_nothing_is_no_failure() -> None:
    """The agent may try other words."""
    observation, *_, info = env_with().step("<search>zzyzx</search>")
    assert 'Nothing was found for "zzyzx". Try other or fewer words.' in str(observation)
    assert info["tool"]["failed"] is False


def test_a_query_of_megabytes_is_cut_and_told() -> None:
    """Without taking its time."""
    observation = env_with().step(f"<search>Fram {'word ' * 1_000_000}</search>")[0]
    assert str(observation).startswith(
        "Output of search:\nOnly the first 1000 characters of your query were used.\n\n[1] Fram (ship)\n"
    )


def test_results_keep_to_their_budget() -> None:
    """Of characters, and of tokens where there is a tokenizer."""
    tool = make_search(max_chars=300)
    content = tool.call(tool.Parameters(query="ship voyage"), None)
    assert len(content.content) <= 300  # type: ignore[union-attr,arg-type]
    tool = make_search(max_tokens=40, tokenizer=str.split, top_k=2)
    content = tool.call(tool.Parameters(query="ship voyage"), None)
    assert len(content.content.split()) == 40  # type: ignore[union-attr]


def test_two_searches_have_names_of_their_own(tmp_path: Path) -> None:
    """Each with its own tag and corpus."""
    corpus = tmp_path / "own.jsonl"
    corpus.write_text('{"title": "Own", "text": "Fram is a name."}\n')
    env = env_with("search", ("search", {"name": "notes", "corpus": str(corpus), "description": "Finds your notes."}))
    assert "[1] Own\nFram is a name." in str(env.step("<notes>Fram</notes>")[0])
    assert "[1] Fram (ship)" in str(env.step("<search>Fram</search>")[0])
    assert [schema["function"]["name"] for schema in env.reset(seed=1)[1]["tools"]] == ["search", "notes"]


def test_the_instructions_can_be_replaced() -> None:
    """The description in the schema stays."""
    tool = make_search(instructions="- Write <search>words</search>.")
    assert tool.instructions() == "- Write <search>words</search>."
    assert make_search(description="Mine.").instructions() == "- search: Mine. Call it with <search>query</search>"
    assert make_search().schema()["function"]["parameters"] == {
        "properties": {
            "query": {"description": "what to look for, in a few words", "title": "Query", "type": "string"}
        },
        "required": ["query"],
        "type": "object",
    }


def test_tools_share_an_index_and_survive_pickling() -> None:
    """In another process a tool is made again from its options."""
    tool = make_search(top_k=7)
    copied = pickle.loads(pickle.dumps(tool))
    assert isinstance(tool, LocalSearch)
    assert copied.index is tool.index
    assert copied.top_k == 7
    assert len(pickle.dumps(tool)) < 1000


def test_a_large_corpus_is_searched_in_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small one in place: its search takes less than starting a thread."""
    assert make_search().concurrency == "inline"
    monkeypatch.setattr("gem_tools.search.tool._FEW", 10)
    assert make_search().concurrency == "thread"


def test_it_works_in_many_environments_at_once() -> None:
    """Asynchronously, with a server; one cache for all."""
    found = {"result": [[{"document": {"contents": '"T"\nx'}, "score": 1.0}]]}
    with serving(Reply(found)) as server:
        envs = [env_with(("search", {"url": server.url})) for _ in range(20)]
        assert {env.concurrency for env in envs} == {"async"}

        async def many() -> list[Any]:
            return await asyncio.gather(*(env.step_async("<search>same</search>") for env in envs))

        assert {str(result[0]).split("\nTool")[0] for result in asyncio.run(many())} == {"Output of search:\n[1] T\nx"}
        assert len(server.requests) == 1
        with ThreadPoolExecutor(8) as pool:
            results = list(pool.map(lambda env: env.step("<search>other</search>"), envs))
        assert {result[4]["tool"]["failed"] for result in results} == {False}
        for env in envs:
            env.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"top_k": 0}, "top_k must be a whole number from 1 to 100, not 0"),
        (
            {"engine": "tavly"},
            "no search engine 'tavly'. Did you mean 'tavily'? There are: local, retrieve, serper, serpapi, tavily",
        ),
        (
            {"engine": "local", "url": "http://x.example"},
            "the engine 'local' takes a corpus, not a url; for a server name another engine",
        ),
        ({"url": "http://x.example", "corpus": "y"}, "the engine 'retrieve' asks a server and takes no corpus"),
        ({"engine": "retrieve"}, "the engine 'retrieve' needs an address: pass url=…, or set SEARCH_URL"),
        (
            {"url": "ftp://x.example"},
            "the address of the engine 'retrieve' must look like 'http://localhost:8000/retrieve'",
        ),
        (
            {"url": "http://x.example:99999"},
            "the address of the engine 'retrieve' must look like 'http://localhost:8000/retrieve'",
        ),
        ({"url": "http://x.example", "timeout_s": 0}, "timeout_s must be a positive number, not 0"),
        ({"url": "http://x.example", "max_retries": -1}, "max_retries must be a whole number from 0 up, not -1"),
        ({"url": "http://x.example", "requests_per_s": "1"}, "requests_per_s must be a positive number, not '1'"),
        ({"instructions": "a\nb"}, "instructions must be one line of text, not 'a\\nb'"),
    ],
)
def test_options_that_cannot_be_right_are_refused(options: dict[str, Any], message: str) -> None:
    """When the tool is made."""
    with pytest.raises(ArgumentError) as caught:
        make_search(**options)
    assert str(caught.value) == message


@pytest.mark.thorough
def test_the_tool_keeps_its_promises() -> None:
    """Those of every tool, and of every plugin."""
    assert check_tool("search", {"query": "white rhino"})
    assert check_plugin("tools")


def test_the_doctor_is_told_which_engines_can_be_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the services that there are, and without the value of a key."""
    web = {name: service.key_name for name, service in SERVICES.items() if service.key_name}
    assert web == status.KEYS
    for name in (*web.values(), "SEARCH_URL"):
        monkeypatch.delenv(name, raising=False)
    assert status.status() == {"local": "200 articles, or corpus=…", "retrieve": "with url=…", "web": "no key is set"}
    monkeypatch.setenv("TAVILY_API_KEY", "pssst")
    monkeypatch.setenv("SEARCH_URL", "http://user:pssst@localhost")
    assert status.status()["web"] == "tavily"
    assert "pssst" not in str(status.status())


def test_listing_imports_nothing_heavy() -> None:
    """Neither numpy nor bm25s nor aiohttp."""
    code = "import sys, gem_tools._plugin as p; list(p.gem_register_tools()); list(p.gem_add_commands()); "
    code += "print({'numpy', 'bm25s', 'aiohttp', 'pydantic'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "set()\n"


# The articles.

ARTICLES = [
    json.loads(line) for line in Path(package.__file__).with_name("articles.jsonl").read_text("utf-8").splitlines()
]


def test_there_are_200_articles_in_good_form() -> None:
    """Ids and titles are their own; three to eight sentences; in the order of their ids."""
    assert len(ARTICLES) == 200
    ids = [article["id"] for article in ARTICLES]
    assert ids == sorted(set(ids))
    assert len({article["title"] for article in ARTICLES}) == 200
    for article in ARTICLES:
        assert set(article) == {"id", "title", "text"}
        assert re.fullmatch(r"[a-z0-9-]+", article["id"])
        assert 3 <= len(re.findall(r"[.!?](?: |$)", article["text"])) <= 8, article["id"]
        assert 35 <= len(article["text"].split()) <= 110, article["id"]
        assert re.search(r"\d", article["text"]), article["id"]


def test_every_article_is_found_by_its_title() -> None:
    """First of all."""
    tool = make_search(top_k=1)
    assert isinstance(tool, LocalSearch)
    missed = [a["title"] for a in ARTICLES if tool.index.search(a["title"], 1)[0].id != a["id"]]
    assert missed == []
    assert len(tool.index) == 200
    assert find_corpus("articles").files[0].name == "articles.jsonl"


def test_most_articles_name_another() -> None:
    """So that questions can be asked in several steps."""
    titles = {article["title"].partition(" (")[0] for article in ARTICLES}
    linked = [a for a in ARTICLES if any(t in a["text"] for t in titles - {a["title"].partition(" (")[0]})]
    assert len(linked) > 170
