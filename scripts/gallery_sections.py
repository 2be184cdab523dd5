"""For gallery.py: the sections of a page, as lines of Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from gallery_measuring import SEED, Solver

from gem_core.registry import EnvSpec

if TYPE_CHECKING:
    from gallery_docstrings import Described


def needs_of(record: EnvSpec) -> str:
    """Say in words what an environment needs besides its distribution."""
    told = []
    for word in record.requires:
        kind, _, name = word.partition(":")
        if kind == "argument":
            told.append(f"the argument `{name}`")
        elif kind == "hub":
            told.append("a data set of the Hugging Face hub, which is fetched when it is first used")
        elif kind == "postgres":
            told.append("the programs of PostgreSQL, or a server of it")
        elif kind == "docker":
            told.append("Docker")
    return f"It needs {' and '.join(told)}." if told else ""


def ids(records: Sequence[EnvSpec]) -> Iterator[str]:
    """Yield the table of ids, with the arguments in which they differ."""
    family = len({record.name.partition("-")[0] for record in records}) == 1
    differing = _differing(records) if family else []
    yield "## Ids\n"
    yield "| id | what it is | arguments |" if differing else "| id | what it is |"
    yield "| --- | --- | --- |" if differing else "| --- | --- |"
    for record in records:
        values = ", ".join(f"`{name}={_short(record.kwargs[name])}`" for name in differing if name in record.kwargs)
        yield f"| `{record.id}` | {_cell(record.summary)} |" + (f" {values} |" if differing else "")
    yield ""
    seats = records[0].seats
    if seats:
        yield f"Several agents act; the seats are {' and '.join(f'`{seat}`' for seat in seats)}.\n"
    if not all(record.deterministic for record in records):
        yield "A seed does not fix the whole episode.\n"


def _differing(records: Sequence[EnvSpec]) -> list[str]:
    names = list(dict.fromkeys(name for record in records for name in record.kwargs))
    return [
        name
        for name in names
        if len({repr(record.kwargs.get(name, "")) for record in records}) > 1 or len(records) == 1
    ]


def _short(value: object) -> str:
    text = repr(value).replace("\n", " ").replace("|", "\\|")
    return text if len(text) <= 60 else f"{text[:57]}…"


def arguments(told: Described, above: str, records: Sequence[EnvSpec]) -> Iterator[str]:
    """Yield the table of the constructor's arguments."""
    known = set.intersection(*(set(record.kwargs) for record in records))
    yield "## Arguments\n"
    if not told.arguments:
        yield "There are none.\n"
        return
    yield "`make` takes them as keywords, over those of the id.\n"
    yield "| argument | default | meaning |"
    yield "| --- | --- | --- |"
    for argument in told.arguments:
        required = "by the id" if argument.name in known else "must be given"
        default = required if argument.default is None else f"`{_short_source(argument.default)}`"
        default = "" if argument.name.startswith("*") else default
        yield f"| `{argument.name}` | {default} | {_cell(argument.meaning)} |"
    yield ""
    if any("DatasetEnv" in argument.meaning for argument in told.arguments):
        yield f"What `DatasetEnv` takes stands in [Data sets]({above}data-sets.md).\n"


def _short_source(source: str) -> str:
    source = source.replace("|", "\\|").replace("\n", "\\n")
    return source if len(source) <= 60 else f"{source[:57]}…"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def rewards(told: Described) -> Iterator[str]:
    """Yield what the docstring says about the rules, the rewards and the infos."""
    yield "## Rules and rewards\n"
    yield f"{told.summary}\n"
    if told.body:
        yield f"{told.body}\n"
    if told.source:
        yield f"Source: {told.source}\n"


def scores(records: Sequence[EnvSpec], played: Mapping[str, Any] | None, solver: Solver | None) -> Iterator[str]:
    """Yield the table of scores, and how they came about."""
    yield "## Scores\n"
    if not played or not played["rows"]:
        yield f"Not measured. {needs_of(records[0]) or 'Nobody has played it for this page yet.'}\n"
        return
    seats = any(row["seat"] for row in played["rows"])
    heads = ["id", "player", *(["seat"] if seats else []), "episodes", "mean return", "success", "turns"]
    yield f"| {' | '.join(heads)} |"
    yield f"| {' | '.join('---' for _ in heads)} |"
    for row in played["rows"]:
        cells = [
            f"`{row['id']}`",
            row["player"],
            *([f"`{row['seat']}`" if row["seat"] else ""] if seats else []),
            str(row["episodes"]),
        ]
        cells.append(_with_error(row["mean_return"], row["return_error"]))
        cells.append(_with_error(row["success"], row["success_error"], percent=True))
        yield f"| {' | '.join([*cells, _plain(row['turns'])])} |"
    yield ""
    yield f"Behind ± stands the standard error; that of the success is Wilson's. Seed of each run: {SEED}."
    errors = sum(row["errors"] for row in played["rows"])
    if errors:
        yield f"{errors} episodes ended in an error of the environment and do not count."
    if solver is not None:
        yield solver.told
    yield ""


def _with_error(value: float | None, error: float | None, *, percent: bool = False) -> str:
    if value is None:
        return "-"
    scale, form, unit = (100, ".1f", " %") if percent else (1, ".3f", "")
    shown = format(value * scale, form)
    return f"{shown}{unit}" if error is None else f"{shown} ± {error * scale:{form}}{unit}"


def _plain(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


# Episodes.


def transcript(episode: Mapping[str, Any]) -> Iterator[str]:
    """Tell an episode; what is said stands in ``pre``, which GitHub and the site show alike."""
    returns = ", ".join(f"{seat} {value:.4g}".strip() for seat, value in episode["returns"].items())
    start = f"`seed={episode['seed']}`" + (f", `options={episode['options']}`" if episode["options"] else "")
    yield f"Player: {episode['player']}. Environment: `{episode['id']}`, {start}."
    yield f"Return: {returns}. {_verdict(episode)}"
    yield ""
    yield f"<details>\n<summary>All that was said ({_counted(episode['num_turns'], 'turn')})</summary>\n"
    yield f"<pre><code>{_preformatted(episode['opening'])}</code></pre>\n"
    before = 0
    for turn in episode["turns"]:
        if turn["number"] > before + 1:
            yield f"<p>[left out here: {_counted(turn['number'] - before - 1, 'turn')}]</p>\n"
        before = turn["number"]
        who = f", {escape(turn['seat'])}" if turn["seat"] else ""
        yield f"<p><b>Turn {turn['number']}{who}</b>, reward {turn['reward']:.4g}</p>\n"
        yield f"<pre><code>{_preformatted(turn['action'])}</code></pre>\n"
        yield f"<pre><code>{_preformatted(turn['answer'])}</code></pre>\n" if turn["answer"] else ""
    yield "</details>\n"


def _counted(count: int, word: str) -> str:
    return f"{count} {word}{'' if count == 1 else 's'}"


def _verdict(episode: Mapping[str, Any]) -> str:
    seats = [seat for seat, success in episode["success"].items() if success]
    if list(episode["success"]) == [""]:
        return "Solved." if seats else "Not solved."
    return f"Won by: {', '.join(seats) or 'nobody'}."


def _preformatted(text: str) -> str:
    # Extensions of Markdown look for fences inside HTML too.
    return escape(text, quote=False).replace("`", "&#96;")
