"""Attacks on what passes between the code and its keeper: forged output, broken streams, endings of every kind.

Each is really tried; afterwards the pool still serves, and no process, file or memory is left.
"""

from __future__ import annotations

import struct

import pytest
from python_levels import SHORT, SMALL, Watched, attack, each_level

from gem_tools.python import Limits
from gem_tools.python.inside import wire

watched = each_level()


WRITE_EVERYWHERE = """
import os
def everywhere(data):
    for descriptor in range(1, 256):
        try: os.write(descriptor, data)
        except OSError: pass
"""


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "data",
    [
        b'{"kind": "ok", "code": 0, "value": "forged"}\n',
        b"-the machine",
        b"+\n+",
        wire.head({"op": "ready", "failed": []}, 0),
        wire.head({"id": 1, "ended": None, "failed": None, "status": 0, "reported": False}, 0),
        struct.pack(">II", 1 << 31, 1 << 31),
        b"\xff" * 100_000,
    ],
    ids=["result", "failed", "started", "ready", "answer", "huge", "noise"],
)
def test_forged_messages(watched: Watched, data: bytes) -> None:
    """Written to every descriptor there is, they change nothing but this call's own value, and fail as it fails."""
    code = f"{WRITE_EVERYWHERE}\neverywhere({data!r})\nimport sys\nsys.exit(7)"
    outcome = attack(watched, code, Limits(wall_s=10))
    assert (outcome.status, outcome.exit_code, outcome.session_lost) == ("exit", 7, False)
    assert outcome.wall_s < 10


@pytest.mark.thorough
def test_a_forged_failure_of_the_machinery_is_not_believed(watched: Watched) -> None:
    """Code cannot say that it was not its fault."""
    data = b"-the machine"
    outcome = attack(watched, f"{WRITE_EVERYWHERE}\neverywhere({data!r})\n1 / 0")
    assert (outcome.status, outcome.exit_code) == ("exit", 1)


@pytest.mark.thorough
@pytest.mark.parametrize("body", [b"[]", b"null", b"{", b"[" * 100_000, b'{"code": "x"}', b'{"value": 3, "error": []}'])
def test_reports_that_are_none(watched: Watched, body: bytes) -> None:
    """What the process reports of itself may be anything."""
    data = body + b"\n"
    outcome = attack(watched, f"import os\nos.write(3, {data!r})\nos._exit(0)")
    assert (outcome.status, outcome.value) == ("ok", None)


FORGED = [
    b"-the machine\n",
    b"{}\n",
    b"+",
    b'{"kind": "exit", "code": ' + b"9" * 4000 + b"}\n",
    b'{"kind": "ok", "value": "' + b"x" * 1_000_000 + b'"}\n',
    struct.pack(">II", 1 << 31, 1 << 31),
    b"\xff" * 100_000,
]


@pytest.mark.few(1)
@pytest.mark.parametrize("data", FORGED, ids=["failed", "empty", "started", "code", "value", "huge", "noise"])
def test_forging_the_next_call_of_a_session(watched: Watched, data: bytes) -> None:
    """Threads and hooks can forge what their own session says, and reach neither its keeper nor another session."""
    session, other = watched.pool.session(SHORT), watched.pool.session(SMALL)
    code = f"""
import os, threading
data = {data!r}
def send():
    while True:
        try: os.write(3, data)
        except OSError: pass
threading.Thread(target=send, daemon=True).start()
"""
    try:
        other.run("x = 'kept'")
        session.run(code)
        outcome = session.run("1")
        assert outcome.status in ("ok", "exit", "timeout", "killed", "cpu"), outcome
        assert len(outcome.value or "") < 100_000
        assert other.run("x").value == "'kept'"
    finally:
        session.close()
        other.close()
    watched.check()


