"""Verify the task archive_function."""

from __future__ import annotations

from gem_mcpmark.sample_checks import Connection, expect_original, expect_rows, run

MOVED = 87  # of the 107 that came back before 2025, 20 have a fee


def verify(connection: Connection) -> None:
    """Call the function, twice."""
    expect_original(connection, "members", "tools", "loans", "fees")
    expect_rows(connection, "SELECT count(*) FROM public.loans_archive", [(0,)])
    all_loans = "SELECT md5(string_agg(each::text, '/' ORDER BY each::text)) FROM ({}) each"
    columns = "loan_id, tool_id, member_id, lent_on, due_on, returned_on"
    before = connection.execute(all_loans.format(f"SELECT {columns} FROM public.loans")).fetchall()
    expect_rows(connection, "SELECT public.archive_loans(DATE '2025-01-01')", [(MOVED,)])
    expect_rows(connection, "SELECT count(*) FROM public.loans", [(160 - MOVED,)])
    both = f"SELECT {columns} FROM public.loans UNION ALL SELECT {columns} FROM public.loans_archive"
    expect_rows(connection, all_loans.format(both), before)
    expect_rows(
        connection,
        "SELECT count(*) FROM public.loans_archive WHERE returned_on >= DATE '2025-01-01' OR returned_on IS NULL "
        "OR loan_id IN (SELECT loan_id FROM public.fees)",
        [(0,)],
    )
    expect_rows(connection, "SELECT public.archive_loans(DATE '2025-01-01')", [(0,)])


run(verify)
