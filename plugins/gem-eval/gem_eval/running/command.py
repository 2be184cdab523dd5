"""``gem eval``: score models on suites, with the uncertainty of each score, and keep a record of the run."""

from __future__ import annotations

import json
import shlex
from typing import TYPE_CHECKING, Any

import click

from gem_core.cli import (
    AGENTS,
    INTERRUPTED,
    AtLeast,
    Words,
    agent_options,
    arguments_option,
    counted,
    env_arguments,
    env_ids,
    given,
    parsed_choices,
    stack_options,
    typed_command,
)
from gem_core.errors import ArgumentError

if TYPE_CHECKING:
    from gem_eval.records import Row
    from gem_eval.running.evaluation import EvaluationSession
    from gem_eval.suites import Suite


def _suites_and_ids(ctx: click.Context, incomplete: str) -> list[tuple[str, str]]:
    from gem_eval.suites import builtin_suites

    return [*((name, "suite") for name in builtin_suites() if name.startswith(incomplete)), *env_ids(ctx, incomplete)]


_OF_SESSION = (
    "error_threshold",
    "retry_errors",
    "step_timeout",
    "backend",
    "prices",
    "out",
    "new",
    "go_on_anyway",
)
"""Options that the session takes under the same names."""


@click.command(
    "eval",
    epilog="""\b
Examples:
  gem eval sample --model random
  gem eval games rg --model openai:gpt-5-mini --model openai:gpt-5-nano
  gem eval math:GSM8K --model openai:gpt-5-mini --limit 200 --shuffle 1 --epochs 4
  gem eval math:GSM8K --model openai:my-model --base-url http://localhost:8000/v1 --tools python
  gem eval tasks.yaml --model my_module:my_agent --where 'level == 5'
  gem eval tau-sample --model openai:gpt-5-mini --role user=openai:gpt-5-nano --run-cost 5
  gem eval math:GSM8K --model openai:gpt-5-mini --tools python --perturb tool_429 --perturb typos,polite
\b
--perturb also plays each row as a variant of the model, such as 'openai:gpt-5-mini + typos'. It takes tool_429,
tool_timeout, polite, typos, and any other name of 'gem list wrappers'; 'gem info NAME' says what each does.
\b
The same command goes on with a run that was stopped, and begins a new one after it has finished. Rows and
seeds are the same in every run of a suite, for 'gem compare'. 'gem view', 'gem report' and 'gem show' read
the folder. Each score stands with its 95 % interval, clustered by row. An episode that was cut off by a
limit is not solved; one with an error is in no score.
\b
Exit code: 0 if every episode ran, 1 if one had an error or a limit of the run was reached, 2 for a
wrong argument, 130 after Ctrl-C.
""",
)
@click.argument("targets", nargs=-1, type=Words(_suites_and_ids, files=True), metavar="SUITE|ID...")
@click.option("--list", "list_suites", is_flag=True, help="List the suites that are built in.")
@click.option(
    "-m",
    "--model",
    "models",
    multiple=True,
    type=AGENTS,
    metavar="AGENT",
    help="openai:MODEL, MODULE:CALLABLE, or an agent's name. Can be repeated.",
)
@click.option(
    "--role", "roles", multiple=True, type=AGENTS, metavar="ROLE=AGENT", help="Agent of another part: user, judge."
)
@click.option("-e", "--epochs", type=AtLeast(min=1), help="How often each row is played.  [default: 1]")
@click.option("--limit", type=AtLeast(min=1), help="Most rows of each task.")
@click.option("--sample-ids", metavar="ID,ID", help="Only the rows with these values of task_id.")
@click.option("--shuffle", type=click.IntRange(min=0), metavar="SEED", help="Take rows in a random order.")
@click.option("--where", metavar="CONDITION", help="Only rows that fit: 'level == 5 and subject != \"Geometry\"'.")
@click.option(
    "-p",
    "--perturb",
    multiple=True,
    metavar="NAME[:OPTION=VALUE]",
    help="Also play a variant of each model; see below.",
)
@click.option(
    "-n",
    "--episodes",
    type=AtLeast(min=1),
    help="Episodes of each ID.  [default: each row of a data set once, else 10]",
)
@click.option("-s", "--seed", type=AtLeast(min=0), help="Seed of the run.  [default: 0]")
@arguments_option
@stack_options("They replace those of the suite.")
@click.option("--episode-time", type=click.FloatRange(min=0, min_open=True), help="Most seconds of an episode.")
@click.option("--episode-tokens", type=AtLeast(min=1), help="Most tokens of an episode.")
@click.option("--episode-cost", type=click.FloatRange(min=0, min_open=True), help="Most US dollars of an episode.")
@click.option("--run-time", type=click.FloatRange(min=0, min_open=True), help="Most seconds of this session.")
@click.option("--run-tokens", type=AtLeast(min=1), help="Most tokens of the run.")
@click.option("--run-cost", type=click.FloatRange(min=0, min_open=True), help="Most US dollars of the run.")
@click.option("--prices", metavar="FILE", help="What tokens cost, in place of the built-in list.")
@click.option("--retry-errors", is_flag=True, help="Play episodes with an error again.")
@click.option(
    "--error-threshold",
    type=click.FloatRange(min=0, max=1),
    default=0.5,
    show_default=True,
    help="Stop when more than this share of episodes had an error.",
)
@click.option("-k", "--num-envs", type=AtLeast(min=1), help="Episodes at once.  [default: --max-concurrency, or 8]")
@click.option("--step-timeout", type=click.FloatRange(min=0, min_open=True), help="Most seconds of a step or a reset.")
@click.option("--backend", default="auto", show_default=True, help="Where environments live, as process:workers=2.")
@click.option("-o", "--out", metavar="FOLDER", help="Folder of the run.  [default: a new one in runs/]")
@click.option("--new", is_flag=True, help="Begin a new run, even if one was stopped.")
@click.option("--go-on-anyway", is_flag=True, help="Go on with a run although code of it was changed.")
@click.option("--json", "as_json", is_flag=True, help="Write scores and times as JSON.")
@agent_options
@click.pass_context
def command(
    ctx: click.Context,
    /,
    targets: tuple[str, ...],
    list_suites: bool,
    models: tuple[str, ...],
    num_envs: int | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Score models on suites or environments, and record the run in a folder.

    A SUITE is built in, or a YAML file. An ID is an environment, a glob such as 'game:*-easy', a class in a file, a
    file of questions, or a folder of tasks. Tasks and models are played side by side.
    """
    # Imported here, so that help need not wait for them.
    from gem_core.progress import Progress
    from gem_core.records import without_secrets
    from gem_core.rollouts import current_folder_importable
    from gem_eval.running.evaluation import EvaluationSession
    from gem_eval.running.limits import Limits

    if list_suites:
        _list_suites(as_json)
        return
    ctx.with_resource(current_folder_importable())  # an agent may import what stands beside it when it first acts
    limits = Limits(**{name: options.pop(name) for name in vars(Limits())})
    settings: dict[str, Any] = {name: options.pop(name) for name in _OF_SESSION}
    session = EvaluationSession(
        _suite(targets, options),
        [*models],
        limits=limits,
        max_concurrency=num_envs,
        command=shlex.join(without_secrets(shlex.split(typed_command(ctx)))),
        **settings,
    )
    total, before = session.plan.episodes, session.already_done()
    _begin(session, total, before)
    solved, errors = [], 0
    stopped_by: BaseException | None = None
    with Progress(total, session.suite.name, quiet=session.interactive) as progress:
        try:
            for done, row in enumerate(session.play(), start=before + 1):
                errors += row.error is not None
                solved += [] if row.success is None else [row.success]
                success = [f"success {sum(solved) / len(solved):.0%}"] if solved else []
                progress.advance(done, ", ".join([*success, counted(errors, "error")] if errors else success))
        except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 - raised again below, after the table
            stopped_by = error
    if stopped_by is not None and not session.path.joinpath("run.json").exists():
        raise stopped_by
    rows = session.rows()
    if as_json:
        click.echo(json.dumps({**session.metrics(), "run": str(session.path)}, indent=1))
    elif rows:
        from gem_eval.running.table import print_scores

        print_scores(session.scores(), rows)
        where = f"The record is in {session.path}; look at it with: gem view {shlex.quote(str(session.path))}"
        click.echo(where)
    _finish(ctx, session, rows, stopped_by)


def _begin(session: EvaluationSession, total: int, before: int) -> None:
    """Say which run goes on, and which roles are of no use."""
    for role in session.suite.roles:
        if not any(role in task.kwargs for task in session.plan.tasks):
            click.echo(f"gem: no task has the role {role!r}: no environment has a keyword of that name", err=True)
    if before:
        done = f"{before} of {total} episodes are there"
        click.echo(f"gem: going on with {session.path}, where {done}; --new begins another run", err=True)
    if session.changed:
        click.echo(f"gem: changed since the last session: {'; '.join(session.changed)}", err=True)


def _finish(ctx: click.Context, session: EvaluationSession, rows: list[Row], stopped_by: BaseException | None) -> None:
    """Say what failed and what was cut short, and exit."""
    errors = [row for row in rows if row.error is not None]
    if errors:
        told = f"{counted(len(errors), 'episode')} had an error; the first, {errors[0].row}: {errors[0].error}"
        click.echo(f"gem: {told}. Play them again with --retry-errors", err=True)
    done = f"after {len(rows)} of {session.plan.episodes} episodes; the same command"
    if isinstance(stopped_by, KeyboardInterrupt):
        click.echo(f"gem: interrupted {done} goes on", err=True)
        ctx.exit(INTERRUPTED)
    if stopped_by is not None:
        click.echo(f"gem: stopped {done} goes on", err=True)
        raise stopped_by
    reason = session.run.info.get("reason")
    if reason is not None:
        limit = reason.replace(" ", "-")
        click.echo(f"gem: the limit --{limit} was reached {done} with a higher limit goes on", err=True)
    ctx.exit(1 if errors or reason is not None else 0)


def _suite(targets: tuple[str, ...], options: dict[str, Any]) -> Suite:
    """Return the suite of the targets, with what the options say of it."""
    from gem_eval.suites import changed_suite, combined_suite

    suite = combined_suite(targets)
    names = ("limit", "shuffle", "where", "episodes", "max_turns", "max_tool_uses", "epochs", "seed")
    own: dict[str, Any] = {name: options.pop(name) for name in names}
    own["limit"] = own["limit"] or own["episodes"]  # an episode is a row, if there are rows
    sample_ids = options.pop("sample_ids")
    own["sample_ids"] = None if sample_ids is None else tuple(each.strip() for each in sample_ids.split(","))
    for name in ("tools", "wrappers"):
        own[name] = tuple(choice for text in options.pop(name) for choice in parsed_choices(text, f"--{name}")) or None
    own["kwargs"] = env_arguments(options.pop("arguments"))
    own["perturb"] = options.pop("perturb") or None
    own["roles"] = _roles(options.pop("roles"))
    own["sampling"] = given(options)
    return changed_suite(suite, {name: value for name, value in own.items() if value not in (None, {})})  # type: ignore[arg-type]


def _roles(given_roles: tuple[str, ...]) -> dict[str, str]:
    roles = {}
    for each in given_roles:
        role, equals, agent = each.partition("=")
        if not (role and equals and agent):
            raise ArgumentError(f"--role takes ROLE=AGENT, as user=openai:gpt-5-mini, not {each!r}")
        roles[role] = agent
    return roles


def _list_suites(as_json: bool) -> None:
    from gem_eval.suites import builtin_suites, load_suite

    suites = [(name, load_suite(name)) for name in builtin_suites()]
    if as_json:
        listed = [{"name": name, "description": each.description, "tasks": len(each.tasks)} for name, each in suites]
        click.echo(json.dumps(listed, indent=1))
        return
    width = max(len(name) for name, _ in suites)
    for name, suite in suites:
        click.echo(f"{name.ljust(width)}  {counted(len(suite.tasks), 'task')}. {suite.description}")
