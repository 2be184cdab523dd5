"""Machines of the backend ``local``: programs, terminals, files, processes and limits, in real sandboxes."""

from __future__ import annotations

import io
import os
import re
import tarfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from local_sandboxes import backend, left_running, machine, scratch, shell, wait_for, write_task

from gem_terminal.backends.interface import Limits
from gem_terminal.errors import EngineError, MachineLostError, TaskError

if TYPE_CHECKING:
    from gem_terminal.backends.local.backend import LocalBackend
    from gem_terminal.backends.local.machine import LocalMachine
    from gem_terminal.backends.local.terminal import LocalTerminal

__all__ = ["backend", "machine", "scratch"]


def read_until(terminal: LocalTerminal, words: bytes, timeout_s: float = 20.0) -> bytes:
    """Return what a terminal shows, up to some words."""
    deadline = time.monotonic() + timeout_s
    seen = b""
    while words not in seen:
        assert time.monotonic() < deadline, seen
        seen += terminal.read(0.5)
    return seen


def test_run_returns_the_exit_code_and_what_was_written(machine: LocalMachine) -> None:
    done = machine.run(["sh", "-c", "echo out; echo err >&2; exit 3"], timeout_s=30)
    assert (done.exit_code, done.output, done.dropped) == (3, b"out\nerr\n", 0)


@pytest.mark.parametrize(("command", "code"), [(["sh", "-c", "kill -TERM $$"], 143), (["no-such-program"], 127)])
def test_run_tells_a_signal_and_what_is_not_there(machine: LocalMachine, command: list[str], code: int) -> None:
    assert machine.run(command, timeout_s=30).exit_code == code


def test_run_has_no_input_and_the_environment_that_was_asked_for(machine: LocalMachine) -> None:
    done = machine.run(["sh", "-c", "cat; echo $WORD $PWD $HOME"], env={"WORD": "hello"}, workdir="/tmp", timeout_s=30)
    assert done.output == b"hello /tmp /root\n"


