"""``gem info``: one environment, tool, wrapper, agent or backend described."""

from __future__ import annotations

import json

import click

from gem_core.cli.completion import complete_ids_and_names
from gem_core.cli.list_command import described
from gem_core.cli.tool_info import all_about, find_named, option_lines, own_documentation, print_field, print_named
from gem_core.errors import GemError
from gem_core.registry.lookup import registry
from gem_core.registry.requirements import unmet
from gem_core.registry.specs import EnvSpec


@click.command(
    "info",
    epilog="""\b
Examples:
  gem info game:GuessTheNumber-v0
  gem info game:Mastermind-v0-hard --json
  gem info search                     a tool: its options, and what an agent is told
  gem info concat                     a wrapper; likewise an agent, as openai, or a backend
""",
)
@click.argument("env_id", metavar="ID", shell_complete=complete_ids_and_names)
@click.option("--json", "as_json", is_flag=True, help="Write one JSON object.")
def command(env_id: str, as_json: bool) -> None:
    """Describe one environment: its task, its arguments, what it needs, and what an agent sees first.

    Or one tool, wrapper, agent or vector backend, with its options.
    """
    named = [all_about(record) for record in find_named(env_id)]
    if named:
        if as_json:
            click.echo(json.dumps(named[0] if len(named) == 1 else named, indent=1))
            return
        for number, about in enumerate(named):
            click.echo("\n" * (number > 0), nl=False)
            print_named(about)
        return
    record = registry().env(env_id)
    facts = described(record)
    missing = unmet(record.requires)
    if as_json:
        click.echo(json.dumps({**facts, "unmet": missing}, indent=1))
        return
    click.echo(click.style(record.id, bold=True) + (f" · {record.summary}" if record.summary else ""))
    for label, value in _lines(record, facts):
        print_field(label, value)
    print_field("missing", list(missing.values()))
    if not missing:
        _print_class(record)


def _lines(record: EnvSpec, facts: dict[str, object]) -> list[tuple[str, str]]:
    arguments = ", ".join(f"{key}={value!r}" for key, value in record.kwargs.items())
    lines = [
        ("turn limit", "none" if record.turn_limit is None else str(record.turn_limit)),
        ("arguments", arguments or "none"),
        ("tags", ", ".join(record.tags)),
        ("requires", ", ".join(record.requires) or "nothing more"),
        ("repeatable", "yes, by seed and actions" if record.deterministic else "no"),
        ("offered by", str(facts["distribution"] or "this program")),
        ("entry point", str(facts["entry_point"])),
    ]
    return [(label, value) for label, value in lines if value]


def _print_class(record: EnvSpec) -> None:
    from gem_core.api import make
    from gem_core.registry.entry_points import load_entry_point

    maker = load_entry_point(record.entry_point, f"environment {record.id!r}")
    print_field("accepts", option_lines(maker) or "no arguments")
    documented = own_documentation(maker)
    if documented:
        click.echo("\n" + documented)
    try:
        env = make(record)
        try:
            observation, _ = env.reset(seed=0)
        finally:
            env.close()
    except GemError as error:  # what there is to know of it is worth reading without its data or its engine too
        click.echo(f"\nThere is no observation to show: {error}")
        return
    click.echo(click.style("\nThe first observation, with seed 0:", bold=True))
    click.echo(observation if isinstance(observation, str) else json.dumps(observation, default=repr, indent=1))
