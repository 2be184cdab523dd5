"""The page of a training run, and the page of a study."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from gem_core.terminal import observation_text
from gem_train.reporting import curves, markup
from gem_train.reporting.metrics import read_jsonl, read_metrics

_SAMPLES = 12
_LONGEST_TEXT = 10_000
"""Characters of an observation or response."""


def write_page(folder: str | Path) -> Path:
    """Write the page of a run into ``folder/index.html``, and return its path.

    It shows the curves, the first and the last values of all metrics, the latest samples of episodes, and the options
    of the run. Of the files in the folder only ``metrics.jsonl`` has to be there.

    - ``options.json``: the options of the run, an object.
    - ``samples.jsonl``: an episode a line, as ``{"update": 20, "return": 1.0, "episode": [{"observation": "...",
      "response": "...", "reward": 1.0}]}``. An observation may also be a list of messages or of content parts.
    """
    folder = Path(folder)
    metrics = read_metrics(folder)
    options_file = folder / "options.json"
    options = json.loads(options_file.read_text(encoding="utf-8")) if options_file.exists() else {}
    newest = read_jsonl(folder / "samples.jsonl")[-_SAMPLES:][::-1]
    drawn = markup.panels(curves.run_panels(metrics), curves.run_legend(metrics)) if metrics else ""
    content = [
        f'<p class="soft">{len(metrics):,} updates</p>',
        markup.section("Curves", drawn),
        markup.section("Metrics", markup.table(_last_values(metrics))),
        markup.section("Episodes", *(_sample(sample, opened=sample is newest[0]) for sample in newest)),
        markup.section("Options", _options(options)),
    ]
    return markup.write_page(folder / "index.html", folder.resolve().name, content)


def write_study_page(
    path: str | Path,
    title: str,
    text: str,
    *,
    figures: Iterable[tuple[str, str]] = (),
    table: Sequence[Mapping[str, object]] = (),
) -> Path:
    """Write the page of a study, and return its path.

    Args:
        path: Where it goes, as ``index.html``.
        title: Its title.
        text: What was done and found, as plain text; an empty line begins a paragraph.
        figures: For each figure its caption, as plain text, and what the function that drew it has returned.
        table: The results, a row each, all with the same names; None is shown as a dash.
    """
    drawn = [markup.figure(caption, figure) for caption, figure in figures]
    content = [
        markup.paragraphs(text),
        markup.section("Figures", *drawn),
        markup.section("Results", markup.table(table)),
    ]
    return markup.write_page(path, title, content)


def _last_values(metrics: curves.Metrics) -> list[dict[str, object]]:
    """Return a row for each metric: where it began, and where it ended."""
    count = curves.smoothing_width(len(metrics))
    rows: list[dict[str, object]] = []
    for name in dict.fromkeys(name for line in metrics for name in line if name != "update"):
        values = curves.points(metrics, name).values
        late = curves.points(metrics[-count:], name).values
        row: dict[str, object] = {"metric": name, "first": None, "last": None, f"mean of last {count} updates": None}
        if len(values):
            row |= {"first": float(values[0]), "last": float(values[-1])}
        if len(late):
            row[f"mean of last {count} updates"] = float(late.mean())
        rows.append(row)
    return rows


def _options(options: Mapping[str, object]) -> str:
    items = ((name, value if isinstance(value, str) else json.dumps(value)) for name, value in options.items())
    shown = "".join(f"<dt>{markup.text(name)}</dt><dd>{markup.text(value)}</dd>" for name, value in items)
    return f"<dl>{shown}</dl>" if shown else ""


def _sample(sample: Mapping[str, Any], *, opened: bool) -> str:
    turns = sample["episode"]
    count = f"{len(turns)} turn{'s' * (len(turns) != 1)}"
    title = f"Update {sample['update']}: {count}, return {sample['return']:.4g}"
    shown = "".join(_turn(number, turn) for number, turn in enumerate(turns, start=1))
    return f"<details{' open' * opened}><summary>{markup.text(title)}</summary><div>{shown}</div></details>"


def _turn(number: int, turn: Mapping[str, Any]) -> str:
    observation = markup.text(observation_text(turn["observation"]), _LONGEST_TEXT)
    response = markup.text(turn["response"], _LONGEST_TEXT)
    return (
        f'<div class="turn">Turn {number}</div><pre>{observation}</pre>\n<pre class="response">{response}</pre>'
        f'<div class="turn">Reward {turn["reward"]:.4g}</div>\n'
    )
