"""``gem serve-search``: what the server answers, what it refuses, and how it ends."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from search_server import running

from gem_core.background import run_sync
from gem_tools.search.index import open_index
from gem_tools.search.server import retrieval_app
from gem_tools.search.tool import RemoteSearch, make_search

ROWS = [
    {"id": "r", "title": "Rivers", "text": "The Loire flows through France."},
    {"id": "m", "title": "Mountains", "text": "The Jura lies between France and Switzerland."},
]
RIVERS = {**ROWS[0], "contents": '"Rivers"\nThe Loire flows through France.'}


@pytest.fixture
def corpus(tmp_path: Path) -> Path:
    path = tmp_path / "corpus.jsonl"
    path.write_text("".join(json.dumps(row) + "\n" for row in ROWS), encoding="utf-8")
    return path


@pytest.fixture
def url(corpus: Path, tmp_path: Path) -> Iterator[str]:
    with running(retrieval_app(open_index(corpus, tmp_path / "cache"))) as address:
        yield address


def ask(url: str, body: Any) -> tuple[int, Any]:
    data = body if isinstance(body, bytes) else json.dumps(body).encode()
    try:
        with urllib.request.urlopen(urllib.request.Request(f"{url}/retrieve", data), timeout=60) as response:
            return response.status, json.loads(response.read())
    except urllib.error.HTTPError as error:
        with error:
            return error.code, json.loads(error.read())


def test_queries_are_answered_in_the_form_of_search_r1(url: str) -> None:
    """A list for each query, in order, with scores."""
    status, answer = ask(url, {"queries": ["loire", "nothing"], "topk": 1, "return_scores": True})
    assert status == 200
    ((hit,), none) = answer["result"]
    assert hit["document"] == RIVERS
    assert hit["score"] > 0
    assert none == []


def test_without_scores_the_documents_are_bare(url: str) -> None:
    """As that form has it; three of them where no number is given."""
    assert ask(url, {"queries": ["loire"]}) == (200, {"result": [[RIVERS]]})


@pytest.mark.parametrize(
    "body",
    [
        b"no JSON",
        b"\xff",
        b"[" * 200_000,
        [],
        {"queries": "loire"},
        {"queries": [1]},
        {"queries": ["x"], "topk": 0},
        {"queries": ["x"], "topk": True},
        {"queries": ["x"] * 513},
        b" " * 4_000_001,
    ],
)
def test_what_is_no_request_is_refused(url: str, body: Any) -> None:
    """With what was wrong; and the server goes on."""
    status, answer = ask(url, body)
    assert status in (400, 413)
    assert answer["error"]
    assert ask(url, {"queries": []}) == (200, {"result": []})


def test_hostile_queries_are_answered(url: str) -> None:
    """Broken Unicode, control characters, and much of it."""
    queries = ["\ud800 loire", "\x00", "", "loire " * 100_000, "\u202eloire"]
    status, answer = ask(url, {"queries": queries, "return_scores": True})
    assert status == 200
    assert [len(hits) for hits in answer["result"]] == [1, 0, 0, 1, 1]


def test_every_error_is_json(url: str) -> None:
    """Also for a page that is not there, and a body that is not what it is said to be."""
    for method, path, status in [("GET", "/nothing", 404), ("GET", "/retrieve", 405), ("POST", "/retrieve", 400)]:
        request = urllib.request.Request(url + path, b"gz" if method == "POST" else None, {"Content-Encoding": "gzip"})
        with pytest.raises(urllib.error.HTTPError) as caught:
            urllib.request.urlopen(request, timeout=60)
        with caught.value as error:
            assert (error.code, list(json.loads(error.read()))) == (status, ["error"])
    with urllib.request.urlopen(f"{url}/health", timeout=60) as response:
        assert json.loads(response.read()) == {"status": "ok", "passages": 2}


class BrokenIndex:
    """An index whose files were taken away."""

    def __len__(self) -> int:
        return 1

    def search(self, query: str, top_k: int) -> Any:
        raise ValueError("secret")


def test_a_search_that_fails_is_answered_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    """With status 500, on which a client tries again."""
    with running(retrieval_app(BrokenIndex())) as url:  # type: ignore[arg-type]
        status, answer = ask(url, {"queries": ["loire"]})
    assert status == 500
    assert "secret" not in answer["error"]
    assert len(caplog.records) == 1


def test_the_tool_searches_it(url: str) -> None:
    """The two halves fit together."""
    tool = make_search(url=url)
    assert isinstance(tool, RemoteSearch)
    result = run_sync(tool.call(tool.Parameters(query="switzerland"), None))
    assert result.content == "[1] Mountains\nThe Jura lies between France and Switzerland."
    assert result.info["results"][0]["id"] == "m"


# The command.


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "gem_core", "serve-search", *arguments]


@pytest.mark.few(1)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_command_serves_until_it_is_told_to_end(corpus: Path, tmp_path: Path, number: int) -> None:
    """Cleanly: exit code 0, and no traceback."""
    options = ["--port", "0", "--cache-dir", str(tmp_path / "cache")]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        command(str(corpus), *options), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line.startswith("Serving 2 passages at http://127.0.0.1:")
            url = line.split(" at ")[1].split("/retrieve")[0]
            assert ask(url, {"queries": ["loire"]})[0] == 200
            process.send_signal(number)
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()
    assert (process.returncode, out, err) == (0, "Stopped\n", "")


def test_a_port_that_is_taken_is_told(corpus: Path, tmp_path: Path) -> None:
    """In one line, with what to do next."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        arguments = command(str(corpus), "--port", str(port), "--cache-dir", str(tmp_path))
        done = subprocess.run(arguments, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert f"127.0.0.1:{port}: Address already in use" in done.stderr
