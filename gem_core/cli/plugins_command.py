"""``gem plugins``: the installed plugins, and their problems."""

from __future__ import annotations

import json
from typing import Any

import click

from gem_core.cli.completion import PLUGINS
from gem_core.cli.diagnosis import describe_plugin, offers_in_words, problems_of
from gem_core.cli.documented import Documented
from gem_core.cli.layout import echo_line
from gem_core.registry.lookup import registry


@click.command("plugins", cls=Documented)
@click.argument("name", required=False, type=PLUGINS)
@click.option("--check", is_flag=True, help="Import all that they offer; exit with 1 if something is wrong.")
@click.option("--json", "as_json", is_flag=True, help="Write one JSON list.")
@click.pass_context
def command(ctx: click.Context, name: str | None, check: bool, as_json: bool) -> None:
    """List the installed plugins, what each offers and how long it took to load.

    Examples:
      gem plugins
      gem plugins games
      gem plugins --check     exit code 1 if one is broken, or claims an id of another

    --check imports all that plugins offer, each plugin in its own process, and names each record that cannot
    be imported, with file and line where its module raises.
    """
    plugins = registry().plugins() if name is None else registry().plugins_named(name)
    found: list[dict[str, Any]] = []
    for plugin in plugins:
        found.append({**describe_plugin(plugin), "problems": problems_of(plugin, quick=not check)})
        if not as_json:
            _print(found[-1], with_traceback=check)
    if as_json:
        click.echo(json.dumps(found, indent=1))
    if check and any(plugin["failure"] or plugin["problems"] for plugin in found):
        ctx.exit(1)


def _print(plugin: dict[str, Any], *, with_traceback: bool) -> None:
    failure, lines = plugin["failure"], [*plugin["problems"]]
    if plugin["disabled"]:
        state = click.style("disabled", fg="yellow") + " by GEM_PLUGINS_DISABLE"
    elif failure:
        state = click.style("broken", fg="red") + f" at stage '{failure['stage']}'"
        lines = [failure["error"], *(failure["traceback"].splitlines() if with_traceback else ()), *lines]
    else:
        state = click.style("broken in part", fg="red") if lines else click.style("works", fg="green")
        state += f", {plugin['load_time_ms']:.1f} ms"
        lines = [offers_in_words(plugin), *lines]
    click.echo(f"{click.style(plugin['name'], bold=True)}  {plugin['distribution']} {plugin['version']}  {state}")
    for line in lines:
        echo_line(f"    {line}")
