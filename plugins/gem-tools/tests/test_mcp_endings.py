"""However a program with MCP servers ends, the servers end too."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from mcp_helping import around, bad, servers_of, step, wait_until_gone

pytestmark = pytest.mark.thorough

TESTS = str(Path(__file__).parent)

PROGRAM = """
import json, os, signal, sys
sys.path.insert(0, {tests!r})
from mcp_helping import around, bad, servers_of, step

if __name__ == "__main__":
    env = around(bad(sessions={sessions!r}))
    step(env, "count")
    print(json.dumps(servers_of()), flush=True)
    {then}
"""


@pytest.mark.parametrize("way", ["behaves", "stay"])
def test_closing_ends_a_server(way):
    """Also one that does not end when its input does."""
    env = around(bad(way))
    step(env, "count")
    servers = servers_of()
    assert len(servers) == 1
    env.close()
    wait_until_gone(servers)


@pytest.mark.parametrize(
    ("then", "sessions"),
    [
        ("pass", "episode"),
        ("pass", "shared"),
        ("os._exit(7)", "episode"),
        ("os.kill(os.getpid(), signal.SIGINT)", "episode"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "episode"),
    ],
)
def test_a_server_ends_with_its_program(then, sessions):
    """Without anyone having closed anything: at the end of its input."""
    program = PROGRAM.format(tests=TESTS, sessions=sessions, then=then)
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (0, "") if then == "pass" else done.returncode != 0
    wait_until_gone(json.loads(done.stdout))


FORKED = """
import gc, os
from mcp_helping import around, bad, step

env = around(bad(sessions={sessions!r}))
first = step(env, "count")[0]
child = os.fork()
if not child:
    gc.collect()
    said = step(env, "count")[0]
    env.close()
    gc.collect()
    os._exit(0 if said.endswith("may be lost.]\\n1") else 1)
print(os.waitpid(child, 0)[1], first, step(env, "count")[0])
"""


@pytest.mark.parametrize("sessions", ["episode", "shared"])
def test_a_forked_child_that_goes_on_with_an_environment_gets_a_server_of_its_own(sessions):
    """And the agent is told; the parent goes on with its own."""
    program = f"import sys; sys.path.insert(0, {TESTS!r})\n{FORKED.format(sessions=sessions)}"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert (run.stdout, run.stderr) == ("0 1 2\n", "")
