"""The sections without scores: episodes to look at, what was asked, and how things are counted."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from gem_core.cli import counted
from gem_core.errors import EpisodeFileError
from gem_eval.reporting import amounts
from gem_eval.reporting.contents import Contents, Entrant, ending_of, endings
from gem_eval.reporting.markup import section, text
from gem_eval.turns import TurnView, error_text, figures_of, parts_of, text_of, turn_views

if TYPE_CHECKING:
    from gem_eval.records import Row

_FIRST_TURNS, _LAST_TURNS = 2, 3
_LONGEST_TEXT = 1500
_MOST_NUMBERS = 15
_LONGEST_VALUE = 800
_LONGEST_INFO = 50_000
_FIRST_FACTS = (
    "command",
    "suite",
    "models",
    "tasks",
    "epochs",
    "seed",
    "limits",
    "cache",
    "sessions",
    "versions",
    "host",
)
_NOT_FACTS = ("schema_version", "status")


def examples(chosen: Sequence[tuple[Entrant, Row]]) -> str:
    """Return episodes turn by turn, folded."""
    several = len({entrant.run.path for entrant, _ in chosen}) > 1
    shown = "\n".join(_example(entrant, row, several) for entrant, row in chosen)
    note = "Some failures, cut-offs and errors. Long texts are cut, and turns in between left out."
    return section("examples", "Episodes to look at", f'<p class="soft">{note}</p>' if chosen else "", shown)


def numbers(contents: Contents) -> str:
    """Return the numbers of episodes that failed, by how they ended."""
    lines = []
    for run in contents.runs:
        found: dict[str, list[int]] = {}
        for row in run.rows:
            found.setdefault(ending_of(row), []).append(row.number)
        for ending in endings(run.rows):
            if ending in ("success", "unscored"):
                continue
            own = found[ending]
            listed = ", ".join(map(str, own[:_MOST_NUMBERS])) + (", …" if len(own) > _MOST_NUMBERS else "")
            of_run = f" of {text(run.name)}" if len(contents.runs) > 1 else ""
            lines.append(f"<dt>{text(ending)}{of_run} ({len(own):,})</dt><dd>{listed}</dd>")
    if not lines:
        return ""
    command = f"gem show {shlex.quote(str(contents.runs[0].path))} N"
    note = f'<p class="soft">By number; <code>{text(command)}</code> shows one in the terminal.</p>'
    return section("numbers", "Which episodes failed", note, f"<dl>{''.join(lines)}</dl>")


def asked(contents: Contents) -> str:
    """Return what ``run.json`` of each run says: in words, and folded to the letter."""
    parts = []
    for run in contents.runs:
        info = run.info
        facts = {name: info[name] for name in _FIRST_FACTS if name in info}
        facts |= {name: value for name, value in info.items() if name not in (*_FIRST_FACTS, *_NOT_FACTS)}
        if isinstance(versions := facts.get("versions"), Mapping):
            own = {name: version for name, version in versions.items() if name == "python" or name.startswith("gem-")}
            facts["versions"] = own or versions
        told = [(name, words) for name, value in facts.items() if (words := _words(value))]
        if told:
            lines = "".join(f"<dt>{text(name)}</dt><dd>{text(words, _LONGEST_VALUE)}</dd>" for name, words in told)
            whole = text(json.dumps(info, indent=1, ensure_ascii=False), _LONGEST_INFO)
            heading = f"<h3>{text(run.name)}</h3>" if len(contents.runs) > 1 else ""
            parts.append(f"{heading}<dl>{lines}</dl><details><summary>run.json</summary><pre>{whole}</pre></details>")
    return section("asked", "What was asked", *parts)


def notes(contents: Contents) -> str:
    """Return how things are counted."""
    told = [
        "<b>Success</b> is the share of episodes that solved their task. Each row (one task of a data set, or one seed "
        "of a game) weighs the same, however often it was played.",
        "<b>95 % interval</b>: of a success rate Wilson's, of a return the studentized bootstrap. Both take the rows "
        "as drawn at random, and the epochs of a row as one draw. A dash: one row, or equal rows, do not tell.",
        "<b>Errors</b> are failures of the machinery, as of a server; they are left out of scores.",
        "<b>Cut off</b>: a limit of turns, tokens, time or cost ended the episode. It counts as not solved, unless its "
        "task had given a verdict.",
        "<b>Unscored</b>: the task did not tell whether it was solved; left out of success, not of returns.",
        "<b>Unreadable</b>: the last response held nothing that the task could read; it counts as its task says.",
        "<b>Tokens and cost</b> are those that servers and prices tell.",
    ]
    if contents.differences:
        told.append(
            "<b>Differences</b> are means over rows that both played, of the differences of the rows' means, tested as "
            "by <code>gem compare</code>; the p-values of several tasks are corrected by Holm."
        )
    damaged = [run for run in contents.runs if run.damaged]
    told += [
        f"{text(run.name)}: {counted(run.damaged, 'line')} without a whole episode of one agent left out."
        for run in damaged
    ]
    return section("notes", "How it is counted", f"<ul>{''.join(f'<li>{each}</li>' for each in told)}</ul>")


def _example(entrant: Entrant, row: Row, several: bool) -> str:
    path = shlex.quote(str(entrant.run.path))
    ending = "unreadable" if ending_of(row) == "failure" and row.unreadable else ending_of(row)
    colour = {"error": "warn", "failure": "bad", "unreadable": "bad"}.get(ending, "warn")
    of_run = f" of {text(entrant.run.name)}" if several else ""
    outcome = f'<span class="outcome {colour}">{text(ending)}</span>'
    title = f"<b>{row.number}</b>{of_run} · {text(row.id)} · {text(row.model)} · {outcome}"
    try:
        episode = entrant.run.episode(row)
        views = list(turn_views(episode))
    except EpisodeFileError as error:
        return f"<details><summary>{title}</summary><div>{text(error)}</div></details>"
    first, last = views[:_FIRST_TURNS], views[_FIRST_TURNS:][-_LAST_TURNS:]
    hidden = len(views) - len(first) - len(last)
    blocks = [_turn(view) for view in first]
    blocks += [f'<p class="soft">… {counted(hidden, "turn")} left out</p>'] if hidden else []
    blocks += [_turn(view) for view in last]
    if not views:
        blocks.append(_block("Observation", text_of(parts_of(episode.observation))))
    if episode.error is not None:
        blocks.append(_block("Error", error_text(episode.error)))
    facts = f"{text(row.row)}, {text(figures_of(episode))} · <code>gem show {text(path)} {row.number}</code>"
    return f'<details><summary>{title}</summary><div><p class="soft">{facts}</p>{"".join(blocks)}</div></details>'


def _turn(view: TurnView) -> str:
    flags = "".join(f' · <span class="warn">{text(flag)}</span>' for flag in view.flags)
    repeated = sum(len(part.text) for part in view.observation if part.repeated)
    observation = text_of(part for part in view.observation if not part.repeated)
    if repeated:
        observation = f"… {repeated:,} characters as in the turn before\n{observation}"
    blocks = [_block("Observation", observation)]
    blocks += [_block("Reasoning", view.reasoning, said=True)] if view.reasoning else []
    blocks.append(_block("Response", view.response or "(empty)", said=True))
    blocks += [_block("Tool call", call, said=True) for call in view.calls]
    blocks += [_block("Feedback", text_of(view.feedback))] if view.feedback else []
    return f'<div class="turn"><b>Turn {view.number}</b> · reward {view.reward:g}{flags}{"".join(blocks)}</div>'


def _block(label: str, content: str, *, said: bool = False) -> str:
    kind = "block said" if said else "block"
    return f'<div class="{kind}"><div class="label">{label}</div><pre>{text(content, _LONGEST_TEXT)}</pre></div>'


def _words(value: Any) -> str:
    """Return plain JSON in words: what is empty is left out, and times are dates."""
    if value is None or value in ({}, [], ""):
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float) and 1e9 < value < 1e10:
        return amounts.moment(value)
    if isinstance(value, Mapping):
        told = ((name, part, _words(part)) for name, part in value.items())
        inside = (
            f"{name} ({words})" if isinstance(part, Mapping) else f"{name} {words}"
            for name, part, words in told
            if words
        )
        return ", ".join(inside)
    if isinstance(value, list):
        return "; ".join(filter(None, map(_words, value)))
    return str(value)
