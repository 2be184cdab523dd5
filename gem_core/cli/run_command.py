"""``gem run``: an agent acts in environments, and its episodes are recorded."""

from __future__ import annotations

import json
import os
import shlex
import time
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from gem_core.api import make_vec
from gem_core.cli import INTERRUPTED
from gem_core.cli.completion import AGENTS, BACKENDS, ENVS
from gem_core.cli.documented import Documented
from gem_core.cli.layout import counted, echo_line, print_table
from gem_core.cli.model_options import agent_options, given
from gem_core.cli.targets import find_envs
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
    from gem_core.cli.players import Players
    from gem_core.cli.resumed_run import ResumedRun
    from gem_core.records.summary import RunSummary

_DEFAULT_SLOTS = 8


@click.command("run", cls=Documented)
@click.argument("ids", nargs=-1, required=True, metavar="ID...", type=ENVS)
@click.option(
    "-a",
    "--agent",
    "agents",
    multiple=True,
    default=["random"],
    show_default=True,
    metavar="[SEAT=]AGENT",
    type=AGENTS,
    help="A built-in agent, openai:MODEL, or MODULE:CALLABLE. Can be repeated for several agents.",
)
@click.option(
    "-n",
    "--episodes",
    type=AtLeast(min=1),
    help="Episodes of each environment.  [default: each row of a data set once, else 10]",
)
@click.option(
    "-k",
    "--num-envs",
    type=AtLeast(min=1),
    help="Environments at once.  [default: 8, or one for each ID, or --max-concurrency; 1 for 'human']",
)
@click.option("-s", "--seed", type=AtLeast(min=0), help="The same seed gives the same episodes.  [default: 0]")
@arguments_option
@stack_options("A view decides what the agent reads.")
@click.option(
    "--backend",
    default="auto",
    show_default=True,
    type=BACKENDS,
    help="Where environments live: auto, sync, async, process:workers=2, or a plugin's.",
)
@click.option(
    "--step-timeout",
    type=click.FloatRange(min=0, min_open=True),
    metavar="SECONDS",
    help="Longest time of a step or a reset; a longer one is an error of its episode.",
)
@click.option(
    "-o", "--out", type=click.Path(dir_okay=False), help="File of episodes.  [default: runs/TIME-SEED-PROCESS.jsonl]"
)
@click.option("--overwrite", is_flag=True, help="Replace the file if it exists.")
@click.option(
    "--resume",
    metavar="FILE",
    type=click.Path(dir_okay=False),
    help="Go on with the run in FILE, which was started with the same options. Episodes with an error are run again.",
)
@click.option("--json", "as_json", is_flag=True, help="Write the table as JSON.")
@agent_options
@click.pass_context
def command(
    ctx: click.Context,
    /,
    ids: tuple[str, ...],
    agents: tuple[str, ...],
    episodes: int | None,
    num_envs: int | None,
    seed: int | None,
    arguments: tuple[str, ...],
    max_turns: int | None,
    wrappers: tuple[str, ...],
    tools: tuple[str, ...],
    max_tool_uses: int | str | None,
    backend: str,
    step_timeout: float | None,
    out: str | None,
    overwrite: bool,
    resume: str | None,
    as_json: bool,
    **agent_options: Any,
) -> None:
    """Let an agent act in environments, or several agents together, and record the episodes.

    Each ID is an environment, a glob in quotes such as 'game:*', a class in a file such as my_env.py:MyEnv, a file of
    questions such as questions.jsonl, or a folder, as of a terminal task.

    Prints a table. An episode with an error is counted apart and is in no mean; one that was cut off is not solved. The
    number after ± is the standard error, for success Wilson's.

    Examples:
      gem run game:GuessTheNumber-v0 --agent bisect --episodes 100
      gem run game:Mastermind-v0-easy --agent my_module:my_agent --wrappers concat_with_action:max_turns=4
      gem run math:GSM8K --agent openai:gpt-5-mini --tools python,search:top_k=2 --max-tool-uses 10
      gem run game:GuessTheNumber-v0 --agent openai:my-model --base-url http://localhost:8000/v1
      gem run game:GuessTheNumber-v0 --agent openai:gpt-5-mini --resume runs/stopped.jsonl
      gem run ./my_env.py:MyEnv --agent my_module:my_agent
      gem run questions.jsonl --agent openai:gpt-5-mini
      gem run game:TicTacToe-v0 --agent X=openai:gpt-5-mini --agent O=random
      gem run game:Negotiation-v0 --agent openai:gpt-5-mini --wrappers concat

    Several agents: one --agent plays all seats against itself. --agent SEAT=AGENT for each seat fixes
    who sits where. As many --agent as seats, without the names of seats, change seats after each episode.
    'gem info ID' names the seats. The table has a row for each agent at each seat; success is its share
    of games won.

    An agent is a callable of (observation, context), or of the observation alone, plain or async,
    that returns text:
      # my_module.py
      def my_agent(observation, context):
          return context.sample_random_action()

    It reads the observation, or with tools the conversation so far as text. With my_agent.reads =
    "messages" it reads chat messages, as openai:MODEL does; with "observation" always the observation.
    A view in --wrappers decides for all agents. context.messages has the chat messages in any case.

    openai:MODEL asks any OpenAI-compatible server; its key is read from OPENAI_API_KEY. Options from
    --base-url on go to the agent as keyword arguments; a class of your own may take them as well.

    Exit code: 0 if every episode ran, 1 if one had an error, 2 for a wrong argument, 130 after Ctrl-C.
    """
    # Imported here, so that help and the completion of options need not wait for them.
    from gem_core.cli.players import load_players, several_agents
    from gem_core.cli.report import status_of
    from gem_core.progress import Progress
    from gem_core.records.files import EpisodeWriter
    from gem_core.records.plans import EpisodeQueue
    from gem_core.records.summary import RunSummary
    from gem_core.rollouts.agent import close_agent, current_folder_importable, prepare_agent
    from gem_core.rollouts.drivers import default_plan, rollout

    # What runs: environments, agents, wrappers.
    ctx.with_resource(current_folder_importable())  # an agent may import what stands beside it when it first acts
    given_arguments = env_arguments(arguments)
    envs = [(spec, {**kwargs, **given_arguments}) for spec, kwargs in find_envs(ids, several=several_agents(agents))]
    players = load_players(agents, [spec for spec, _ in envs], given(agent_options))
    stack = wrapper_stack(wrappers, tools, max_tool_uses, max_turns)
    resumed = None if resume is None else _resumed_run(ctx, resume)
    if resumed is not None:
        resumed.check(players, envs, stack)
        seed = resumed.done.run_seed(seed)
    for agent in players.agents.values():
        prepare_agent(agent)  # it says at the start what would fail later
        ctx.call_on_close(partial(close_agent, agent))

    # Play and record.
    chosen = [(spec.id, kwargs) for spec, kwargs in envs]
    slots = _slots(players, num_envs, len(chosen), episodes)
    with closing(
        make_vec(chosen, slots, seed=seed or 0, backend=backend, wrappers=stack, step_timeout=step_timeout)
    ) as vector:
        plan = default_plan(vector, episodes)
        summary = RunSummary([env_id for env_id, _ in chosen])
        if resumed is not None:
            resumed.begin(EpisodeQueue(plan, vector.seed), summary)
        path = resumed.path if resumed else free_path(out, overwrite) if out is not None else _new_path(vector.seed)
        before = summary.episodes
        started = time.perf_counter()
        stopped_by: BaseException | None = None
        with (
            resumed.writer if resumed else EpisodeWriter(path) as writer,
            Progress(len(plan), f"seed {vector.seed}", quiet=players.interactive is not None) as progress,
        ):
            try:
                for episode in rollout(vector, **players.options, plan=plan, resume=resumed.done if resumed else None):
                    writer.write(episode)
                    summary.add(episode)
                    progress.advance(summary.episodes, status_of(summary))
            except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 - raised again below, after the table
                stopped_by = error
            finally:
                if not writer.count:
                    writer.discard()
        seconds = time.perf_counter() - started

    # Report.
    _report(summary, seconds, vector.seed, path, before if resumed else None, as_json=as_json)
    if stopped_by is not None:
        _stop(ctx, stopped_by, summary.episodes, len(plan), None if resumed else path)
    ctx.exit(1 if summary.first_error is not None else 0)


