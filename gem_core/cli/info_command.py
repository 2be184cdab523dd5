"""``gem info``: one environment, tool, wrapper, agent or backend described."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from gem_core.cli.completion import ENVS_AND_NAMES
from gem_core.cli.descriptions import (
    describe_in_full,
    describe_record,
    find_named,
    option_lines,
    own_documentation,
    paragraphs,
)
from gem_core.cli.documented import Documented
from gem_core.cli.layout import output_width, wrapped
from gem_core.cli.targets import find_env
from gem_core.cli.tool_options import import_option
from gem_core.errors import GemError
from gem_core.registry.requirements import unmet
from gem_core.registry.specs import EnvSpec

if TYPE_CHECKING:
    from gem_core.env.multi_agent import MultiAgentEnv
    from gem_core.types import Observation


@click.command("info", cls=Documented)
@click.argument("env_id", metavar="ID", type=ENVS_AND_NAMES)
@import_option
@click.option("--json", "as_json", is_flag=True, help="Write one JSON object.")
def command(env_id: str, as_json: bool) -> None:
    """Describe one environment: its task, its arguments, what it needs, and what an agent sees first.

    ID is an environment, a class in a file, a file of questions, or a folder, as in 'gem run'. The name of a tool,
    wrapper, agent or backend describes that instead, with its options.

    Examples:
      gem info game:GuessTheNumber-v0
      gem info game:Mastermind-v0-hard --json
      gem info game:TicTacToe-v0          several agents: the seats, and what each sees first
      gem info my-tasks                   the environment that a folder belongs to
      gem info search                     a tool: its options, and what an agent is told
      gem info concat                     a wrapper; likewise an agent, as openai, or a backend
    """
    named = [describe_in_full(record) for record in find_named(env_id)]
    if not named:
        record, kwargs = find_env(env_id)
        _describe_env(replace(record, kwargs={**record.kwargs, **kwargs}), as_json)
    elif as_json:
        click.echo(json.dumps(named[0] if len(named) == 1 else named, indent=1))
    else:
        for number, facts in enumerate(named):
            click.echo("\n" * (number > 0), nl=False)
            _print_named(facts)


def _describe_env(record: EnvSpec, as_json: bool) -> None:
    facts = describe_record(record)
    missing = unmet(record.requires)
    if as_json:
        click.echo(json.dumps({**facts, "unmet": missing}, indent=1))
        return
    _print_title(record.id, record.summary)
    _print_field("seats", ", ".join(record.seats))
    _print_field("turn limit", "none" if record.turn_limit is None else str(record.turn_limit))
    _print_field("arguments", ", ".join(f"{key}={value!r}" for key, value in record.kwargs.items()) or "none")
    _print_field("tags", ", ".join(record.tags))
    _print_field("requires", ", ".join(record.requires) or "nothing more")
    _print_field("repeatable", "yes, by seed and actions" if record.deterministic else "no")
    _print_field("offered by", facts["distribution"] or "this program")
    _print_field("entry point", facts["entry_point"])
    _print_field("page", facts["page"])
    _print_field("missing", list(missing.values()))
    if not missing:
        _print_class(record)


def _print_class(record: EnvSpec) -> None:
    from gem_core.api import make
    from gem_core.env.multi_agent import MultiAgentEnv
    from gem_core.registry.entry_points import load_entry_point

    maker = load_entry_point(record.entry_point, f"environment {record.id!r}")
    _print_field("accepts", option_lines(maker) or "no arguments")
    documented = own_documentation(maker)
    if documented:
        _print_text("", *paragraphs(documented))
    try:
        env = make(record)
        try:
            observation, _ = env.reset(seed=0)
            acts = _how_they_act(env) if isinstance(env, MultiAgentEnv) else ""
        finally:
            env.close()
    except GemError as error:  # print the rest even without its data or engine
        _print_text("", f"There is no observation to show: {error}")
        return
    if not acts:
        _print_observation("The first observation", observation)
        return
    _print_text("", acts)
    for seat, seen in observation.items():
        _print_observation(f"The first observation of {seat}", seen)


def _how_they_act(env: MultiAgentEnv) -> str:
    from gem_core.env.agent_selector import AgentSelector

    selector = env.agent_selector
    if type(selector).choose is not AgentSelector.choose:
        return "The environment decides who acts next."
    return "The agents act " + ("one after another." if selector.mode == "sequential" else "all at once.")


def _print_observation(title: str, observation: Observation) -> None:
    click.echo(click.style(f"\n{title}, with seed 0:", bold=True))
    text = observation if isinstance(observation, str) else json.dumps(observation, default=repr, indent=1)
    _print_text(*text.splitlines())


def _print_named(facts: dict[str, Any]) -> None:
    """Print the description of a tool, wrapper, agent or backend: its options, and a tool's instructions."""
    from gem_core.cli.diagnosis import status_line

    _print_title(facts["name"], facts["summary"])
    _print_field("kind", facts["kind"])
    _print_field("argument", facts.get("argument"))
    _print_field("options", facts["options"] or "none")
    _print_field("offered by", facts["distribution"] or "this program")
    _print_field("entry point", facts["entry_point"])
    _print_field("here", status_line(facts.get("status")))
    _print_field("missing", facts.get("problem"))
    if facts["documentation"]:
        _print_text("", *paragraphs(facts["documentation"]))
    if facts.get("instructions"):
        click.echo(click.style("\nWhat an agent is told, without options:", bold=True))
        _print_text(*facts["instructions"])


def _print_title(name: str, summary: str) -> None:
    _print_text(click.style(name, bold=True) + (f" · {summary}" if summary else ""))


def _print_text(*lines: str, indent: int | None = None) -> None:
    for line in lines:
        for piece in wrapped(line, output_width(), indent):
            click.echo(piece)


def _print_field(label: str, value: str | list[str] | None) -> None:
    """Print a label and its value, a list with a line for each item; nothing if there is no value."""
    lines = [value] if isinstance(value, str) and value else value or []
    for number, line in enumerate(lines):
        head = f"{label}:" if number == 0 else ""
        _print_text(f"  {head:<14}{line}", indent=16)
