"""``gem mcp``: what MCP servers offer, and what is wrong with them."""

from __future__ import annotations

import importlib.metadata
import json
import shutil
from dataclasses import replace
from typing import Any

import click

from gem_core.errors import ArgumentError, GemError, MissingRequirementError

_INSTALL = "pip install 'gem-tools[mcp]'"


@click.group("mcp")
def command() -> None:
    """Show what MCP servers offer, and what is wrong with them."""


@command.command(
    "list",
    epilog="""\b
Examples:
  gem mcp list servers.json
  gem mcp list --command "npx -y @modelcontextprotocol/server-filesystem ."
  gem mcp list --url http://127.0.0.1:8000/mcp --json
\b
CONFIG is an mcpServers file, as Claude Desktop, Cursor and VS Code have them. An agent gets the tools by
  gem.make(…, wrappers=[("mcp", {"config": "servers.json"})])
\b
Exit code: 0 if every server answered, else 1.
""",
)
@click.argument("config", required=False, type=click.Path())
@click.option("--command", "command_line", help="Program of one server, with its arguments.")
@click.option("--url", help="Address of one server that runs already.")
@click.option("--transport", type=click.Choice(["http", "sse"]), help="Protocol of that address.")
@click.option(
    "--timeout",
    type=click.FloatRange(0, min_open=True),
    default=30.0,
    show_default=True,
    help="Most seconds to wait for a server.",
)
@click.option("--json", "as_json", is_flag=True, help="Write JSON.")
def list_servers(as_json: bool, **choice: Any) -> None:
    """Start or reach the servers of CONFIG, or one by option, and show their tools."""
    report = _report(**choice)
    if as_json:
        click.echo(json.dumps(report, indent=2, ensure_ascii=False))
    else:
        _show(report)
    broken = [entry["name"] for entry in report if entry["error"]]
    if broken:
        raise GemError(f"{len(broken)} of {len(report)} MCP servers cannot be used: {', '.join(broken)}")


def _report(
    config: str | None, command_line: str | None, url: str | None, transport: str | None, timeout: float
) -> list[dict[str, Any]]:
    try:
        from gem_tools.mcp.listing import asked
    except ModuleNotFoundError as missing:
        raise MissingRequirementError(f"gem mcp needs the package {missing.name}: {_INSTALL}") from missing
    from gem_tools.mcp.config import from_keywords, read_config
    from gem_tools.mcp.names import tool_names

    if sum(choice is not None for choice in (config, command_line, url)) != 1:
        raise ArgumentError(
            "name either a CONFIG file, or one server by --command or by --url; see 'gem mcp list --help'"
        )
    options = {"command": command_line, "url": url, "transport": transport}
    servers = [from_keywords(options)] if config is None else read_config(config)
    servers = [replace(server, connect_s=timeout) for server in servers]
    found = list(zip(servers, asked(servers), strict=True))
    names = iter(tool_names([(server.name, offer.name) for server, listing in found for offer in listing.tools]))
    report: list[dict[str, Any]] = []
    for server, listing in found:
        tools = [
            {"name": next(names), "server_tool": offer.name, "description": offer.description, "schema": offer.schema}
            for offer in listing.tools
        ]
        error = None if listing.error is None else str(listing.error)
        entry = {"name": server.name, "transport": server.transport, "place": server.place, "error": error}
        report.append({**entry, "tools": tools, "problems": listing.problems})
    return report


def _show(report: list[dict[str, Any]]) -> None:
    from gem_tools.mcp.text import shortened

    for entry in report:
        click.echo(f"{entry['name']} ({entry['transport']}: {entry['place']})")
        if entry["error"]:
            click.echo(f"  error: {entry['error']}")
        for tool in entry["tools"]:
            click.echo(f"  {tool['name']}: {shortened(tool['description'], 100)}".rstrip(": "))
        for problem in entry["problems"]:
            click.echo(f"  note: {problem}")


def status() -> dict[str, str]:
    """Return what ``gem doctor`` says: the client's version, and which launchers of servers this machine has."""
    launchers = [name for name in ("npx", "uvx", "pipx", "docker") if shutil.which(name)]
    try:
        client = f"mcp {importlib.metadata.version('mcp')}"
    except importlib.metadata.PackageNotFoundError:
        client = f"is not installed: {_INSTALL}"
    return {"client": client, "launchers": ", ".join(launchers) or "none"}