def _resumed_run(ctx: click.Context, path: str) -> ResumedRun:
    from gem_core.cli.resumed_run import ResumedRun
    from gem_core.records.files import EpisodeWriter

    if ctx.params["out"] not in (None, path):
        raise ArgumentError("--resume adds to the file of the run; leave --out out")
    if not Path(path).exists():
        raise ArgumentError(f"--resume: there is no file {path}; a run that begins takes --out")
    # It is locked before it is read, so that nobody adds to it meanwhile.
    return ResumedRun(ctx.with_resource(EpisodeWriter(path, append=True)))


def _report(summary: RunSummary, seconds: float, seed: int, path: Path, already: int | None, *, as_json: bool) -> None:
    """Print the table, where the episodes are, and the first error; ``already`` episodes were there before."""
    from gem_core.cli.report import run_columns

    written = str(path) if path.exists() else None
    if as_json:
        click.echo(json.dumps({**summary.to_dict(seconds), "seed": seed, "out": written}, indent=1))
    else:
        print_table(run_columns(summary, seconds), summary.rows())
        where = f"written to {written}" if written else "no file written"
        where = where if already is None else f"added to the {already} in {path}"
        number = summary.episodes - (already or 0)
        echo_line(f"{counted(number, 'episode')} in {seconds:.1f} s (seed {seed}), {where}")
    if summary.first_error is not None:
        echo_line(f"gem: {counted(summary.errors, 'episode')} had an error; the first: {summary.first_error}", err=True)
        for frame in summary.first_frames:
            echo_line(f"     {frame}", err=True)


