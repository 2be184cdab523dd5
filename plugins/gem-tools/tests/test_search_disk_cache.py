"""What servers found is kept on disk: asked once, bounded, shared by processes, and never in the way."""

from __future__ import annotations

import gc
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from search_server import Reply, Server, serving

from gem_core.background import run_sync
from gem_core.errors import ArgumentError
from gem_core.tools import ToolResult
from gem_tools.search.disk_cache import DiskCache
from gem_tools.search.passages import Passage
from gem_tools.search.remote import Limits, RemoteEngine
from gem_tools.search.services import SERVICES
from gem_tools.search.tool import RESULTS, make_search

ONE = {"result": [[{"document": {"id": "7", "contents": '"A Title"\nits text'}, "score": 1.5}]]}
PASSAGE = Passage("7", "A Title", "its text", 1.5, "")


@pytest.fixture
def server() -> Iterator[Server]:
    with serving(Reply(ONE)) as running:
        yield running


@pytest.fixture
def cache(tmp_path: Path) -> Iterator[DiskCache]:
    made = DiskCache(tmp_path / RESULTS, most_bytes=20_000)
    yield made
    made.close()


def asked(server: Server, folder: Path, query: str = "what", **options: Any) -> ToolResult:
    """Search with an engine of its own, as another run would have."""
    tool: Any = make_search(url=f"{server.url}/path", cache="disk", cache_dir=folder, **options)
    engine = tool.engine
    tool.engine = RemoteEngine(engine.service, engine.url, engine.limits, DiskCache(engine.disk.path))
    try:
        return run_sync(tool.call(tool.Parameters(query=query), None))
    finally:
        tool.engine.disk.close()


def test_a_later_run_asks_no_more(server: Server, tmp_path: Path) -> None:
    """The same query to the same server, for as many passages; anything else is asked."""
    first, second = asked(server, tmp_path), asked(server, tmp_path)
    assert (first.info["cached"], second.info["cached"]) == (False, True)
    assert first.content == second.content
    assert len(server.requests) == 1
    asked(server, tmp_path, "other")
    asked(server, tmp_path, top_k=2)
    assert len(server.requests) == 3


def test_faults_are_not_kept(tmp_path: Path) -> None:
    """A server that failed is asked again."""
    with serving(Reply("no", status=400), Reply(ONE)) as server:
        assert asked(server, tmp_path).failed
        assert not asked(server, tmp_path).failed


def test_no_address_and_no_query_stands_in_the_file(server: Server, tmp_path: Path) -> None:
    """An address may hold a password; only a hash of what was asked is kept."""
    asked(server, tmp_path, "my private question")
    content = b"".join(path.read_bytes() for path in tmp_path.iterdir())
    assert b"its text" in content
    assert b"private" not in content
    assert b"/path" not in content


def test_memory_alone_writes_no_file(server: Server, tmp_path: Path) -> None:
    """The default."""
    tool: Any = make_search(url=f"{server.url}/path", cache_dir=tmp_path)
    run_sync(tool.call(tool.Parameters(query="what"), None))
    assert list(tmp_path.iterdir()) == []


def test_cache_is_one_of_two_words() -> None:
    """Anything else is refused."""
    with pytest.raises(ArgumentError, match="cache must be 'memory' or 'disk', not 'disc'"):
        make_search(cache="disc")


def test_the_oldest_go_when_there_is_too_much(cache: DiskCache) -> None:
    """The file stays within its bound, and what is new stays in it."""
    for number in range(1000):
        cache.put("s", f"q{number}", 3, (Passage(str(number), "t", "x" * 100),))
    cache._until_check = 0
    cache.put("s", "last", 3, (PASSAGE,))
    with sqlite3.connect(cache.path) as connection:
        ((size,),) = connection.execute("SELECT SUM(size) FROM results")
    connection.close()
    assert 15_000 < size <= 20_000
    assert cache.get("s", "last", 3) == (PASSAGE,)
    assert cache.get("s", "q999", 3) is not None
    assert cache.get("s", "q0", 3) is None


def test_what_is_too_large_is_not_kept(cache: DiskCache) -> None:
    """One result must not push out all others."""
    cache.put("s", "q", 3, (Passage("1", "t", "x" * 5000),))
    assert cache.get("s", "q", 3) is None


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.text(max_size=20), min_size=4, max_size=4), st.floats(allow_nan=False) | st.none(), st.text())
def test_any_passage_comes_back_as_it_was(cache: DiskCache, fields: list[str], score: float | None, query: str) -> None:
    """Halves of characters and zeros included."""
    fields[2] += "\ud800\0"
    passage = Passage(fields[0], fields[1], fields[2], score, fields[3])
    cache.put("s", query, 3, (passage,))
    assert cache.get("s", query, 3) == (passage,)


