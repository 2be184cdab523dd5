"""``gem train``: a small policy learns from scratch, on the processor."""

from __future__ import annotations

import json
import os
import shlex
import signal
import time
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from gem_core.cli import (
    AGENTS,
    ENVS,
    INTERRUPTED,
    AtLeast,
    arguments_option,
    counted,
    echo_line,
    env_arguments,
    find_env,
    find_envs,
    stack_options,
    wrapper_stack,
)
from gem_core.errors import ArgumentError, MissingRequirementError
from gem_train.learner.options import ALGORITHMS, TrainOptions

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_DEFAULTS = {field.name: field.default for field in fields(TrainOptions)}
_ABOVE_0 = click.FloatRange(min=0, min_open=True)
_FROM_0 = click.FloatRange(min=0)
_SHARE = click.FloatRange(min=0, max=1)
_FIELDS = {"ids": "env", "arguments": "env_kwargs", "tools": "wrappers", "skip_cut_off": "learn_cut_off"}
_BESIDE_RESUME = ("resume", "imports", "tensorboard", "as_json")


def _options_of_a_run(*options: tuple[str, Any, str]) -> Callable[[Any], Any]:
    """Return what adds options to a command: of each its name, its type or ``True`` for a flag, and its help.

    Their defaults are those of ``TrainOptions``.
    """

    def add(command: Any) -> Any:
        for name, kind, text in reversed(options):
            default = _DEFAULTS[name.removeprefix("--").replace("-", "_")] if kind is not True else None
            kwargs: dict[str, Any] = {"is_flag": True} if kind is True else {"type": kind}
            if default:
                kwargs |= {"default": default, "show_default": True}
            if isinstance(kind, click.FloatRange):
                kwargs["metavar"] = "NUMBER"
            command = click.option(name, help=text, **kwargs)(command)
        return command

    return add


