"""Machines of several containers: their private network, volumes, healthchecks, and what goes wrong with them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from docker_machines import DOCKERFILE, SMALL, backend, make_task, needs_engine, ready, run_label, say

from gem_terminal.errors import MachineError, MachineLostError, TaskError
from gem_terminal.tasks.task import Container

if TYPE_CHECKING:
    from pathlib import Path

    from gem_terminal.backends.docker.backend import DockerBackend

__all__ = ["backend", "run_label"]
pytestmark = needs_engine
ASK = "import urllib.request as u; print(u.urlopen('http://web:8080/greeting').read().decode(), end='')"


def test_services_are_reached_by_name_and_share_volumes(backend: DockerBackend, tmp_path: Path) -> None:
    """They are ready when the machine is, on a network that leads nowhere else."""
    web = Container(
        context=tmp_path,
        command=("sh", "-c", "echo from-web > /shared/file; exec python3 -m http.server 8080"),
        healthcheck=ready("python3", "-c", ASK.replace("web", "127.0.0.1")),
        volumes={"data": "/shared"},
    )
    main = Container(context=tmp_path, volumes={"data": "/mnt/data"}, env={"KEY": "value"})
    task = make_task(tmp_path, dockerfile=DOCKERFILE, main=main, services={"web": web})
    with backend.start(task, SMALL) as machine:
        assert say(machine, f'python3 -c "{ASK}"; cat /mnt/data/file; echo $KEY') == "hello\nfrom-web\nvalue\n"
        outside = "import socket; socket.create_connection(('192.0.2.1', 80), 3)"
        assert machine.run(["python3", "-c", outside], timeout_s=30).exit_code == 1


def test_the_host_is_not_on_the_private_network(backend: DockerBackend, tmp_path: Path) -> None:
    """No address of the network is the host's, on which it would offer its own servers."""
    task = make_task(tmp_path, services={"web": Container(context=tmp_path, command=("sleep", "1000"))})
    with backend.start(task, SMALL) as machine:
        name = f"{machine.id}-net"
        about = backend.engine.client.inspect_network(name)
        gateway = about["IPAM"]["Config"][0].get("Gateway", "")
        assert about["Internal"] is True
        if gateway:
            reach = f"import socket; socket.create_connection(('{gateway}', 22), 3)"
            done = machine.run(["python3", "-c", reach], timeout_s=30)
            assert b"refused" not in done.output, "something answered there"


def test_a_service_that_is_not_ready_is_named(backend: DockerBackend, tmp_path: Path) -> None:
    """With what its healthcheck said, and nothing is left of the machine."""
    ill = Container(
        context=tmp_path, command=("sleep", "100"), healthcheck=ready("sh", "-c", "echo ill; exit 7", retries=2)
    )
    task = make_task(tmp_path, services={"ill": ill})
    with pytest.raises(MachineLostError, match=r"not ready after 2 tries of .*exit code 7 ill") as caught:
        backend.start(task, SMALL)
    assert caught.value.by_agent is False


def test_a_service_that_ends_is_named(backend: DockerBackend, tmp_path: Path) -> None:
    """Before it was ready, with its exit code."""
    dead = Container(context=tmp_path, command=("sh", "-c", "exit 3"), healthcheck=ready("false"))
    task = make_task(tmp_path, services={"dead": dead})
    with pytest.raises(MachineError, match=r"'dead' ended|is not running"):
        backend.start(task, SMALL)


def test_a_network_of_some_hosts_is_refused(backend: DockerBackend, tmp_path: Path) -> None:
    """With what to choose instead, and another choice runs."""
    task = make_task(tmp_path, network="allowlist")
    with pytest.raises(TaskError, match="choose network='none' or network='public'"):
        backend.start(task, SMALL)


def test_a_task_that_asks_for_what_is_not_there_is_refused(backend: DockerBackend, tmp_path: Path) -> None:
    """Before anything is started."""
    task = make_task(tmp_path)
    object.__setattr__(task.environment, "unsupported", ("a graphics card",))
    with pytest.raises(TaskError, match="asks for what no engine here has: a graphics card"):
        backend.check(task)
