"""``gem info``: one environment, tool, wrapper, agent or backend described."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from gem_core.cli.completion import ENVS_AND_NAMES
from gem_core.cli.descriptions import describe_in_full, describe_record, find_named, option_lines, own_documentation
from gem_core.cli.documented import Documented
from gem_core.cli.layout import echo_line, output_width, wrapped
from gem_core.cli.targets import find_env
from gem_core.cli.tool_options import import_option
from gem_core.errors import GemError
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.requirements import unmet
from gem_core.registry.specs import EnvSpec

if TYPE_CHECKING:
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
    facts = {**describe_record(record), "unmet": unmet(record.requires)}
    if as_json:
        click.echo(json.dumps(facts, indent=1))
        return
    _print_title(record.id, record.summary)
    fields: dict[str, str | list[str] | None] = {
        "seats": ", ".join(record.seats),
        "turn limit": str(record.turn_limit or "none"),
        "arguments": ", ".join(f"{key}={value!r}" for key, value in record.kwargs.items()) or "none",
        "tags": ", ".join(record.tags),
        "requires": ", ".join(record.requires) or "nothing more",
        "repeatable": "yes, by seed and actions" if record.deterministic else "no",
        "offered by": facts["distribution"] or "this program",
        "entry point": facts["entry_point"],
        "page": facts["page"],
        "missing": list(facts["unmet"].values()),
    }
    if facts["unmet"]:
        _print_fields(fields)
        return
    maker = load_entry_point(record.entry_point, f"environment {record.id!r}")
    _print_fields({**fields, "accepts": option_lines(maker) or "no arguments"})
    _print_text("", own_documentation(maker))
    try:
        _print_first_observations(record)
    except GemError as error:  # the rest is printed even without data or engine
        _print_text("", f"There is no observation to show: {error}")


def _print_first_observations(record: EnvSpec) -> None:
    from gem_core.api import make
    from gem_core.env.multi_agent import MultiAgentEnv

    with closing(make(record)) as env:
        observation, _ = env.reset(seed=0)
    seen = observation if isinstance(env, MultiAgentEnv) else {"": observation}
    for seat, text in seen.items():
        _print_observation(f"The first observation of {seat}" if seat else "The first observation", text)


def _print_observation(title: str, observation: Observation) -> None:
    click.secho(f"\n{title}, with seed 0:", bold=True)
    _print_text(observation if isinstance(observation, str) else json.dumps(observation, default=repr, indent=1))


def _print_named(facts: dict[str, Any]) -> None:
    """Print the description of a tool, wrapper, agent or backend: its options, and a tool's instructions."""
    from gem_core.cli.diagnosis import status_line

    _print_title(facts["name"], facts["summary"])
    fields = {
        "kind": facts["kind"],
        "argument": facts.get("argument"),
        "options": facts["options"] or "none",
        "offered by": facts["distribution"] or "this program",
        "entry point": facts["entry_point"],
        "here": status_line(facts.get("status")),
        "missing": facts.get("problem"),
    }
    _print_fields(fields)
    _print_text("", facts["documentation"])
    if facts.get("instructions"):
        click.secho("\nWhat an agent is told, without options:", bold=True)
        _print_text(*facts["instructions"])


def _print_title(name: str, summary: str) -> None:
    _print_text(click.style(name, bold=True) + (f" · {summary}" if summary else ""))


def _print_text(*texts: str | None) -> None:
    if texts[-1]:
        for text in texts:
            for line in (text or "").split("\n"):
                echo_line(line)


def _print_fields(fields: dict[str, str | list[str] | None]) -> None:
    """Print labels and their values, a list with a line for each item; nothing for an empty one."""
    for label, value in fields.items():
        head = f"{label}:"
        for line in [value] if isinstance(value, str) and value else value or []:
            for piece in wrapped(f"  {head:<14}{line}", output_width(), 16):
                click.echo(piece)
            head = ""
