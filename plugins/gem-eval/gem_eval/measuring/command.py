"""``gem bench-env``: time, memory, tokens and rewards of environments."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
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
    echo_line,
    env_arguments,
    find_envs,
    given,
    print_table,
    shown,
    stack_options,
    wrapper_stack,
)
from gem_core.errors import GemError
from gem_core.making import WrapperChoice
from gem_eval.output import print_json
from gem_eval.turns import error_text

if TYPE_CHECKING:
    from gem_core import Episode
    from gem_core.rollouts import Agent
    from gem_eval.measuring.measure import Bin, CountTokens, EnvMeasurement

_BAR = 40
_DEFAULT_SLOTS = 8


@click.command(
    "bench-env",
    epilog="""\b
Examples:
  gem bench-env game:Mastermind-v0-easy
  gem bench-env 'game:*-easy' --groups 4 --no-memory
  gem bench-env math:GSM8K --model openai:gpt-5-mini --group-size 8 --groups 32
  gem bench-env math:GSM8K --tools python --model openai:gpt-5-mini --tokenizer Qwen/Qwen3-8B
  gem bench-env code:Sample --json
\b
What is measured:
  reset, step   50th and 99th percentile of one call in one environment, with nothing beside it; the first
                reset, which may load data, is left out; steps per second include resets
  memory        growth of a new process with each further environment, without containers and other
                processes
  tokens        all that the agent reads in an episode: a quarter of its characters, or what --tokenizer
                counts; earlier turns count again if the agent reads them again
  equal groups  share of groups whose returns are all equal, from which GRPO learns nothing; in parentheses
                the shares that are all 0 and all 1
\b
Exit code: 0 if every ID was measured, 1 if one cannot run here or had errors only, 2 for a wrong
argument, 130 after Ctrl-C, with what was measured until then.
""",
)
@click.argument("ids", nargs=-1, required=True, type=ENVS, metavar="ID...")
@click.option(
    "-m",
    "--model",
    default="random",
    show_default=True,
    type=AGENTS,
    metavar="AGENT",
    help="openai:MODEL, MODULE:CALLABLE, or an agent's name.",
)
@click.option(
    "--groups",
    type=AtLeast(min=1),
    default=16,
    show_default=True,
    help="Groups of each ID; the episodes of a group start alike.",
)
@click.option(
    "--group-size", type=AtLeast(min=1), default=8, show_default=True, help="Episodes of each group, as in GRPO."
)
@click.option("-k", "--num-envs", type=AtLeast(min=1), help="Episodes at once.  [default: --max-concurrency, or 8]")
@click.option("-s", "--seed", type=AtLeast(min=0), default=0, show_default=True, help="Seed of the run.")
@click.option(
    "--seconds",
    type=click.FloatRange(min=0, min_open=True),
    default=10.0,
    show_default=True,
    help="Longest time to measure resets and steps of an ID.",
)
@click.option("--memory/--no-memory", "with_memory", default=True, help="Measure memory, in a process of its own.")
@click.option("--tokenizer", metavar="NAME", help="MODULE:FUNCTION, or a tokenizer of the Hugging Face hub.")
@arguments_option
@stack_options("A view decides what the agent reads.")
@click.option("--json", "as_json", is_flag=True, help="Write all figures as JSON; times in seconds, memory in bytes.")
@agent_options
@click.pass_context
def command(
    ctx: click.Context,
    /,
    ids: tuple[str, ...],
    model: str,
    groups: int,
    group_size: int,
    num_envs: int | None,
    seed: int,
    seconds: float,
    with_memory: bool,
    tokenizer: str | None,
    arguments: tuple[str, ...],
    max_turns: int | None,
    wrappers: tuple[str, ...],
    tools: tuple[str, ...],
    max_tool_uses: int | str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Measure environments: time of steps and resets, memory, tokens, rewards, and what GRPO cannot learn from.

    An agent plays groups of episodes that start alike; its actions are then played again to measure the environment
    alone. An environment that cannot run here is named, and the others are measured.
    """
    from gem_core.progress import Progress
    from gem_core.rollouts import close_agent, current_folder_importable, load_agent, prepare_agent
    from gem_eval.measuring.measure import EnvMeasurement, token_counter

    ctx.with_resource(current_folder_importable())
    envs = [(record, {**kwargs, **env_arguments(arguments)}) for record, kwargs in find_envs(ids, several=False)]
    stack = wrapper_stack(wrappers, tools, max_tool_uses, max_turns)
    count_tokens = token_counter(tokenizer)
    agent = load_agent(model, **given(options))
    prepare_agent(agent)
    ctx.call_on_close(partial(close_agent, agent))
    at_once = num_envs or min(getattr(agent, "max_concurrency", _DEFAULT_SLOTS), groups * group_size)
    measurements: list[EnvMeasurement] = []
    played = itertools.count(1)
    with Progress(None, "episodes") as progress, suppress(KeyboardInterrupt):

        def on_episode(episode: Episode) -> None:
            progress.advance(next(played), episode.id)

        for record, kwargs in envs:
            if record.seats:
                measured = EnvMeasurement(record.id, error="it is for several agents, and one acts here")
            else:
                run = {"wrappers": stack, "seed": seed, "groups": groups, "group_size": group_size, "num_envs": at_once}
                measured = _measured(record.id, kwargs, agent, run, count_tokens, seconds, with_memory, on_episode)
            measurements.append(measured)
    interrupted = len(measurements) < len(envs)
    if as_json:
        asked = {"model": model, "seed": seed, "group_size": group_size, "tokenizer": tokenizer or "characters/4"}
        print_json({**asked, "environments": [each.to_dict() for each in measurements]})
    else:
        _print([each for each in measurements if each.error is None])
    for each in measurements:
        for note in each.notes:
            echo_line(f"gem: {each.id}: {note}", err=True)
        if each.error is not None:
            echo_line(f"gem: {each.id} is not measured: {each.error.removeprefix(f'{each.id} ')}", err=True)
    if interrupted:
        echo_line(f"gem: interrupted after {len(measurements)} of {len(envs)} environments", err=True)
    failed = any(each.error is not None for each in measurements)
    ctx.exit(INTERRUPTED if interrupted else 1 if failed else 0)


