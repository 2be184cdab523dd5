"""``gem new-plugin``: starts a plugin."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

import click

from gem_core.cli.documented import Documented
from gem_core.cli.new_plugin import KINDS, first_steps, names_of, render, write
from gem_core.errors import ArgumentError


@click.command("new-plugin", cls=Documented)
@click.argument("name")
@click.option("--env", "kinds", flag_value="env", multiple=True, help="A game of several turns.  [default]")
@click.option("--tool", "kinds", flag_value="tool", multiple=True, help="A tool with a session.")
@click.option("--wrapper", "kinds", flag_value="wrapper", multiple=True, help="A wrapper that changes rewards.")
@click.option("--dataset", "kinds", flag_value="dataset", multiple=True, help="Questions in a JSONL file, graded.")
@click.option("--agent", "kinds", flag_value="agent", multiple=True, help="An agent, for 'gem run --agent'.")
@click.option("--command", "kinds", flag_value="command", multiple=True, help="A subcommand of gem.")
@click.option("--backend", "kinds", flag_value="backend", multiple=True, help="A backend of vector environments.")
@click.option("--into", type=click.Path(file_okay=False, path_type=Path), help="Folder to write.  [default: gem-NAME]")
def command(name: str, kinds: tuple[str, ...], into: Path | None) -> None:
    """Start a plugin: a distribution that installs, registers, and passes its own conformance tests.

    Kinds can be combined. Prints the three commands to type next.

    Examples:
      gem new-plugin riddles                       an environment, in the folder gem-riddles
      gem new-plugin riddles --tool                a tool
      gem new-plugin riddles --env --tool --wrapper
      gem new-plugin riddles --dataset --into ~/projects/riddles

    NAME becomes the namespace of the ids (riddles:Letters-v0), the distribution gem-NAME and the package
    gem_NAME. The files are small, and meant to be changed.

    Exit code: 0 if it was written, 2 if NAME or the folder cannot be used. Nothing is overwritten.
    """
    names = names_of(name)
    chosen = [kind for kind in KINDS if kind in kinds] or ["env"]
    target = into or Path(names.distribution)
    _refuse_taken(names.name, names.distribution)
    texts = render(names, chosen)
    write(target, texts)
    click.echo(f"Wrote {len(texts)} files to {target}. Go on with:")
    click.echo(f"  python -m pip install -e {quote(f'{_dotted(target)}[test]')}")
    click.echo(f"  {first_steps(names, chosen)}")
    click.echo(f"  python -m pytest {quote(str(target))}")


def _refuse_taken(name: str, distribution: str) -> None:
    from gem_core.registry.lookup import registry

    for plugin in registry().plugins():
        if name == plugin.name or distribution == plugin.distribution:
            raise ArgumentError(f"{plugin} is installed already; choose another name")
    for record in registry().envs():
        if record.namespace == name:
            raise ArgumentError(f"the namespace {name!r} is in use already, by {record.id!r}; choose another name")


def _dotted(target: Path) -> str:
    # Without ./ pip would take a relative folder for the name of a distribution.
    return str(target) if target.is_absolute() else f"./{target.as_posix()}"
