"""Verify the task category_ranking."""

from __future__ import annotations

from gem_mcpmark.sample_checks import Connection, expect_original, expect_rows, run

RANKING = [
    ("building", "extension ladder", 9, 1),
    ("building", "paint sprayer", 9, 1),
    ("building", "spirit level", 9, 1),
    ("building", "plaster mixer", 8, 4),
    ("building", "tile cutter", 8, 4),
    ("garden", "hedge trimmer", 10, 1),
    ("garden", "leaf rake", 8, 2),
    ("garden", "pruning loppers", 8, 2),
    ("garden", "post digger", 7, 4),
    ("garden", "wheelbarrow", 7, 4),
    ("hand", "bolt cutter", 8, 1),
    ("hand", "claw hammer", 7, 2),
    ("hand", "hand saw", 7, 2),
    ("hand", "pipe wrench", 7, 2),
    ("hand", "wood plane", 5, 5),
    ("power", "circular saw", 10, 1),
    ("power", "heat gun", 10, 1),
    ("power", "angle grinder", 9, 3),
    ("power", "cordless drill", 8, 4),
    ("power", "jigsaw", 6, 5),
]
LATER = [("hand", "claw hammer", 9, 1), ("hand", "bolt cutter", 8, 2), ("hand", "vice", 0, 6)]


def verify(connection: Connection) -> None:
    """Compare the view with the ranking, now and after two more loans and a new tool."""
    ranking = "SELECT category, tool, times_lent, place FROM public.tool_ranking"
    expect_rows(connection, f"{ranking} ORDER BY category, place, tool", RANKING)
    expect_original(connection, "members", "tools", "loans", "fees")
    connection.execute("INSERT INTO public.tools VALUES (99, 'vice', 'hand', 30, 'new')")
    for month in ("07", "08"):
        values = f"VALUES (6, 1, DATE '2025-{month}-01', DATE '2025-{month}-08')"
        connection.execute(f"INSERT INTO public.loans (tool_id, member_id, lent_on, due_on) {values}")
    some = "WHERE tool IN ('claw hammer', 'bolt cutter', 'vice') ORDER BY place"
    expect_rows(connection, f"{ranking} {some}", LATER)


run(verify)
