"""Who may do what: the agent in its own database alone, the verifier as a role of its own."""

from __future__ import annotations

import contextlib

import pytest
from mcpmark_helping import CONNECT, NOTHING_TO_DO, agent_of, episode_of, needs_postgres, write_task

pytestmark = needs_postgres

BEYOND = [
    "CREATE DATABASE other",
    "CREATE ROLE other",
    "COPY fruit TO PROGRAM 'cat'",
    "SELECT pg_read_file('PG_VERSION')",
    "SELECT * FROM pg_authid",
    "ALTER ROLE postgres PASSWORD 'mine'",
    "GRANT pg_execute_server_program TO CURRENT_USER",
    "ALTER DATABASE postgres RENAME TO mine",
    "DO $$ BEGIN EXECUTE format('ALTER DATABASE %I SET search_path = public', current_database()); END $$",
]


@pytest.fixture(autouse=True)
def private(monkeypatch):
    """Use a private server, whatever is named."""
    monkeypatch.delenv("GEM_MCPMARK_POSTGRES", raising=False)


def test_the_agent_owns_its_database_and_has_no_rights_beyond(tmp_path):
    import psycopg

    episode = episode_of(write_task(tmp_path, verify=NOTHING_TO_DO))
    with agent_of(episode) as agent:
        for sql in BEYOND:
            with pytest.raises(psycopg.errors.InsufficientPrivilege):
                agent.execute(sql)
        agent.execute("CREATE SCHEMA mine; ALTER TABLE fruit ADD price int; CREATE VIEW mine.dear AS TABLE fruit")
        agent.execute("ALTER TABLE fruit ENABLE ROW LEVEL SECURITY; DROP TABLE fruit CASCADE; DROP SCHEMA public")
    episode.close()


def test_an_agent_does_not_reach_the_database_of_another(tmp_path):
    import psycopg

    root = write_task(tmp_path, verify=NOTHING_TO_DO)
    one, other = episode_of(root), episode_of(root)
    with pytest.raises(psycopg.OperationalError, match="permission denied for database"):
        psycopg.connect(one.variables["DATABASE_URI"], dbname=other.name)
    one.close()
    other.close()


@pytest.mark.thorough
def test_episodes_that_make_the_same_role(tmp_path):
    """Each has a server to itself; the verifier may act as that role, which is gone afterwards.

    Before PostgreSQL 16 an agent that may make roles could grant itself to run programs.
    """
    import psycopg

    verify = f"{CONNECT}cursor.execute('SET ROLE clerk')\n"
    root = write_task(tmp_path, words="Create a role clerk.", verify=verify)
    episodes = [episode_of(root), episode_of(root)]
    for episode in episodes:
        with agent_of(episode) as agent:
            agent.execute("CREATE ROLE clerk")
            for role in ("pg_execute_server_program", "pg_write_server_files", "pg_read_server_files", "postgres"):
                with pytest.raises(psycopg.errors.InsufficientPrivilege):
                    agent.execute(f"GRANT {role} TO CURRENT_USER")
    assert [episode.verify(60).exit_code for episode in episodes] == [0, 0]
    for episode in episodes:
        episode.close()
    again = episode_of(root)
    assert again.verify(60).exit_code == 1  # there is no role before the agent makes it
    again.close()


def test_the_verifier_is_a_process_and_a_role_of_its_own(tmp_path, monkeypatch):
    """With MCPMark's variables and no others of ours; row security hides nothing, and what it calls is no superuser."""
    script = (
        f"{CONNECT}import sys\n"
        "assert sys.argv[1] == os.environ['POSTGRES_DATABASE'] and 'SECRET' not in os.environ\n"
        "cursor.execute('SELECT who, super, hidden FROM trap')\n"
        "print(*cursor.fetchone())\n"
    )
    monkeypatch.setenv("SECRET", "1")
    episode = episode_of(write_task(tmp_path, verify=script))
    with contextlib.closing(agent_of(episode)) as agent:
        agent.execute("CREATE TABLE secret AS SELECT 1")
        agent.execute("ALTER TABLE secret ENABLE ROW LEVEL SECURITY, FORCE ROW LEVEL SECURITY")
        agent.execute("CREATE FUNCTION me() RETURNS text LANGUAGE sql AS 'SELECT current_user::text'")
        super_and_hidden = "current_setting('is_superuser') AS super, (SELECT count(*) FROM secret) AS hidden"
        agent.execute(f"CREATE VIEW trap AS SELECT me() AS who, {super_and_hidden}")
        agent.execute("BEGIN; LOCK TABLE secret")  # which it still has as the verifier begins
        assert episode.verify(60).output.split() == [f"{episode.name}_verifier", "off", "1"]
    episode.close()
