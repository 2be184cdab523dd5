"""The levels of isolation: which is taken, what is said of it, and what happens where it cannot be had."""

from __future__ import annotations

import itertools
import os
import stat
from pathlib import Path

import pytest
from python_levels import why_not

from gem_core.docs import page_url
from gem_core.errors import MissingRequirementError
from gem_tools.python import Pool, levels, starting
from gem_tools.python import docker as docker_words
from gem_tools.python.inside import syscalls
from gem_tools.python.status import status


def install(folder: Path, name: str, text: str) -> None:
    """Write a program."""
    program = folder / name
    program.write_text(text, "utf-8")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)


def test_the_strongest_level_that_works_is_taken() -> None:
    """And it is the one that calls say they ran in."""
    pool = Pool(num_workers=1)
    try:
        level = pool.start()
        assert level == next(each for each in levels.LEVELS if each == pool.level)
        assert pool.run("").sandbox == level
        if why_not("bubblewrap") is None:
            assert level == "bubblewrap"
    finally:
        pool.close()


def test_a_level_that_is_missing_is_an_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Which says what to install; nothing weaker is taken."""
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingRequirementError) as caught:
        Pool("bubblewrap", num_workers=1).run("")
    assert str(caught.value) == (
        "the Python sandbox 'bubblewrap' cannot run here: bubblewrap is not on the PATH: "
        f"install the package 'bubblewrap' of your system. See {page_url('python-tool/#levels')}"
    )
    with pytest.raises(MissingRequirementError) as caught:
        Pool("docker", num_workers=1).run("")
    assert "install Docker's client and start an engine" in str(caught.value)


def test_without_the_stronger_ones_auto_takes_the_next_and_says_why(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """In what ``gem doctor`` shows."""
    reason = why_not("process")
    if reason is not None:
        pytest.skip(reason)
    monkeypatch.setenv("PATH", str(tmp_path))
    facts = status()
    assert facts["sandbox"].startswith("process (each call as a user of its own)" if os.geteuid() == 0 else "process (")
    assert "Landlock" in facts["files"]
    assert facts["not bubblewrap"].startswith("bubblewrap is not on the PATH")
    assert facts["not docker"].startswith("the command 'docker' is not on the PATH")


def test_auto_does_not_come_down_to_process_in_silence(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """It warns once, in the log; a level that was named needs no warning."""
    reason = why_not("process")
    if reason is not None:
        pytest.skip(reason)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(starting, "_warned", [])
    for sandbox, expected in (("process", 0), ("auto", 1), ("auto", 0)):
        pool = Pool(sandbox, num_workers=1)
        caplog.clear()
        pool.start()
        pool.close()
        told = [text for text in caplog.messages if "weakest level" in text]
        assert len(told) == expected
        assert all(text.startswith("gem: Python code of agents runs on the weakest level, 'process'") for text in told)
        assert all("install the package 'bubblewrap'" in text for text in told)


def test_a_bubblewrap_that_fails_is_passed_over(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As in a container that allows no namespaces; what it said is told."""
    install(tmp_path, "bwrap", "#!/bin/sh\necho 'bwrap: No permissions to create new namespace' >&2\nexit 1\n")
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(MissingRequirementError) as caught:
        Pool("bubblewrap", num_workers=1).run("")
    assert "No permissions to create new namespace" in str(caught.value)
    assert "Allow unprivileged user namespaces" in str(caught.value)
    if why_not("process") is None:
        pool = Pool(num_workers=1)
        pool.start()
        assert "bubblewrap" in pool.passed_over
        pool.close()


def test_a_container_is_closed_off_by_the_options_that_it_is_started_with() -> None:
    """The image is never pulled, nothing is reached, and few rights are left."""
    words = docker_words.run_words("name", "image:1", {}, ["python3"], folder_mb=1, folder_files=1)
    pairs = [*itertools.pairwise(words)]
    assert {"--rm", "--read-only"} <= set(words)
    assert {("--network", "none"), ("--cap-drop", "ALL"), ("--pull", "never"), ("--memory", "4096m")} <= {*pairs}
    assert ("--security-opt", "no-new-privileges") in pairs
    assert [right for word, right in pairs if word == "--cap-add"] == [*docker_words.POWERS]


# The filter of system calls.


def run_filter(program: list[syscalls.Instruction], number: int, arch: int, arguments: tuple[int, ...] = ()) -> int:
    """Do what the kernel does with a filter: return what it says of one system call."""
    words = {0: number, 4: arch, **{16 + 8 * i: value & 0xFFFFFFFF for i, value in enumerate(arguments)}}
    accumulator, place = 0, 0
    while True:
        code, jump_true, jump_false, constant = program[place]
        place += 1
        if code == 0x06:
            return constant
        if code == 0x20:
            accumulator = words.get(constant, 0)
        else:
            holds = {
                0x15: accumulator == constant,
                0x35: accumulator >= constant,
                0x45: bool(accumulator & constant),
            }[code]
            place += jump_true if holds else jump_false


ALLOW, REFUSE, NOT_THERE, KILL = 0x7FFF0000, 0x00050001, 0x00050026, 0x80000000
NOTHING, NOT_SUPPORTED, NO_IOCTL = 0x00050000, 0x0005005F, 0x00050019


