"""``gem show``: recorded episodes as a person reads them."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import sys
import time
from collections.abc import Iterable, Iterator
from typing import Any

import click

from gem_core.cli.viewing.filters import SORTS, Filters, chosen
from gem_core.cli.viewing.index import Entry, EpisodeFile
from gem_core.cli.viewing.pages import episode_lines, list_lines
from gem_core.cli.viewing.terminal import Paint, in_terminal, one_line, wants_colours
from gem_core.errors import ArgumentError, EpisodeFileError
from gem_core.records.plain_json import ImageFolder, to_plain

_HTML_LIMIT = 500
_SILENT_S = 2.0
_BATCH = 100


@click.command(
    "show",
    epilog="""\b
Examples:
  gem show runs/mine.jsonl                            the list
  gem show runs/mine.jsonl --failure --return '>0.5'  nearly solved
  gem show runs/mine.jsonl --grep Traceback --json
  gem show runs/mine.jsonl --sort return --reverse --limit 10
  gem show runs/mine.jsonl 17                         one episode, turn by turn
  gem show runs/mine.jsonl --diff 17 21               where two episodes of one start part
  gem show runs/mine.jsonl --html mine.html           a page for the browser, in one file
\b
The number of an episode is its line in the file. In a terminal, the output is paged: '/' searches,
'n' finds the next, 'q' leaves; PAGER names another pager, NO_COLOR switches colours off. What could
move the cursor or hide text is shown as its code. Images are named; --html shows them.
\b
A file of some size gets an index beside it, FILE.index, so that it opens at once the next time; it
may be deleted. A line that is cut off or damaged is passed over, and named on standard error.
\b
Exit code: 0 if the file could be read, even where no episode fits, 1 if it holds no whole episode or
the one asked for is damaged, 2 for a wrong argument.
""",
)
@click.argument("path", metavar="FILE", type=click.Path(exists=True, dir_okay=False))
@click.argument("number", metavar="[N]", required=False, type=click.IntRange(min=1))
@click.option("--episode", "option_number", metavar="N", type=click.IntRange(min=1), help="The same as N.")
@click.option("--env", metavar="PATTERN", help="Only ids with this part, or that fit a glob in quotes.")
@click.option("--success/--failure", "success", default=None, help="Only solved, or only known as not solved.")
@click.option("--return", "returns", metavar="COMPARISON", help="Only these returns: '>0.5', '<=0', '=1'.")
@click.option("--errors/--no-errors", "errors", default=None, help="Only with, or only without an error.")
@click.option("--group", metavar="G", help="Only this group.")
@click.option("--grep", metavar="TEXT", help="Only with this text in an observation, response or info.")
@click.option("--sort", type=click.Choice(list(SORTS)), help="Order of the list; the whole file is looked at first.")
@click.option("--reverse", is_flag=True, help="The other way round.")
@click.option(
    "--limit", type=click.IntRange(min=1), help=f"So many episodes at most.  [default: all; {_HTML_LIMIT} with --html]"
)
@click.option("--diff", nargs=2, metavar="A B", type=click.IntRange(min=1), help="Tell two episodes apart.")
@click.option("--html", metavar="OUT", type=click.Path(dir_okay=False), help="Write one page that needs no network.")
@click.option("--full", is_flag=True, help="Show long infos, and what observations repeat, as well.")
@click.option("--json", "as_json", is_flag=True, help="Write the list, or the episode N, as JSON.")
def command(
    path: str,
    number: int | None,
    option_number: int | None,
    diff: tuple[int, int] | None,
    html: str | None,
    full: bool,
    as_json: bool,
    sort: str | None,
    reverse: bool,
    limit: int | None,
    **conditions: Any,
) -> None:
    """Show the episodes of a file: a list, one of them turn by turn, two compared, or a page for the browser.

    FILE is what 'gem run' wrote. N is the number of one episode.
    """
    if number is not None and option_number not in (None, number):
        raise ArgumentError(f"N is {number}, but --episode is {option_number}; name one")
    number = option_number if number is None else number
    _check_combination(number, diff, html, as_json)
    filters = Filters(**conditions)
    _make_output_safe()
    with EpisodeFile(path) as file:
        if not file.size:
            raise EpisodeFileError(f"{path} is empty: it holds no episodes (yet)")
        if diff is not None:
            _show_diff(file, diff)
        elif number is not None and html is None:
            _show_episode(file, number, full, as_json)
        elif html is not None:
            entries = filters.select(file) if number is None else iter([_whole(file, number)])
            _write_page(file, chosen(_with_progress(file, entries), sort, reverse, None), html, limit or _HTML_LIMIT)
        else:
            entries = filters.select(file)
            if as_json or sort is not None or reverse or not in_terminal():
                entries = _with_progress(file, entries)
            _show_list(file, chosen(entries, sort, reverse, limit), as_json)
        _report_damage(file)


def _check_combination(number: int | None, diff: object, html: str | None, as_json: bool) -> None:
    if diff is not None and (number is not None or html is not None or as_json):
        raise ArgumentError("--diff goes with no other form: leave out N, --html and --json")
    if html is not None and as_json:
        raise ArgumentError("--html and --json are two forms; choose one")


def _show_list(file: EpisodeFile, entries: Iterator[Entry], as_json: bool) -> None:
    if as_json:
        click.echo(json.dumps([to_plain(entry.to_dict()) for entry in entries], indent=1))
    else:
        first = list(itertools.islice(entries, 1))
        width = shutil.get_terminal_size().columns if in_terminal() else None
        _print(list_lines(itertools.chain(first, entries), Paint(wants_colours()), width))
        if first:
            return
    if file.share_indexed < 1:
        return
    whole = sum(1 for _ in file.entries())
    if not whole and file.damaged:
        worst = file.damaged[0]
        raise EpisodeFileError(f"{file.path} holds no whole episode; line {worst.number}: {worst.damage}")
    if not whole:
        raise EpisodeFileError(f"{file.path} holds no episode: its lines are blank")
    if not as_json:
        click.echo(f"gem: none of the {whole:,} episodes of {file.path} fits", err=True)


def _show_episode(file: EpisodeFile, number: int, full: bool, as_json: bool) -> None:
    episode = file.read(_whole(file, number))
    if as_json:
        click.echo(json.dumps(to_plain({"number": number, **episode.to_dict()}), indent=1))
    else:
        _print(episode_lines(episode, number, Paint(wants_colours()), full=full))


def _show_diff(file: EpisodeFile, numbers: tuple[int, int]) -> None:
    from gem_core.cli.viewing.diff import diff_lines

    one, other = (file.read(_whole(file, number)) for number in numbers)
    _print(diff_lines(numbers, (one, other), Paint(wants_colours())))


def _write_page(file: EpisodeFile, entries: Iterator[Entry], out: str, limit: int) -> None:
    from gem_core.cli.viewing.html import PageWriter

    if os.path.realpath(out) == os.path.realpath(file.path):
        raise ArgumentError(f"--html {out} is the file of episodes itself; name another")
    page = PageWriter(file.path.name, ImageFolder.beside(file.path))
    count = left_out = 0
    for entry in entries:
        if count == limit:
            left_out += 1
            continue
        try:
            page.add(entry.number, file.read(entry))
        except EpisodeFileError as error:
            click.echo(f"gem: passed over, {one_line(str(error))}", err=True)
        else:
            count += 1
    if not count:
        if any(True for _ in file.entries()):
            raise ArgumentError(f"no episode of {file.path} fits; no page is written")
        raise EpisodeFileError(f"{file.path} holds no whole episode; no page is written")
    if left_out:
        page.notes.append(
            f"{left_out:,} more episodes are left out of this page; --limit {count + left_out} takes all."
        )
    if file.damaged:
        page.notes.append(f"{len(file.damaged):,} lines of the file hold no whole episode.")
    page.write(out)
    rest = f" ({left_out:,} more left out: raise --limit)" if left_out else ""
    click.echo(f"{count} episode{'s' if count != 1 else ''} written to {out}{rest}")


def _whole(file: EpisodeFile, number: int) -> Entry:
    entry = file.entry(number)
    if entry.damage is not None:
        raise EpisodeFileError(f"{file.path}, line {number} holds no whole episode: {entry.damage}")
    return entry


def _report_damage(file: EpisodeFile) -> None:
    damaged = file.damaged
    if damaged:
        more = f"; lines passed over in all: {len(damaged):,}" if len(damaged) > 1 else ""
        reason = one_line(f"{damaged[0].damage}", 300)
        click.echo(f"gem: {file.path}, line {damaged[0].number}: passed over, because {reason}{more}", err=True)


def _print(lines: Iterable[str]) -> None:
    """Write lines: paged in a terminal, else as they come."""
    if in_terminal():
        # F: what fits the screen stays there without a pager. R: colours, and no other codes. X: no clearing.
        os.environ.setdefault("LESS", "-FRX")
        click.echo_via_pager((f"{line}\n" for line in lines), color=wants_colours())
        return
    for batch in _batches(lines):
        click.echo("\n".join(batch))


def _batches(lines: Iterable[str]) -> Iterator[list[str]]:
    # Each line written alone would cost a system call.
    remaining = iter(lines)
    while batch := list(itertools.islice(remaining, _BATCH)):
        yield batch


def _make_output_safe() -> None:
    """Let what the output's encoding does not have be shown as its code."""
    reconfigure = getattr(sys.stdout, "reconfigure", None)
    if reconfigure is not None:
        reconfigure(errors="backslashreplace")


def _with_progress(file: EpisodeFile, entries: Iterator[Entry]) -> Iterator[Entry]:
    """Say how far the indexing is, in a terminal and when it takes longer than a moment."""
    if not sys.stderr.isatty() or file.share_indexed == 1:
        yield from entries
        return
    started = shown = time.monotonic()
    for entry in entries:
        now = time.monotonic()
        if now - started > _SILENT_S and now - shown > 0.2:
            shown = now
            click.echo(f"\rgem: reading {file.path.name}, {file.share_indexed:.0%} ", err=True, nl=False)
        yield entry
    if shown != started:
        click.echo("\r\x1b[K", err=True, nl=False)
