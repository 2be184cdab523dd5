"""What the tests of databases share: a skip where there is no PostgreSQL, task folders, and calls of tools."""

from __future__ import annotations

import importlib.util
import json
import os
from pathlib import Path
from typing import Any

import pytest

from gem_mcpmark import read_tasks
from gem_mcpmark.binaries import server_programs

_MISSING = [name for name in ("psycopg", "psycopg2") if importlib.util.find_spec(name) is None]

needs_postgres = pytest.mark.skipif(
    bool(_MISSING) or server_programs() is None or os.name != "posix",
    reason=f"not installed: {', '.join(_MISSING) or 'PostgreSQL'}",
)

NOTHING_TO_DO = "import sys\nsys.exit(0)\n"
CONNECT = (
    "import os, psycopg2\n"
    "connection = psycopg2.connect(host=os.environ['POSTGRES_HOST'], port=os.environ['POSTGRES_PORT'],"
    " dbname=os.environ['POSTGRES_DATABASE'], user=os.environ['POSTGRES_USERNAME'],"
    " password=os.environ['POSTGRES_PASSWORD'])\n"
    "connection.autocommit = True\n"
    "cursor = connection.cursor()\n"
)
FILL = f"{CONNECT}cursor.execute('CREATE TABLE fruit AS SELECT 1 AS id, %s AS name', ['pear'])\n"


def write_task(
    root: Path, *, verify: str, name: str = "shop/fruit", prepare: str | None = FILL, words: str = "Sell all fruit."
) -> Path:
    """Write a task folder; return the folder of all tasks."""
    folder = root / "tasks" / name
    folder.mkdir(parents=True)
    (folder / "description.md").write_text(words)
    (folder / "verify.py").write_text(verify)
    meta = {"category_id": name.partition("/")[0], "difficulty": "L1", "mcp": ["postgres"]}
    (folder / "meta.json").write_text(json.dumps(meta))
    if prepare is not None:
        (folder / "prepare_environment.py").write_text(prepare)
    return root / "tasks"


def episode_of(root: Path) -> Any:
    """Begin an episode of the one task there, without tools."""
    from gem_mcpmark.episode import EpisodeDatabase

    (task,) = read_tasks(root)
    return EpisodeDatabase(task, None)


def agent_of(episode: Any) -> Any:
    """Return a connection as the agent has it."""
    import psycopg

    return psycopg.connect(episode.variables["DATABASE_URI"], autocommit=True)


def execute(env: Any, sql: str) -> tuple[str, dict[str, Any]]:
    """Call the tool ``execute_sql``; return the observation and what the step says of the call."""
    call = {"name": "execute_sql", "arguments": {"sql": sql}}
    observation, _, terminated, truncated, info = env.step(f"<tool_call>{json.dumps(call)}</tool_call>")
    assert not terminated
    assert not truncated
    return observation, info["tool"]
