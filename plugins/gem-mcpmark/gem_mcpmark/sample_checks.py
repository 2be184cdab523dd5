"""What the verifiers of the sample tasks share: they connect by MCPMark's variables, and exit with 0 or 1."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

import psycopg

ORIGINAL = {
    "members": "4c230aef15e2b5f14fde0f7ae3b181ea",
    "tools": "458e7511124dedef46e297850ebe98a9",
    "loans": "a5e44bfe1809f28b43c8d9b6e6568b85",
    "fees": "dbeeebba64a649aab1c685cf18ac4aca",
}
"""MD5 of the rows of each table as the tasks begin."""

Connection = psycopg.Connection[tuple[Any, ...]]


class Unsolved(Exception):
    """Something in the database is not as the task asks."""


def run(verify: Callable[[Connection], None]) -> None:
    """Exit with 0 where ``verify`` finds nothing wrong, else with 1, and print what."""
    connection: Connection = psycopg.connect(
        host=os.environ["POSTGRES_HOST"],
        port=os.environ["POSTGRES_PORT"],
        dbname=os.environ["POSTGRES_DATABASE"],
        user=os.environ["POSTGRES_USERNAME"],
        password=os.environ["POSTGRES_PASSWORD"],
    )
    with connection:
        try:
            verify(connection)
        except (Unsolved, psycopg.Error) as error:
            sys.exit(f"not solved: {error}")
        finally:
            connection.rollback()  # what was tried leaves no trace
    sys.stdout.write("solved\n")


def expect_rows(connection: Connection, query: str, expected: Sequence[tuple[Any, ...]]) -> None:
    """Raise ``Unsolved`` where a query does not return these rows, in this order."""
    # A table that the agent has made may hold any number of rows.
    found = connection.execute(query).fetchmany(len(expected) + 1)
    if [tuple(map(str, row)) for row in found] != [tuple(map(str, row)) for row in expected]:
        raise Unsolved(f"{query!r} returns other rows than expected; the first are {found[:3]}")


def expect_original(connection: Connection, *tables: str) -> None:
    """Raise ``Unsolved`` where the rows of a table are not those that it had."""
    for table in tables:
        query = f"SELECT md5(string_agg(each::text, '/' ORDER BY each::text)) FROM public.{table} each"
        found = connection.execute(query).fetchone()
        if found is None or found[0] != ORIGINAL[table]:
            raise Unsolved(f"the rows of {table} are not those that it had")


def expect_refused(connection: Connection, statement: str, *, because: type[psycopg.Error] = psycopg.Error) -> None:
    """Raise ``Unsolved`` where the database lets a statement pass that it should refuse."""
    try:
        with connection.transaction(force_rollback=True):
            connection.execute(statement)
    except because:
        return
    raise Unsolved(f"the database does not refuse {statement!r}")
