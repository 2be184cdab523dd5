"""``gem play``: a person is the agent."""

from __future__ import annotations

from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from gem_core.api import make
from gem_core.cli.completion import AGENTS, ENVS
from gem_core.cli.documented import Documented
from gem_core.cli.run_command import free_path
from gem_core.cli.targets import find_env
from gem_core.cli.tool_options import (
    AtLeast,
    arguments_option,
    env_arguments,
    stack_options,
    typed_command,
    wrapper_stack,
)
from gem_core.errors import ArgumentError

if TYPE_CHECKING:
    from gem_core.env.wrapper import AnyEnv
    from gem_core.registry.specs import EnvSpec


@click.command("play", cls=Documented)
@click.argument("env_id", metavar="ID", type=ENVS)
@click.option("--seat", help="Your seat in a game of several agents.  [default: the first]")
@click.option(
    "-a",
    "--agent",
    "agents",
    multiple=True,
    metavar="[SEAT=]AGENT",
    type=AGENTS,
    help="Who plays the other seats: one agent for all, or one for each.  [default: random]",
)
@click.option(
    "-s", "--seed", type=AtLeast(min=0), help="The same episodes as 'gem run' with this seed.  [default: drawn]"
)
@click.option(
    "-n",
    "--episodes",
    type=AtLeast(min=1),
    help="Play this many without asking.  [default: ask after each; 1 in a pipe]",
)
@arguments_option
@stack_options("Observations are then shown exactly as a model reads them; '' shows those of the bare environment.")
@click.option("-o", "--out", type=click.Path(dir_okay=False), help="Record the finished episodes in this file.")
@click.option("--overwrite", is_flag=True, help="Replace the file if it exists.")
@click.pass_context
def command(
    ctx: click.Context,
    env_id: str,
    seat: str | None,
    agents: tuple[str, ...],
    seed: int | None,
    episodes: int | None,
    arguments: tuple[str, ...],
    max_turns: int | None,
    wrappers: tuple[str, ...],
    tools: tuple[str, ...],
    max_tool_uses: int | str | None,
    out: str | None,
    overwrite: bool,
) -> None:
    r"""Play an environment yourself: you are the agent.

    ID is an environment, a class in a file, a file of questions, or a folder, as in 'gem run'. You read an observation,
    type an answer, and see the reward. In a game of several agents you have one seat, and see only what it sees.

    Examples:
      gem play game:GuessTheNumber-v0
      gem play game:Mastermind-v0-hard --seed 7 --out runs/mine.jsonl
      gem play game:TowerofHanoi-v0-easy --wrappers concat_with_action
      gem play game:Sudoku-v0-easy --tools python
      gem play my-tasks/fix-the-server
      gem play game:TicTacToe-v0 --seat O --agent X=tictactoe
      printf '25\n12\n' | gem play game:GuessTheNumber-v0 --seed 1

    Answers:
      25           is sent as \boxed{25} if the environment expects a box, and likewise in a tag or a fenced
                   block. An answer in that form, and a tool call, are sent unchanged.
      two lines    Write them between two lines of triple quotes, in which nothing is a command.
      (nothing)    An empty line is ignored.
      a typo       If the environment cannot read an answer, you answer again.

    Commands:
      ?            the keys, the form of an answer, and the rules
      !undo        take the last turn back, if a seed and the actions repeat the episode
      !random      play a random valid action
      !quit        end, as Ctrl-D does

    In a pipe, each line is an answer: to one episode, or to as many as --episodes says.
    There are no colours in a pipe, or if NO_COLOR is set.
    Exit code: 0 at the end or at the end of input, 2 for a wrong argument, 130 after Ctrl-C.
    """
    # Imported here, so that help and the completion of options need not wait for them.
    from gem_core.cli.play_session import PlaySession
    from gem_core.records.files import EpisodeWriter

    record, kwargs = find_env(env_id)
    record, seated = _at_one_seat(record, seat, agents)
    kwargs = {**kwargs, **env_arguments(arguments), **seated}
    stack = wrapper_stack(wrappers, tools, max_tool_uses, max_turns)
    path = None if out is None else free_path(out, overwrite)
    with closing(make(record, wrappers=stack, **kwargs)) as env:
        if not wrappers and not seated:  # a drawing may show what other seats hold
            _draw_boards(env)
        writer = None if path is None else ctx.with_resource(EpisodeWriter(path))
        session = PlaySession(
            env,
            seed=seed,
            repeatable=record.deterministic,
            exact=bool(wrappers),
            summary=record.summary,
            writer=writer,
            seat=seated.get("seat"),
        )
        try:
            with suppress(EOFError):
                session.play(episodes)
        finally:
            if writer is not None and not writer.count:
                writer.discard()
            session.farewell(typed_command(ctx) + ("" if seed is not None else f" --seed {session.seed}"))


def _at_one_seat(record: EnvSpec, seat: str | None, agents: tuple[str, ...]) -> tuple[EnvSpec, dict[str, Any]]:
    """Return the record of an environment with all seats but a person's played inside, and its arguments for that.

    That of one agent is returned as it is.

    Raises:
        ArgumentError: The seat or the agents do not fit the environment.
    """
    from gem_core.cli.players import seats_of_others
    from gem_core.rollouts.one_seat import single_agent

    if not record.seats:
        if seat is not None or agents:
            raise ArgumentError(f"{record.id} is for one agent: leave {'--agent' if agents else '--seat'} out")
        return record, {}
    own, others = seats_of_others(agents, seat, record)
    against = ", ".join(f"{other}={agent}" for other, agent in others.items())
    summary = f"{record.summary} Your seat is {own}; the others are {against}.".strip()
    maker = partial(single_agent, record.id)
    return replace(record, entry_point=maker, summary=summary, max_turns=None, seats=()), {
        "seat": own,
        "others": others,
    }


def _draw_boards(env: AnyEnv) -> None:
    # Set on what was made, so that a record holds the arguments that a run without a board would have.
    task = env.unwrapped
    if "ansi" in task.metadata.get("render_modes", []):
        task.render_mode = "ansi"
