"""``gem robustness``: how much a model's score falls when its tools, outputs or instructions are disturbed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gem_core.cli import (
    AGENTS,
    ENVS,
    INTERRUPTED,
    AtLeast,
    Column,
    agent_options,
    arguments_option,
    counted,
    echo_line,
    env_arguments,
    find_envs,
    given,
    parsed_choices,
    print_table,
    stack_options,
    wrapper_stack,
)
from gem_core.errors import ArgumentError, GemError
from gem_eval import figures
from gem_eval.output import print_json

if TYPE_CHECKING:
    from gem_core import Episode
    from gem_core.making import WrapperChoice
    from gem_eval.robustness.scoring import Disturbance, Disturbed

_DEFAULT_SLOTS = 8


@click.command(
    "robustness",
    epilog="""\b
Examples:
  gem robustness game:GuessTheNumber-v0 --model openai:gpt-5-mini --episodes 50
  gem robustness math:GSM8K --model openai:gpt-5-mini --tools python --limit 200
  gem robustness math:GSM8K --model openai:gpt-5-mini --tools python --perturb tool_429:rate=0.5
  gem robustness qa:NaturalQuestions --model openai:gpt-5-mini --tools search \\
      --perturb distractor_tools:count=8 --perturb paraphrase,typos:rate=0.05
  gem robustness qa:Sample --model my_module:my_agent --perturb paraphrase:function=my_module:reword
  gem robustness game:Mastermind-v0-easy --model random --json
\b
Perturbations; 'gem info NAME' says what each does, and its options:
  tool_429            some calls of tools are answered with HTTP status 429
  tool_timeout        some calls of tools run out of time
  cut_outputs         some outputs of tools and of the task are cut off
  distractor_tools    useless tools are offered beside the others
  renamed_parameters  the parameters of tools have other names
  paraphrase          the task is said in other words of the same meaning
  typos               some words of the task are misspelt
  server_429          requests to the model fail with status 429 (rate=0.2, retries=2)
  server_timeout      requests to the model run out of time (rate=0.2, retries=2)
\b
Any wrapper or tool of 'gem list wrappers' and 'gem list tools' can be named as well. The two of the
model's server are tried only if you name them: an episode ends in an error if all attempts fail, and is in
no score.
\b
Exit code: 0 if every episode ran, 1 if one had an error that was not injected, 2 for a wrong
argument, 130 after Ctrl-C, with what was scored until then.
""",
)
@click.argument("ids", nargs=-1, required=True, type=ENVS, metavar="ID...")
@click.option(
    "-m",
    "--model",
    required=True,
    type=AGENTS,
    metavar="AGENT",
    help="openai:MODEL, MODULE:CALLABLE, or an agent's name.",
)
@click.option(
    "-p",
    "--perturb",
    "perturbations",
    multiple=True,
    metavar="NAME[:OPTION=VALUE]",
    help="A line of the table; names joined by commas are applied together. Can be repeated.  [default: the first "
    "seven below]",
)
@click.option("--limit", type=AtLeast(min=1), help="Most rows of each ID.")
@click.option(
    "-n",
    "--episodes",
    type=AtLeast(min=1),
    default=10,
    show_default=True,
    help="Episodes of each ID without a data set.",
)
@click.option("-e", "--epochs", type=AtLeast(min=1), default=1, show_default=True, help="How often each row is played.")
@click.option("-k", "--num-envs", type=AtLeast(min=1), help="Episodes at once.  [default: --max-concurrency, or 8]")
@click.option("-s", "--seed", type=AtLeast(min=0), default=0, show_default=True, help="Seed of the run.")
@arguments_option
@stack_options("Perturbations go inside views, and outside tools.")
@click.option(
    "-o", "--out", type=click.Path(file_okay=False), help="Folder for the episodes, a file for each line of the table."
)
@click.option("--json", "as_json", is_flag=True, help="Write the scores as JSON.")
@agent_options
@click.pass_context
def command(
    ctx: click.Context,
    /,
    ids: tuple[str, ...],
    model: str,
    perturbations: tuple[str, ...],
    limit: int | None,
    episodes: int,
    epochs: int,
    num_envs: int | None,
    seed: int,
    arguments: tuple[str, ...],
    max_turns: int | None,
    wrappers: tuple[str, ...],
    tools: tuple[str, ...],
    max_tool_uses: int | str | None,
    out: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Score a model without and with each perturbation on the same rows, and show how much its score falls.

    The seed fixes what is disturbed. Differences are paired by row, and have an interval of 95 %. A perturbation that
    does not fit an environment, such as one of tools if there are none, is left out and named.
    """
    from gem_core.progress import Progress
    from gem_core.rollouts import close_agent, current_folder_importable, load_agent, prepare_agent
    from gem_eval.robustness.scoring import DEFAULT, Disturbance, in_all, score_disturbed

    names = perturbations or DEFAULT
    ctx.with_resource(current_folder_importable())
    disturbances = [Disturbance.of(name, parsed_choices(name, "--perturb")) for name in dict.fromkeys(names)]
    stack = wrapper_stack(wrappers, tools, max_tool_uses, max_turns)
    envs = [(record.id, {**kwargs, **env_arguments(arguments)}) for record, kwargs in _of_one_agent(ids)]
    agent = load_agent(model, **given(options))
    prepare_agent(agent)
    ctx.call_on_close(partial(close_agent, agent))
    fitting = [_fitting(env, disturbances, stack) for env in envs]
    if perturbations and not any(fitting):
        raise ArgumentError(f"no perturbation fits {', '.join(env_id for env_id, _ in envs)}; name others by --perturb")
    results: list[Disturbed] = []
    stopped_by: BaseException | None = None
    with ExitStack() as at_end:
        record = at_end.enter_context(_recording(out))
        progress = at_end.enter_context(Progress(None, f"seed {seed}"))
        played = 0

        def on_episode(disturbance: Disturbance, episode: Episode) -> None:
            nonlocal played
            played += 1
            progress.advance(played, f"{episode.id}, {disturbance.name}")
            record(disturbance.name, episode)

        try:
            for env, fit in zip(envs, fitting, strict=True):
                results += score_disturbed(
                    env,
                    agent,
                    fit,
                    wrappers=stack,
                    seed=seed,
                    limit=limit,
                    episodes=episodes,
                    epochs=epochs,
                    num_envs=num_envs or getattr(agent, "max_concurrency", _DEFAULT_SLOTS),
                    on_episode=on_episode,
                )
        except (GemError, KeyboardInterrupt) as error:  # raised again below, after the table
            stopped_by = error
    rows = [*results, *in_all(results)]
    if as_json:
        print_json({"scores": [row.to_dict(model) for row in rows], "seed": seed})
    else:
        print_table(_COLUMNS, rows)
    failed = [row for row in results if row.first_error is not None and not row.disturbance.server_faults]
    if failed:
        errors = counted(sum(row.errors for row in failed), "episode")
        echo_line(f"gem: {errors} had an error; the first: {failed[0].id}: {failed[0].first_error}", err=True)
    if stopped_by is not None:
        echo_line(f"gem: stopped after {counted(played, 'episode')}; runs that had not ended are left out", err=True)
        if not isinstance(stopped_by, KeyboardInterrupt):
            raise stopped_by
        ctx.exit(INTERRUPTED)
    ctx.exit(1 if failed else 0)


