"""Find a container engine: where it is looked for, and what is said if there is none."""

from __future__ import annotations

import hashlib
import json
import socket
from pathlib import Path

import pytest

from gem_core.errors import MissingRequirementError
from gem_tools.container_engine import engine_places, find_engine, probe


@pytest.fixture(autouse=True)
def _nothing_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Nothing is named but what a test names."""
    for name in ("DOCKER_HOST", "DOCKER_CONTEXT", "DOCKER_TLS_VERIFY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def test_usual_sockets_are_looked_at_in_order(tmp_path: Path) -> None:
    """Docker's, then those of Podman."""
    assert [place.url for place in engine_places()] == [
        "unix:///var/run/docker.sock",
        f"unix://{tmp_path}/podman/podman.sock",
        "unix:///run/podman/podman.sock",
    ]


def test_what_the_user_names_is_the_only_place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """DOCKER_HOST before the context of Docker's client, which may be broken."""
    meta = tmp_path / "contexts" / "meta" / hashlib.sha256(b"far").hexdigest()
    meta.mkdir(parents=True)
    (meta / "meta.json").write_text('{"Endpoints": {"docker": {"Host": "ssh://far"}}}')
    (tmp_path / "config.json").write_text(json.dumps({"currentContext": "far"}))
    assert engine_places() == [("ssh://far", "context 'far'", "far")]
    monkeypatch.setenv("DOCKER_CONTEXT", "gone")
    assert "'gone'" in probe().advice
    monkeypatch.setenv("DOCKER_HOST", "unix:///from/variable.sock")
    assert engine_places() == [("unix:///from/variable.sock", "DOCKER_HOST", "")]


@pytest.mark.parametrize(
    ("host", "status", "advice"),
    [
        ("unix:///nowhere/none.sock", "unmet", "No such file"),
        ("tcp://127.0.0.1:1", "unmet", "systemctl start docker"),
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
    assert probe().status == status
    assert advice in probe().advice


def test_first_place_that_answers_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of several; none of them is an error that names each."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        there = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        monkeypatch.setenv("DOCKER_HOST", there)
        assert find_engine().url == there
        assert probe().status == "met"
    monkeypatch.setenv("DOCKER_HOST", "")
    monkeypatch.setattr("socket.socket.connect", lambda *_: (_ for _ in ()).throw(ConnectionRefusedError("refused")))
    with pytest.raises(MissingRequirementError) as caught:
        find_engine()
    assert "/var/run/docker.sock" in str(caught.value)
    assert "podman.sock" in str(caught.value)
