"""``gem doctor``: what is installed, what is broken, and what is missing."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any

import click

from gem_core.cli.diagnosis import diagnose, offers_in_words, status_line
from gem_core.cli.documented import Documented
from gem_core.cli.layout import counted, output_width, wrapped

_WIDTH = 80  # at most
_INDENT = 12
_COLOURS = {"ok": "green", "met": "green", "broken": "red", "unmet": "red", "note": "yellow", "disabled": "yellow"}


@click.command("doctor", cls=Documented)
@click.option("--quick", is_flag=True, help="Do not import what plugins offer.")
@click.option("--json", "as_json", is_flag=True, help="Write one JSON object.")
@click.pass_context
def command(ctx: click.Context, quick: bool, as_json: bool) -> None:
    """Find out what is installed, what is broken and why, and what is missing to run the rest.

    Shows versions, plugins with their load times, the traceback of each failure, the state of tools on this machine,
    and what environments require, with what to type to get it.

    Examples:
      gem doctor
      gem doctor --json > report.json     to send with a report of a bug

    A requirement is met, unmet, untried (as the network, which is known only when it is used) or unknown (a
    plugin's own word). Keys are only looked for. Nothing is sent but a ping to the container engine.

    Tools show what is in force here, such as the level of a sandbox. What plugins offer is imported, each plugin
    in its own process, which takes some seconds; --quick skips that. 'pytest --gem-envs ID' checks that an
    environment keeps its promises.

    Exit code: 1 if something installed is broken, else 0; unmet requirements do not count.
    """
    found = diagnose(quick=quick)
    if as_json:
        click.echo(json.dumps(found, indent=1))
    else:
        _print_section("Versions", _versions(found))
        _print_section("Plugins", map(_plugin, found["plugins"]))
        none = [("", "none is installed; 'pip install gem-tools' brings some")]
        _print_section("Tools", list(map(_tool, found["tools"])) or none)
        _print_section("Requirements", (row for each in found["requirements"] for row in _requirement(each)))
        broken = [("broken", line) for line in found["broken"]]
        _print_section("Verdict", broken or [("ok", "nothing that is installed is broken")])
    ctx.exit(1 if found["broken"] else 0)


def _versions(found: dict[str, Any]) -> Iterator[tuple[str, str]]:
    yield "", f"gem-core {found['gem_core']}, {found['implementation']} {found['python']} on {found['platform']}"
    yield "", ", ".join(f"{name} {version or 'missing'}" for name, version in found["packages"].items())


def _plugin(plugin: dict[str, Any]) -> tuple[str, str]:
    name = f"{plugin['name']} ({plugin['distribution']} {plugin['version']})"
    if plugin["failure"]:
        return "broken", f"{name}\n{plugin['failure']['traceback'].rstrip()}"
    if plugin["disabled"]:
        return "disabled", name
    return "ok", f"{name}, {plugin['load_time_ms']:.1f} ms: {offers_in_words(plugin)}"


def _tool(tool: dict[str, Any]) -> tuple[str, str]:
    status = status_line(tool["status"])
    state = "broken" if tool["error"] else "ok" if status else ""
    return state, f"{tool['tool']}: {status_line(tool['error']) or status or tool['summary']}".removesuffix(": ")


def _requirement(row: dict[str, Any]) -> Iterator[tuple[str, str]]:
    name = "never" if row["requirement"].startswith("never:") else row["requirement"]
    needed = f"needed by {counted(row['environments'], 'environment')}, as {row['example']}"
    yield row["status"], f"{name}: {row['detail']}; {needed}"
    if row["advice"]:
        yield "", f"→ {row['advice']}"


def _print_section(title: str, rows: Iterable[tuple[str, str]]) -> None:
    """Print rows under a title, each behind its state; long ones are broken between words."""
    width = min(output_width() or _WIDTH, _WIDTH)
    click.secho(title, bold=True)
    for state, text in rows:
        first, *rest = (piece for line in text.split("\n") for piece in wrapped(line, width - _INDENT))
        click.echo(f"    {click.style(f'{state:<8}', fg=_COLOURS.get(state))}{first}")
        for line in rest:
            click.echo(" " * _INDENT + line)
