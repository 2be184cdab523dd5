"""``gem report``: the scores of runs as a page or as JSON."""

from __future__ import annotations

from pathlib import Path

import click

from gem_core.cli import counted
from gem_core.errors import ArgumentError
from gem_eval.files import write_page
from gem_eval.opening import warn_of_damage
from gem_eval.output import print_json
from gem_eval.records import open_run
from gem_eval.reporting.contents import contents_of
from gem_eval.reporting.page import html_report

_OUT = Path("report.html")


@click.command(
    "report",
    epilog="""\b
Examples:
  gem report runs/mine                              writes report.html
  gem report runs/a runs/b --out a-and-b.html       side by side, with the differences on shared rows
  gem report runs/mine --json                       the scores, for a program
\b
The page is one file that needs no network. Texts of models are in its examples only.
\b
Exit code: 0 if the report was written, 1 if a run cannot be read, 2 for a wrong argument.
""",
)
@click.argument("runs", metavar="RUN…", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "-o", "--out", type=click.Path(path_type=Path, dir_okay=False), default=_OUT, show_default=True, help="The file."
)
@click.option(
    "--examples", type=click.IntRange(min=0), default=8, show_default=True, help="Episodes to show turn by turn."
)
@click.option("--json", "as_json", is_flag=True, help="Write the scores as JSON to standard output, and no page.")
def command(runs: tuple[Path, ...], out: Path, examples: int, as_json: bool) -> None:
    """Write the scores of runs, with intervals and plots, as one page.

    RUN is a folder that 'gem eval' wrote, or a file of 'gem run'. Several runs stand side by side.
    """
    contents = contents_of([open_run(path) for path in runs])
    for run in contents.runs:
        warn_of_damage(run)
    if as_json:
        scores = [
            {"run": str(entrant.run.path), **score.to_dict()}
            for entrant in contents.entrants
            for score in entrant.scores.values()
        ]
        print_json({"scores": scores})
        return
    if out.exists() and any(out.resolve().is_relative_to(path.resolve()) for path in runs):
        raise ArgumentError(f"--out {out} is part of a run; name another file")
    write_page(out, html_report(contents, examples))
    click.echo(f"report of {counted(len(contents.rows), 'episode')} written to {out}")
