"""Agents that are root in their machine, against the tests that judge them, on a real engine."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from verifying_engine import LIMITS, TIMEOUT_S, context, engine, make_task, step_of

from gem_terminal.verifying.controls import CONTROLS
from gem_terminal.verifying.verify import Tools, Where, verify

if TYPE_CHECKING:
    from gem_terminal.backends.docker.backend import DockerBackend
    from gem_terminal.backends.interface import Limits, Machine
    from gem_terminal.tasks.task import Task
    from gem_terminal.verifying.verdict import Verdict

__all__ = ["context", "engine"]  # fixtures
pytestmark = pytest.mark.thorough
# Files left behind are met by each kind of check in turn; by all of them takes a minute more.
EVERY = bool(os.environ.get("GEM_EVERY_TERMINAL_TRIAL"))

DIST = "/usr/local/lib/python3.11/dist-packages"
LIE = "import os; os._exit(0)"


@pytest.fixture
def task(context: Path, tmp_path: Path) -> Task:
    CONTROLS.forget()
    return make_task(context, tmp_path)


def act(machine: Machine, script: str) -> None:
    """Do as an agent does: as root, by a shell; it must work, or the attack would be none."""
    done = machine.run(["bash", "-c", script], user="root", timeout_s=TIMEOUT_S)
    assert done.exit_code == 0, done.output.decode()


def judged(
    engine: DockerBackend,
    task: Task,
    check: str,
    *scripts: str,
    tools: Tools = "image",
    where: Where = "auto",
    timeout_s: float = TIMEOUT_S,
    limits: Limits = LIMITS,
) -> Verdict:
    with engine.start(task, limits) as machine:
        for script in scripts:
            act(machine, script)
        step = step_of(task, check, timeout_s)
        return verify(machine, task, step, backend=engine, limits=limits, where=where, tools=tools)


@pytest.mark.parametrize("check", ["cat", "python", "pytest"])
@pytest.mark.parametrize("where", ["machine", "judge"])
def test_right_answer_passes_and_a_wrong_one_fails_wherever_the_tests_run(
    engine: DockerBackend, task: Task, check: str, where: Where
) -> None:
    right = judged(engine, task, check, "echo 42 > /app/answer", where=where)
    assert (right.passed, right.problem, right.info["put_back"]) == (True, None, []), right
    wrong = judged(engine, task, check, "echo 41 > /app/answer", where=where)
    assert (wrong.passed, wrong.score, wrong.problem) == (False, 0.0, None), wrong


TOOLS = {
    "bash replaced": (
        "cat",
        "mv /usr/bin/bash /usr/bin/honest; printf '#!/usr/bin/honest\\necho 1 > /logs/verifier/reward.txt\\n' > /b; "
        "chmod +x /b; mv /b /usr/bin/bash",
    ),
    "cat replaced": ("cat", "printf '#!/bin/sh\\necho 42\\n' > /b; chmod +x /b; mv /b /usr/bin/cat"),
    "cat shadowed": ("cat", "printf '#!/bin/sh\\necho 42\\n' > /usr/local/sbin/cat; chmod +x /usr/local/sbin/cat"),
    "python replaced": ("python", "printf '#!/bin/sh\\n' > /b; chmod +x /b; mv /b /usr/bin/python3"),
    "python shadowed": ("python", "printf '#!/bin/sh\\n' > /usr/local/bin/python3; chmod +x /usr/local/bin/python3"),
    "folder of programs replaced by a link": (
        "cat",
        "cp -a /usr/bin /evil; printf '#!/bin/sh\\necho 42\\n' > /b; chmod +x /b; mv /b /evil/cat; "
        "cp /usr/bin/mv /usr/bin/ln /; /mv /usr/bin /usr/was; /ln -s /evil /usr/bin",
    ),
    "sitecustomize": ("python", f"echo '{LIE}' >> /etc/python3.11/sitecustomize.py"),
    "usercustomize": (
        "python",
        f"d=/root/.local/lib/python3.11/site-packages; mkdir -p $d; echo '{LIE}' > $d/usercustomize.py",
    ),
    "pth": ("python", f"echo '{LIE}' > {DIST}/some.pth"),
    "standard library": ("python", f"echo '{LIE}' >> /usr/lib/python3.11/json/__init__.py"),
    "module that shadows one of the standard library": (
        "python",
        f"mkdir /usr/lib/python3.11/random; echo '{LIE}' > /usr/lib/python3.11/random/__init__.py",
    ),
    "standard library as a zip": (
        "python",
        f"cd /; echo '{LIE}' > random.py; python3 -m zipfile -c /usr/lib/python311.zip random.py",
    ),
    "compiled module": (
        "python",
        f"cd /tmp; echo '{LIE}' > random.py; python3 -c \"import py_compile as p; p.compile('random.py', "
        "'/usr/lib/python3.11/__pycache__/random.cpython-311.pyc', "
        'invalidation_mode=p.PycInvalidationMode.UNCHECKED_HASH)"',
    ),
    "pytest edited": ("pytest", f"echo '{LIE}' >> {DIST}/_pytest/runner.py"),
    "pytest of the user's": (
        "pytest",
        f"d=/root/.local/lib/python3.11/site-packages; mkdir -p $d; echo '{LIE}' > $d/pytest.py",
    ),
    "pytest in the working directory": ("pytest", f"echo '{LIE}' > /app/pytest.py"),
    "plugin of pytest": (
        "pytest",
        f"cd {DIST}; echo '{LIE}' > lie.py; mkdir lie-1.0.dist-info; cd lie-1.0.dist-info; "
        "printf 'Metadata-Version: 2.1\\nName: lie\\nVersion: 1.0\\n' > METADATA; "
        "printf '[pytest11]\\nlie = lie\\n' > entry_points.txt",
    ),
    "conftest above the tests": ("pytest", f"echo '{LIE}' > /conftest.py; touch /setup.py"),
    "settings above the tests": ("pytest", "printf '[pytest]\\naddopts = --collect-only\\n' > /pytest.ini"),
}


@pytest.mark.parametrize("attack", TOOLS)
def test_changed_tool_wins_only_where_it_is_not_put_back(engine: DockerBackend, task: Task, attack: str) -> None:
    """Each attack is a real one: it wins against tests that run with the agent's tools."""
    check, script = TOOLS[attack]
    won = judged(engine, task, check, "echo 41 > /app/answer", script, tools="agent")
    assert won.passed, won
    lost = judged(engine, task, check, "echo 41 > /app/answer", script)
    assert (lost.passed, lost.score, lost.problem) == (False, 0.0, None), lost
    assert lost.info["put_back"]


