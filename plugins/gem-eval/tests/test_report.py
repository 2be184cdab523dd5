"""gem report: what the page and the JSON say, and that text of others is inert in them."""

from __future__ import annotations

import json
from pathlib import Path

import made_runs
import pytest
import recorded
from click.testing import CliRunner
from pages import Page, hash_of

from gem_core import Episode, Response, Transition
from gem_core.cli import cli
from gem_eval.comparing.comparison import compare
from gem_eval.records import RunWriter, open_run
from gem_eval.reporting import plots
from gem_eval.reporting.contents import choose_examples, contents_of, ending_of, solved_counts
from gem_eval.reporting.page import html_report

ALLOWED = set(
    "html head meta title style body main header footer h1 h2 h3 p section div span b br wbr code pre ul li dl dt dd "  # noqa: SIM905
    "table thead tbody tr th td details summary figure figcaption svg rect path circle text g".split()
)


def report(*arguments: object) -> str:
    return CliRunner().invoke(cli, ["report", *map(str, arguments)], catch_exceptions=False).output


def page_of(*runs: Path, shown: int = 8) -> Page:
    page = Page(html_report(contents_of([open_run(run) for run in runs]), shown))
    assert {tag for tag, _ in page.elements} <= ALLOWED
    assert page.policy["style-src"] == [hash_of(page.raw["style"][0])]
    assert not {name for name in page.attributes if name.startswith("on")} | page.attributes & {"href", "src", "style"}
    return page


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two tasks, two models, three epochs."""
    return made_runs.make_run(
        tmp_path_factory.mktemp("runs") / "grid", ["mine:a", "mine:b"], ["small", "large"], rows=8, epochs=3
    )


def test_a_page_shows_the_scores_of_the_run(grid: Path) -> None:
    """Those of ``--json``, for each task and model and for all, with intervals."""
    text = page_of(grid).text
    scores = json.loads(report(grid, "--json"))["scores"]
    shown = [score for score in scores if score["metric"] == "success"]
    assert {(score["id"], score["model"]) for score in shown} == {
        (task, model) for task in ("mine:a", "mine:b", "all") for model in ("small", "large")
    }
    for score in shown:
        assert f"{100 * score['mean']:.1f}%{100 * score['low']:.1f} to {100 * score['high']:.1f}" in text
    assert "pass@2" in text
    assert "large minus small" in text
    assert str(made_runs.INFO["command"]) in text
    assert "0f1e2d3c4b5a69788796a5b4" in text


def test_a_page_names_episodes_and_how_to_see_them(grid: Path) -> None:
    """An example of each ending but success, with the command that shows it."""
    run = open_run(grid)
    chosen = choose_examples(contents_of([run]).entrants, 100)
    endings = {ending_of(row) for row in run.rows}
    assert {ending_of(row) for _, row in chosen} == endings - {"success"}
    first = choose_examples(contents_of([run]).entrants, len(endings) - 1)
    assert len({ending_of(row) for _, row in first}) >= len(endings) - 2  # of failures, the unreadable ones apart
    text = page_of(grid).text
    assert all(f"gem show {grid} {row.number}" in text for _, row in chosen[:8])


@pytest.mark.parametrize(
    ("rows", "failing", "said"),
    [(0, 0.0, "there is nothing to score"), (3, 1.0, "no score: 3 errors"), (1, 0.0, "1 episode of 1 row.")],
)
def test_a_page_of_little(tmp_path: Path, rows: int, failing: float, said: str) -> None:
    """No episodes, only errors, one episode."""
    run = made_runs.make_run(tmp_path / "run", rows=rows, failing=failing, info={})
    assert said in page_of(run).text
    silent = made_runs.make_run(tmp_path / "silent", ["a", "b"], ["m", "n"], tells=False, failing=0.0)
    contents = contents_of([open_run(silent)])
    assert {(each.found.id, each.metric) for each in contents.differences} == {("a", "return"), ("b", "return")}
    assert "Returns" in page_of(silent).text


def test_runs_are_compared_on_the_rows_that_they_share(tmp_path: Path) -> None:
    """Of one model in two runs, the runs are named; compared as ``gem compare`` does."""
    one = made_runs.make_run(tmp_path / "one", rows=10, failing=0.0, skill=0.05)
    two = made_runs.make_run(tmp_path / "two", rows=12, failing=0.0, skill=1.3)
    contents = contents_of([open_run(one), open_run(two)])
    assert [entrant.label for entrant in contents.entrants] == ["one", "two"]
    (difference,) = contents.differences
    assert difference.found == compare(one, two).overall
    assert difference.metric == "success"
    assert "two minus one" in page_of(one, two).text


def test_solved_counts_rows_by_how_often_they_were_solved(tmp_path: Path) -> None:
    """Rows with fewer epochs are left out."""
    with RunWriter(tmp_path / "run") as writer:
        writer.write_info({})
        for row, verdicts in enumerate([[True, True], [True, False], [False, False], [False, True], [True]]):
            for epoch, correct in enumerate(verdicts):
                turn = Transition("?", Response("!"), 0.0, True, False, {"correct": correct})
                writer.write(Episode("t", row, "?", {}, [turn], key=str(row), repeat=epoch), {})
    assert solved_counts(open_run(tmp_path / "run").rows) == (2, [1, 2, 1])


def test_hostile_text_is_inert(tmp_path: Path) -> None:
    """In names, errors, transcripts and run.json; in HTML."""
    evil = recorded.HOSTILE
    with RunWriter(tmp_path / "run") as writer:
        writer.write_info({evil: evil, "command": evil, "models": {evil: {evil: [evil]}}})
        for key, (task, model) in enumerate([(evil, evil), (evil, "m"), ("t", evil)]):
            episode = recorded.hostile()
            episode.key = str(key)
            episode.transitions[-1].info["correct"] = False
            writer.write(episode, {"id": task, "model": model, "row": evil})
        broken = recorded.broken()
        broken.transitions[-1].info["error"] = {"kind": evil, "message": evil}
        writer.write(broken, {"id": evil, "model": evil, "row": evil})
    page = page_of(tmp_path / "run")
    assert "</script><script>alert(1)</script>" in page.text
    assert "\u202e" not in page.text


@pytest.mark.parametrize("values", [[], [3.0], [0.0, 0.0], [-1.0, 1e9], [float("nan"), 1.0], [0.1, 0.25, 7.0]])
def test_scales_hold_their_values(values: list[float]) -> None:
    """With ticks at round numbers, a few of them."""
    scale = plots.Scale.of(values)
    assert all(scale.low <= value <= scale.high for value in values if value == value)
    assert 2 <= len(scale.ticks) <= 8
    assert plots.histogram([(0, values)], "x", "t").across
