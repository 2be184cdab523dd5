"""Verify the task missing_fees."""

from __future__ import annotations

from gem_mcpmark.sample_checks import Connection, expect_original, expect_rows, run

CHARGED = {
    **{3: "1.00", 8: "3.30", 13: "0.50", 21: "0.50", 23: "3.90", 48: "0.50", 51: "0.50", 63: "2.50", 68: "1.65"},
    **{117: "1.00", 118: "2.50", 119: "1.80", 123: "0.50", 125: "6.50", 128: "1.00", 135: "0.50", 136: "2.10"},
    **{147: "1.00", 151: "0.50"},
}
OLD_FEES = 25


def verify(connection: Connection) -> None:
    """Look at the new fees, then at the old ones without them."""
    new = f"SELECT loan_id, amount, paid FROM public.fees WHERE fee_id > {OLD_FEES} ORDER BY loan_id"
    expect_rows(connection, new, [(loan, amount, False) for loan, amount in CHARGED.items()])
    with connection.transaction(force_rollback=True):
        connection.execute(f"DELETE FROM public.fees WHERE fee_id > {OLD_FEES}")
        expect_original(connection, "fees")
    expect_original(connection, "members", "tools", "loans")


run(verify)
