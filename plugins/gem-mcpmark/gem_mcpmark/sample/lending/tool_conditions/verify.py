"""Verify the task tool_conditions."""

from __future__ import annotations

import psycopg

from gem_mcpmark.sample_checks import Connection, expect_original, expect_refused, expect_rows, run

_FIRST = "worn good good good good worn worn new good good"
_LAST = "good worn good broken good new new worn worn worn"
CONDITIONS = f"{_FIRST} {_LAST}".split()


def verify(connection: Connection) -> None:
    """Compare the words, then try others."""
    expect_rows(
        connection, "SELECT tool_id, condition FROM public.tools ORDER BY tool_id", list(enumerate(CONDITIONS, 1))
    )
    for word in ("used", "Good", " new", ""):
        statement = f"UPDATE public.tools SET condition = '{word}' WHERE tool_id = 1"
        expect_refused(connection, statement, because=psycopg.errors.Error)
    for word in ("new", "good", "worn", "broken"):
        with connection.transaction(force_rollback=True):
            connection.execute(f"UPDATE public.tools SET condition = '{word}' WHERE tool_id = 1")
    others = (
        "SELECT md5(string_agg(concat_ws('/', tool_id, name, category, price), '/' ORDER BY tool_id)) FROM public.tools"
    )
    expect_rows(connection, others, [("8a038bddbdcbee3fbd1d3f14d7dff494",)])
    expect_original(connection, "members", "loans", "fees")


run(verify)
