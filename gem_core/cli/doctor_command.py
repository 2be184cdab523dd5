"""``gem doctor``: what is installed, what is broken, and what is missing."""

from __future__ import annotations

import json
import textwrap
from typing import Any

import click

from gem_core.cli.diagnosis import diagnose, offers_in_words, status_line
from gem_core.cli.layout import output_width

_WIDTH = 80  # at most
_INDENT = 4
_COLOURS = {"met": "green", "unmet": "red", "untried": "yellow", "unknown": "yellow"}


@click.command(
    "doctor",
    epilog="""\b
Examples:
  gem doctor
  gem doctor --json > report.json     what a report of a bug should have with it
\b
A requirement is met, unmet, untried (known only when it is used, as the network) or unknown (a word
of a plugin's own). Of keys only the presence is looked at, and nothing is sent anywhere but a ping to
the container engine.
\b
Tools say what is in force here, as the level of a sandbox. All that plugins point to is imported, each
plugin in an interpreter of its own, which takes some seconds; --quick leaves that out. That an environment
keeps its promises is shown by 'pytest --gem-envs ID'.

\b
Exit code: 1 when something installed is broken, 0 otherwise, whatever requirements are unmet.
""",
)
@click.option("--quick", is_flag=True, help="Do not import what plugins point to.")
@click.option("--json", "as_json", is_flag=True, help="Write one JSON object.")
@click.pass_context
def command(ctx: click.Context, quick: bool, as_json: bool) -> None:
    """Find out what is installed, what is broken and why, and what is missing to run the rest.

    Shows versions, every plugin with the time that it takes to load, the traceback of each that failed, how the tools
    stand on this machine, and what the environments require of it with the way to get it.
    """
    found = diagnose(quick=quick)
    if as_json:
        click.echo(json.dumps(found, indent=1))
    else:
        _print_versions(found)
        _print_plugins(found)
        _print_tools(found["tools"])
        _print_requirements(found["requirements"])
        _print_rest(found)
        _print_verdict(found)
    ctx.exit(1 if found["broken"] else 0)


def _print_versions(found: dict[str, Any]) -> None:
    _heading("Versions")
    _row(f"gem-core {found['gem_core']}, {found['implementation']} {found['python']} on {found['platform']}")
    _row(", ".join(f"{name} {version or 'missing'}" for name, version in found["packages"].items()))


def _print_plugins(found: dict[str, Any]) -> None:
    _heading("Plugins")
    for plugin in found["plugins"]:
        failure = plugin["failure"]
        state, colour = ("disabled", "yellow") if plugin["disabled"] else ("ok", "green")
        if failure:
            state, colour = "broken", "red"
        what = f"at stage '{failure['stage']}'" if failure else "" if plugin["disabled"] else offers_in_words(plugin)
        name = f"{plugin['name']} ({plugin['distribution']} {plugin['version']})"
        _row(f"{name}, {plugin['load_time_ms']:.1f} ms: {what}".removesuffix(": "), state, colour)
        if failure:
            for line in failure["traceback"].rstrip().splitlines():
                click.echo(f"{'':{_INDENT + 8}}{line}")
    for line in found["notes"]:
        _row(line, "note", "yellow")


def _print_tools(tools: list[dict[str, Any]]) -> None:
    _heading("Tools")
    for tool in tools:
        status = status_line(tool["status"])
        text = " ".join(str(tool["error"] or status or tool["summary"]).split())
        state, colour = ("broken", "red") if tool["error"] else ("ok", "green") if status else ("", None)
        _row(f"{tool['tool']}: {text}" if text else tool["tool"], state, colour)
    if not tools:
        _row("none is installed; 'pip install gem-tools' brings some")


def _print_requirements(rows: list[dict[str, Any]]) -> None:
    _heading("Requirements")
    for row in rows:
        count, name = row["environments"], row["requirement"]
        if name.startswith("never:"):
            name = "never"
        needed = "no environment needs it" if not count else f"{row['example']} needs it"
        if count > 1:
            needed = f"{count} environments need it, as {row['example']}"
        # Nobody need act on what nothing needs.
        state, colour = (row["status"], _COLOURS[row["status"]]) if count else (row["status"], None)
        _row(f"{name}: {row['detail']}; {needed}", state, colour)
        if count and row["advice"]:
            _row(f"→ {row['advice']}", "", None)


def _print_rest(found: dict[str, Any]) -> None:
    _heading("Extras and surroundings")
    for extra in found["extras"]:
        packages = ", ".join(f"{name} {version or 'missing'}" for name, version in extra["packages"].items())
        advice = "" if extra["present"] else f"; pip install 'gem-core[{extra['extra']}]'"
        state, colour = ("there", "green") if extra["present"] else ("absent", None)
        _row(f"{extra['extra']}: {packages}{advice}", state, colour)
    program = found["command"]
    advice = f"; {program['advice']}" if program["advice"] else ""
    _row(
        f"command gem: {program['detail']}{advice}",
        *(("ok", "green") if program["status"] == "met" else ("note", "yellow")),
    )


def _print_verdict(found: dict[str, Any]) -> None:
    _heading("Verdict")
    for line in found["broken"]:
        _row(line, "broken", "red")
    unmet = [row for row in found["requirements"] if row["status"] == "unmet" and row["environments"]]
    if unmet:
        _row(f"{len(unmet)} unmet requirement{'s' if len(unmet) > 1 else ''}, see the arrows above", "note", "yellow")
    if not found["broken"]:
        _row("nothing that is installed is broken", "ok", "green")


def _heading(text: str) -> None:
    click.echo(click.style(text, bold=True))


def _row(text: str, state: str = "", colour: str | None = None) -> None:
    margin = " " * _INDENT
    label = state.ljust(8)
    width = min(output_width() or _WIDTH, _WIDTH) - _INDENT - len(label)
    first, *rest = textwrap.wrap(text, width, break_on_hyphens=False, break_long_words=False) or [""]
    click.echo(f"{margin}{click.style(label, fg=colour) if colour else label}{first}")
    for line in rest:
        click.echo(f"{margin}{'':8}{line}")