@click.command(
    "train",
    epilog="""\b
Examples:
  gem train game:GuessTheNumber-v0-easy --out runs/guess
  gem train --resume runs/guess
  gem train game:Sudoku-v0-easy --algorithm ppo --eval-every 50
  gem train game:GuessTheNumber-v0 --imitate bisect --feedback --memory 1 --context 64 --episodes 512
  gem run game:GuessTheNumber-v0 --agent train:runs/guess
\b
A new policy writes random text, which no environment can read: so it first imitates a player, which plays
at random unless --imitate names another. It reads the conversation so far, or what a view in --wrappers
shows.
\b
The folder of the run has options.json, metrics.jsonl, checkpoint.pt and curves.png. Ctrl-C keeps a
checkpoint. The same command with --out, or --resume FOLDER, goes on, and ends with the metrics and
weights of a run that was never stopped (with --overlap nearly).
\b
Exit code: 0 if every episode ran, 1 if one had an error, 2 for a wrong argument, 130 after Ctrl-C.
""",
)
@click.argument("ids", nargs=-1, type=ENVS, metavar="ID...")
@arguments_option
@stack_options("A view decides what the policy reads.")
@click.option("-o", "--out", type=click.Path(file_okay=False), help="Folder of the run.  [default: a new one in runs/]")
@click.option("--resume", metavar="FOLDER", help="Go on with the run in FOLDER, with its options.")
@click.option("-s", "--seed", type=AtLeast(min=0), default=0, show_default=True, help="Seed of the run.")
@click.option("--threads", type=AtLeast(min=0), default=0, help="Threads of torch.  [default: torch's own]")
@click.option("--tensorboard", is_flag=True, help="Write for TensorBoard as well, into FOLDER/tensorboard.")
@click.option("--json", "as_json", is_flag=True, help="Write the last metrics as JSON.")
@_options_of_a_run(
    ("--algorithm", click.Choice(ALGORITHMS), "Estimator of advantages, and loss."),
    ("--gamma", _SHARE, "Discount from turn to turn; not for GRPO and RLOO."),
    ("--lam", _SHARE, "Lambda of GAE, for PPO."),
    ("--updates", AtLeast(min=1), "Number of updates."),
    ("--episodes", AtLeast(min=1), "Episodes of each update."),
    ("--group-size", AtLeast(min=1), "Episodes with one start.  [default: 8 for GRPO and RLOO, else 1]"),
    ("--epochs", AtLeast(min=1), "Passes over each batch.  [default: 4 for PPO, else 1]"),
    ("--minibatches", AtLeast(min=1), "Steps of the optimizer in a pass.  [default: 4 for PPO, else 1]"),
    ("--learning-rate", _ABOVE_0, "Of AdamW; it falls to 0, in a straight line, until the last update."),
    ("--clip", _ABOVE_0, "Range of the ratio, for PPO and GRPO."),
    ("--entropy", _FROM_0, "Weight of the entropy bonus.  [default: 0]"),
    ("--role-baselines", True, "Subtract a moving mean of each seat's returns, in self-play."),
    ("--failure-reward", float, "Added to the last reward of an episode that was not solved.  [default: 0]"),
    ("--overlap", True, "Play the next batch while learning from this one, one update off-policy."),
    ("--feedback", True, "After the first turn, show only the environment's feedback, if it gives some."),
    ("--memory", AtLeast(min=0), "Earlier turns that the policy reads.  [default: all that fit in --context]"),
    ("--context", AtLeast(min=2), "Most tokens of a prompt and its response."),
    ("--max-tokens", AtLeast(min=1), "Most tokens of a response."),
    ("--skip-cut-off", True, "Do not learn from responses cut off there."),
    ("--temperature", _ABOVE_0, "Temperature of sampling."),
    ("--layers", AtLeast(min=1), "Layers of the transformer."),
    ("--width", AtLeast(min=2), "Width of the transformer, a multiple of 4."),
    ("--imitate", AGENTS, "Agent to imitate first: a name, MODULE:CALLABLE, or none."),
    ("--imitate-episodes", AtLeast(min=1), "Episodes that it plays."),
    ("--imitate-steps", AtLeast(min=1), "Steps of the optimizer, of 128 turns each."),
    ("--eval-every", AtLeast(min=0), "Updates between evaluations.  [default: one, at the end]"),
    ("--eval-episodes", AtLeast(min=1), "Episodes of an evaluation."),
    ("--checkpoint-every", AtLeast(min=1), "Updates between checkpoints."),
)
@click.option(
    "--eval-env",
    "eval_envs",
    multiple=True,
    type=ENVS,
    metavar="ID",
    help="Evaluate on this environment. Can be repeated.  [default: those of the training]",
)
@click.pass_context
def command(
    ctx: click.Context,
    /,
    resume: str | None,
    out: str | None,
    tensorboard: bool,
    as_json: bool,
    **given: Any,
) -> None:
    """Train a small transformer from scratch, which reads and writes the text of environments.

    Several environments are learned together. The policy is kept in a folder, and plays as the agent train:FOLDER.
    """
    # Imported here, so that help need not wait for them.
    from gem_core.progress import Progress
    from gem_core.rollouts import current_folder_importable

    try:
        from gem_train.learner.run import RunFolder, train
    except ImportError as error:
        raise MissingRequirementError("gem train needs PyTorch: pip install 'gem-train[torch]'") from error
    ctx.with_resource(current_folder_importable())  # a player to imitate may be there
    if resume is not None:
        _refuse_beside_resume(ctx)
        folder, options = Path(resume), RunFolder(resume).options()
    else:
        options = _options(given)
        _check_names(options)  # before a folder is made
        folder = Path(out) if out is not None else _new_folder(options)
    steps = options.imitate_steps if options.imitate else 0
    try:
        with Progress(steps + options.updates, "training", unit="steps and updates") as progress:
            metrics = train(
                options,
                folder,
                named=[_FIELDS.get(name, name) for name in ctx.params if _is_given(ctx, name)],
                tensorboard=tensorboard,
                on_imitation=lambda step, loss: progress.advance(step + 1, f"imitation, loss {loss:.3f}"),
                on_update=lambda update, metrics: progress.advance(steps + update, _line(metrics)),
            )
    except KeyboardInterrupt:
        # A second Ctrl-C would cut off what is said after the first.
        before_it = signal.signal(signal.SIGINT, signal.SIG_IGN)
        ctx.call_on_close(lambda: signal.signal(signal.SIGINT, before_it))
        click.echo(f"gem: interrupted; go on with: gem train --resume {shlex.quote(str(folder))}", err=True)
        ctx.exit(INTERRUPTED)
    if as_json:
        click.echo(json.dumps({"folder": str(folder), **metrics}, indent=1))
    else:
        _print_end(metrics, options, folder)
    _tell_errors(ctx, folder)


