"""Verify the task one_loan_at_a_time."""

from __future__ import annotations

from gem_mcpmark.sample_checks import ORIGINAL, Connection, expect_original, expect_refused, expect_rows, run

FORGOTTEN = [(100, "2025-03-11"), (134, "2025-04-09"), (148, "2025-06-19")]
LEND = "INSERT INTO public.loans (tool_id, member_id, lent_on, due_on) VALUES ({}, 1, '2025-07-01', '2025-07-08')"


def verify(connection: Connection) -> None:
    """Look at the forgotten loans, then lend tools that are out, and one that is not."""
    listed = ", ".join(str(loan) for loan, _ in FORGOTTEN)
    expect_rows(
        connection, f"SELECT loan_id, returned_on FROM public.loans WHERE loan_id IN ({listed}) ORDER BY 1", FORGOTTEN
    )
    before = f"CASE WHEN loan_id NOT IN ({listed}) THEN returned_on END"
    row = f"ROW(loan_id, tool_id, member_id, lent_on, due_on, {before})::text"
    digest = f"SELECT md5(string_agg({row}, '/' ORDER BY {row})) FROM public.loans"
    expect_rows(connection, digest, [(ORIGINAL["loans"],)])
    expect_refused(connection, LEND.format(20))
    expect_refused(connection, "UPDATE public.loans SET returned_on = NULL WHERE tool_id = 20")
    with connection.transaction(force_rollback=True):
        connection.execute(
            "UPDATE public.loans SET returned_on = DATE '2025-06-30' WHERE tool_id = 20 AND returned_on IS NULL"
        )
        connection.execute(LEND.format(20))
    expect_original(connection, "members", "tools", "fees")


run(verify)
