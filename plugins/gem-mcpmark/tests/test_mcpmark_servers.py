"""Servers: a private one ends with its process; on a named one nothing of others is touched, and nothing is left."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mcpmark_helping import CONNECT, NOTHING_TO_DO, agent_of, episode_of, needs_postgres, write_task

from gem_core.errors import MissingRequirementError
from gem_mcpmark import PostgresError

pytestmark = needs_postgres

MAKES_A_ROLE = f"{CONNECT}cursor.execute('CREATE TABLE till (id int)')\ncursor.execute('CREATE ROLE cashier LOGIN')\n"
THEN_DIE = "import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n"


@pytest.fixture(scope="module")
def named():
    """A server that stands for the user's, with a role and a database of theirs; the administrator's connection."""
    import psycopg

    from gem_mcpmark.private import PrivateServer

    server = PrivateServer()
    with psycopg.connect(server.uri, autocommit=True) as connection:
        connection.execute("CREATE ROLE bystander LOGIN PASSWORD 'secret'")
        connection.execute("CREATE DATABASE market")
        with psycopg.connect(server.uri, dbname="market") as inside:
            inside.execute("CREATE TABLE fruit AS SELECT generate_series(1, 3) AS id")
        yield server.uri, connection
    server.stop()


@pytest.fixture
def untouched(named, monkeypatch):
    """The named server is used, and has afterwards what it had before."""
    address, connection = named
    monkeypatch.setenv("GEM_MCPMARK_POSTGRES", address)
    before = [name for name in everything(connection) if not name.startswith("gem_mcpmark_")]
    yield address, connection
    templates = re.compile(r"gem_mcpmark_\w{8}_t\d+")  # which the process keeps
    assert [name for name in everything(connection) if not templates.fullmatch(name)] == before


def everything(connection):
    """Return the names of all roles and databases."""
    rows = connection.execute("SELECT rolname FROM pg_roles UNION ALL SELECT datname FROM pg_database ORDER BY 1")
    return [name for (name,) in rows.fetchall()]


def test_roles_of_a_task_are_gone_after_its_episode(untouched, tmp_path):
    _, connection = untouched
    root = write_task(tmp_path, verify=NOTHING_TO_DO, prepare=MAKES_A_ROLE)
    episode = episode_of(root)
    assert "cashier" in everything(connection)
    assert episode.verify(60).exit_code == 0
    episode.close()
    episode.close()  # which may be called again


@pytest.mark.thorough
def test_what_a_killed_process_left_is_removed_by_the_next(untouched, tmp_path):
    from gem_mcpmark.server import Server

    address, connection = untouched
    root = write_task(tmp_path, verify=NOTHING_TO_DO, prepare=MAKES_A_ROLE)
    program = f"import gem_core as gem\nenv = gem.make('mcp:Postgres', path={str(root)!r})\nenv.reset()\n{THEN_DIE}"
    env = {**os.environ, "TMPDIR": str(tmp_path)}  # where it leaves a folder
    assert subprocess.run([sys.executable, "-c", program], check=False, env=env).returncode == -9
    left = everything(connection)
    assert "cashier" in left
    owner = next(name for name in left if name.startswith("gem_mcpmark_") and name.endswith("_e1"))[:-3]
    present = "SELECT FROM pg_stat_activity WHERE application_name = %s"
    wait_until(lambda: connection.execute(present, [owner]).fetchone() is None)
    Server(address)


def test_a_role_of_the_users_is_neither_taken_nor_dropped(untouched, tmp_path):
    script = MAKES_A_ROLE.replace("CREATE ROLE cashier LOGIN", "DROP ROLE IF EXISTS bystander; CREATE ROLE bystander")
    with pytest.raises(PostgresError, match="has roles that the task 'shop/fruit' may make: bystander"):
        episode_of(write_task(tmp_path, verify=NOTHING_TO_DO, prepare=script))


@pytest.mark.usefixtures("untouched")
def test_a_database_of_the_users_is_copied_and_stays(tmp_path):
    """It is that of the task's category, and goes before the script of the task."""
    verify = f"{CONNECT}cursor.execute('DELETE FROM fruit')\nprint(cursor.rowcount)\n"
    root = write_task(tmp_path, name="market/fruit", verify=verify, prepare="raise SystemExit(1)\n")
    for _ in range(2):
        episode = episode_of(root)
        assert episode.verify(60).output == "3\n"
        episode.close()


def test_a_named_server_that_does_not_answer_is_an_error(monkeypatch, tmp_path):
    monkeypatch.setenv("GEM_MCPMARK_POSTGRES", "postgresql://postgres:hidden@127.0.0.1:1/postgres")
    with pytest.raises(PostgresError, match="the server of GEM_MCPMARK_POSTGRES cannot be reached") as caught:
        episode_of(write_task(tmp_path, verify=NOTHING_TO_DO))
    assert "hidden" not in str(caught.value)


@pytest.mark.few(1)
@pytest.mark.parametrize("end", ["", THEN_DIE], ids=["at its end", "killed"])
def test_a_private_server_ends_with_its_process(end):
    """However that ends; then its folder is removed."""
    start = (
        "from gem_mcpmark.private import PrivateServer\nserver = PrivateServer()\nprint(server.folder, flush=True)\n"
    )
    program = start + end
    done = subprocess.run([sys.executable, "-c", program], check=False, capture_output=True, text=True)
    folder = Path(done.stdout.strip())
    assert folder.name.startswith("gem-mcpmark-"), done.stderr
    wait_until(lambda: not folder.exists())


def wait_until(condition):
    """Wait for what another process is about to do."""
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_living_processes_keep_what_is_theirs(untouched, tmp_path):
    """Another process that begins on the same server removes nothing of theirs."""
    from gem_mcpmark.server import Server

    address, _ = untouched
    episode = episode_of(write_task(tmp_path, verify=NOTHING_TO_DO, prepare=MAKES_A_ROLE))
    Server(address)
    assert episode.verify(60).exit_code == 0
    episode.close()


def test_agents_make_roles_only_where_others_are_safe(untouched, tmp_path):
    """Before PostgreSQL 16 they could change those of others."""
    _, connection = untouched
    root = write_task(tmp_path, verify=NOTHING_TO_DO, words="Create a role clerk.")
    if connection.info.server_version < 160000:
        with pytest.raises(PostgresError, match="before PostgreSQL 16 whoever may do so may change those of others"):
            episode_of(root)
        return
    import psycopg

    episode = episode_of(root)
    with agent_of(episode) as agent:
        agent.execute("CREATE ROLE of_another_name CREATEROLE")
        with pytest.raises(psycopg.Error):
            agent.execute("DROP ROLE bystander")
    episode.close()


def test_a_named_server_needs_a_superuser(named, monkeypatch, tmp_path):
    port = named[1].info.port
    monkeypatch.setenv("GEM_MCPMARK_POSTGRES", f"postgresql://bystander:secret@127.0.0.1:{port}")
    with pytest.raises(MissingRequirementError, match="is no superuser of the server"):
        episode_of(write_task(tmp_path, verify=NOTHING_TO_DO))