def test_nothing_of_the_host_shows(machine: LocalMachine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Neither its environment nor its files, processes, or network, though the backend's own process has them."""
    (tmp_path / "secret").write_text("secret", "utf-8")
    shell(machine, f"! cat {tmp_path}/secret")
    assert shell(machine, "ls -A /home /root /tmp") == "/home:\n\n/root:\n\n/tmp:\n"
    names = set(re.findall(r"^(\w+)=", shell(machine, "env"), re.MULTILINE))
    assert names <= {"PATH", "HOME", "LANG", "HOSTNAME", "LD_LIBRARY_PATH", "PWD", "OLDPWD", "SHLVL", "_"}
    assert shell(machine, "cut -d: -f1 /proc/net/dev | tail -n +3 | tr -d ' '") == "lo\n"
    assert not os.path.exists(f"/proc/{os.getpid()}/./root/app") or os.getpid() != 1


def test_root_is_the_user_and_no_permission_stops_it(machine: LocalMachine) -> None:
    """As root of a container does; so tasks about permissions behave alike."""
    said = shell(machine, "id -un; cd /app; echo secret > file; chmod 0 file; cat file; stat -c %U:%G:%a file")
    assert said == "root\nsecret\nroot:root:0\n"


ATTEMPTS = """
touch /usr/bin/mine
rm -f /usr/bin/env
unshare --user true
unshare --mount true
mount -t tmpfs none /mnt
umount /proc/sys
mount -o remount,rw /usr
echo x > /proc/sys/kernel/hostname
echo 9 > /proc/sys/user/max_user_namespaces
nsenter --target 1 --mount true
mknod /app/disk b 8 0
ip link set lo down
head -c 1 /proc/1/fd/0
kill -STOP 1 && grep -q 'State:.T' /proc/1/status
kill -KILL 1 && ! kill -0 1
"""


def test_a_program_cannot_undo_its_sandbox(machine: LocalMachine) -> None:
    for attempt in ATTEMPTS.strip().splitlines():
        done = machine.run(["bash", "-c", attempt], timeout_s=30)
        assert done.exit_code not in (0, None), attempt
    assert machine.run(["true"], timeout_s=30).exit_code == 0


def test_output_is_cut_in_the_middle(machine: LocalMachine) -> None:
    done = machine.run(["sh", "-c", "echo begin; yes | head -c 3000000; echo end"], timeout_s=60, most_output=1000)
    assert (len(done.output), done.dropped) == (1000, 3_000_000 + 10 - 1000)
    assert done.output.startswith(b"begin\ny\n")
    assert done.output.endswith(b"y\nend\n")


def test_run_does_not_wait_for_what_goes_on_in_the_background(machine: LocalMachine) -> None:
    done = machine.run(["sh", "-c", "sleep 1000 & echo started"], timeout_s=60)
    assert (done.exit_code, done.output) == (0, b"started\n")
    assert len(machine.processes()) == 1


def test_a_command_out_of_time_takes_all_that_came_from_it(machine: LocalMachine) -> None:
    """Also what has a session of its own, and has lost its parents; and nothing else."""
    left_running(machine, 2000)
    script = "(setsid sh -c 'sleep 1001 & sleep 1002' &); setsid sleep 1003 & trap '' TERM; echo begun; sleep 1004"
    done = machine.run(["bash", "-c", script], timeout_s=1.0)
    assert done.exit_code is None
    assert [process.command for process in machine.processes()] == ["sleep 2000"]


def test_a_fork_bomb_ends_with_its_command(backend: LocalBackend, tmp_path: Path) -> None:
    with backend.start(write_task(tmp_path), Limits(processes=40)) as machine:
        machine.run(["sh", "-c", "for n in $(seq 100); do sleep 1000 & done"], timeout_s=60)
        assert 20 < len(machine.processes()) <= 56
        machine.kill(machine.processes())
        done = machine.run(["bash", "-c", "bomb() { bomb | bomb & }; bomb; sleep 100"], timeout_s=1.5)
        assert done.exit_code is None
        assert machine.processes() == []
        assert shell(machine, "echo alive") == "alive\n"


def test_kill_ends_the_processes_named_and_no_others(machine: LocalMachine) -> None:
    left_running(machine, 1001, 1002)
    first, second = sorted(machine.processes(), key=lambda process: process.command)
    machine.kill([first, type(second)(second.pid, second.parent, second.started + 1, "", 0)])
    wait_for(machine, f"! kill -0 {first.pid} 2>/dev/null")
    assert [process.command for process in machine.processes()] == ["sleep 1002"]


def test_more_memory_than_allowed_is_not_given(backend: LocalBackend, tmp_path: Path) -> None:
    with backend.start(write_task(tmp_path), Limits(memory_mb=200)) as machine:
        done = machine.run(["python3", "-c", "x = bytearray(400 << 20)"], timeout_s=60)
        assert done.exit_code == 1
        assert b"MemoryError" in done.output


def test_files_come_back_as_they_were_put(machine: LocalMachine, tmp_path: Path) -> None:
    folder = tmp_path / "put"
    (folder / "inner").mkdir(parents=True)
    (folder / "inner" / "large").write_bytes(os.urandom(3_000_000))
    (folder / "run.sh").write_text("#!/bin/sh\necho run\n", "utf-8")
    (folder / "run.sh").chmod(0o700)
    (folder / "link").symlink_to("run.sh")
    shell(machine, "mkdir -p /tests/old; touch /tests/old/file")
    machine.put({"/tests": folder, "/one": b"1", "/deep/er/two": b"2"})
    files = machine.get("/tests")
    assert files == {"inner/large": (folder / "inner" / "large").read_bytes(), "run.sh": b"#!/bin/sh\necho run\n"}
    assert shell(machine, "/tests/run.sh; readlink /tests/link; stat -c %a /tests/run.sh /one") == (
        "run\nrun.sh\n744\n644\n"
    )
    assert (machine.get("/one"), machine.get("/deep")) == ({"": b"1"}, {"er/two": b"2"})
    assert (machine.get("/missing"), machine.get("/one/below")) == ({}, {})


def test_put_replaces_links_and_never_follows_them(machine: LocalMachine) -> None:
    shell(machine, "mkdir /app/mine; ln -s /app/mine /tests; ln -s /app/mine/file /target; ln -s loop /loop")
    machine.put({"/tests/deep/file": b"new", "/target": b"new", "/loop/file": b"new"}, mode=0o600)
    assert (
        shell(machine, "ls -A /app/mine; cat /tests/deep/file /target /loop/file; stat -c %a /target")
        == "newnewnew600\n"
    )


def test_get_follows_no_link_and_leaves_out_what_is_too_much(machine: LocalMachine) -> None:
    shell(machine, "mkdir /out; ln -s /etc/passwd /out/link; ln -s /etc /out/etc; mkfifo /out/pipe; echo a > /out/a")
    shell(machine, "cd /out; head -c 600 /dev/zero > b; head -c 600 /dev/zero > c; echo d > d")
    assert sorted(machine.get("/out", most_bytes=1000)) == ["a", "b", "d"]
    assert machine.get("/out/etc") == {}
    assert machine.get("/out/pipe") == {}


def test_files_are_removed_whatever_they_are(machine: LocalMachine) -> None:
    shell(machine, "mkdir -p /a/b; touch /a/b/c; chmod 000 /a/b; ln -s /etc /link; touch /file")
    machine.remove_files(["/a", "/link", "/file", "/missing", "/file/below"])
    assert shell(machine, "ls -d /a /link /file 2>/dev/null | wc -l; ls /etc/passwd") == "0\n/etc/passwd\n"


def test_what_is_saved_of_one_machine_stands_in_another(
    machine: LocalMachine, backend: LocalBackend, tmp_path: Path
) -> None:
    """With permissions and links, under another path, in place of what was there."""
    shell(machine, "mkdir -p /job/in; cd /job; echo a > in/a; chmod 4711 in/a; ln -s a in/link; ln in/a in/hard")
    saved = io.BytesIO()
    assert machine.save("/job", saved, most_bytes=1_000_000)
    saved.seek(0)
    with tarfile.open(fileobj=saved) as tar:
        assert {member.name.split("/")[-1] for member in tar} == {"job", "in", "a", "link", "hard"}
    saved.seek(0)
    with backend.start(write_task(tmp_path), Limits()) as other:
        shell(other, "mkdir -p /new/place; touch /new/place/old; ln -s /new/place /new/place/self")
        other.load("/new/place", saved)
        assert shell(other, "cd /new/place; ls . in; stat -c '%a %h' in/a; readlink in/link; ls -A /new") == (
            ".:\nin\n\nin:\na\nhard\nlink\n4711 2\na\nplace\n"
        )


def test_saving_says_what_is_not_there_and_refuses_what_is_too_much(machine: LocalMachine) -> None:
    shell(machine, "truncate -s 1G /app/sparse; echo one > /app/one; ln -s one /app/link")
    saved = io.BytesIO()
    assert not machine.save("/missing", saved, most_bytes=1000)
    assert machine.save("/app/link", saved, most_bytes=100_000)
    with pytest.raises(MachineLostError, match=r"/app in .* has more than 100000 bytes") as caught:
        machine.save("/app", saved, most_bytes=100_000)
    assert caught.value.by_agent is True


def test_a_path_that_cannot_be_written_is_refused(machine: LocalMachine) -> None:
    for path in ("relative", "/usr/lib/x", "/proc/x", "/app/../x", "/", "/a\0b"):
        with pytest.raises(EngineError):
            machine.put({path: b""})


def test_another_user_than_root_is_refused(machine: LocalMachine) -> None:
    with pytest.raises(TaskError, match=r"the user 'agent'; a sandbox has root alone: use 'docker'"):
        machine.run(["true"], user="agent", timeout_s=10)


def test_a_terminal_is_one(machine: LocalMachine) -> None:
    terminal = machine.open_terminal(["bash", "--norc", "-i"], env={"PS1": "ready> "}, columns=90, lines=30)
    read_until(terminal, b"ready> ")
    terminal.write(b"tty; stty size; echo $TERM-$$; sleep 100\n")
    shown = read_until(terminal, b"xterm-")
    assert b"/dev/pts/" in shown
    assert b"30 90" in shown
    pid = terminal.pid
    assert pid in [process.pid for process in machine.processes()]
    wait_for(machine, "pgrep -fx 'sleep 100' > /dev/null")
    terminal.write(b"\x03")
    terminal.write(b"echo inter''rupted\n")
    read_until(terminal, b"interrupted")
    terminal.close()
    terminal.close()
    wait_for(machine, f"! kill -0 {pid} 2>/dev/null")


def test_a_terminal_says_when_its_program_has_ended(machine: LocalMachine) -> None:
    """Although a process in the background still holds it open; what was written before is read first."""
    terminal = machine.open_terminal(["bash", "-c", "setsid sleep 1000 & echo last words"])
    read_until(terminal, b"last words")
    with pytest.raises(MachineLostError, match=r"the program in the terminal has ended"):
        read_until(terminal, b"never written")
    with pytest.raises(MachineLostError):
        terminal.write(b"x")
    terminal.close()


def test_typing_ends_though_nobody_reads(machine: LocalMachine) -> None:
    terminal = machine.open_terminal(["sleep", "1000"])
    terminal.write(b"x" * 1_000_000)
    assert machine.run(["true"], timeout_s=30).exit_code == 0
    terminal.close()


@pytest.mark.thorough
def test_several_threads_may_use_a_machine(machine: LocalMachine) -> None:
    found: list[bytes] = []

    def work(number: int) -> None:
        machine.put({f"/app/{number}": str(number).encode()})
        found.append(machine.run(["cat", f"/app/{number}"], timeout_s=60).output)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(found) == sorted(str(number).encode() for number in range(16))


def test_a_machine_is_gone_after_its_removal(machine: LocalMachine) -> None:
    terminal = machine.open_terminal(["sleep", "1000"])
    machine.remove()
    machine.remove()
    with pytest.raises(MachineLostError, match=r"was removed"):
        machine.run(["true"], timeout_s=10)
    with pytest.raises(MachineLostError):
        read_until(terminal, b"never written")
    terminal.close()