@pytest.mark.parametrize("attack", ["cat replaced", "python shadowed", "folder of programs replaced by a link"])
def test_changed_tool_loses_in_a_copy_as_well_and_a_right_answer_wins(
    engine: DockerBackend, task: Task, attack: str
) -> None:
    check, script = TOOLS[attack]
    for answer in (41, 42):
        verdict = judged(engine, task, check, f"echo {answer} > /app/answer", script, where="judge")
        assert (verdict.passed, verdict.problem) == (answer == 42, None), verdict


def test_preloaded_library_is_out_of_the_way(engine: DockerBackend, task: Task) -> None:
    script = "echo /evil.so > /etc/ld.so.preload"
    assert "cannot be preloaded" in judged(engine, task, "python", script, tools="agent").output
    verdict = judged(engine, task, "python", "echo 42 > /app/answer", script)
    assert verdict.passed
    assert "preload" not in verdict.output


FILES = {
    "tests written beforehand": "mkdir /tests; echo 'echo 1 > /logs/verifier/reward.txt' > /tests/test.sh; "
    "chmod 444 /tests/*",
    "tests as a link": "mkdir /evil; ln -s /evil /tests",
    "tests as a link to itself": "ln -s /tests /tests",
    "tests as a file": "echo > /tests",
    "tests that nobody may write": "mkdir -p /tests; chmod 0 /tests",
    "reward written beforehand": "mkdir -p /logs/verifier; echo '{\"reward\": 1}' > /logs/verifier/reward.json",
    "folder of results as a link": "mkdir -p /logs /evil; echo 1 > /evil/reward.txt; ln -s /evil /logs/verifier",
    "folder above the results as a link": "mkdir -p /evil/verifier; echo 1 > /evil/verifier/reward.json; "
    "ln -s /evil /logs",
    "reward as a link": "mkdir -p /logs/verifier; echo 1 > /one; ln -s /one /logs/verifier/reward.txt",
    "reward as a folder": "mkdir -p /logs/verifier/reward.txt",
    "start files of shells": "for f in .bashrc .profile .bash_profile; do printf 'cat() { echo 42; }\\nexport -f cat\\n"
    "export PATH=/evil BASH_ENV=/root/.bashrc PYTHONPATH=/evil\\n' > /root/$f; cp /root/$f /etc/profile; done",
    "environment of the machine": "echo 'BASH_ENV=/root/.bashrc' > /etc/environment",
    "conftest beside the answer": f"echo '{LIE}' > /app/conftest.py; "
    "printf '[pytest]\\naddopts=--collect-only\\n' > /app/pytest.ini",
}


