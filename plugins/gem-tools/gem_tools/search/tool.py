"""The tool ``search``: one for corpora on this machine, one for servers, and the function that makes the right one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import pydantic

from gem_core.errors import ArgumentError
from gem_core.suggestions import did_you_mean
from gem_core.tools import Tool, ToolResult
from gem_core.types import Concurrency
from gem_tools.configured import ConfiguredTool
from gem_tools.search.corpus import ARTICLES
from gem_tools.search.index import Index, open_index
from gem_tools.search.passages import LEAST_CHARS, MAX_QUERY_CHARS, MAX_TOP_K, Passage, cleaned_query, rendered

if TYPE_CHECKING:
    from gem_tools.search.remote import SearchServer

ENGINES = ("local", "retrieve", "serper")

_DESCRIPTION = (
    "Looks for passages in a collection of texts and shows those that fit best. Ask with the few words that such a "
    "passage would contain, such as names; for a question in several steps, search once for each step."
)
_WEB_DESCRIPTION = (
    "Looks something up with a search engine and shows the results that fit best. Ask with a few telling words; for a "
    "question in several steps, search once for each step."
)
_EMPTY = ToolResult("The query is empty. Write what you look for, in a few words.", failed=True)
_FEW = 20_000
"""So many passages are searched in under a millisecond, less than a thread costs."""


def make_search(
    engine: str | None = None,
    *,
    corpus: str | os.PathLike[str] | None = None,
    url: str | None = None,
    top_k: int = 3,
    max_chars: int = 4000,
    name: str = "search",
    description: str | None = None,
    instructions: str | None = None,
    cache_dir: str | os.PathLike[str] | None = None,
    timeout_s: float = 20.0,
    max_retries: int = 3,
    max_concurrency: int = 64,
) -> Tool:
    """Return a search tool.

    Args:
        engine: ``"local"`` for a corpus on this machine, ``"retrieve"`` for a server of Search-R1's form, or
            ``"serper"`` for the web. By default ``"retrieve"`` if there is an address, else ``"local"``.
        corpus: A file of lines ``{"id", "title", "text"}``, a folder of text files, or ``"articles"``, which come with
            the plugin and are the default. Indexed on first use; the index is kept.
        url: Address of the server; for ``"retrieve"`` by default the environment variable ``SEARCH_URL``.
        top_k: Passages in a result.
        max_chars: Most characters in a result, titles included.
        name: What the agent calls it by, and its tag; for two searches in one environment.
        description: What it is, in the instructions and the schema.
        instructions: The line that explains the tool to an agent, in place of the usual one.
        cache_dir: Where indices are kept; by default ``gem/search`` in the user's cache folder.
        timeout_s: Limit of one search on a server, in seconds, all attempts included.
        max_retries: Attempts after the first on a server, for status 429 and faults that may pass.
        max_concurrency: Requests to a server at once.

    Raises:
        ArgumentError: An option that cannot be right.
        DatasetError: The corpus cannot be read.
        MissingRequirementError: The web engine without its key.
    """
    options = dict(locals())
    engine = engine or ("local" if url is None else "retrieve")
    if engine not in ENGINES:
        hint = did_you_mean(engine, ENGINES) if isinstance(engine, str) else ""
        raise ArgumentError(f"no search engine {engine!r}.{hint} There are: {', '.join(ENGINES)}")
    for option, value, least, most in (("top_k", top_k, 1, MAX_TOP_K), ("max_chars", max_chars, LEAST_CHARS, 1 << 40)):
        if type(value) is not int or not least <= value <= most:
            raise ArgumentError(f"{option} must be a whole number from {least} to {most}, not {value!r}")
    if engine == "local":
        if url is not None:
            raise ArgumentError("the engine 'local' takes a corpus, not a url; for a server name another engine")
        index = open_index(ARTICLES if corpus is None else corpus, cache_dir)
        return LocalSearch(index, top_k, max_chars).configured(make_search, options)
    if corpus is not None:
        raise ArgumentError(f"the engine {engine!r} asks a server and takes no corpus")
    from gem_tools.search.remote import shared_server  # aiohttp takes 0.16 s, which local searches need not pay

    address = url or (os.environ.get("SEARCH_URL", "").strip() if engine == "retrieve" else "")
    if engine == "retrieve" and not address:
        raise ArgumentError("the engine 'retrieve' needs an address: pass url=…, or set SEARCH_URL")
    server = shared_server(engine, address, timeout_s, max_retries, max_concurrency)
    return RemoteSearch(server, top_k, max_chars).configured(make_search, options)


class SearchTool(ConfiguredTool):
    """What both search tools have in common."""

    name = "search"
    description = _DESCRIPTION

    class Parameters(pydantic.BaseModel):
        """What is looked for."""

        query: str = pydantic.Field(description="what to look for, in a few words")

    def __init__(self, top_k: int, max_chars: int) -> None:
        self.top_k, self.max_chars = top_k, max_chars

    def _result(self, asked: str, passages: Sequence[Passage], cut: bool, engine: str) -> ToolResult:
        note = f"Only the first {MAX_QUERY_CHARS} characters of your query were used.\n\n" if cut else ""
        nothing = f'Nothing was found for "{asked[:200]}". Try other or fewer words.'
        text = rendered(passages, self.max_chars) if passages else nothing
        results = [{"id": p.id, "title": p.title, "score": p.score, "url": p.url} for p in passages]
        return ToolResult(f"{note}{text}", info={"engine": engine, "results": results})


class LocalSearch(SearchTool):
    """Searches a corpus on this machine."""

    def __init__(self, index: Index, top_k: int, max_chars: int) -> None:
        super().__init__(top_k, max_chars)
        self.index = index
        self.concurrency: Concurrency = "inline" if len(index) <= _FEW else "thread"

    def call(self, arguments: Any, session: Any) -> ToolResult:
        """Return the passages that fit best."""
        query, cut = cleaned_query(arguments.query)
        return self._result(query, self.index.search(query, self.top_k), cut, "local") if query else _EMPTY


class RemoteSearch(SearchTool):
    """Searches on a server."""

    def __init__(self, server: SearchServer, top_k: int, max_chars: int) -> None:
        super().__init__(top_k, max_chars)
        self.server = server
        self.description = _DESCRIPTION if server.engine == "retrieve" else _WEB_DESCRIPTION

    async def call(self, arguments: Any, session: Any) -> ToolResult:
        """Return what the server finds; if it does not answer, say so."""
        from gem_tools.search.remote import SearchFault

        query, cut = cleaned_query(arguments.query)
        if not query:
            return _EMPTY
        engine = self.server.engine
        try:
            return self._result(query, await self.server.search(query, self.top_k), cut, engine)
        except SearchFault as fault:
            text = (
                f"The search server did not answer: {fault}. This is no fault of your query. "
                "Try again later, or go on without searching."
            )
            # For trainers: a machine failed, not the agent.
            return ToolResult(text, failed=True, info={"engine": engine, "fault": str(fault), "results": []})