@pytest.mark.thorough
@pytest.mark.parametrize(
    "code",
    [
        "import os\nos.dup2(os.open('/dev/null', os.O_RDWR), 3)",
        "import os\nos.close(3)",
        "import os, threading\nthreading.Timer(0.01, os._exit, [0]).start()",
        "import os, threading\nread = lambda: [os.read(3, 1) for _ in iter(int, 1)]\n"
        "threading.Thread(target=read, daemon=True).start()",
    ],
    ids=["nowhere", "closed", "dying", "reading"],
)
def test_a_session_that_does_not_begin_its_next_call(watched: Watched, code: str) -> None:
    """Is its own fault, told within the limits of the call, and not the machine's."""
    session, other = watched.pool.session(SHORT), watched.pool.session(SMALL)
    try:
        other.run("x = 'kept'")
        session.run(code)
        for _ in range(2):
            outcome = session.run("import time\ntime.sleep(0.1)")
            if outcome.session_lost:
                break
        assert outcome.wall_s < 30
        assert other.run("x").value == "'kept'"
    finally:
        session.close()
        other.close()
    watched.check()


@pytest.mark.thorough
@pytest.mark.parametrize("descriptors", ["range(0, 256)", "(0, 1, 2)", "(3,)"])
def test_closing_descriptors(watched: Watched, descriptors: str) -> None:
    """Without its streams a process still ends, and its end is told."""
    code = f"import os\nfor number in {descriptors}:\n    try: os.close(number)\n    except OSError: pass"
    outcome = attack(watched, f"{code}\nos._exit(5)")
    assert (outcome.status, outcome.exit_code) == ("exit", 5)
    assert attack(watched, code).status in ("ok", "error")


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("code", "status", "exit_code"),
    [
        ("import sys\nsys.exit(0)", "ok", 0),
        ("import sys\nsys.exit(300)", "exit", 44),
        ("import sys\nsys.exit(-1)", "exit", 255),
        ("import sys\nsys.exit(object())", "exit", 1),
        ("raise SystemExit", "ok", 0),
        ("import os\nos._exit(9)", "exit", 9),
        ("raise KeyboardInterrupt", "error", 1),
        ("raise BaseException('x')", "error", 1),
        ("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\nimport ctypes\nctypes.string_at(0)", "killed", None),
        ("import ctypes\nctypes.string_at(0)", "killed", None),
        ("import os\nos.abort()", "killed", None),
        ("def f(): f()\nf()", "error", 1),
        ("x = eval('(' * 10 ** 6)", "error", 1),
        ("import atexit, os\natexit.register(os._exit, 4)", "exit", 4),
        ("import atexit\natexit.register(lambda: 1 / 0)", "ok", 0),
        ("import sys\nsys.excepthook = lambda *a: 1 / 0\nraise ValueError", "error", 1),
        ("import sys\nsys.stdout = None\n1", "ok", 0),
        ("import sys\nsys.stdout.close()\nsys.stderr.close()", "ok", 0),
        ("import sys\ndel sys.modules['__main__'], sys.modules['sys']", "ok", 0),
        ("import builtins\nbuiltins.repr = builtins.len = builtins.isinstance = None\n1", "ok", 0),
        ("__builtins__ = {}\nx", "error", 1),
        ("input()", "error", 1),
        ("import os\nos.execv('/bin/sh', ['sh', '-c', 'exit 6'])", "exit", 6),
        ("import os\nif os.fork() == 0: raise ValueError\nos.wait()", "ok", 0),
    ],
)
def test_endings(watched: Watched, code: str, status: str, exit_code: int | None) -> None:
    """However a process ends, that is what is told."""
    outcome = attack(watched, code, Limits(wall_s=20, memory_mb=256))
    assert (outcome.status, outcome.exit_code) == (status, exit_code), outcome


