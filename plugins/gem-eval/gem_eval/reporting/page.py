"""A report as one self-contained page: no script, no network, and no style but its own."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from gem_core.cli import counted
from gem_eval import figures
from gem_eval.assets import hash_source, read_assets
from gem_eval.reporting import amounts, details, plots, score_tables, sections
from gem_eval.reporting.contents import Contents, Entrant
from gem_eval.reporting.contents import examples as choose_examples
from gem_eval.reporting.markup import text

if TYPE_CHECKING:
    from gem_eval.scores import Score

_MOST_CARDS = 8
_LONGEST_COMMAND = 1000


def html_report(contents: Contents, examples: int) -> str:
    """Return a report as HTML.

    Args:
        contents: What it says.
        examples: How many episodes to show turn by turn, at most.
    """
    title = " and ".join(run.name for run in contents.runs)
    if contents.rows:
        parts = [
            _cards(contents),
            score_tables.scores(contents),
            score_tables.differences(contents),
            sections.outcomes(contents),
            sections.epochs(contents),
            sections.distributions(contents),
            sections.costs(contents),
            details.examples(choose_examples(contents.entrants, examples)),
            details.numbers(contents),
        ]
    else:
        parts = ["<section><p>No episode has ended yet: there is nothing to score.</p></section>"]
    commands = [command for run in contents.runs if isinstance(command := run.info.get("command"), str)]
    asked = "".join(f"<p><code>{text(command, _LONGEST_COMMAND)}</code></p>" for command in commands)
    head = f'<header>\n<h1>{text(title)}</h1>\n<p class="lead">{text(summary(contents))}</p>{asked}\n</header>'
    footer = "<footer>Made by <code>gem report</code>.</footer>"
    body = "\n".join([head, *filter(None, parts), details.asked(contents), details.notes(contents), footer])
    style = read_assets("report.css")
    filled = {"HASH": hash_source(style), "STYLE": style, "TITLE": text(title), "BODY": body}
    # In one pass, so that a mark in a text of others stays what it is.
    return re.sub(r"\{\{(\w+)\}\}", lambda mark: filled[mark[1]], read_assets("report.html"))


def summary(contents: Contents) -> str:
    """Return in a sentence how much was played."""
    rows = contents.rows
    if not rows:
        return "No episodes."
    different = len({(row.id, row.row) for row in rows})
    errors = sum(row.error is not None for row in rows)
    models = {each.model for each in contents.entrants}
    told = f"{counted(len(models), 'model')} on {counted(len(contents.tasks), 'task')}: "
    if len(contents.runs) > 1:
        told = f"{counted(len(contents.runs), 'run')}, {told}"
    told += f"{counted(len(rows), 'episode')} of {counted(different, 'row')}"
    told += f", {counted(errors, 'error')}." if errors else "."
    unfinished = [run.name for run in contents.runs if run.info.get("status", "finished") != "finished"]
    told += f" Not finished: {' and '.join(unfinished)}." if unfinished else ""
    ended = [row.finished for row in rows if row.finished is not None]
    return f"{told} Last episode: {amounts.moment(max(ended))}." if ended else told


def main_score(contents: Contents, entrant: Entrant) -> Score | None:
    """Return the score that says most of an entrant: of all tasks where there are several, of success where told."""
    tasks = list(entrant.by_task)
    told = contents.tasks_with("success")
    tasks = [task for task in tasks if task in told] or tasks
    if not told and len(tasks) > 1:
        return None  # returns of different tasks are of different sizes
    return entrant.scores.get((tasks[0] if len(tasks) == 1 else "all", "success" if told else "return"))


def _cards(contents: Contents) -> str:
    cards = []
    for entrant in contents.entrants[:_MOST_CARDS]:
        score = main_score(contents, entrant)
        if score is None:
            continue
        if score.mean is None:
            told = f"no score: {counted(score.errors, 'error')}"
        else:
            told = f"{'success' if score.metric == 'success' else 'mean return'}<br>"
            told += f"95 % interval {figures.bounds(score.low, score.high, score.metric)}<br>"
            told += f"{counted(score.episodes, 'episode')} of {counted(score.rows, 'row')}"
            told += f", {counted(score.errors, 'error')}" if score.errors else ""
        figure = figures.score(score.mean, score.metric)
        cards.append(
            f'<div class="card s{entrant.place % plots.COLOURS}"><div class="name">{text(entrant.label)}</div>'
            f'<b>{figure}</b><div class="figures">{told}</div></div>'
        )
    return f'<div class="cards">{"".join(cards)}</div>' if cards else ""
