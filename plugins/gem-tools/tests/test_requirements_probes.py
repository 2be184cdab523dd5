"""Whether there is a container engine, and bubblewrap, as ``gem doctor`` and ``make`` ask."""

from __future__ import annotations

import os
import socket
import threading
from pathlib import Path

import pytest

from gem_tools.requirements import bubblewrap, docker


def test_docker_host_meets_docker(monkeypatch: pytest.MonkeyPatch) -> None:
    """An engine elsewhere, named by DOCKER_HOST, is an engine."""
    monkeypatch.setenv("DOCKER_HOST", "tcp://engine:2375")
    assert docker("").status == "met"


def serve_once(answer: bytes) -> str:
    """Answer one connection on this machine, and return its address as DOCKER_HOST has it."""
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with server, server.accept()[0] as connection:
            connection.recv(1024)
            connection.sendall(answer)

    threading.Thread(target=serve, daemon=True).start()
    return f"tcp://127.0.0.1:{server.getsockname()[1]}"


@pytest.mark.parametrize(
    ("answer", "status", "detail"),
    [
        (b"HTTP/1.0 200 OK\r\n\r\nOK", "met", "the engine answers"),
        (b"SSH-2.0", "unmet", "what listens there is no container engine"),
    ],
)
def test_engine_is_asked_whether_it_answers(
    answer: bytes, status: str, detail: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A closer look than ``make`` takes, which believes DOCKER_HOST."""
    monkeypatch.delenv("DOCKER_TLS_VERIFY", raising=False)
    monkeypatch.setenv("DOCKER_HOST", serve_once(answer))
    finding = docker("", closely=True)
    assert (finding.status, finding.detail) == (status, detail)


def test_engine_that_is_down_is_unmet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A socket that nobody listens to."""
    monkeypatch.setenv("DOCKER_HOST", f"unix://{tmp_path}/none.sock")
    finding = docker("", closely=True)
    assert (finding.status, finding.detail) == ("unmet", "the engine cannot be reached (FileNotFoundError)")
    assert finding.advice == "start the container engine"


@pytest.mark.parametrize(
    ("host", "status"),
    [("ssh://somebody@engine", "untried"), ("tcp://no-port-at-all:x", "unmet"), ("nonsense", "untried")],
)
def test_odd_docker_hosts_are_no_traceback(host: str, status: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever stands in the variable."""
    monkeypatch.delenv("DOCKER_TLS_VERIFY", raising=False)
    monkeypatch.setenv("DOCKER_HOST", host)
    assert docker("", closely=True).status == status


@pytest.mark.parametrize(
    ("script", "status", "detail"),
    [
        ("#!/bin/sh\nexit 0\n", "met", "a sandbox starts"),
        ("#!/bin/sh\necho 'bwrap: no permission' >&2\nexit 1\n", "unmet", "it fails: bwrap: no permission"),
    ],
)
def test_bubblewrap_is_tried(
    script: str, status: str, detail: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Being on the PATH is not enough: many systems refuse user namespaces."""
    bwrap = tmp_path / "bwrap"
    bwrap.write_text(script)
    bwrap.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    finding = bubblewrap("", closely=True)
    assert (finding.status, finding.detail) == (status, detail)
