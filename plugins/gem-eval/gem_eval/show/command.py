"""``gem show``: recorded episodes as a person reads them."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from typing import Any

import click

from gem_core import Episode
from gem_core.cli import counted, output_width
from gem_core.errors import ArgumentError, EpisodeFileError
from gem_core.records import Record
from gem_core.suggestions import did_you_mean
from gem_eval.filters import SORTS, at_seat, ordered, parse_comparison, select
from gem_eval.opening import warn_of_damage
from gem_eval.output import print_json
from gem_eval.records import Row, Run
from gem_eval.show.lines import episode_lines, list_lines
from gem_eval.show.paging import write_lines
from gem_eval.show.text import one_line

_HTML_LIMIT = 500


@click.command(
    "show",
    epilog="""\b
Examples:
  gem show runs/mine.jsonl                            the list
  gem show runs/mine.jsonl --failure --return '>0.5'  nearly solved
  gem show runs/mine.jsonl --grep Traceback --json
  gem show runs/mine.jsonl --sort return --reverse --limit 10
  gem show runs/mine.jsonl 17                         one episode, turn by turn
  gem show runs/mine.jsonl --html mine.html           a page for the browser, in one file
  gem show runs/games.jsonl 3 --seat white            a game as white saw it
\b
Of a game of several agents, --success finds those that one of them won, and --return compares the sum of
their returns. In a terminal, the output is paged: '/' searches, 'q' leaves; PAGER names another pager,
NO_COLOR switches colours off.
\b
Exit code: 0 if the file could be read, even if no episode fits, 1 if it has no whole episode or
the one asked for is damaged, 2 for a wrong argument.
""",
)
@click.argument("path", metavar="RUN", type=click.Path(exists=True))
@click.argument("number", metavar="[N]", required=False, type=click.IntRange(min=1))
@click.option("--env", metavar="PATTERN", help="Only ids with this part, or that fit a glob in quotes.")
@click.option("--model", metavar="PATTERN", help="Only these models, by the same rule.")
@click.option("--success/--failure", "success", default=None, help="Only solved, or only not solved.")
@click.option(
    "--return", "returns", metavar="COMPARISON", type=parse_comparison, help="Only these returns: '>0.5', '<=0', '=1'."
)
@click.option("--errors/--no-errors", "errors", default=None, help="Only with, or only without an error.")
@click.option("--group", metavar="G", help="Only this group.")
@click.option("--seat", metavar="NAME", help="Only what the agent at this seat saw and did.")
@click.option("--grep", metavar="TEXT", help="Only with this text in an observation, response or info.")
@click.option("--sort", type=click.Choice(list(SORTS)), help="Order of the list.")
@click.option("--reverse", is_flag=True, help="Reverse the order.")
@click.option(
    "--limit", type=click.IntRange(min=1), help=f"Most episodes to show.  [default: all; {_HTML_LIMIT} with --html]"
)
@click.option("--html", metavar="OUT", type=click.Path(dir_okay=False), help="Write one page that needs no network.")
@click.option("--full", is_flag=True, help="Also show long infos, and what observations repeat.")
@click.option("--json", "as_json", is_flag=True, help="Write the list, or the episode N, as JSON.")
def command(
    path: str,
    number: int | None,
    seat: str | None,
    html: str | None,
    full: bool,
    as_json: bool,
    sort: str | None,
    reverse: bool,
    limit: int | None,
    **conditions: Any,
) -> None:
    """Show recorded episodes: a list, one of them turn by turn, or a page for the browser.

    RUN is a folder that 'gem eval' wrote, or a file of 'gem run'. N is the number of one episode.
    """
    if html is not None and as_json:
        raise ArgumentError("--html and --json are two forms; choose one")
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # for what its encoding does not have
    run = Run(path, joint=True)
    if not run.rows:
        reason = f"; line {min(run.damage)}: {run.damage[min(run.damage)]}" if run.damage else " (yet)"
        raise EpisodeFileError(f"{path} holds no whole episode{reason}")
    if number is not None and html is None:
        _show_episode(run, number, seat, full, as_json)
    else:
        rows = run.rows if seat is None else at_seat(run.rows, seat)
        fitting = select(run, rows, **conditions) if number is None else iter([run.row(number)])
        if html is not None:
            _write_page(run, ordered(fitting, sort, reverse, None), seat, html, limit or _HTML_LIMIT)
        else:
            _show_list(run, list(ordered(fitting, sort, reverse, limit)), as_json)
    warn_of_damage(run)


def _show_list(run: Run, rows: list[Row], as_json: bool) -> None:
    if as_json:
        print_json([_json_row(row) for row in rows])
        return
    write_lines(list_lines(rows, output_width()))
    if not rows:
        click.echo(f"gem: no episode of {run.path} fits, of {len(run.rows):,}", err=True)


def _json_row(row: Row) -> dict[str, Any]:
    record = {"number": row.number, "id": row.id, **_figures(row), "seed": row.seed, "group": row.group}
    record |= {"model": row.model or None, "cut_off": row.cut_off}
    if row.seats is not None:
        record["model"] = None
        record["seats"] = {seat: {"agent": own.model, **_figures(own)} for seat, own in row.seats.items()}
    return record


def _figures(row: Row) -> dict[str, Any]:
    return {"success": row.success, "return": row.episode_return, "turns": row.turns, "error": row.error}


def _show_episode(run: Run, number: int, seat: str | None, full: bool, as_json: bool) -> None:
    episode = _read(run, run.row(number), seat)
    if as_json:
        print_json({"number": number, **episode.to_dict()})
    else:
        write_lines(episode_lines(episode, number, full=full))


def _read(run: Run, row: Row, seat: str | None) -> Record:
    """Return the episode of a row, or that of one of its seats."""
    record = run.record(row)
    if seat is None:
        return record
    if isinstance(record, Episode):
        raise ArgumentError(f"episode {row.number} is of one agent, and has no seats: leave --seat out")
    if seat not in record.seats:
        raise ArgumentError(
            f"episode {row.number} has no seat {seat!r}.{did_you_mean(seat, list(record.seats))} Its seats are "
            f"{', '.join(map(one_line, record.seats))}"
        )
    return record.seats[seat]


def _write_page(run: Run, rows: Iterator[Row], seat: str | None, out: str, limit: int) -> None:
    from gem_eval.show.page import PageWriter

    if os.path.realpath(out) == os.path.realpath(run.path):
        raise ArgumentError(f"--html {out} is the file of episodes itself; name another")
    page = PageWriter(run.path.name, run.images)
    written = left_out = 0
    for row in rows:
        if written == limit:
            left_out += 1
            continue
        try:
            page.add(row.number, _read(run, row, seat))
        except EpisodeFileError as error:
            click.echo(f"gem: passed over, {one_line(str(error))}", err=True)
        else:
            written += 1
    if not written:
        raise ArgumentError(f"no episode of {run.path} fits; no page is written")
    if left_out:
        page.notes.append(
            f"{left_out:,} more episodes are left out of this page; --limit {written + left_out} takes all."
        )
    if run.damaged:
        page.notes.append(f"{run.damaged:,} lines of the file hold no whole episode.")
    page.write(out)
    rest = f" ({left_out:,} more left out: raise --limit)" if left_out else ""
    click.echo(f"{counted(written, 'episode')} written to {out}{rest}")