def _stop(ctx: click.Context, stopped_by: BaseException, count: int, total: int, path: Path | None) -> NoReturn:
    """Say how to go on with a run that was stopped, whose new file is ``path``, and end with its cause."""
    interrupted = isinstance(stopped_by, KeyboardInterrupt)
    if interrupted:
        click.echo(f"gem: interrupted after {count} of {total} episodes", err=True)
    if count:
        more = "" if path is None else f" --resume {shlex.quote(str(path))}"
        click.echo(f"gem: go on with: {typed_command(ctx)}{more}", err=True)
    if interrupted:
        ctx.exit(INTERRUPTED)
    raise stopped_by


def _slots(players: Players, num_envs: int | None, ids: int, episodes: int | None) -> int:
    """Return how many environments keep agents busy: as many as one answers at once, but no more than episodes."""
    if players.interactive is not None and num_envs not in (None, 1):
        raise ArgumentError(
            f"the agent {players.interactive!r} answers one episode at a time; use --num-envs 1, not {num_envs}"
        )
    if num_envs is not None or players.interactive is not None:
        return num_envs or 1
    wanted: int = max(getattr(agent, "max_concurrency", _DEFAULT_SLOTS) for agent in players.agents.values())
    return max(ids, wanted if episodes is None else min(wanted, max(_DEFAULT_SLOTS, ids * episodes)))


def free_path(out: str, overwrite: bool) -> Path:
    """Return the path of a file that may be written.

    Raises:
        ArgumentError: It is there already, and ``overwrite`` was not asked for; or it is no name of a file.
    """
    if out in ("", "-"):
        raise ArgumentError(f"--out takes the name of a file, not {out!r}; leave it out for one in runs/")
    path = Path(out)
    if path.is_file() and path.stat().st_size and not overwrite:
        raise ArgumentError(f"{path} is there already; choose another file, or add --overwrite")
    return path


def _new_path(seed: int) -> Path:
    """Return the path of a file of its own in ``runs``, also if another run begins in the same second."""
    return Path("runs", f"{time.strftime('%Y%m%d-%H%M%S')}-{seed}-{os.getpid()}.jsonl")