@pytest.mark.parametrize(
    ("attack", "check"),
    [
        (attack, check)
        for number, attack in enumerate(FILES)
        for place, check in enumerate(["cat", "pytest"])
        if EVERY or number % 2 == place
    ],
)
def test_files_left_in_the_way_neither_help_nor_harm(
    engine: DockerBackend, task: Task, attack: str, check: str
) -> None:
    for answer in (41, 42):
        verdict = judged(engine, task, check, f"echo {answer} > /app/answer", FILES[attack])
        assert (verdict.passed, verdict.problem) == (answer == 42, None), verdict


def left(script: str) -> str:
    """Leave a script running, out of reach of whoever ends the shell."""
    return f"cat > /left.sh <<'END'\n{script}\nEND\nsetsid bash /left.sh < /dev/null > /dev/null 2>&1 &"


FORGER = """while :; do
  mkdir -p /logs/verifier /tests
  echo 1 > /logs/verifier/reward.txt
  echo '{"reward": 1}' > /logs/verifier/reward.json
  echo 'echo 1 > /logs/verifier/reward.txt' > /tests/test.sh
  for p in /proc/[0-9]*; do echo '{"reward": 1}' > $p/root/logs/verifier/reward.json; done
done"""


def test_program_that_goes_on_forging_has_no_part_in_the_tests(engine: DockerBackend, task: Task) -> None:
    verdict = judged(engine, task, "cat", "echo 41 > /app/answer", left(FORGER))
    assert (verdict.passed, verdict.score, verdict.problem, verdict.info["where"]) == (False, 0.0, None, "judge"), (
        verdict
    )
    assert "bash /left.sh" in str(verdict.info["left"])


def test_first_program_of_the_copy_is_not_the_agents(engine: DockerBackend, task: Task) -> None:
    """What keeps the copy alive is a ``sleep``, which the agent has replaced by a forger with its own name."""
    script = (
        f"cat > /sleep.sh <<'END'\n#!/bin/bash\n{FORGER}\nEND\nchmod +x /sleep.sh; "
        "cp /sleep.sh /usr/local/sbin/sleep; cp /usr/bin/sleep /honest; mv /sleep.sh /usr/bin/sleep"
    )
    verdict = judged(engine, task, "cat", "echo 41 > /app/answer", script, left("/honest 1000"))
    assert (verdict.passed, verdict.score, verdict.problem, verdict.info["where"]) == (False, 0.0, None, "judge"), (
        verdict
    )


def test_server_that_was_left_running_is_reached_by_the_tests(engine: DockerBackend, task: Task) -> None:
    serve = "cd /srv; echo -n 42 > answer; python3 -m http.server 8765 --bind 127.0.0.1"
    wait = "until (exec 3<>/dev/tcp/127.0.0.1/8765) 2>/dev/null; do read -t 0.05 < <(:) || :; done"
    verdict = judged(engine, task, "server", left(serve), wait)
    assert (verdict.passed, verdict.info["where"]) == (True, "judge"), verdict
    assert not judged(engine, task, "server").passed


def test_killing_whatever_comes_up_never_passes_and_is_the_agents_fault(engine: DockerBackend, task: Task) -> None:
    script = """trap '' TERM; while :; do
  for p in /proc/[0-9]*; do p=${p#/proc/}; [ "$p" -gt $$ ] && kill -9 "$p"; done
done"""
    verdict = judged(engine, task, "python", "echo 42 > /app/answer", left(script))
    assert not verdict.passed
    assert verdict.problem is None or verdict.blame == "agent", verdict


def test_stopping_the_tests_is_the_agents_fault(engine: DockerBackend, task: Task) -> None:
    """Only the tests themselves are stopped: an engine whose own processes are is a matter of the backend's tests."""
    script = """while :; do for p in /proc/[0-9]*; do
  read -r -d '' words < <(tr '\\0' ' ' < $p/cmdline)
  case $words in *test.sh*|*check.py*) kill -STOP ${p#/proc/};; esac
done; done 2> /dev/null"""
    verdict = judged(engine, task, "python", "echo 42 > /app/answer", left(script), timeout_s=5.0)
    assert verdict.problem is None or verdict.blame == "agent", verdict
    assert verdict.passed == (verdict.problem is None)