def _is_given(ctx: click.Context, name: str) -> bool:
    return ctx.get_parameter_source(name) == ParameterSource.COMMANDLINE


def _refuse_beside_resume(ctx: click.Context) -> None:
    for parameter in ctx.command.params:
        name = str(parameter.name)
        if _is_given(ctx, name) and name not in _BESIDE_RESUME:
            what = parameter.opts[-1] if isinstance(parameter, click.Option) else "the ids"
            raise ArgumentError(f"--resume goes on with the options of the run; leave out {what}")


def _options(given: dict[str, Any]) -> TrainOptions:
    ids, imitate = given.pop("ids"), given.pop("imitate")
    if not ids:
        raise ArgumentError("name an environment, as in 'gem train game:GuessTheNumber-v0'; 'gem list' shows them")
    envs = find_envs(ids, several=False)
    if any(own for _, own in envs):
        raise ArgumentError("gem train takes ids of environments, not folders")
    stack = [given.pop(name) for name in ("wrappers", "tools", "max_tool_uses", "max_turns")]
    return TrainOptions(
        env=tuple(record.id for record, _ in envs),
        env_kwargs=env_arguments(given.pop("arguments")),
        wrappers=tuple(wrapper_stack(*stack)),
        learn_cut_off=not given.pop("skip_cut_off"),
        eval_envs=tuple(find_env(each)[0].id for each in given.pop("eval_envs")),
        imitate=None if imitate == "none" else imitate,
        **{name: value for name, value in given.items() if value is not None},
    )


def _check_names(options: TrainOptions) -> None:
    """Make the player and each environment once, so that a wrong name or argument is told at once."""
    from gem_core.rollouts import load_agent
    from gem_train.learner.environments import seat_count

    if options.imitate is not None:
        load_agent(options.imitate)
    for env_id in (*options.env, *options.eval_envs):
        seat_count(env_id, options)


def _new_folder(options: TrainOptions) -> Path:
    folder = Path("runs", f"train-{time.strftime('%Y%m%d-%H%M%S')}-{options.seed}-{os.getpid()}")
    folder.mkdir(parents=True)
    return folder


def _line(metrics: Mapping[str, float | None], prefix: str = "") -> str:
    """Return return, success and turns in words, as far as they are known."""
    shown = []
    for name, form in (("return", "{:.3f}"), ("success", "{:.0%}"), ("turns", "{:.2f}")):
        value = metrics.get(prefix + name)
        if value is not None and value == value:
            shown.append(f"{name} {form.format(value)}")
    return ", ".join(shown)


def _print_end(metrics: Mapping[str, float | None], options: TrainOptions, folder: Path) -> None:
    """Say how the run ended, and what can be done with it."""
    echo_line(f"last update: {_line(metrics)}")
    for prefix in dict.fromkeys(f"{name.rpartition('/')[0]}/" for name in metrics if name.startswith("eval/")):
        echo_line(f"evaluation{prefix.removeprefix('eval').rstrip('/').replace('/', ' of ')}: {_line(metrics, prefix)}")
    echo_line(f"curves: {folder / 'curves.png'}")
    again = ["gem", "run", options.env[0], "--agent", f"train:{folder}"]
    if options.wrappers:
        again += ["--wrappers", json.dumps(options.to_dict()["wrappers"])]
    for name, value in options.env_kwargs.items():
        again += ["--set", f"{name}={json.dumps(value)}"]
    echo_line(f"let it play: {shlex.join(again)}")


def _tell_errors(ctx: click.Context, folder: Path) -> None:
    from gem_train.reporting import read_metrics

    errors = sum(
        int(value or 0)
        for line in read_metrics(folder)
        for name, value in line.items()
        if name.rpartition("/")[2] == "errors"
    )
    if errors:
        echo_line(f"gem: {counted(errors, 'episode')} had an error, and were left out", err=True)
    ctx.exit(1 if errors else 0)
