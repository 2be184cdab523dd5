"""``gem mcp list``, and what ``gem doctor`` says of the tool ``mcp``."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from mcp_helping import BAD_SERVER, wait_until_no_server_runs

from gem_core import cli


@pytest.fixture
def config(tmp_path: Path) -> str:
    """A file of a server that works, one that has two tools of a name, one that is broken, and one that is disabled."""

    def server(*ways: str, **more: object) -> dict[str, object]:
        return {"command": sys.executable, "args": ["-S", BAD_SERVER, *ways], **more}

    servers = {
        "good": server("pages"),
        "twice": server("duplicates"),
        "broken": server("die-at-start"),
        "off": server(disabled=True),
    }
    path = tmp_path / "servers.json"
    path.write_text(json.dumps({"mcpServers": servers}))
    return str(path)


def run(*words: str) -> int:
    """Run the command ``gem`` and return its exit code."""
    with pytest.raises(SystemExit) as caught:
        cli.main(["mcp", "list", *words])
    return int(caught.value.code or 0)


def test_it_shows_servers_tools_and_what_is_wrong(config, capsys):
    assert run(config) == 1
    shown = capsys.readouterr()
    lines = shown.out.splitlines()
    assert f"good (stdio: {sys.executable})" in lines
    assert "  good_echo: Does echo." in lines
    assert "  twice_echo: Does echo." in lines
    assert "  note: it has several tools of the name 'echo'; only the first is used" in lines
    assert not [line for line in lines if line.startswith("off")]
    (error,) = [line for line in lines if line.startswith("  error: ")]
    assert "its standard error ends with: cannot open the database" in error
    assert "1 of 3 MCP servers cannot be used: broken" in shown.err
    wait_until_no_server_runs()


def test_json_is_for_machines(config, capsys):
    assert run(config, "--json") == 1
    good, twice, broken = json.loads(capsys.readouterr().out)
    assert good["tools"][0]["name"] == "good_echo"
    assert good["tools"][0]["server_tool"] == "echo"
    assert good["tools"][0]["schema"]["required"] == ["text"]
    assert twice["problems"]
    assert "cannot open the database" in broken["error"]


def test_one_server_by_its_command_line(capsys):
    assert run("--command", f"{sys.executable} -S {BAD_SERVER}") == 0
    assert "  echo: Does echo." in capsys.readouterr().out.splitlines()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ((), "CONFIG"),
        (("--command", "x", "--url", "http://h"), "CONFIG"),
        (("--command", ""), "key 'command'"),
        (("no-such-file.json",), "no-such-file.json"),
        (("--command", "no-such-program"), "no-such-program"),
    ],
)
def test_errors_say_what_is_wrong(words, named, capsys):
    assert run(*words) in (1, 2)
    assert named in capsys.readouterr().err


def test_doctor_knows_the_client():
    from gem_tools.mcp.command import status

    assert status()["client"].startswith("mcp 2.")