def _measured(
    env_id: str,
    kwargs: Mapping[str, Any],
    agent: Agent,
    run: Mapping[str, Any],
    count_tokens: CountTokens,
    seconds: float,
    with_memory: bool,
    on_episode: Callable[[Episode], None],
) -> EnvMeasurement:
    """Return all that is measured of an environment, or why it cannot be."""
    from gem_eval.measuring.measure import EnvMeasurement, count_sent, measure_times, play
    from gem_eval.measuring.memory import measure_memory

    measured = EnvMeasurement(env_id)
    first_error = None
    stack: Sequence[WrapperChoice] = run["wrappers"]
    try:
        for episode in play((env_id, kwargs), agent, **run):
            on_episode(episode)
            if episode.error is not None:
                measured.errors += 1
                first_error = first_error or error_text(episode.error)
                continue
            measured.episodes.append(episode)
            measured.tokens.append(count_sent(episode, count_tokens))
        if not measured.episodes:
            measured.error = f"every episode had an error; the first: {first_error}"
            return measured
        measure_times(measured, kwargs, stack, seconds)
    except GemError as error:
        measured.error = str(error)
        return measured
    if measured.errors:
        measured.notes.append(f"{measured.errors} episodes had an error and are left out; the first: {first_error}")
    if with_memory:
        try:
            measured.memory = measure_memory(env_id, kwargs, stack)
        except GemError as error:
            measured.notes.append(f"memory is not measured: {error}")
    return measured


def _print(measurements: Sequence[EnvMeasurement]) -> None:
    if measurements:
        print_table(_COLUMNS, measurements)
    for each in measurements:
        _print_bars(each)


def _groups(measured: EnvMeasurement) -> str:
    groups = measured.groups
    if groups.equal is None:
        return "-"
    return f"{groups.equal:.0%} of {groups.number} ({groups.zero:.0%}, {groups.one:.0%})"


def _print_bars(measured: EnvMeasurement) -> None:
    from gem_eval.measuring.measure import histogram

    click.echo(f"\n{click.style(measured.id, fg='cyan')}: {len(measured.episodes)} episodes")
    if measured.usage is not None:
        read, wrote = measured.usage["prompt_tokens"], measured.usage["completion_tokens"]
        click.echo(f"  the model read {read:,.0f} and wrote {wrote:,.0f} tokens an episode")
    for what, values in (("reward of a turn", measured.rewards), ("return of an episode", measured.returns)):
        bins = histogram(values)
        labels = [_label(each) for each in bins]
        width, most = max(map(len, labels), default=0), max((each.number for each in bins), default=1)
        click.echo(f"  {what}")
        for label, each in zip(labels, bins, strict=True):
            bar = "#" * max(round(each.number / most * _BAR), 1 if each.number else 0)
            click.echo(f"    {label:>{width}}  {bar:<{_BAR}}  {each.number:,}")


def _label(each: Bin) -> str:
    return f"{each.low:.4g}" if each.low == each.high else f"{each.low:.4g} to {each.high:.4g}"


def _duration(seconds: float | None) -> str:
    if seconds is None:
        return "-"
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"


def _size(count: float) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count:.0f} B"


_COLUMNS = [
    Column("environment", lambda measured: str(measured.id), name=True),
    Column("reset p50", lambda measured: _duration(measured.reset.p50)),
    Column("p99", lambda measured: _duration(measured.reset.p99), 0),
    Column("step p50", lambda measured: _duration(measured.step.p50)),
    Column("p99", lambda measured: _duration(measured.step.p99), 1),
    Column("steps/s", lambda measured: shown(measured.steps_per_second, ",.0f"), 5),
    Column("memory", lambda measured: "-" if measured.memory is None else _size(measured.memory.bytes_each)),
    Column("turns", lambda measured: shown(measured.mean_turns, ".1f"), 2),
    Column("tokens", lambda measured: shown(measured.mean_tokens, ",.0f")),
    Column("success", lambda measured: shown(measured.success_rate, ".0%"), 4),
    Column("return", lambda measured: shown(measured.mean_return, ".3f"), 3),
    Column("equal groups (all 0, all 1)", _groups),
]
