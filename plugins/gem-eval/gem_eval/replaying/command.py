"""``gem replay``: repeat a recorded episode, and go on from any of its turns."""

from __future__ import annotations

import shlex
from typing import Any

import click

from gem_core import Episode
from gem_core.cli import (
    AGENTS,
    Column,
    agent_options,
    arguments_option,
    counted,
    echo_line,
    env_arguments,
    given,
    print_table,
)
from gem_core.errors import ArgumentError
from gem_core.rollouts import close_agent, load_agent
from gem_eval.opening import refuse_seats
from gem_eval.output import print_json
from gem_eval.records import open_run
from gem_eval.replaying.branches import write_branches
from gem_eval.replaying.replay import Replay, repeated_turns, replay
from gem_eval.show.text import one_line
from gem_eval.turns import error_text, outcome_of

_PERSON = "human"


@click.command(
    "replay",
    epilog="""\b
Examples:
  gem replay runs/mine 17                              does a replay go as recorded?
  gem replay runs/mine 17 --from-turn 4 --agent openai:gpt-5-mini --branches 8
  gem replay runs/mine 17 --from-turn 4 --agent human  go on yourself, as in 'gem play'
  gem replay runs/mine 17 --set rows=data/mine.jsonl   with an argument that the record lacks
\b
GEM makes the environment from the record (id, arguments, wrappers), resets it with the recorded seed and
options, and repeats the recorded responses. Turns count from 1, as in 'gem show'; K is the first that is
played anew. The agent reads the conversation up to there as its own.
\b
A record lacks long arguments and secrets: --set gives them. Observations and rewards are compared with the
record; a difference ends a branch with an error, unless --force is given.
\b
Branches are a run of their own, with the original as episode 1, for 'gem show', 'gem compare' and others.
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
@click.option("-o", "--out", metavar="PATH", help="Folder, or file .jsonl, for the branches.  [default: in runs/]")
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
    kwargs = env_arguments(arguments)
    if agent is None:
        _refuse_without_agent(
            {
                "--from-turn": from_turn is not None,
                "--branches": branches > 1,
                "--out": out is not None,
                "--force": force,
                **given(options),
            }
        )
        found = replay(path, number, kwargs=kwargs)
        _report(found, as_json)
        ctx.exit(0 if found.agrees and found.episodes[0].error is None else 1)
    if from_turn is None:
        raise ArgumentError("--agent goes on from a turn: give --from-turn K; 1 is the beginning")
    if agent == _PERSON:
        found = _by_a_person(path, number, from_turn, kwargs, branches)
        if not found.episodes:
            return
    else:
        loaded = load_agent(agent, **given(options))
        try:
            limit = options.get("max_concurrency")
            found = replay(
                path, number, from_turn, loaded, branches=branches, kwargs=kwargs, force=force, max_requests=limit
            )
        finally:
            close_agent(loaded)
        for episode in found.episodes:
            episode.agent = agent
    written = str(write_branches(found, agent, out))
    _report(found, as_json, agent=agent, written=written)
    failed = any(episode.error is not None for episode in found.episodes)
    ctx.exit(1 if failed or not found.agrees else 0)


def _by_a_person(path: str, number: int, from_turn: int, kwargs: dict[str, Any], branches: int) -> Replay:
    from gem_eval.replaying.person import play_on

    run = open_run(path)
    row = run.row(number)
    refuse_seats([row])
    original = run.episode(row, images=True)
    return play_on(run, row, original, repeated_turns(original, from_turn), kwargs, branches)


def _refuse_without_agent(given_options: dict[str, Any]) -> None:
    for option, is_given in given_options.items():
        if is_given:
            name = option if option.startswith("--") else f"--{option.replace('_', '-')}"
            raise ArgumentError(
                f"{name} is for an agent that goes on: name one by --agent, as in --agent random --from-turn 2"
            )


def _report(found: Replay, as_json: bool, *, agent: str | None = None, written: str | None = None) -> None:
    if as_json:
        print_json(_as_dict(found, written))
        return
    where = f"episode {found.row.number} of {one_line(str(found.run.path))}"
    for place, each in enumerate(found.differences, start=1):
        for difference in each:
            of = "" if agent is None else f"branch {place}, "
            echo_line(one_line(f"not as recorded: {of}{difference}"))
    for episode in found.episodes:
        if episode.error is not None and agent is None:
            echo_line(one_line(f"the replay ended in an error: {error_text(episode.error)}"))
    if found.agrees:
        echo_line(f"{counted(found.turns, 'turn')} of {where} repeated: all as recorded.")
    if agent is None:
        return
    click.echo()
    listed = [("original", found.original), *((f"branch {n}", each) for n, each in enumerate(found.episodes, start=1))]
    print_table(_columns(), listed)
    path = shlex.quote(written or "")
    click.echo(f"\nWritten to {written}, the original as episode 1:")
    click.echo(f"  gem show {path}\n  gem show {path} --diff 1 2")


def _columns() -> list[Column]:
    def of(episode: Episode) -> str:
        return outcome_of(episode.success, failed=episode.error is not None)

    columns = [
        Column("episode", lambda each: str(each[0]), name=True),
        Column("outcome", lambda each: of(each[1])),
        Column("return", lambda each: f"{each[1].episode_return:.4g}"),
        Column("turns", lambda each: str(each[1].turns)),
        Column("cut off", lambda each: each[1].cut_off or ""),
        Column("error", lambda each: one_line(error_text(each[1].error), 200)),
    ]
    return columns


def _as_dict(found: Replay, written: str | None) -> dict[str, Any]:
    def told(episode: Episode) -> dict[str, Any]:
        return {
            "success": episode.success,
            "return": episode.episode_return,
            "turns": episode.turns,
            "cut_off": episode.cut_off,
            "error": error_text(episode.error) or None,
        }

    return {
        "run": str(found.run.path),
        "episode": found.row.number,
        "turns_repeated": found.turns,
        "agrees": found.agrees,
        "original": told(found.original),
        "episodes": [
            {**told(episode), "differences": each}
            for episode, each in zip(found.episodes, found.differences, strict=True)
        ],
        "written": written,
    }