def _of_one_agent(ids: tuple[str, ...]) -> list[Any]:
    envs = find_envs(ids, several=False)
    shared = next((record for record, _ in envs if record.seats), None)
    if shared is not None:
        raise ArgumentError(f"{shared.id} is for several agents; gem robustness scores one that acts alone")
    return envs


def _fitting(
    env: tuple[str, Mapping[str, Any]], disturbances: Sequence[Disturbance], stack: Sequence[WrapperChoice]
) -> list[Disturbance]:
    """Return the disturbances that fit an environment, and name the others."""
    from gem_eval.robustness.scoring import does_not_apply

    unfit = {each.name: why for each in disturbances if (why := does_not_apply(env, each, stack)) is not None}
    if unfit:
        echo_line(f"gem: {env[0]}: left out {', '.join(unfit)}: {next(iter(unfit.values()))}", err=True)
    return [each for each in disturbances if each.name not in unfit]


@contextmanager
def _recording(folder: str | None) -> Iterator[Callable[[str, Episode], None]]:
    """Write episodes to a folder inside this context, a file for each perturbation; yield what writes one."""
    from gem_core.records import EpisodeWriter

    if folder is None:
        yield lambda name, episode: None
        return
    path = Path(folder)
    if path.is_dir() and any(path.iterdir()):
        raise ArgumentError(f"{path} is not empty; name another folder by --out")
    path.mkdir(parents=True, exist_ok=True)
    writers: dict[str, EpisodeWriter] = {}
    with ExitStack() as files:

        def write(name: str, episode: Episode) -> None:
            if name not in writers:
                file = f"{len(writers)}-{''.join(char if char.isalnum() else '_' for char in name)[:80]}.jsonl"
                writers[name] = files.enter_context(EpisodeWriter(path / file))
            writers[name].write(episode)

        yield write


def _difference(row: Disturbed) -> str:
    if row.plain is None:
        return ""
    return figures.change(None if row.difference is None else row.difference.mean, row.metric)


def _interval(row: Disturbed) -> str:
    if row.plain is None:
        return ""
    low, high = (None, None) if row.difference is None else row.difference[2:]
    return figures.change_bounds(low, high, row.metric)


_COLUMNS = [
    Column("environment", lambda row: str(row.id), name=True),
    Column("perturbation", lambda row: str(row.disturbance.name), name=True),
    Column("metric", lambda row: str(row.metric), 0),
    Column("score [95 %]", lambda row: figures.with_bounds(row.score, row.metric)),
    Column("difference", _difference),
    Column("95 % interval", _interval),
    Column("rows", lambda row: str(len(row.rows)), 1),
    Column("errors", lambda row: str(row.errors), alarm=True),
]
