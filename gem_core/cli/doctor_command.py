"""``gem doctor``: what is installed, what is broken, and what is missing."""

from __future__ import annotations

import json
from typing import Any

import click

from gem_core.cli.diagnosis import diagnose, offers_in_words, status_line
from gem_core.cli.documented import Documented
from gem_core.cli.layout import counted, output_width, wrapped

_WIDTH = 80  # at most
_INDENT = 4
_LABEL = 8
_COLOURS = {
    **dict.fromkeys(("ok", "met", "there"), "green"),
    **dict.fromkeys(("broken", "unmet"), "red"),
    **dict.fromkeys(("note", "disabled", "untried", "unknown"), "yellow"),
}


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
    _row(_versions(found["packages"]))


def _print_plugins(found: dict[str, Any]) -> None:
    _heading("Plugins")
    for plugin in found["plugins"]:
        failure = plugin["failure"]
        state = "broken" if failure else "disabled" if plugin["disabled"] else "ok"
        what = f"at stage '{failure['stage']}'" if failure else "" if plugin["disabled"] else offers_in_words(plugin)
        name = f"{plugin['name']} ({plugin['distribution']} {plugin['version']})"
        _row(f"{name}, {plugin['load_time_ms']:.1f} ms: {what}".removesuffix(": "), state)
        for line in failure["traceback"].rstrip().splitlines() if failure else ():
            click.echo(f"{'':{_INDENT + _LABEL}}{line}")
    for line in found["notes"]:
        _row(line, "note")


def _print_tools(tools: list[dict[str, Any]]) -> None:
    _heading("Tools")
    for tool in tools:
        status = status_line(tool["status"])
        text = " ".join(str(tool["error"] or status or tool["summary"]).split())
        _row(f"{tool['tool']}: {text}".removesuffix(": "), "broken" if tool["error"] else "ok" if status else "")
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
        # No colour for a requirement that nothing needs.
        _row(f"{name}: {row['detail']}; {needed}", row["status"], plain=not count)
        if count and row["advice"]:
            _row(f"→ {row['advice']}")


def _print_rest(found: dict[str, Any]) -> None:
    _heading("Extras and surroundings")
    for extra in found["extras"]:
        advice = "" if extra["present"] else f"; pip install 'gem-core[{extra['extra']}]'"
        _row(f"{extra['extra']}: {_versions(extra['packages'])}{advice}", "there" if extra["present"] else "absent")
    program = found["command"]
    advice = f"; {program['advice']}" if program["advice"] else ""
    _row(f"command gem: {program['detail']}{advice}", "ok" if program["status"] == "met" else "note")


def _print_verdict(found: dict[str, Any]) -> None:
    _heading("Verdict")
    for line in found["broken"]:
        _row(line, "broken")
    unmet = [row for row in found["requirements"] if row["status"] == "unmet" and row["environments"]]
    if unmet:
        _row(f"{counted(len(unmet), 'unmet requirement')}, see the arrows above", "note")
    if not found["broken"]:
        _row("nothing that is installed is broken", "ok")


def _versions(packages: dict[str, str | None]) -> str:
    return ", ".join(f"{name} {version or 'missing'}" for name, version in packages.items())


def _heading(text: str) -> None:
    click.echo(click.style(text, bold=True))


def _row(text: str, state: str = "", *, plain: bool = False) -> None:
    """Print a row after its state, which is coloured unless ``plain``."""
    label = state.ljust(_LABEL)
    width = min(output_width() or _WIDTH, _WIDTH) - _INDENT - _LABEL
    first, *rest = wrapped(text, width)
    colour = None if plain else _COLOURS.get(state)
    click.echo(f"{'':{_INDENT}}{click.style(label, fg=colour) if colour else label}{first}")
    for line in rest:
        click.echo(f"{'':{_INDENT + _LABEL}}{line}")
