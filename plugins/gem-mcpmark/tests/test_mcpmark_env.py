"""Episodes: what the agent is told and may do, how they end, and what the verifier's failures are."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from mcpmark_helping import CONNECT, execute, needs_postgres, write_task
from sample_solutions import SOLUTIONS

import gem_core as gem
from gem_core.errors import ArgumentError, StateNotSupported
from gem_core.making.again import Recipe
from gem_core.parsing import extract_code_blocks
from gem_mcpmark import PostgresError, TaskError

pytestmark = needs_postgres

SOLD = f"{CONNECT}import sys\ncursor.execute('SELECT count(*) FROM fruit')\nsys.exit(cursor.fetchone()[0])\n"


@pytest.fixture(autouse=True)
def private(monkeypatch):
    """Use a private server, whatever is named."""
    monkeypatch.delenv("GEM_MCPMARK_POSTGRES", raising=False)


def test_an_episode_by_the_tools():
    """The agent finds its way, changes the database and answers; the next episode starts afresh."""
    env = gem.make("mcp:Sample")
    name = "lending/missing_fees"
    observation, info = env.reset(options={"task": name})
    assert info["task_id"] == name
    assert "Insert the missing fees" in observation
    tools = [tool["function"]["name"] for tool in info["tools"]]
    assert tools == ["execute_sql", "list_schemas", "list_objects", "get_object_details"]
    assert execute(env, "SELECT count(*) FROM fees")[0].startswith('Output of execute_sql:\n[{"count": 25}]')
    observation, tool = execute(env, "SELECT owed FROM fees")
    assert tool["failed"]
    assert 'column "owed" does not exist' in observation
    execute(env, SOLUTIONS[name][0])
    _, reward, terminated, truncated, info = env.step("All late returns are charged.")
    assert (reward, terminated, truncated, info["correct"]) == (1.0, True, False, True)
    assert info["verifier"] == {"exit_code": 0, "output": "solved\n"}
    env.reset(options={"task": name})
    _, reward, terminated, _, info = env.step("Nothing was missing.")
    assert (reward, terminated, info["correct"]) == (0.0, True, False)
    assert info["verifier"]["exit_code"] == 1
    env.close()


def test_it_is_made_again_from_its_record():
    """As worker processes and records do; a living database cannot be forked."""
    env = gem.make("mcp:Sample", tasks="lending/missing_fees", max_tool_uses=3)
    again = env.spec.make()
    assert again.unwrapped.num_tasks == 1
    assert Recipe.of(env).make(tasks="lending/*").unwrapped.num_tasks == 8
    with pytest.raises(StateNotSupported, match="living database"):
        env.fork()


def test_wrong_arguments_are_refused():
    with pytest.raises(ArgumentError, match="mcp_server must look like"):
        gem.make("mcp:Sample", mcp_server={"url": "http://localhost"})
    with pytest.raises(ArgumentError, match="verify_timeout_s must be a number of seconds above 0"):
        gem.make("mcp:Sample", verify_timeout_s=0)
    env = gem.make("mcp:Sample")
    with pytest.raises(ArgumentError, match="there is no task 'lending/fees' among 8"):
        env.reset(options={"task": "lending/fees"})


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("verify", "words"),
    [
        ("import no_such_package\n", "No module named 'no_such_package'"),
        ("import time\ntime.sleep(600)\n", "ran past 1 s"),
        ("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n", "was ended by signal 9"),
    ],
)
def test_a_verifier_that_cannot_run_is_an_error(tmp_path, verify, words):
    """It is no reward of 0."""
    env = gem.make(
        "mcp:Postgres", path=write_task(tmp_path, verify=verify), verify_timeout_s=1 if "sleep" in verify else 60
    )
    env.reset()
    _, reward, terminated, truncated, info = env.step("done")
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["error"]["kind"] == "grading"
    assert words in info["error"]["message"]
    assert "correct" not in info
    env.close()


def test_a_task_without_data_says_what_to_provide(tmp_path):
    env = gem.make("mcp:Postgres", path=write_task(tmp_path, verify=SOLD, prepare=None))
    with pytest.raises(TaskError, match=r"needs the data of 'shop': put shop.backup or shop.sql into a folder"):
        env.reset()
    env.close()


def test_a_verifier_that_finds_no_table_fails_the_agent(tmp_path):
    """Its exception is what the agent has left undone."""
    env = gem.make("mcp:Postgres", path=write_task(tmp_path, verify=f"{CONNECT}cursor.execute('SELECT FROM sales')\n"))
    env.reset()
    _, reward, terminated, _, info = env.step("done")
    assert (reward, terminated, info["correct"]) == (0.0, True, False)
    env.close()


@pytest.mark.thorough
def test_the_example_of_the_page_runs():
    page = Path(__file__).parents[3] / "docs" / "mcpmark.md"
    if not page.exists():
        pytest.skip("only in the repository")
    (example,) = extract_code_blocks(page.read_text(encoding="utf-8"), "python")
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", example.code], capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    assert "Make the list for its reminders" in done.stdout
    assert "0.0 {'exit_code': 1" in done.stdout


def test_a_script_that_cannot_prepare_is_an_error(tmp_path):
    root = write_task(tmp_path, verify=SOLD, prepare="raise SystemExit('no more')\n")
    env = gem.make("mcp:Postgres", path=root)
    with pytest.raises(PostgresError, match="exited with 1: no more"):
        env.reset()
    env.close()
