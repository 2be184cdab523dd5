"""``gem replay``: repeat a recorded episode, and go on from any of its turns."""

from __future__ import annotations

import itertools
import shlex
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from gem_core import write_episodes
from gem_core.cli import AGENTS, agent_options, arguments_option, counted, echo_line, env_arguments, given, output_width
from gem_core.errors import ArgumentError
from gem_eval.output import print_json
from gem_eval.records import open_run
from gem_eval.replaying.replay import Replay, replay
from gem_eval.show.lines import episode_lines, list_lines
from gem_eval.show.paging import write_lines
from gem_eval.show.text import one_line, rule
from gem_eval.turns import error_text

_PERSON = "human"


@click.command(
    "replay",
    epilog="""\b
Examples:
  gem replay runs/mine 17                              does a replay go as recorded?
  gem replay runs/mine 17 --from-turn 4 --agent openai:gpt-5-mini --branches 8
  gem replay runs/mine 17 --from-turn 4 --agent human  go on yourself
  gem replay runs/mine 17 --set rows=data/mine.jsonl   with an argument that the record lacks
\b
Turns count from 1, as in 'gem show'; K is the first that is played anew. A difference from the record ends a
branch with an error, unless --force is given. Branches are written to a file, with the original as episode 1.
\b
Exit code: 0 if all went as recorded and no branch has an error, 1 if not, 2 for a wrong argument.
""",
)
@click.argument("path", metavar="RUN", type=click.Path())
@click.argument("number", metavar="EPISODE", type=click.IntRange(min=1))
@click.option("--from-turn", metavar="K", type=click.IntRange(min=1), help="First turn to play anew, from 1.")
@click.option("-a", "--agent", type=AGENTS, metavar="AGENT", help=f"Agent that goes on; '{_PERSON}' is you.")
@click.option(
    "--branches",
    metavar="N",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Episodes to play from there.",
)
@arguments_option
@click.option("--force", is_flag=True, help="Go on even if the replay differs from the record.")
@click.option("-o", "--out", metavar="FILE", help="File .jsonl for the branches.  [default: in runs/]")
@click.option("--json", "as_json", is_flag=True, help="Write the result as JSON.")
@agent_options
@click.pass_context
def command(
    ctx: click.Context,
    /,
    path: str,
    number: int,
    from_turn: int | None,
    agent: str | None,
    branches: int,
    arguments: tuple[str, ...],
    force: bool,
    out: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Replay an episode of a run; with --agent, go on from a turn.

    RUN is a folder that 'gem eval' wrote, or a file of 'gem run'; EPISODE is a number of 'gem show'.
    """
    if agent is None and (from_turn or branches > 1 or out or force or given(options)):
        raise ArgumentError("these options are for an agent that goes on: name one, as in --agent random --from-turn 2")
    if agent is not None and from_turn is None:
        raise ArgumentError("--agent goes on from a turn: give --from-turn K; 1 is the beginning")
    file = Path(out or f"runs/replay-{time.strftime('%Y%m%d-%H%M%S')}.jsonl")
    if agent is not None and file.exists():
        raise ArgumentError(f"{file} is there already; choose another name for --out")
    kwargs = env_arguments(arguments)
    settings: dict[str, Any] = {"branches": branches, "kwargs": kwargs, "force": force, "options": given(options)}
    if agent == _PERSON:
        _show_beginning(replay(path, number, kwargs=kwargs), (from_turn or 1) - 1)
    found = replay(path, number, from_turn, agent, **settings)
    written = None
    if agent is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        original = replace(found.original, key="original", repeat=0, agent="original")
        write_episodes(file, [original, *found.episodes])
        written = str(file)
    if as_json:
        print_json(_as_dict(found, written))
    else:
        _print(found, written)
    ctx.exit(0 if found.agrees and all(episode.error is None for episode in found.episodes) else 1)


def _show_beginning(found: Replay, turns: int) -> None:
    """Show a person the turns before the first of theirs."""
    first = replace(found.original, transitions=found.original.transitions[:turns], final_observation="")
    write_lines(itertools.takewhile(lambda line: line != rule("end"), episode_lines(first, found.row.number)))


def _print(found: Replay, written: str | None) -> None:
    for place, each in enumerate(found.differences, start=1):
        for difference in each:
            echo_line(one_line(f"not as recorded: {f'branch {place}, ' if written else ''}{difference}"))
    if found.agrees:
        where = f"episode {found.row.number} of {one_line(str(found.run.path))}"
        echo_line(f"{counted(found.turns, 'turn')} of {where} repeated: all as recorded.")
    if written is None:
        for episode in found.episodes:
            if episode.error is not None:
                echo_line(one_line(f"the replay ended in an error: {error_text(episode.error)}"))
        return
    click.echo()
    for line in list_lines(open_run(written).rows, output_width()):
        click.echo(line)
    path = shlex.quote(written)
    click.echo(f"\nWritten to {written}, the original as episode 1:")
    click.echo(f"  gem show {path}\n  gem compare {path}")


def _as_dict(found: Replay, written: str | None) -> dict[str, Any]:
    return {
        "run": str(found.run.path),
        "episode": found.row.number,
        "turns_repeated": found.turns,
        "agrees": found.agrees,
        "differences": found.differences,
        "errors": [error_text(episode.error) or None for episode in found.episodes],
        "written": written,
    }
