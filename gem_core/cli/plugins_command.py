"""``gem plugins``: what is installed, and what is wrong with it."""

from __future__ import annotations

import json
from collections import Counter
from typing import Any

import click

from gem_core.plugins import Plugin
from gem_core.registry import registry
from gem_core.specs import EnvSpec


@click.command(
    "plugins",
    epilog="""\b
Examples:
  gem plugins
  gem plugins games
  gem plugins --check     exit code 1 and the whole traceback when one is broken
""",
)
@click.argument("name", required=False)
@click.option("--check", is_flag=True, help="Show tracebacks, and exit with 1 when a plugin is broken.")
@click.option("--json", "as_json", is_flag=True, help="Write one JSON list.")
@click.pass_context
def command(ctx: click.Context, name: str | None, check: bool, as_json: bool) -> None:
    """List the installed plugins, what each offers and how long it took to load."""
    plugins = registry().plugins() if name is None else [registry().plugin(name)]
    if as_json:
        click.echo(json.dumps([_described(plugin) for plugin in plugins], indent=1))
    else:
        for plugin in plugins:
            _print(plugin, check)
    if check and any(plugin.failure for plugin in plugins):
        ctx.exit(1)


def _print(plugin: Plugin, with_traceback: bool) -> None:
    head = f"{click.style(plugin.name, bold=True)}  {plugin.distribution} {plugin.version}"
    if plugin.disabled:
        click.echo(f"{head}  {click.style('disabled', fg='yellow')} by GEM_PLUGINS_DISABLE")
    elif plugin.failure is not None:
        click.echo(f"{head}  {click.style('broken', fg='red')} at stage '{plugin.failure.stage}'")
        click.echo(f"    {plugin.failure.error}")
        if with_traceback:
            click.echo("".join(f"    {line}\n" for line in plugin.failure.traceback.splitlines()), nl=False)
    else:
        offers = ", ".join(f"{count} {kind}{'s' if count > 1 else ''}" for kind, count in _offers(plugin).items())
        click.echo(f"{head}  {click.style('works', fg='green')}, {plugin.load_time_s * 1000:.1f} ms")
        click.echo(f"    {offers or 'offers nothing'}")


def _described(plugin: Plugin) -> dict[str, Any]:
    return {
        "name": plugin.name,
        "distribution": plugin.distribution,
        "version": plugin.version,
        "disabled": plugin.disabled,
        "load_time_ms": round(plugin.load_time_s * 1000, 3),
        "offers": dict(_offers(plugin)),
        "failure": None if plugin.failure is None else vars(plugin.failure),
    }


def _offers(plugin: Plugin) -> Counter[str]:
    return Counter("environment" if isinstance(record, EnvSpec) else record.kind for record in plugin.records)
