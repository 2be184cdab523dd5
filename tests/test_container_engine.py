"""Find a container engine: where it is looked for, whether it answers, and what is said if there is none."""

from __future__ import annotations

import hashlib
import json
import socket
import threading
from pathlib import Path

import pytest

from gem_core.container_engine import engine_places, find_engine, probe
from gem_core.errors import MissingRequirementError


@pytest.fixture(autouse=True)
def _nothing_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Nothing is named but what a test names."""
    for name in ("DOCKER_HOST", "DOCKER_CONTEXT", "DOCKER_TLS_VERIFY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def write_context(folder: Path, name: str, about: object) -> None:
    """Write a context of Docker's client."""
    meta = folder / "contexts" / "meta" / hashlib.sha256(name.encode()).hexdigest()
    meta.mkdir(parents=True)
    (meta / "meta.json").write_text(json.dumps(about))


def serve_once(answer: bytes) -> str:
    """Answer one connection on this machine, and return its address as DOCKER_HOST has it."""
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with server, server.accept()[0] as connection:
            connection.recv(1024)
            connection.sendall(answer)

    threading.Thread(target=serve, daemon=True).start()
    return f"tcp://127.0.0.1:{server.getsockname()[1]}"


def test_usual_sockets_are_looked_at_in_order(tmp_path: Path) -> None:
    """Docker's, then those of Podman."""
    assert [place.url for place in engine_places()] == [
        "unix:///var/run/docker.sock",
        f"unix://{tmp_path}/podman/podman.sock",
        "unix:///run/podman/podman.sock",
    ]


def test_what_the_user_names_is_the_only_place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """DOCKER_HOST before the context of Docker's client, which may be broken."""
    write_context(tmp_path, "far", {"Endpoints": {"docker": {"Host": "ssh://far"}}})
    (tmp_path / "config.json").write_text('{"currentContext": "far"}')
    assert engine_places() == [("ssh://far", "context 'far'", "far")]
    monkeypatch.setenv("DOCKER_CONTEXT", "gone")
    assert "'gone'" in probe().advice
    monkeypatch.setenv("DOCKER_HOST", "unix:///from/variable.sock")
    assert engine_places() == [("unix:///from/variable.sock", "DOCKER_HOST", "")]


@pytest.mark.parametrize(
    ("answer", "status"),
    [
        (b'HTTP/1.0 200 OK\r\n\r\n{"ApiVersion": "1.41"}', "met"),
        (b"HTTP/1.0 200 OK\r\n\r\nhello", "unmet"),
        (b"SSH-2.0", "unmet"),
    ],
)
def test_engine_is_asked_whether_it_answers(answer: bytes, status: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A closer look than ``make`` takes, which believes DOCKER_HOST."""
    monkeypatch.setenv("DOCKER_HOST", serve_once(answer))
    assert probe().status == "met"
    assert probe(closely=True).status == status


@pytest.mark.parametrize(
    ("host", "status", "advice"),
    [
        ("unix:///nowhere/none.sock", "unmet", "start it"),
        ("tcp://127.0.0.1:1", "unmet", "start it"),
        ("tcp://no-port-at-all:x", "unmet", "'x'"),
        ("ssh://somebody@engine", "untried", ""),
        ("nonsense", "untried", ""),
    ],
)
def test_odd_docker_hosts_are_no_traceback(
    host: str, status: str, advice: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever stands in the variable; what is reached by ssh is not tried."""
    monkeypatch.setenv("DOCKER_HOST", host)
    found = probe(closely=True)
    assert found.status == status
    assert advice in found.advice


def test_no_engine_at_all_says_how_to_start_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the places that were looked at."""
    monkeypatch.setattr("os.path.lexists", lambda _: False)
    assert probe().status == probe(closely=True).status == "unmet"
    with pytest.raises(MissingRequirementError) as caught:
        find_engine()
    assert "/var/run/docker.sock" in str(caught.value)
    assert "Install and start Docker" in str(caught.value)
