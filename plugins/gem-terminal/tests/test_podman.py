"""Machines from Podman, by its socket of Docker's kind: run where one is there."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import docker
import pytest
from docker_machines import BASE, SMALL, make_task, say

from gem_terminal.backends.docker.backend import DockerBackend
from gem_terminal.backends.docker.engine import Engine
from gem_terminal.backends.docker.sweeping import RUN
from gem_terminal.errors import EngineError


def socket() -> str:
    """Return the address that GEM_TERMINAL_PODMAN names, else that of the usual place that is there."""
    places = [f"{os.environ.get('XDG_RUNTIME_DIR', '/nowhere')}/podman/podman.sock", "/run/podman/podman.sock"]
    there = [f"unix://{place}" for place in places if Path(place).exists()]
    return os.environ.get("GEM_TERMINAL_PODMAN") or (there[0] if there else "")


def why_not() -> str:
    """Return why there is no Podman to test with; empty where there is one."""
    if not socket():
        return "no socket of Podman: 'podman system service -t 0 ADDRESS', and GEM_TERMINAL_PODMAN=ADDRESS"
    engine = Engine(socket())
    try:
        engine.client.inspect_image(BASE)
    except EngineError as error:
        return f"no Podman: {error}"
    except docker.errors.NotFound:
        return f"Podman has no image {BASE!r}: 'podman load' it, or name one with GEM_TERMINAL_BASE_IMAGE"
    finally:
        engine.close()
    return ""


pytestmark = pytest.mark.skipif(bool(why_not()), reason=why_not())


@pytest.fixture
def backend(monkeypatch: pytest.MonkeyPatch) -> Iterator[DockerBackend]:
    """Return a backend that finds nothing of its own in the end, but images."""
    run = f"test-podman-{os.getpid()}"
    monkeypatch.setenv("GEM_TERMINAL_RUN", run)
    made = DockerBackend(socket(), build_args={"BASE": BASE})
    assert made.engine.client
    assert made.engine.is_podman
    yield made
    names = sorted(made.images.built)
    made.close()
    client = Engine(socket()).client
    for name in names:
        client.remove_image(name, force=True)
    wanted = {"label": f"{RUN}={run}"}
    assert client.containers(all=True, filters=wanted) == []
    assert client.networks(filters=wanted) == []
    client.close()


def test_podman_runs_machines_and_their_terminals(backend: DockerBackend, tmp_path: Path) -> None:
    """What is left running is seen."""
    with backend.start(make_task(tmp_path), SMALL) as machine:
        assert say(machine, "cat greeting; id -u") == "hello\n0\n"
        assert machine.processes() == []
        with contextlib.closing(machine.open_terminal(["sh", "-c", "echo shown; sleep 1000"])) as terminal:
            seen = b""
            while b"shown" not in seen:
                seen += terminal.read(10.0)
            assert [process.command for process in machine.processes()][-1] == "sleep 1000"
        assert machine.why_lost() is None
