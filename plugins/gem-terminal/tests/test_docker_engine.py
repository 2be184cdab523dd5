"""The connection to an engine, and what is said when that is not what it should be."""

from __future__ import annotations

import json
import socketserver
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
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
def engine_that_says(path: Path, version: tuple[int, Any], **answers: tuple[int, Any]) -> Iterator[str]:
    """Give the address of a server that answers to paths by their ends; an event is waited for before the answer."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            end = self.path.partition("?")[0].rpartition("/")[2]
            status, body = ({"version": version} | answers).get(end, (404, {"message": "page not found"}))
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

    with Server(str(path / "e.sock"), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield f"unix://{path}/e.sock"
        server.shutdown()
        thread.join()


GOOD = (200, {"ApiVersion": "1.41"})


@pytest.mark.parametrize("version", [(200, {"ApiVersion": "1.24"}), (200, b"hello"), (200, []), (200, {}), (500, {})])
def test_what_is_no_engine_or_too_old_says_so(short_path: Path, version: tuple[int, Any]) -> None:
    """Whatever it answers."""
    said = r"1\.24, and 1\.40 is needed" if "1.24" in str(version) else "no container engine answers"
    with engine_that_says(short_path, version) as url, pytest.raises(EngineError, match=said):
        _ = Engine(url).client
    with pytest.raises(EngineError, match=r"none\.sock"):
        _ = Engine(f"unix://{short_path}/none.sock").client


def test_a_full_disk_says_what_frees_space(short_path: Path) -> None:
    """Whatever was tried."""
    full = (500, {"message": "write /var/lib/docker/tmp: no space left on device"})
    with (
        engine_that_says(short_path, GOOD, json=full) as url,
        closing(Engine(url)) as engine,
        pytest.raises(EngineError, match="free space"),
        engine.asking("look") as client,
    ):
        client.inspect_container("x")


def test_podman_is_known_by_its_parts(short_path: Path) -> None:
    """Its version names it."""
    said = {"ApiVersion": "1.41", "Components": [{"Name": "Podman Engine"}]}
    with engine_that_says(short_path, (200, said)) as url, closing(Engine(url)) as engine:
        assert (engine.client.api_version, engine.is_podman) == ("1.41", True)


def test_an_engine_that_hangs_says_what_to_look_at(short_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After the time in which any answer is expected; a look for what was left behind holds up nobody meanwhile."""
    wakes = threading.Event()
    answers = {"json": (200, wakes), "volumes": (200, {}), "networks": (200, [])}
    with engine_that_says(short_path, GOOD, **answers) as url, closing(DockerBackend(url)) as backend:
        backend.check(plain_task())
        monkeypatch.setattr(backend.engine.client, "timeout", 0.2)
        with pytest.raises(EngineError):
            sweep(backend.engine)
        wakes.set()
        for thread in threading.enumerate():
            if thread.name == "gem-terminal-sweep":
                thread.join()
