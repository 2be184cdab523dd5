"""Verify the task duplicate_members."""

from __future__ import annotations

import psycopg

from gem_mcpmark.sample_checks import Connection, expect_original, expect_refused, expect_rows, run

LOANS_OF = [
    (4, [11, 12, 24, 35, 46, 48, 55, 71, 89, 106, 121, 124, 127, 138, 153]),
    (9, [10, 21, 44, 57, 105, 116, 125, 135, 142]),
]


def verify(connection: Connection) -> None:
    """Look at members and loans, then try to join twice."""
    expect_rows(connection, "SELECT member_id FROM public.members ORDER BY 1", [(number,) for number in range(1, 21)])
    expect_rows(connection, "SELECT count(*) FROM public.members WHERE email <> lower(trim(email))", [(0,)])
    expect_rows(
        connection,
        "SELECT member_id, array_agg(loan_id ORDER BY loan_id) FROM public.loans WHERE member_id IN (4, 9, 21, 22, 23)"
        " GROUP BY 1 ORDER BY 1",
        LOANS_OF,
    )
    expect_rows(connection, "SELECT count(*), sum(loan_id), sum(tool_id) FROM public.loans", [(160, 12880, 1696)])
    expect_original(connection, "tools", "fees")
    second = "INSERT INTO public.members (member_id, name, email, joined_on) SELECT 99, 'Second', {}, DATE '2025-07-01'"
    for address in ("email", "upper(email)"):
        statement = f"{second.format(address)} FROM public.members WHERE member_id = 4"
        expect_refused(connection, statement, because=psycopg.errors.IntegrityError)


run(verify)
