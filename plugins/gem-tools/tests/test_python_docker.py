"""The level ``docker`` on a real engine: what becomes of its containers, whatever ends them or whoever started them.

The attacks of ``test_python_attacks_*`` are tried in containers as well. ``scripts/docker_engine.sh`` starts an engine.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest
from python_levels import docker, image, pool_of, until

from gem_core.errors import MissingRequirementError
from gem_tools.python import Limits, Pool, SandboxError, sandbox
from gem_tools.python import docker as containers

pytestmark = pytest.mark.thorough

PARENT = """
import sys, threading
from gem_tools.python import Limits, Pool
pool = Pool("docker", num_workers=2, image=sys.argv[1])
pool.start()
endless = ("while True: pass",), {"limits": Limits(wall_s=600)}
threading.Thread(target=pool.run, args=endless[0], kwargs=endless[1], daemon=True).start()
print(*[cell.launch.container for cell in pool.cells], flush=True)
try:
    threading.Event().wait()
except KeyboardInterrupt:
    pass
"""


@pytest.fixture
def running() -> Iterator[Pool]:
    """A pool of one container."""
    found = pool_of("docker")
    yield found
    found.close()


def names(*filters: str) -> list[str]:
    """Return the containers of the engine with a name or a label."""
    words = [word for each in filters for word in ("--filter", each)]
    return docker("ps", "--all", "--format", "{{.Names}}", *words).stdout.split()


def container(of: Pool) -> str:
    """Return the name of a pool's container."""
    name = of.cells[0].launch.container
    assert name is not None
    return name


def gone(name: str) -> bool:
    """Whether a container is no more, also among those that have ended."""
    return until(lambda: not names(f"name={name}"))


def test_code_yields_the_processor_to_the_watch_over_its_limits() -> None:
    """Many processes of one call would else hold up the only process that looks at their memory."""
    assert pool_of("docker").run("import os; os.getpriority(os.PRIO_PROCESS, 0)", value=True).value == "19"


def test_nothing_can_be_written_but_the_folder(running: Pool) -> None:
    """So that no call finds what another has left: not in the shared memory of a container, nor beside its folder."""
    code = """
import os
found = []
for top, folders, _ in os.walk("/"):
    if top == os.getcwd() or top.startswith(("/proc/", "/sys/")):
        folders.clear()
    elif os.access(top, os.W_OK):
        found.append(top)
print(found)
"""
    assert running.run(code).stdout == "[]\n"


def test_the_environment_is_empty(running: Pool) -> None:
    """What the image, or the client's configuration, sets is not there."""
    outcome = running.run("import os\nprint({'HOSTNAME', 'container'} & {*os.environ}, 'PYTHONHASHSEED' in os.environ)")
    assert outcome.stdout == "set() True\n"


def test_no_container_after_close(running: Pool) -> None:
    """Also when a call runs, as soon as it returns."""
    name = container(running)
    session = running.session(Limits(wall_s=600))
    session.run("1")
    running.close()
    assert names(f"name={name}") == []


def test_a_container_that_hangs_is_removed(running: Pool, monkeypatch: pytest.MonkeyPatch) -> None:
    """One whose processes do not see that their input has ended."""
    monkeypatch.setattr(sandbox, "END_S", 0.2)
    name = container(running)
    assert docker("pause", name).returncode == 0
    running.close()
    assert names(f"name={name}") == []


@pytest.mark.parametrize("what", ["container", "client"])
def test_a_container_is_killed_in_the_middle(running: Pool, what: str) -> None:
    """The call fails as the machine's fault; the next has a new container, and the old one is gone."""
    name = container(running)
    errors: list[SandboxError] = []

    def call() -> None:
        try:
            running.run("while True: pass", limits=Limits(wall_s=600))
        except SandboxError as error:
            errors.append(error)

    thread = threading.Thread(target=call)
    thread.start()
    assert until(lambda: running.cells[0].answer is not None)
    if what == "container":
        docker("kill", name)
    else:
        process = running.cells[0].process
        assert process is not None
        process.kill()
    thread.join()
    assert [str(error).partition(":")[0] for error in errors] == ["the sandbox was lost"]
    assert running.run("print(1)").stdout == "1\n"
    assert gone(name)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_container_after_the_parent(number: signal.Signals) -> None:
    """Whether it may clean up or not."""
    pool_of("docker").close()
    process = subprocess.Popen([sys.executable, "-c", PARENT, str(image())], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        started = process.stdout.readline().split()
        assert started
        process.send_signal(number)
        process.wait(60)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
    for name in started:
        assert gone(name)


def test_a_container_that_never_started_is_removed_by_a_later_start(
    running: Pool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its client was killed in between; those that run, and those of others, stay."""
    monkeypatch.setattr(containers, "_LEFT_FOR", "0s")
    found = {"ours": containers.LABEL, "another": "gem-tools=other"}
    for what, label in found.items():
        found[what] = containers.new_name()
        done = docker("create", "--network", "none", "--name", found[what], "--label", label, str(image()), "true")
        assert done.returncode == 0, done.stderr
    try:
        # As each start does; the engine counts whole seconds.
        assert until(lambda: containers.check(str(image())) or not names(f"name={found['ours']}"))
        assert [what for what, name in found.items() if names(f"name={name}")] == ["another"]
        assert running.run("1", value=True).value == "1"
    finally:
        docker("rm", "--force", *found.values())


def test_an_image_that_is_missing(running: Pool) -> None:
    """Is told with what to do, though another image works."""
    with pytest.raises(MissingRequirementError) as caught:
        Pool("docker", num_workers=1, image="gem/not-there:1").run("")
    assert "the image 'gem/not-there:1' is not there: 'docker pull gem/not-there:1'" in str(caught.value)


def test_an_engine_that_does_not_answer(running: Pool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Is told so, and not as an image that is missing."""
    monkeypatch.setenv("DOCKER_HOST", "unix:///nonexistent/docker.sock")
    with pytest.raises(MissingRequirementError) as caught:
        Pool("docker", num_workers=1, image=image()).run("")
    assert "the container engine does not answer: " in str(caught.value)
    assert "unix:///nonexistent/docker.sock" in str(caught.value)