@pytest.mark.parametrize("name", sorted(syscalls.MACHINES))
@pytest.mark.parametrize("own_pid", [None, 77])
@pytest.mark.parametrize("sockets", [True, False])
def test_the_filter_refuses_what_it_should_and_nothing_else(name: str, own_pid: int | None, sockets: bool) -> None:
    """On each processor; other processors' calls end the process."""
    machine = syscalls.MACHINES[name]
    program = syscalls.program(machine, sockets=sockets, own_pid=own_pid)
    assert len(program) < 250
    special = {machine.clone, machine.clone3, machine.timer_create, machine.socket, machine.socketpair}
    special |= {machine.connect, machine.bind, machine.utimensat}
    special |= {machine.fcntl, machine.ioctl, *machine.signalling, *machine.priorities, syscalls.PIDFD_SEND_SIGNAL}
    for number in range(480):
        if number in machine.denied:
            assert run_filter(program, number, machine.arch) == REFUSE, number
        elif own_pid is not None and number in machine.owning:
            assert run_filter(program, number, machine.arch) == NOTHING, number
        elif own_pid is not None and number in machine.attributes:
            assert run_filter(program, number, machine.arch) == NOT_SUPPORTED, number
        elif number not in special:
            assert run_filter(program, number, machine.arch) == ALLOW, number
    assert run_filter(program, 0, machine.arch ^ 1) == KILL
    for number in (machine.clone3, machine.timer_create):
        assert run_filter(program, number, machine.arch) == NOT_THERE
    assert run_filter(program, machine.clone, machine.arch, (17,)) == ALLOW
    assert run_filter(program, machine.clone, machine.arch, (0x10000000 | 17,)) == REFUSE
    if machine.x32:
        assert run_filter(program, 0x40000000 | 101, machine.arch) == REFUSE


@pytest.mark.parametrize("name", sorted(syscalls.MACHINES))
@pytest.mark.parametrize("sockets", [True, False])
def test_the_filter_looks_at_the_family_and_the_type_of_sockets(name: str, sockets: bool) -> None:
    """Those that reach out of a network namespace are refused everywhere; those with addresses where it matters."""
    machine = syscalls.MACHINES[name]
    program = syscalls.program(machine, sockets=sockets, own_pid=None)
    for family, allowed in (
        (1, True),
        (2, sockets),
        (10, sockets),
        (16, sockets),
        (17, False),
        (38, False),
        (40, False),
    ):
        assert run_filter(program, machine.socket, machine.arch, (family, 1)) == (ALLOW if allowed else REFUSE), family
    for call in (machine.socket, machine.socketpair):
        for kind in (1, 5, 1 | 0o2004000):
            assert run_filter(program, call, machine.arch, (1, kind)) == ALLOW
        for kind in (2, 3, 2 | 0o2004000):
            assert run_filter(program, call, machine.arch, (1, kind)) == (ALLOW if sockets else REFUSE)
    for number in (machine.connect, machine.bind):
        assert run_filter(program, number, machine.arch) == (ALLOW if sockets else REFUSE)


@pytest.mark.parametrize("name", sorted(syscalls.MACHINES))
@pytest.mark.parametrize("own_pid", [None, 77])
def test_the_filter_keeps_code_off_other_processes(name: str, own_pid: int | None) -> None:
    """By signals, limits, priorities, and the owners of files; where they are out of sight anyway it lets all pass."""
    machine = syscalls.MACHINES[name]
    program = syscalls.program(machine, sockets=False, own_pid=own_pid)
    others = ALLOW if own_pid is None else REFUSE
    for number in machine.signalling:
        for own in (77, 0):
            assert run_filter(program, number, machine.arch, (own,)) == ALLOW
        for other in (1, 78, -1, -77):
            assert run_filter(program, number, machine.arch, (other,)) == others
    for number in (*machine.priorities, syscalls.PIDFD_SEND_SIGNAL):
        assert run_filter(program, number, machine.arch, (2, 0)) == others
    for command, allowed in ((8, others), (10, others), (15, others), (1, ALLOW), (4, ALLOW), (1030, ALLOW)):
        assert run_filter(program, machine.fcntl, machine.arch, (0, command)) == allowed
    for path, times, result in ((1, 0, REFUSE), (0, 0, NOTHING), (1, 1, NOTHING), (0, 1, NOTHING)):
        expected = ALLOW if own_pid is None else result
        assert run_filter(program, machine.utimensat, machine.arch, (0, path, times)) == expected
    for command, allowed in ((0x8901, others), (0x8902, others), (0x541B, ALLOW), (0x5401, ALLOW), (0x8927, ALLOW)):
        assert run_filter(program, machine.ioctl, machine.arch, (0, command)) == allowed
    for command in (0x40086602, 0x40087602, 0x40806685, 0x5000940F, 0, 0x53FF, 0x5500, 0x88FF, 0x8A00):
        assert run_filter(program, machine.ioctl, machine.arch, (0, command)) == (
            ALLOW if own_pid is None else NO_IOCTL
        )


def test_the_filter_is_in_force_here() -> None:
    """On the processors that it knows."""
    pool = Pool(num_workers=1)
    try:
        pool.start()
        assert pool.chosen is not None
        assert pool.chosen.ready["filtered"] is (syscalls.platform.machine() in syscalls.MACHINES)
    finally:
        pool.close()
