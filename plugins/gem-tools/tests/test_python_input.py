"""What a program in a sandbox finds as its input and output, and how its timers end it."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest
from python_levels import ALL, pool_of

from gem_tools.python import Limits, Pool

pytestmark = pytest.mark.thorough


@pytest.fixture(params=ALL)
def pool(request: pytest.FixtureRequest) -> Iterator[Pool]:
    """A pool of two sandboxes of each level."""
    made = pool_of(request.param, workers=2)
    yield made
    made.close()


def test_input_has_the_usual_names(pool: Pool) -> None:
    """As solutions of contests open it; no call sees another's."""
    code = """
for name in ("/dev/stdin", "/dev/fd/0", 0):
    with open(name) as stream: print(stream.read().split())
"""
    assert pool.run(code, stdin="1 2\n").stdout == "['1', '2']\n['1', '2']\n['1', '2']\n"
    assert pool.run("import os; print(os.listdir(), open('/dev/null').read())").stdout == "[] \n"
    outcome = pool.run("print(open('/dev/stdin').read() == '')")
    assert outcome.stdout == "True\n", outcome
    big = "x" * 10_000_000
    assert pool.run("print(len(open('/dev/stdin').read()))", stdin=big).stdout == f"{len(big)}\n"
    read = "import sys; print(sys.stdin.read())"
    limits = Limits(folder_mb=1, output_bytes=4_000_000)
    too_big = pool.run(f"{read} # /dev/stdin", stdin="x" * 3_000_000, limits=limits)
    assert (too_big.status, len(too_big.stdout)) == ("ok", 3_000_001)


def test_input_by_name_in_a_session(pool: Pool) -> None:
    """Each call that asks by the name gets its own, whatever the one before has put there."""
    if pool.sandbox != "bubblewrap":
        pytest.skip("elsewhere the kernel gives the name, to the input of the first call")
    session = pool.session()
    read = "print(open('/dev/stdin').read())"
    assert session.run(read, stdin="first").stdout == "first\n"
    assert session.run("import os; os.unlink('.stdin'); os.mkfifo('.stdin')").status == "ok"
    assert session.run(read, stdin="second").stdout == "second\n"
    session.close()


def test_streams_are_those_of_an_interpreter(pool: Pool) -> None:
    """Their names and modes, for which libraries and the fast input of contestants ask."""
    code = """
import os, sys
for stream in (sys.stdin, sys.stdout, sys.stderr):
    print(stream.name, stream.mode, stream.buffer.name, stream.buffer.mode, stream.fileno(), stream.isatty())
print(os.read(sys.stdin.fileno(), max(os.fstat(sys.stdin.fileno()).st_size, 8192)))
"""
    expected = "<stdin> r <stdin> rb 0 False\n<stdout> w <stdout> wb 1 False\n<stderr> w <stderr> wb 2 False\n"
    assert pool.run(code, stdin="1 2\n").stdout == f"{expected}b'1 2\\n'\n"
    session = pool.session()
    for text in ("one", "two"):
        outcome = session.run("import sys; print(sys.stdin.name, sys.stdin.mode, sys.stdin.read())", stdin=text)
        assert outcome.stdout == f"<stdin> r {text}\n"
    session.close()


def test_an_alarm_ends_the_code(pool: Pool) -> None:
    """A timer that nothing handles, which the kernel keeps from the first process of a namespace."""
    outcome = pool.run("import signal\nsignal.setitimer(signal.ITIMER_REAL, 0.01)\nsignal.pause()\nprint('later')")
    assert outcome.stdout == ""
    if outcome.sandbox == "bubblewrap":
        assert (outcome.status, outcome.exit_code) == ("exit", signal.SIGALRM)
    else:
        assert (outcome.status, outcome.signal) == ("killed", "SIGALRM")
    handled = """
import signal
rang = []
signal.signal(signal.SIGALRM, lambda *_: rang.append("rang"))
signal.setitimer(signal.ITIMER_REAL, 0.01)
while not rang: pass
print(*rang)
"""
    assert pool.run(handled).stdout == "rang\n"
