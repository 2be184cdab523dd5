"""The databases that episodes are copied from: restored from a dump, or filled by a task's script, once a process."""

from __future__ import annotations

import contextlib
import gzip
import re
import secrets
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING

from psycopg import sql

from gem_mcpmark import roles
from gem_mcpmark.binaries import SERVER_VARIABLE, client_program
from gem_mcpmark.errors import PostgresError, TaskError
from gem_mcpmark.scripts import run_script
from gem_mcpmark.tasks import PREPARE, Task, find_dump

if TYPE_CHECKING:
    from gem_mcpmark.roles import Connection
    from gem_mcpmark.server import Server

PREPARE_LIMIT_S = 300.0

# What a restored database does not lack: settings of a newer version, owners and rights, which are ours here, and what
# every database has.
_HARMLESS = re.compile(
    r'unrecognized configuration parameter|role "[^"]*" does not exist|must be member of role|must be able to SET ROLE'
    r"|must be owner of (extension|schema)|permission denied to set (session authorization|parameter|role)"
    r'|schema "public" already exists|extension "plpgsql" already exists|invalid command \\(un)?restrict'
)
_ERROR = re.compile(r"(?:ERROR|FATAL|error): +(.*)")


def template(server: Server, task: Task, databases: str | Path | None) -> str | None:
    """Return the database that a task's episodes are copied from; None where each is filled by the task's script.

    As in MCPMark, the category's data comes first: a dump, or on a named server the database of that name. Only without
    one does the script ``prepare_environment.py`` fill an empty database.

    Args:
        server: Where it is made.
        task: The task.
        databases: See ``find_dump``.

    Raises:
        TaskError: There is neither a dump nor a script; the message says what to provide.
        PostgresError: The dump cannot be restored, or the script failed.
    """
    dump = find_dump(task, databases)
    with server.templates_lock:
        source = dump
        if dump is None and not server.is_private and _exists(server, task.category):
            source = Path(task.category)
        if source is None and task.prepare is None:
            raise TaskError(
                f"the task {task.name!r} needs the data of {task.category!r}: put {task.category}.backup or "
                f"{task.category}.sql into a folder and give that as databases=…, or name a server that has a database "
                f"{task.category!r} with {SERVER_VARIABLE}"
            )
        if source is None and task.prepare_makes_roles:
            return None  # roles are no part of a copy
        key = str(source or task.folder)
        if key not in server.templates:
            name = server.new_name("t")
            password = secrets.token_hex(16)
            with server.failures(f"making the database of {task.name!r}"):
                try:
                    _make_empty(server, name, password)
                    if source is None:
                        prepare(server, task, name, name, password)
                    else:
                        with _dumped(server, dump, task.category) as script:
                            _execute(server, script, name, password, str(source))
                    _finish(server, name)
                except BaseException:
                    with server.admin() as admin:
                        roles.drop_database(admin, name)
                        roles.drop_roles(admin, [name])
                    raise
            server.templates[key] = name
        return server.templates[key]


def prepare(server: Server, task: Task, database: str, role: str, password: str) -> None:
    """Run a task's ``prepare_environment.py`` on a database, as a role.

    Raises:
        PostgresError: It failed, whatever the agent will do.
    """
    if task.prepare is None:
        return
    done = run_script(task.prepare, [], server.variables(database, role, password), PREPARE_LIMIT_S)
    if done.exit_code != 0:
        how = f"ran past {PREPARE_LIMIT_S:g} s" if done.exit_code is None else f"exited with {done.exit_code}"
        raise PostgresError(f"{task.name}: {PREPARE} {how}: {done.output.strip()[-500:]}")


def make_role(admin: Connection, name: str, password: str, *, makes_roles: bool = False) -> None:
    """Make a role that may log in, and that row security does not hold, as it does not hold MCPMark's superuser."""
    words = "LOGIN BYPASSRLS" + (" CREATEROLE" if makes_roles else "")
    # The statement takes no parameters; the password is ours, of hexadecimal digits.
    statement = sql.SQL("CREATE ROLE {} " + words + " PASSWORD {}")
    admin.execute(statement.format(sql.Identifier(name), sql.Literal(password)))


