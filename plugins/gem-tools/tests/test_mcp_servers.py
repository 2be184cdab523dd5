"""The tool ``mcp`` with real servers; ``scripts/mcp_servers.sh`` installs them, and what is not there is skipped."""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcp_helping import around, step, wait_until_no_server_runs

from gem_core.data import DatasetEnv
from gem_core.tools import ToolEnv

pytestmark = pytest.mark.thorough

ROOT = Path(__file__).resolve().parents[3]
SERVERS = Path(os.environ.get("GEM_MCP_SERVERS", ROOT / ".venv-mcp"))
SQL_SERVER = Path(__file__).parents[1] / "gem_tools" / "mcp" / "sql_server.py"


def program(path: str) -> str:
    """Return the path of a server's program; skip where it is not installed."""
    found = SERVERS / path
    if not found.exists():
        pytest.skip(f"{path} is not installed; run scripts/mcp_servers.sh")
    if path.startswith("npm") and shutil.which("node") is None:
        pytest.skip("there is no node")
    return str(found)


@pytest.fixture(autouse=True)
def nothing_left() -> Iterator[None]:
    """Every server is gone after its test."""
    yield
    wait_until_no_server_runs()


def test_time():
    env = around(("mcp", {"command": program("python/bin/mcp-server-time"), "args": ["--local-timezone", "UTC"]}))
    observation, info = step(env, "convert_time", source_timezone="UTC", time="12:00", target_timezone="Asia/Tokyo")
    assert info["structured"]["time_difference"] == "+9.0h"
    assert "T21:00:00+09:00" in observation
    assert step(env, "get_current_time", timezone="No/Where")[1]["failed"]
    env.close()


@pytest.mark.parametrize("transport", ["stdio", "streamableHttp", "sse"])
def test_everything(transport, tmp_path):
    """The server that uses all of the protocol, over each transport."""
    command = program("npm/node_modules/.bin/mcp-server-everything")
    process = None
    if transport == "stdio":
        choice = ("mcp", {"command": command, "args": ["stdio"]})
    else:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        process = subprocess.Popen(
            [command, transport], env={**os.environ, "PORT": str(port)}, stderr=subprocess.PIPE, text=True
        )
        for line in process.stderr:
            if re.search(r"listening|running|started", line, re.IGNORECASE):
                break
        path = "mcp" if transport == "streamableHttp" else "sse"
        choice = ("mcp", {"url": f"http://127.0.0.1:{port}/{path}"})
    try:
        env = around(choice)
        assert "hello" in step(env, "echo", message="hello")[0]
        assert "5" in step(env, "get-sum", a=2, b=3)[0]
        parts, _ = step(env, "get-tiny-image")
        assert [part["image"].format for part in parts if part["type"] == "image"] == ["PNG"]
        assert json.loads(json.dumps(step(env, "get-structured-content", location="New York")[1]["structured"]))
        env.close()
    finally:
        if process is not None:
            process.terminate()
            process.communicate(timeout=30)


# PostgreSQL.


@pytest.fixture(scope="module")
def database() -> Iterator[str]:
    """A PostgreSQL of our own on loopback; its address."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/pg_ctl")) or [p for p in [shutil.which("pg_ctl")] if p]
    if not found:
        pytest.skip("PostgreSQL is not installed")
    binaries = Path(found[-1]).parent
    folder = tempfile.mkdtemp(prefix="gem-postgres-")
    as_user: list[str] = []
    if os.getuid() == 0:  # as which PostgreSQL refuses to run
        try:
            shutil.chown(folder, "postgres")
        except LookupError:
            pytest.skip("PostgreSQL does not run as root, and there is no user postgres")
        as_user = ["runuser", "-u", "postgres", "--"]
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    data = f"{folder}/data"

    def run(*command: str) -> None:
        subprocess.run([*as_user, *command], check=True, cwd="/", stdout=subprocess.DEVNULL, timeout=120)

    options = f"-p {port} -c listen_addresses=127.0.0.1 -c unix_socket_directories={folder} -c fsync=off"
    try:
        run(str(binaries / "initdb"), "-D", data, "-U", "gem", "-A", "trust", "--no-sync", "-E", "UTF8", "--locale=C")
        run(str(binaries / "pg_ctl"), "-D", data, "-w", "-l", f"{folder}/log", "-o", options, "start")
        yield f"postgresql://gem@127.0.0.1:{port}/postgres"
        run(str(binaries / "pg_ctl"), "-D", data, "-m", "immediate", "stop")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def test_postgresql_is_used_in_several_turns(database):
    """An agent finds its way through a database it does not know, changes it, and answers."""
    choice = {"command": program("python/bin/python"), "args": [str(SQL_SERVER)], "env": {"DATABASE_URI": database}}
    task = DatasetEnv([{"question": "What do all items cost together, once tea is one dearer?", "answer": "6"}])
    env = ToolEnv(task, [("mcp", {**choice, "server_name": "shop"})], max_tool_uses=None)
    env.reset(seed=0)
    step(env, "execute_sql", sql="CREATE TABLE item (name text PRIMARY KEY, price int NOT NULL)")
    assert step(env, "execute_sql", sql="INSERT INTO item VALUES ('tea', 3), ('50% milk', 2)")[0] == "INSERT 0 2"
    assert "pg_catalog" in step(env, "list_schemas")[0]
    assert step(env, "list_objects", schema_name="public")[0] == '[{"name": "item"}]'
    assert "columns" in step(env, "list_objects", schema_name="information_schema", object_type="view")[0]
    assert step(env, "list_objects", schema_name="public", object_type="sequence")[0] == "[]"
    assert "plpgsql" in step(env, "list_objects", schema_name="public", object_type="extension")[0]
    details = json.loads(step(env, "get_object_details", schema_name="public", object_name="item")[0])
    assert [column["name"] for column in details["columns"]] == ["name", "price"]
    assert details["constraints"][0]["definition"] == "PRIMARY KEY (name)"
    observation, info = step(env, "execute_sql", sql="SELECT cost FROM item")
    assert 'column "cost" does not exist' in observation
    assert info["failed"]
    assert step(env, "execute_sql", sql="UPDATE item SET price = price + 1 WHERE name = 'tea'")[0] == "UPDATE 1"
    total = json.loads(step(env, "execute_sql", sql="SELECT sum(price) AS total FROM item WHERE name LIKE '%'")[0])
    _, reward, terminated, _, _ = env.step(f"\\boxed{{{total[0]['total']}}}")
    assert (reward, terminated) == (1.0, True)
    env.close()
