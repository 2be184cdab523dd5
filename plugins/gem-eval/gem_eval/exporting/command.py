"""``gem export``: runs in the forms that other programs read."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import click

from gem_core.cli import counted
from gem_core.errors import ArgumentError, EpisodeFileError
from gem_core.records import whole_file
from gem_eval.exporting.inspect_log import write_log
from gem_eval.exporting.tables import write_csv, write_jsonl
from gem_eval.grouping import grouped
from gem_eval.opening import warn_of_damage
from gem_eval.records import Run, open_run


@click.command(
    "export",
    epilog="""\b
Examples:
  gem export runs/mine --to csv --texts --out mine.csv    a row for each episode, with questions and responses
  gem export runs/a runs/b --to jsonl --out both.jsonl    whole episodes, as gem run writes them, with their images
  gem export runs/mine --to inspect --out logs            for: inspect view --log-dir logs
\b
In Python, gem_eval.to_pandas("runs/mine") returns the table of csv as a DataFrame.
\b
Exit code: 0 if all was written, 1 if a run cannot be read, 2 for a wrong argument.
""",
)
@click.argument("runs", metavar="RUN…", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--to", "form", required=True, type=click.Choice(["csv", "jsonl", "inspect"]), help="The form.")
@click.option("-o", "--out", required=True, type=click.Path(path_type=Path), help="The file; for inspect a folder.")
@click.option("--texts", is_flag=True, help="csv: add the first observation and the last response.")
def command(runs: tuple[Path, ...], form: str, out: Path, texts: bool) -> None:
    """Write the episodes of runs in a form that other programs read.

    RUN is a folder that 'gem eval' wrote, or a file of 'gem run'.
    """
    if texts and form != "csv":
        raise ArgumentError(f"--texts goes with csv: {form} always has all texts")
    if any(out.resolve().is_relative_to(path.resolve()) for path in runs):
        raise ArgumentError(f"--out {out} is the run itself, or inside of it; name another place")
    opened = [open_run(path) for path in runs]
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        if form == "inspect":
            written = counted(_write_logs(opened, out), "log")
        elif form == "jsonl":
            written = counted(write_jsonl(opened, out), "episode")
        else:
            written = counted(write_csv(opened, out, texts=texts), "episode")
    except OSError as error:
        raise EpisodeFileError(f"cannot write {out}: {error.strerror or error}") from error
    click.echo(f"{written} written to {out}")
    for run in opened:
        warn_of_damage(run)


def _write_logs(runs: Sequence[Run], out: Path) -> int:
    """Write a log for each task and model of each run, and return their number."""
    logs = [(run, *key, own) for run in runs for key, own in grouped(run.rows, lambda row: (row.id, row.model)).items()]
    if not logs:
        raise ArgumentError("there are no episodes in these runs, and no logs to write")
    out.mkdir(exist_ok=True)
    for number, (run, task, model, rows) in enumerate(logs, start=1):
        # The number keeps names apart that differ in what no file name may hold.
        name = "_".join(re.sub(r"[^\w.-]+", "-", text)[:60] for text in (run.name, task, model))
        with whole_file(out / f"{name}_{number}.eval") as file:
            write_log(run, task, model, rows, file)
    return len(logs)
