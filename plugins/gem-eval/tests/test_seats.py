"""Games of several agents in files of ``gem run``: each seat apart, in scores, comparisons, reports and tables."""

from __future__ import annotations

from pathlib import Path

import pytest
from recorded import duel

import gem_eval
from gem_core import JointEpisode, read_records, write_episodes
from gem_core.cli import main
from gem_core.errors import ArgumentError
from gem_eval.viewing.library import ViewedRun
from gem_eval.viewing.table import Query, answer, row_data

WHITE, BLACK = "duel:Words-v0 white", "duel:Words-v0 black"


@pytest.fixture
def played(tmp_path: Path) -> Path:
    """Eight games: white wins six, black two."""
    path = tmp_path / "run.jsonl"
    write_episodes(path, [duel("white" if seed < 6 else "black", seed) for seed in range(8)])
    return path


def test_each_seat_has_its_own_score_and_no_sum_mixes_them(played: Path) -> None:
    """Somebody always won: that is no success rate. ``gem view`` shows the same."""
    run = gem_eval.open_run(played)
    found = {(s.id, s.model): s.mean for s in gem_eval.compute_scores(run.rows) if s.metric == "success"}
    assert found == {(WHITE, "openai:tiny"): 0.75, (BLACK, "random"): 0.25}
    assert [run.episode(row).seat for row in run.rows[:2]] == ["white", "black"]
    viewed = ViewedRun("run", played)
    while viewed.read():
        pass
    shown = {(s["id"], s["mean"]) for s in viewed.summary["scores"] if s["metric"] == "success"}
    assert shown == {(WHITE, 0.75), (BLACK, 0.25)}
    places, summary = answer(Query(), ((viewed, viewed.version),))
    assert (row_data(places[0])["outcome"], row_data(places[0])["reason"]) == ("split", "success: white")
    assert not Query(outcomes=("success",)).places([viewed])
    assert (summary["episodes"], summary["success"], summary["return"]) == (8, None, None)


def test_runs_of_games_are_compared_seat_by_seat(played: Path, tmp_path: Path) -> None:
    """The same seats of two runs, by seed."""
    write_episodes(tmp_path / "other.jsonl", [duel("white", seed) for seed in range(8)])
    found = gem_eval.compare(played, tmp_path / "other.jsonl", models=["openai:tiny"])
    assert [(task.id, task.rows, task.a, task.b) for task in found.tasks] == [(WHITE, 8, 0.75, 1.0)]


def test_games_are_reported_and_exported(played: Path, tmp_path: Path) -> None:
    """With a row for each seat, and of JSON lines the whole game."""
    page, table, lines = (tmp_path / name for name in ("page.html", "table.csv", "lines.jsonl"))
    for command in (
        ["report", str(played), "--out", str(page)],
        ["export", str(played), "--to", "csv", "--out", str(table)],
        ["export", str(played), "--to", "jsonl", "--out", str(lines)],
    ):
        with pytest.raises(SystemExit) as ended:
            main(command)
        assert not ended.value.code
    assert all(name in page.read_text() for name in (WHITE, BLACK))
    assert len(table.read_text().splitlines()) == 17
    assert [type(each) for each in read_records(lines)] == [JointEpisode] * 8


def test_games_are_not_replayed_or_graded_again(played: Path) -> None:
    with pytest.raises(ArgumentError, match="episode 1 is of several agents"):
        gem_eval.replay(played, 1)
    with pytest.raises(ArgumentError, match="episode 1 is of several agents"):
        gem_eval.score(played, "env")