@pytest.mark.thorough
@pytest.mark.parametrize(
    "code",
    [
        "class X:\n    def __repr__(self):\n        while True: pass\nX()",
        "class X(Exception):\n    def __str__(self):\n        while True: pass\nraise X",
        "import atexit\ndef hang():\n    while True: pass\natexit.register(hang)",
        "import threading, time\nthreading.Thread(target=time.sleep, args=(600,)).start()",
        "import sys\nclass Out:\n    def flush(self):\n        while True: pass\nsys.stdout = Out()",
        "import sys\nwhile True:\n    try: sys.exit()\n    except BaseException: pass",
        "try:\n    while True: pass\nfinally:\n    while True: pass",
        "import os, signal\nos.kill(os.getpid(), signal.SIGSTOP)\nwhile True: pass",
    ],
    ids=["repr", "str", "atexit", "thread", "flush", "exits", "finally", "stopped"],
)
def test_what_hangs_at_the_end_is_ended(watched: Watched, code: str) -> None:
    """Representations, handlers and threads run within the limits of the call."""
    outcome = watched.pool.run(code, limits=Limits(wall_s=0.5, cpu_s=60), value=True)
    assert outcome.status == "timeout"
    watched.check()


@pytest.mark.thorough
def test_recursion_without_an_end(watched: Watched) -> None:
    """Deeper than any stack or memory."""
    code = "import sys\nsys.setrecursionlimit(10 ** 9)\ndef f(): f()\nf()"
    # Where the memory ends first decides: an exception of some kind, or the end of the process.
    assert attack(watched, code, Limits(wall_s=20, memory_mb=256)).status not in ("ok", "exit")


@pytest.mark.thorough
def test_huge_values_and_errors(watched: Watched) -> None:
    """They are cut, like output."""
    limits = Limits(value_chars=100)
    outcome = watched.pool.run("'x' * 10 ** 7", value=True, limits=limits)
    assert outcome.value is not None
    assert len(outcome.value) < 200
    assert "characters left out" in outcome.value
    outcome = watched.pool.run("raise ValueError('y' * 10 ** 7)", limits=limits)
    assert outcome.error is not None
    assert len(outcome.error) < 200
    watched.check()


@pytest.mark.thorough
def test_values_that_break(watched: Watched) -> None:
    """A representation that raises is the code's own failure; one that is no text as well."""
    run = watched.pool.run
    outcome = run("class X:\n    def __repr__(self): raise ValueError('no')\nX()", value=True)
    assert (outcome.status, outcome.error) == ("error", "ValueError: no")
    assert run("class X:\n    def __repr__(self): return 5\nX()", value=True).status == "error"
    assert run("class E(Exception):\n    def __str__(self): raise E\nraise E", value=True).status == "error"
    assert run("import builtins\nbuiltins.repr = None\n1", value=True).status == "error"
    assert run("import builtins\nbuiltins.eval = builtins.compile = None\n1", value=True).status in ("ok", "error")
    assert run("raise type('E\\ud8\\n', (Exception,), {})('\\ud800')", value=True).status == "error"
    watched.check()


@pytest.mark.thorough
def test_any_text_is_code(watched: Watched) -> None:
    """NULs, lone surrogates, megabytes, nothing."""
    for code in ("\0", "\ud800", "'\ud800'", "#" * 5_000_000, "", "\n", "\ufeffx = 1", "\x0c\t\r", "x" * 1_000_000):
        assert watched.pool.run(code, value=True).status in ("ok", "error")
    watched.check()


@pytest.mark.thorough
def test_any_bytes_are_input_and_output(watched: Watched) -> None:
    """What is not UTF-8 goes in and comes out as such."""
    code = "import sys\ndata = sys.stdin.buffer.read()\nsys.stdout.buffer.write(data + b'\\xff\\x00')"
    assert attack(watched, code, stdin="a\0\udcffé").stdout == "a\0\ufffdé\ufffd\0"
    big = "0123456789" * 400_000
    outcome = watched.pool.run("import sys\nprint(len(sys.stdin.read()))", stdin=big)
    assert outcome.stdout == "4000000\n"


@pytest.mark.thorough
def test_what_the_code_wrote_is_kept_when_it_is_ended(watched: Watched) -> None:
    """Up to the limit that it reached."""
    outcome = attack(watched, "print('before', flush=True)\nwhile True: pass", Limits(wall_s=0.5))
    assert outcome.stdout == "before\n"
