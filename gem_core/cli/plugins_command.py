"""``gem plugins``: what is installed, and what is wrong with it."""

from __future__ import annotations

import json

import click

from gem_core.cli.completion import complete_plugins
from gem_core.cli.diagnosis import described, listed
from gem_core.plugins import Plugin
from gem_core.registry import registry


@click.command(
    "plugins",
    epilog="""\b
Examples:
  gem plugins
  gem plugins games
  gem plugins --check     exit code 1 and the whole traceback when one is broken
""",
)
@click.argument("name", required=False, shell_complete=complete_plugins)
@click.option("--check", is_flag=True, help="Show tracebacks, and exit with 1 when a plugin is broken.")
@click.option("--json", "as_json", is_flag=True, help="Write one JSON list.")
@click.pass_context
def command(ctx: click.Context, name: str | None, check: bool, as_json: bool) -> None:
    """List the installed plugins, what each offers and how long it took to load."""
    plugins = registry().plugins() if name is None else [registry().plugin(name)]
    if as_json:
        click.echo(json.dumps([described(plugin) for plugin in plugins], indent=1))
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
        click.echo(f"{head}  {click.style('works', fg='green')}, {plugin.load_time_s * 1000:.1f} ms")
        click.echo(f"    {listed(plugin)}")