def _exists(server: Server, database: str) -> bool:
    with server.admin() as admin:
        return admin.execute("SELECT FROM pg_database WHERE datname = %s", [database]).fetchone() is not None


def _make_empty(server: Server, name: str, password: str) -> None:
    with server.admin() as admin:
        make_role(admin, name, password)
        admin.execute(sql.SQL("ALTER ROLE {} SET lc_messages = 'C'").format(sql.Identifier(name)))
        admin.execute(sql.SQL("CREATE DATABASE {} TEMPLATE template0").format(sql.Identifier(name)))
    grant_database(server, name, name)


def grant_database(server: Server, database: str, role: str) -> None:
    """Give a role, and nobody else, what it needs to work in a database: not the database itself, but all in it."""
    place, who = sql.Identifier(database), sql.Identifier(role)
    with server.admin(database) as admin:
        admin.execute(sql.SQL("REVOKE ALL ON DATABASE {} FROM PUBLIC").format(place))
        admin.execute(sql.SQL("GRANT CONNECT, CREATE, TEMPORARY ON DATABASE {} TO {}").format(place, who))
        admin.execute(sql.SQL("ALTER SCHEMA public OWNER TO {}").format(who))


def _finish(server: Server, name: str) -> None:
    database = sql.Identifier(name)
    with server.admin(name) as admin:
        empty = admin.execute(
            "SELECT NOT EXISTS (SELECT FROM pg_class WHERE relnamespace IN (SELECT oid FROM pg_namespace "
            "WHERE nspname <> 'information_schema' AND nspname NOT LIKE 'pg\\_%') AND relkind IN ('r', 'p'))"
        ).fetchone()
        if empty and empty[0]:
            raise PostgresError("the data of the database has no table")
        admin.execute("ANALYZE")
    with server.admin() as admin:
        admin.execute(sql.SQL("ALTER ROLE {} NOLOGIN").format(database))
        admin.execute(sql.SQL("ALTER DATABASE {} ALLOW_CONNECTIONS false").format(database))


@contextlib.contextmanager
def _dumped(server: Server, dump: Path | None, database: str) -> Iterator[IO[bytes]]:
    """Yield a dump, or a database of the named server, as a file of SQL."""
    with contextlib.ExitStack() as files:
        if dump is not None and dump.suffix == ".sql":
            yield files.enter_context(dump.open("rb"))
            return
        script = files.enter_context(tempfile.TemporaryFile())
        if dump is not None and dump.suffix == ".gz":
            shutil.copyfileobj(files.enter_context(gzip.open(dump)), script)
        else:
            without = ["--no-owner", "--no-privileges"]
            if dump is not None:
                command, env = [client_program("pg_restore"), *without, "--file=-", str(dump)], None
            else:
                command, env = [client_program("pg_dump"), *without], server.client_variables(database)
            done = subprocess.run(command, stdout=script, stderr=subprocess.PIPE, env=env, check=False)
            if done.returncode:
                said = " ".join(done.stderr.decode(errors="replace").split())[-500:]
                raise PostgresError(f"{dump or database}: {said} ({command[0]})")
        script.seek(0)
        yield script


def _execute(server: Server, script: IO[bytes], name: str, password: str, source: str) -> None:
    """Run a file of SQL as the owner of a database.

    Raises:
        PostgresError: A statement failed without which the database lacks something.
    """
    command = [client_program("psql"), "-X", "-q", "--file=-"]
    env = server.client_variables(name, name, password)
    with tempfile.TemporaryFile() as errors:
        subprocess.run(command, stdin=script, stdout=subprocess.DEVNULL, stderr=errors, env=env, check=False)
        errors.seek(0)
        for line in errors:
            found = _ERROR.search(line.decode(errors="replace"))
            if found and not _HARMLESS.search(found[1]):
                raise PostgresError(f"{source} could not be restored: {found[1].strip()}")
