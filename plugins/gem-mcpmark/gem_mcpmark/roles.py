"""Which databases and roles belong to an owner, those included that its episodes made by other names."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable
from typing import Any

import psycopg
from psycopg import sql
from psycopg.rows import TupleRow

logger = logging.getLogger(__name__)

Connection = psycopg.Connection[TupleRow]

# Since PostgreSQL 16, who makes a role is made a member of it by the server itself (role 10), and cannot undo that.
_MADE_BY = """
WITH RECURSIVE made(oid) AS (
    SELECT oid FROM pg_roles WHERE rolname = %s OR starts_with(rolname, %s)
    UNION
    SELECT member_of.roleid FROM pg_auth_members member_of JOIN made ON member_of.member = made.oid
    WHERE member_of.admin_option AND member_of.grantor = 10
)
SELECT oid FROM made
"""


def snapshot(connection: Connection, words: Iterable[str] | None) -> str:
    """Return a note of the roles that there are, which is kept on the server as the comment of an episode's role.

    Args:
        connection: Of the administrator.
        words: Names that the task may give to roles; None where all new roles are its own, as on a private server.
    """
    known = [row[0] for row in connection.execute("SELECT oid FROM pg_roles").fetchall()]
    return json.dumps({"known": known, "words": None if words is None else sorted(words)})


def made(connection: Connection, role: str) -> list[str]:
    """Return the names of the roles that an episode made, by the note on its role; none where there is no note.

    On a server that others use too, a new role is the episode's where the server has recorded that; before PostgreSQL
    16, which does not, where the task's files have its name.
    """
    found = connection.execute(
        "SELECT shobj_description(oid, 'pg_authid') FROM pg_roles WHERE rolname = %s", [role]
    ).fetchone()
    if found is None or found[0] is None:
        return []
    note: dict[str, Any] = json.loads(found[0])
    recorded = {row[0] for row in connection.execute(_MADE_BY, [role, f"{role}_"]).fetchall()}
    new = connection.execute(
        "SELECT oid, rolname FROM pg_roles WHERE NOT oid = ANY(%s) AND NOT rolname LIKE 'gem\\_mcpmark\\_%%' "
        "AND NOT rolname LIKE 'pg\\_%%' AND NOT rolsuper",
        [note["known"]],
    ).fetchall()
    if note["words"] is None:
        return [name for _, name in new]
    words = note["words"] if connection.info.server_version < 160000 else ()
    return [name for oid, name in new if oid in recorded or name.lower() in words]


def remove(connection: Connection, owner: str) -> None:
    """Drop the databases and roles whose names begin with that of an owner, and the roles that its episodes made."""
    prefix = f"{owner}_"
    ours = [row[0] for row in connection.execute(
        "SELECT rolname FROM pg_roles WHERE starts_with(rolname, %s) ORDER BY 1", [prefix]
    ).fetchall()]  # fmt: skip
    doomed = [name for role in ours for name in made(connection, role)]
    databases = connection.execute("SELECT datname FROM pg_database WHERE starts_with(datname, %s)", [prefix])
    for (name,) in databases.fetchall():
        drop_database(connection, name)
    drop_roles(connection, [*dict.fromkeys(doomed), *ours])


def drop_database(connection: Connection, name: str) -> None:
    """Drop a database, whoever is connected to it."""
    connection.execute(sql.SQL("DROP DATABASE IF EXISTS {} WITH (FORCE)").format(sql.Identifier(name)))


def drop_roles(connection: Connection, names: Iterable[str]) -> None:
    """Drop roles in one statement, since one may have granted another; one that cannot be dropped is logged."""
    listed = list(names)
    if not listed:
        return
    try:
        drop = sql.SQL("DROP ROLE IF EXISTS {}").format(sql.SQL(", ").join(map(sql.Identifier, listed)))
        connection.execute(drop)
    except psycopg.errors.DependentObjectsStillExist as error:
        if len(listed) == 1:
            logger.warning("gem-mcpmark: the role %s could not be dropped: %s", listed[0], error)
            return
        for name in listed:
            drop_roles(connection, [name])
