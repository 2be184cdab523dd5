"""Machines of several containers: their private network, volumes, healthchecks, and what goes wrong with them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from docker_machines import SMALL, backend, make_task, needs_engine, run_label, say

from gem_terminal.errors import MachineError, TaskError
from gem_terminal.tasks.task import Container, Healthcheck

if TYPE_CHECKING:
    from pathlib import Path

    from gem_terminal.backends.docker.backend import DockerBackend

__all__ = ["backend", "run_label"]
pytestmark = needs_engine
ASK = "import urllib.request as u; print(u.urlopen('http://web:8080/greeting').read().decode(), end='')"


def ready(*command: str, retries: int = 50) -> Healthcheck:
    """Return a healthcheck that tries often."""
    return Healthcheck(command, interval_s=0.05, timeout_s=10, retries=retries)


def test_services_are_reached_by_name_and_share_volumes(backend: DockerBackend, tmp_path: Path) -> None:
    """They are ready when the machine is, on a network that leads nowhere else, nor to the host's own servers."""
    web = Container(
        context=tmp_path,
        command=("sh", "-c", "echo from-web > /shared/file; exec python3 -m http.server 8080"),
        healthcheck=ready("python3", "-c", ASK.replace("web", "127.0.0.1")),
        volumes={"data": "/shared"},
    )
    main = Container(context=tmp_path, volumes={"data": "/mnt/data"}, env={"KEY": "value"})
    with backend.start(make_task(tmp_path, main=main, services={"web": web}), SMALL) as machine:
        assert say(machine, f'python3 -c "{ASK}"; cat /mnt/data/file; echo $KEY') == "hello\nfrom-web\nvalue\n"
        about = backend.engine.client.inspect_network(f"{machine.id}-net")
        assert about["Internal"] is True
        for host, port in (("192.0.2.1", 80), (about["IPAM"]["Config"][0].get("Gateway") or "192.0.2.1", 22)):
            reach = f"import socket; socket.create_connection(('{host}', {port}), 3)"
            done = machine.run(["python3", "-c", reach], timeout_s=30)
            assert (done.exit_code, b"refused" in done.output) == (1, False), "something answered there"


@pytest.mark.parametrize(
    ("command", "check", "said"),
    [
        (("sleep", "100"), ready("sh", "-c", "echo ill; exit 7", retries=2), "after 2 tries of .*exit code 7 ill"),
        (("sh", "-c", "exit 3"), ready("false"), "'one' ended|is not running"),
    ],
)
def test_a_service_that_does_not_get_ready_is_named(
    backend: DockerBackend, tmp_path: Path, command: Any, check: Healthcheck, said: str
) -> None:
    """With what its healthcheck said or that it ended, and nothing is left of the machine."""
    one = Container(context=tmp_path, command=command, healthcheck=check)
    with pytest.raises(MachineError, match=said):
        backend.start(make_task(tmp_path, services={"one": one}), SMALL)


def test_what_an_engine_does_not_have_is_refused(backend: DockerBackend, tmp_path: Path) -> None:
    """With what to choose instead, before anything is started."""
    with pytest.raises(TaskError, match="network='none' or network='public'"):
        backend.start(make_task(tmp_path, network="allowlist"), SMALL)
    with pytest.raises(TaskError, match="a graphics card"):
        backend.check(make_task(tmp_path, unsupported=("a graphics card",)))