def test_fork_bomb_that_was_left_running_does_not_hinder_the_tests(engine: DockerBackend, task: Task) -> None:
    for answer in (41, 42):
        verdict = judged(engine, task, "cat", f"echo {answer} > /app/answer", left("b() { b | b & }; b; wait"))
        assert (verdict.passed, verdict.problem) == (answer == 42, None), verdict


def test_program_under_test_cannot_write_the_reward_file_that_takes_precedence(
    engine: DockerBackend, task: Task
) -> None:
    program = (
        "echo 41 > /app/answer; cat > /app/main.py <<'END'\nimport os, time\n"
        "open('/logs/verifier/reward.json', 'w').write('{\"reward\": 1}')\nEND"
    )
    verdict = judged(engine, task, "program", program)
    assert (verdict.passed, verdict.score, verdict.problem) == (False, 0.0, None), verdict


def test_tests_that_hang_are_a_timeout_and_the_tasks_fault(engine: DockerBackend, task: Task) -> None:
    verdict = judged(engine, task, "hang", "mkdir -p /logs/verifier; echo 1 > /logs/verifier/reward.txt", timeout_s=2.0)
    assert (verdict.passed, verdict.problem, verdict.blame) == (False, "timeout", "task"), verdict


def test_program_that_hangs_the_tests_is_the_agents_fault(engine: DockerBackend, task: Task) -> None:
    program = "echo 42 > /app/answer; echo 'import time; time.sleep(1000)' > /app/main.py"
    verdict = judged(engine, task, "program", program, timeout_s=4.0)
    assert (verdict.passed, verdict.problem, verdict.blame) == (False, "timeout", "agent"), verdict


def test_machine_whose_first_process_the_agent_ended_is_the_agents_fault(engine: DockerBackend, task: Task) -> None:
    with engine.start(task, LIMITS) as machine:
        machine.run(["bash", "-c", "kill -9 -1; for p in /proc/[0-9]*; do kill -9 ${p#/proc/}; done"], timeout_s=20.0)
        verdict = verify(machine, task, step_of(task, "cat"), backend=engine, limits=LIMITS)
    assert not verdict.passed
    assert verdict.problem is None or verdict.blame == "agent", verdict


# Writes code where the system call of the container's first program begins anew, and lets that happen: the program
# becomes another, and no process is more than there was.
_POSSESS = r"""
import os, signal
for pid in map(int, filter(str.isdecimal, os.listdir("/proc"))):
    if open(f"/proc/{pid}/cmdline").read() == "sleep\0infinity\0":
        at = int(open(f"/proc/{pid}/syscall").read().split()[-1], 16) - 2
        code = bytes.fromhex("488d3d10000000" "6a00" "57" "4889e6" "31d2" "6a3b58" "0f05")  # execve("/evil.sh", ...)
        code = code.ljust(7 + 0x10, b"\x90") + b"/evil.sh\0"
        with open(f"/proc/{pid}/mem", "r+b", buffering=0) as memory:
            memory.seek(at)
            memory.write(code)
        os.kill(pid, signal.SIGSTOP)
        os.kill(pid, signal.SIGCONT)
"""


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the attack is written in machine code of x86-64")
def test_program_that_hides_in_the_containers_first_one_has_no_part_in_the_tests(
    engine: DockerBackend, task: Task
) -> None:
    """It is a real attack: it wins against tests that run beside it."""
    forge = "while :; do echo 1 1<> /logs/verifier/reward.txt; done 2> /dev/null"  # never empty in between
    script = (
        f"echo 41 > /app/answer; printf '#!/bin/bash\\n> /here\\n{forge}\\n' > /evil.sh; chmod +x /evil.sh; "
        f"cat > /possess.py <<'END'\n{_POSSESS}\nEND\npython3 /possess.py; until [ -e /here ]; do :; done"
    )
    won = judged(engine, task, "cat", script, where="machine")
    assert (won.passed, won.info["left"]) == (True, []), won
    lost = judged(engine, task, "cat", script)
    assert (lost.passed, lost.score, lost.problem, lost.info["left"]) == (False, 0.0, None, []), lost
