"""Verify the task overdue_list."""

from __future__ import annotations

from gem_mcpmark.sample_checks import Connection, expect_original, expect_rows, run

OVERDUE = [
    (100, "Bruno Ibsen", "wood plane", 211),
    (134, "Sami Engel", "pruning loppers", 101),
    (146, "Sami Jansen", "extension ladder", 54),
    (148, "Rosa Brandt", "angle grinder", 39),
    (149, "Bruno Ibsen", "heat gun", 38),
    (153, "Sami Abel", "wheelbarrow", 25),
    (154, "Mira Abel", "tile cutter", 23),
    (159, "Hanna Brandt", "hedge trimmer", 8),
]


def verify(connection: Connection) -> None:
    """Compare the table with what was worked out by hand."""
    expect_rows(connection, "SELECT loan_id, member, tool, days_late FROM public.overdue ORDER BY loan_id", OVERDUE)
    expect_original(connection, "members", "tools", "loans", "fees")


run(verify)
