"""The database of one episode: made, given to the agent, verified, and removed with all roles that it brought."""

from __future__ import annotations

import contextlib
import re
import secrets
from pathlib import Path
from typing import TYPE_CHECKING

import psycopg
from psycopg import sql

from gem_core.errors import GradingError
from gem_mcpmark import roles
from gem_mcpmark.errors import PostgresError
from gem_mcpmark.scripts import Finished, run_script
from gem_mcpmark.server import lease
from gem_mcpmark.tasks import VERIFY, Task
from gem_mcpmark.templates import grant_database, make_role, prepare, template

if TYPE_CHECKING:
    from gem_mcpmark.roles import Connection

# Uncaught errors of a script that no state of the database brings about.
_BROKEN = re.compile(
    r"(ImportError|ModuleNotFoundError|SyntaxError|IndentationError|FileNotFoundError|PermissionError|MemoryError)\b"
)


class EpisodeDatabase:
    """A database of its own, and a role of its own for the agent, which has rights there and nowhere else.

    Args:
        task: The task.
        databases: See ``gem_mcpmark.tasks.find_dump``.

    Raises:
        TaskError: The task's data is missing.
        PostgresError: It cannot be made.
    """

    def __init__(self, task: Task, databases: str | Path | None) -> None:
        self.task = task
        self.server, self._held = lease(exclusive=task.makes_roles)
        self.name = self.server.new_name("e")
        self._password = secrets.token_hex(16)
        try:
            with self.server.failures(f"making the database of {task.name!r}"):
                self._make(template(self.server, task, databases))
        except BaseException:
            self.close()
            raise

    @property
    def variables(self) -> dict[str, str]:
        """Environment variables that lead the agent's tools to the database."""
        return self.server.variables(self.name, self.name, self._password)

    def verify(self, limit_s: float) -> Finished:
        """Run the task's verifier, as a role of its own, once the agent's sessions have ended.

        Raises:
            GradingError: It could not be run, so that nobody knows whether the task is solved.
        """
        name, password = f"{self.name}_verifier", secrets.token_hex(16)
        try:
            with self.server.admin() as admin, self.server.failures("making the verifier's role"):
                self._end_sessions(admin)
                self._make_verifier(admin, name, password)
            done = run_script(self.task.verify, [self.name], self.server.variables(self.name, name, password), limit_s)
            with self.server.admin(self.name):
                pass  # a server that is gone would look like a task that is not solved
        except PostgresError as error:
            raise GradingError(f"{self.task.name}: the verifier could not be run: {error}") from error
        if done.exit_code is None:
            raise GradingError(f"{self.task.name}: {VERIFY} ran past {limit_s:g} s and was ended")
        if done.exit_code < 0:
            raise GradingError(f"{self.task.name}: {VERIFY} was ended by signal {-done.exit_code}")
        if done.exit_code and _BROKEN.match(done.last_line):
            raise GradingError(f"{self.task.name}: {VERIFY} could not be run: {done.last_line}")
        return done

    def close(self) -> None:
        """Drop the database and all roles of the episode. May be called again."""
        try:
            # A server that is gone has nothing left; what is left on a named one, the next process removes.
            with contextlib.suppress(PostgresError, psycopg.Error), self.server.admin() as admin:
                made = roles.made(admin, self.name)
                roles.drop_database(admin, self.name)
                roles.drop_roles(admin, [*made, f"{self.name}_verifier", self.name])
        finally:
            self._held.close()

    def _make(self, source: str | None) -> None:
        server, task = self.server, self.task
        with server.admin() as admin:
            self._refuse_conflicts(admin)
            makes_roles = task.prepare_makes_roles and source is None
            make_role(admin, self.name, self._password, makes_roles=makes_roles)
            words = None if server.is_private else task.words
            note = roles.snapshot(admin, words if task.makes_roles else ())
            self._alter(admin, sql.SQL("COMMENT ON ROLE {} IS {}"), sql.Literal(note))
            original = sql.Identifier(source or "template0")
            self._alter(admin, sql.SQL("CREATE DATABASE {} TEMPLATE {}"), original)
        if source is not None:
            with server.admin(self.name) as inside:
                inside.execute(
                    sql.SQL("REASSIGN OWNED BY {} TO {}").format(sql.Identifier(source), sql.Identifier(self.name))
                )
        grant_database(server, self.name, self.name)
        if source is None:
            prepare(server, task, self.name, self.name, self._password)
        with server.admin() as admin:
            attribute = "CREATEROLE" if task.agent_makes_roles else "NOCREATEROLE"
            self._alter(admin, sql.SQL("ALTER ROLE {} " + attribute))

    def _refuse_conflicts(self, admin: Connection) -> None:
        """Refuse to work beside roles of the user's that the task would change or drop."""
        if self.server.is_private or not self.task.makes_roles:
            return
        if self.task.agent_makes_roles and self.server.version < 16:
            raise PostgresError(
                f"the agent of {self.task.name!r} has to make roles, and before PostgreSQL 16 whoever may do so may "
                "change those of others: use a newer server, or a private one"
            )
        theirs = admin.execute(
            "SELECT rolname FROM pg_roles WHERE NOT rolsuper AND NOT rolname LIKE 'gem\\_mcpmark\\_%' "
            "AND NOT rolname LIKE 'pg\\_%'"
        ).fetchall()
        if both := sorted(name for (name,) in theirs if name.lower() in self.task.words):
            raise PostgresError(
                f"the server has roles that the task {self.task.name!r} may make: {', '.join(both)}; drop them, or use "
                "a private server"
            )

    def _end_sessions(self, admin: Connection) -> None:
        """End what the agent still has under way: it might hold locks."""
        self._alter(admin, sql.SQL("ALTER ROLE {} NOLOGIN"))
        admin.execute("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE usename = %s", [self.name])

    def _make_verifier(self, admin: Connection, name: str, password: str) -> None:
        """Make a role that may do in the database what the agent may, and all that roles of the episode may."""
        verifier = sql.Identifier(name)
        make_role(admin, name, password, makes_roles=self.task.verify_makes_roles)
        members = [self.name, *roles.made(admin, self.name)]
        listed = sql.SQL(", ").join(map(sql.Identifier, members))
        admin.execute(sql.SQL("GRANT {} TO {}").format(listed, verifier))
        grant = sql.SQL("GRANT CONNECT, TEMPORARY ON DATABASE {} TO {} WITH GRANT OPTION")
        admin.execute(grant.format(sql.Identifier(self.name), verifier))

    def _alter(self, admin: Connection, statement: sql.SQL, *more: sql.Composable) -> None:
        admin.execute(statement.format(sql.Identifier(self.name), *more))
