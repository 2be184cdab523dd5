"""Verify the task front_desk_role."""

from __future__ import annotations

import psycopg

from gem_mcpmark.sample_checks import Connection, Unsolved, expect_original, expect_refused, expect_rows, run

ALLOWED = [
    "SELECT name, condition FROM public.tools",
    "SELECT returned_on FROM public.loans",
    "INSERT INTO public.loans (tool_id, member_id, lent_on, due_on) VALUES (1, 1, DATE '2025-07-01', '2025-07-08')",
    "UPDATE public.loans SET returned_on = DATE '2025-06-30' WHERE loan_id = 159",
    "SELECT member_id, name FROM public.member_names",
]
FORBIDDEN = [
    "SELECT email FROM public.members",
    "SELECT name FROM public.members",
    "SELECT amount FROM public.fees",
    "UPDATE public.loans SET due_on = DATE '2026-01-01' WHERE loan_id = 159",
    "DELETE FROM public.loans WHERE loan_id = 159",
    "UPDATE public.tools SET price = 0",
    "INSERT INTO public.tools VALUES (99, 'vice', 'hand', 30, 'new')",
    "UPDATE public.member_names SET name = 'Nobody'",
    "DELETE FROM public.member_names",
]


def verify(connection: Connection) -> None:
    """Try what the role may do, and what it may not."""
    rights = "rolcanlogin, rolsuper, rolcreaterole, rolcreatedb, rolbypassrls"
    expect_rows(connection, f"SELECT {rights} FROM pg_roles WHERE rolname = 'front_desk'", [(False,) * 5])
    expect_original(connection, "members", "tools", "loans", "fees")
    expect_rows(connection, "SELECT count(*), sum(member_id) FROM public.member_names", [(23, 276)])
    connection.execute("SET ROLE front_desk")
    for statement in ALLOWED:
        try:
            with connection.transaction(force_rollback=True):
                connection.execute(statement)
        except psycopg.errors.InsufficientPrivilege as error:
            raise Unsolved(f"front_desk cannot execute {statement!r}: {error}") from error
    for statement in FORBIDDEN:
        expect_refused(connection, statement, because=psycopg.errors.InsufficientPrivilege)
    connection.execute("RESET ROLE")


run(verify)
