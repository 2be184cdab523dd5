"""The PostgreSQL server of this process: the one that the user named, or private ones."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import secrets
import threading
import weakref
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

import psycopg
from psycopg.conninfo import conninfo_to_dict

from gem_core.errors import MissingRequirementError
from gem_mcpmark import roles
from gem_mcpmark.binaries import SERVER_VARIABLE, named_server
from gem_mcpmark.errors import PostgresError
from gem_mcpmark.private import PrivateServer

if TYPE_CHECKING:
    from gem_mcpmark.roles import Connection

PREFIX = "gem_mcpmark"
_OURS = re.compile(rf"{PREFIX}_(?P<owner>[0-9a-f]{{8}})_.*")
_ROLES_LOCK = 0x67656D
"""Key of the advisory lock that an episode holds whose task makes roles."""

_LOCK_S = 300


class Server:
    """A server on which databases and roles are made for episodes.

    All of them are called ``gem_mcpmark_OWNER_…``, where the owner is this object. For as long as it lives, a
    connection of it is shown in ``pg_stat_activity`` under that name; what belongs to an owner that is not there was
    left by a process that died, and is removed by the next one.

    Args:
        address: Of a server of the user's; None to start a private one.

    Raises:
        MissingRequirementError: There is no PostgreSQL, or its user is no superuser.
        PostgresError: The server does not start, or does not answer.
    """

    def __init__(self, address: str | None) -> None:
        self._private = PrivateServer() if address is None else None
        self.is_private = self._private is not None
        self.named = address
        self._address = self._private.uri if self._private is not None else address or ""
        self.owner = f"{PREFIX}_{secrets.token_hex(4)}"
        self._numbers = itertools.count(1)
        self._roles_lock = threading.Lock()
        self.templates_lock = threading.Lock()
        self.templates: dict[str, str] = {}
        """Databases that episodes are copied from, by what they were made from."""
        with contextlib.ExitStack() as undo:
            undo.callback(self._stop_private)
            self._presence = undo.enter_context(contextlib.closing(self._connect()))
            self.version = self._presence.info.server_version // 10000
            self._check()
            self._protect()
            self._sweep()
            undo.pop_all()
        self._stop = weakref.finalize(self, _stop, self._presence, self._private, self.owner, os.getpid())

    def variables(self, database: str, user: str, password: str) -> dict[str, str]:
        """Return the environment variables by which a script or a tool finds a database, and its role."""
        host, port = self._presence.info.host, str(self._presence.info.port)
        query = {key: str(value) for key, value in conninfo_to_dict(self._address).items() if key.startswith("ssl")}
        if host.startswith("/"):
            query["host"] = host  # the folder of a socket
        place = f"{user}:{password}@{'' if 'host' in query else host}:{port}/{database}"
        uri = f"postgresql://{place}" + (f"?{urlencode(query)}" if query else "")
        return {
            "POSTGRES_HOST": host,
            "POSTGRES_PORT": port,
            "POSTGRES_DATABASE": database,
            "POSTGRES_USERNAME": user,
            "POSTGRES_PASSWORD": password,
            "DATABASE_URL": uri,
            "DATABASE_URI": uri,
        }

    def client_variables(self, database: str, user: str | None = None, password: str | None = None) -> dict[str, str]:
        """Return the environment in which a client program goes to a database, by default as the administrator."""
        given = {**conninfo_to_dict(self._address), "dbname": database}
        if user is not None:
            given |= {"user": user, "password": password}
        names = {"dbname": "PGDATABASE"}
        return os.environ | {names.get(key, f"PG{key.upper()}"): str(value) for key, value in given.items()}

    def new_name(self, kind: str) -> str:
        """Return a name for a database and its role that nothing else has."""
        return f"{self.owner}_{kind}{next(self._numbers)}"

    @contextlib.contextmanager
    def admin(self, database: str | None = None) -> Iterator[Connection]:
        """Yield a connection of the administrator, by default to the maintenance database."""
        with contextlib.closing(self._connect(database)) as connection:
            yield connection

    @contextlib.contextmanager
    def failures(self, what: str) -> Iterator[None]:
        """Turn errors of the database into a ``PostgresError`` that says what failed."""
        try:
            yield
        except psycopg.Error as error:
            raise PostgresError(f"{what} failed: {' '.join(str(error).split())}") from error

    def lock_roles(self) -> contextlib.ExitStack | None:
        """Keep other episodes that make roles off this server, until the returned stack is closed.

        A private server that is taken returns None; on a named one, which other processes use too, this waits.

        Raises:
            PostgresError: Another episode holds it too long.
        """
        with contextlib.ExitStack() as held:
            if not self._roles_lock.acquire(timeout=0 if self.is_private else _LOCK_S):
                if self.is_private:
                    return None
                raise PostgresError(_LOCKED)
            held.callback(self._roles_lock.release)
            if not self.is_private:
                connection = held.enter_context(contextlib.closing(self._connect()))
                connection.execute(f"SET lock_timeout = '{_LOCK_S}s'")
                try:
                    connection.execute("SELECT pg_advisory_lock(%s)", [_ROLES_LOCK])
                except psycopg.errors.LockNotAvailable:
                    raise PostgresError(_LOCKED) from None
            return held.pop_all()

    def _connect(self, database: str | None = None) -> Connection:
        options: dict[str, Any] = {"application_name": self.owner, "connect_timeout": 10, "autocommit": True}
        if database is not None:
            options["dbname"] = database
        elif "dbname" not in conninfo_to_dict(self._address):
            options["dbname"] = "postgres"
        try:
            return psycopg.connect(self._address, **options)
        except psycopg.Error as error:
            place = "the private PostgreSQL server" if self.is_private else f"the server of {SERVER_VARIABLE}"
            raise PostgresError(f"{place} cannot be reached: {' '.join(str(error).split())}") from error

    def _check(self) -> None:
        found = self._presence.execute("SELECT rolsuper FROM pg_roles WHERE rolname = current_user").fetchone()
        if found is None or not found[0]:
            raise MissingRequirementError(
                f"the user of {SERVER_VARIABLE} is no superuser of the server: databases and roles are made for each "
                "episode, so name a superuser, or unset it to have a private server"
            )
        if self.version < 13:
            raise MissingRequirementError(f"PostgreSQL {self.version} is too old: 13 or newer is needed")

    def _protect(self) -> None:
        """Close the ways out of a private server."""
        if not self.is_private:
            return
        self._presence.execute("REVOKE CONNECT ON DATABASE template1 FROM PUBLIC")
        # Before PostgreSQL 16, whoever may make roles may grant all but superusers to itself, and so could run programs
        # and read files as the server: on this server these roles are superusers.
        self._presence.execute(
            "UPDATE pg_authid SET rolsuper = true WHERE rolname IN "
            "('pg_execute_server_program', 'pg_read_server_files', 'pg_write_server_files')"
        )

    def _sweep(self) -> None:
        """Remove what processes that died left on this server."""
        if self.is_private:
            return
        connection = self._presence
        names = connection.execute(
            "SELECT rolname FROM pg_roles WHERE starts_with(rolname, %s)"
            " UNION SELECT datname FROM pg_database WHERE starts_with(datname, %s) ORDER BY 1",
            [f"{PREFIX}_", f"{PREFIX}_"],
        ).fetchall()
        alive = {row[0] for row in connection.execute("SELECT application_name FROM pg_stat_activity").fetchall()}
        owners = {f"{PREFIX}_{found['owner']}" for (name,) in names if (found := _OURS.fullmatch(name))}
        for owner in owners - alive:
            roles.remove(connection, owner)

    def _stop_private(self) -> None:
        if self._private is not None:
            self._private.stop()


_LOCKED = (
    f"another episode on this server has made roles, which belong to all of it, for more than {_LOCK_S} s; run such "
    f"tasks one at a time (--num-envs 1), or unset {SERVER_VARIABLE} to have private servers"
)


def _stop(presence: Connection, private: PrivateServer | None, owner: str, process: int) -> None:
    """Remove everything of an owner at the end of its process; not in a forked child."""
    if process != os.getpid():
        return
    if private is None:
        with contextlib.suppress(psycopg.Error):
            roles.remove(presence, owner)
    presence.close()
    if private is not None:
        private.stop()


_servers: list[Server] = []
_servers_of = os.getpid()
_lock = threading.Lock()


def lease(*, exclusive: bool = False) -> tuple[Server, contextlib.ExitStack]:
    """Return the server that the environments of this process share, which is started at the first call.

    Args:
        exclusive: For a task that makes roles, which belong to a whole server: one on which no other such task is under
            way. Where the private ones are taken another is started; the named one is waited for.

    Returns:
        The server, and a stack to be closed at the end of the episode.
    """
    global _servers_of
    with _lock:
        if _servers_of != os.getpid():  # a forked child has servers of its own
            _servers.clear()
            _servers_of = os.getpid()
        named = named_server()
        for server in (each for each in _servers if each.named == named):
            if not exclusive:
                return server, contextlib.ExitStack()
            if named is not None:
                break
            if (held := server.lock_roles()) is not None:
                return server, held
        else:
            server = Server(named)
            held = server.lock_roles() if exclusive else None
            _servers.append(server)
            return server, held or contextlib.ExitStack()
    return server, server.lock_roles() or contextlib.ExitStack()