@pytest.mark.parametrize("content", [b"no database at all" * 100, b"SQLite format 3\0" + b"\xff" * 5000, b""])
def test_a_file_that_is_no_cache_is_begun_anew(cache: DiskCache, content: bytes) -> None:
    """As after a crash of the machine."""
    cache.path.write_bytes(content)
    assert cache.get("s", "q", 3) is None
    cache.put("s", "q", 3, (PASSAGE,))
    assert cache.get("s", "q", 3) == (PASSAGE,)


def test_a_row_of_another_form_begins_anew(cache: DiskCache) -> None:
    """What an unknown version wrote is no result."""
    cache.put("s", "q", 3, (PASSAGE,))
    with sqlite3.connect(cache.path) as connection:
        connection.execute("UPDATE results SET passages = '[[1, 2]]'")
    connection.close()
    assert cache.get("s", "q", 3) is None


def test_a_cache_that_cannot_be_written_is_told_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """And the search goes on."""
    (tmp_path / "file").write_text("in the way")
    cache = DiskCache(tmp_path / "file" / RESULTS)
    for _ in range(3):
        cache.put("s", "q", 3, (PASSAGE,))
        assert cache.get("s", "q", 3) is None
    assert len(caplog.messages) == 1
    assert caplog.messages[0].startswith("gem: searching without the cache ")


def test_a_file_that_another_process_holds_is_done_without(cache: DiskCache, monkeypatch: pytest.MonkeyPatch) -> None:
    """It waits a moment, and never for long; the file is left whole."""
    monkeypatch.setattr("gem_tools.search.disk_cache._BUSY_S", 0.01)
    cache.put("s", "q", 3, (PASSAGE,))
    cache.close()
    holder = sqlite3.connect(cache.path, isolation_level=None)
    holder.execute("BEGIN EXCLUSIVE")
    cache.put("s", "other", 3, (PASSAGE,))
    holder.execute("COMMIT")
    holder.close()
    assert cache.get("s", "q", 3) == (PASSAGE,)
    assert cache.get("s", "other", 3) is None


WRITE_MANY = """
import sys
from pathlib import Path
from gem_tools.search import disk_cache
from gem_tools.search.passages import Passage
disk_cache._BUSY_S = 600.0  # on a busy machine a turn may take longer than a search would wait
cache = disk_cache.DiskCache(Path(sys.argv[1]))
for number in range(int(sys.argv[2]), int(sys.argv[2]) + 100):
    cache.put("s", f"q{number}", 3, (Passage("7", "A Title", "its text"),))
"""


def test_processes_write_side_by_side(cache: DiskCache) -> None:
    """Nothing is lost, and nothing breaks."""
    words = [sys.executable, "-c", WRITE_MANY, str(cache.path)]
    writers = [subprocess.Popen([*words, first], stderr=subprocess.PIPE) for first in ("0", "100", "200")]
    assert [writer.communicate()[1] for writer in writers] == [b"", b"", b""]
    assert sum(cache.get("s", f"q{number}", 3) is not None for number in range(300)) == 300


def test_engines_with_another_cache_are_others(server: Server, tmp_path: Path) -> None:
    """A tool without a cache on disk does not get one from its neighbour."""
    with_disk: Any = make_search(url=server.url, cache="disk", cache_dir=tmp_path)
    without: Any = make_search(url=server.url)
    assert with_disk.engine is not without.engine
    assert with_disk.engine is make_search(url=server.url, cache="disk", cache_dir=tmp_path).engine  # type: ignore[attr-defined]
    assert RemoteEngine(SERVICES["retrieve"], server.url, Limits()).disk is None


def test_a_forgotten_cache_closes_its_file(tmp_path: Path) -> None:
    """As soon as no tool uses it; Python warns of a connection that nobody closed."""
    forgotten = DiskCache(tmp_path / "results.sqlite")
    assert forgotten.get("server", "query", 1) is None
    assert forgotten._connection is not None
    connection = forgotten._connection[1]
    del forgotten
    gc.collect()
    with pytest.raises(sqlite3.ProgrammingError, match="closed"):
        connection.execute("SELECT 1")
