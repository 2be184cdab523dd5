"""The connection to an engine, and what is said when that is not what it should be."""

from __future__ import annotations

import json
import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any

import pytest
from memory_backend import plain_task

from gem_terminal.backends.docker.backend import DockerBackend
from gem_terminal.backends.docker.engine import Engine
from gem_terminal.backends.docker.sweeping import sweep
from gem_terminal.errors import EngineError


@contextmanager
def engine_that_says(path: Path, answers: dict[str, tuple[int, Any]], asked: list[str] | None = None) -> Iterator[str]:
    """Give the address of a server that answers to paths by their ends; an event is waited for before the answer."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            found = [said for end, said in answers.items() if self.path.partition("?")[0].endswith(end)]
            if asked is not None:
                asked.append(self.path.rpartition("/")[2])
            status, body = found[0] if found else (404, {"message": "page not found"})
            if isinstance(body, threading.Event):
                body.wait(60.0)
                body = {}
            data = body if isinstance(body, bytes) else json.dumps(body).encode()
            with suppress(BrokenPipeError):  # who asked has given up
                self.send_response(status)
                self.send_header("Content-Type", "application/json")
                self.send_header("Content-Length", str(len(data)))
                self.end_headers()
                self.wfile.write(data)

        def address_string(self) -> str:
            return "test"

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    class Server(socketserver.ThreadingUnixStreamServer):
        daemon_threads = True

    with Server(str(path), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield f"unix://{path}"
        server.shutdown()
        thread.join()


def test_an_engine_that_is_not_running_says_so(short_path: Path) -> None:
    """With its address."""
    url = f"unix://{short_path}/none.sock"
    with pytest.raises(EngineError, match=r"none\.sock .*No such file"):
        _ = Engine(url).client


def test_an_engine_that_is_too_old_says_what_is_needed(short_path: Path) -> None:
    """By the version of its interface."""
    with (
        engine_that_says(short_path / "e.sock", {"/version": (200, {"ApiVersion": "1.24"})}) as url,
        pytest.raises(EngineError, match=r"has version 1\.24, and 1\.40 is needed: install a newer engine"),
    ):
        _ = Engine(url).client


@pytest.mark.parametrize("said", [(200, b"hello"), (200, []), (200, {}), (500, {"message": "broken"})])
def test_something_else_that_answers_is_no_engine(short_path: Path, said: tuple[int, Any]) -> None:
    """Whatever it says."""
    with (
        engine_that_says(short_path / "e.sock", {"/version": said}) as url,
        pytest.raises(EngineError, match="no container engine answers at"),
    ):
        _ = Engine(url).client


def test_a_full_disk_says_what_frees_space(short_path: Path) -> None:
    """Whatever was tried."""
    full = (500, {"message": "write /var/lib/docker/tmp: no space left on device"})
    answers = {"/version": (200, {"ApiVersion": "1.41"}), "/json": full}
    with engine_that_says(short_path / "e.sock", answers) as url:
        engine = Engine(url)
        with pytest.raises(EngineError, match="disk is full: free space"), engine.asking("look") as client:
            client.inspect_container("x")
        engine.close()


def test_podman_is_known_by_its_parts(short_path: Path) -> None:
    """Its version names it."""
    said = {"ApiVersion": "1.41", "Components": [{"Name": "Podman Engine"}]}
    with engine_that_says(short_path / "e.sock", {"/version": (200, said)}) as url:
        engine = Engine(url)
        assert engine.client.api_version == "1.41"
        assert engine.is_podman
        engine.close()


def test_an_engine_that_hangs_says_what_to_look_at(short_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After the time in which any answer is expected; a look for what was left behind holds up nobody meanwhile."""
    wakes = threading.Event()
    answers = {"/version": (200, {"ApiVersion": "1.41"}), "/json": (200, wakes)}
    answers |= {"/volumes": (200, {}), "/networks": (200, [])}
    with engine_that_says(short_path / "e.sock", answers) as url:
        backend = DockerBackend(url)
        backend.check(plain_task())
        monkeypatch.setattr(backend.engine.client, "timeout", 0.2)
        with pytest.raises(EngineError, match="timed out"):
            sweep(backend.engine)
        wakes.set()
        for thread in threading.enumerate():
            if thread.name == "gem-terminal-sweep":
                thread.join()
        backend.close()
