"""The record of a run: read back the same, small, readable while it grows, whole after a kill at any byte."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded import duel

import gem_core as gem
from gem_core import Episode, Response
from gem_core.errors import ArgumentError, EpisodeFileError
from gem_core.records import write_episodes
from gem_eval.records import Run, RunWriter, open_run

ID = "game:GuessTheNumber-v0-hard"


def guess(observation: Any, context: Any) -> Response:
    usage = {"prompt_tokens": 100 + context.turn, "completion_tokens": 20}
    return Response(f"I halve the range. \\boxed{{{context.turn * 3 + 1}}}", usage=usage, finish_reason="stop")


@pytest.fixture(scope="module")
def played() -> list[Episode]:
    return list(gem.rollout(gem.make_vec(ID, 4, wrappers="concat_with_action"), guess, episodes=6, seed=1))


def told(episode: Episode) -> dict[str, Any]:
    return {"model": "toy", "row": f"{ID}/{episode.seed}", "seconds": 0.5}


def recorded(path: Path, episodes: list[Episode]) -> Path:
    with RunWriter(path) as writer:
        writer.write_info({"suite": "toy"})
        for episode in episodes:
            writer.write(episode, told(episode))
    return path


def test_a_run_is_read_back_the_same(tmp_path: Path, played: list[Episode]) -> None:
    """Episodes to the letter, and rows that say what they are."""
    run = open_run(recorded(tmp_path / "run", played))
    assert [run.episode(row) for row in run.rows] == played
    first = run.rows[0]
    assert (first.model, first.row, first.seconds, first.turns) == ("toy", f"{ID}/{played[0].seed}", 0.5, 7)
    assert first.tokens_out == 20 * first.turns
    assert run.info == {"suite": "toy"}


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_run_that_was_killed_at_any_byte_goes_on(
    tmp_path_factory: pytest.TempPathFactory, played: list[Episode], data: st.DataObject
) -> None:
    """What was whole stays, what was torn is cut off, and the next episodes are appended."""
    path = recorded(tmp_path_factory.mktemp("run") / "run", played)
    whole = open_run(path).rows
    for name in ("episodes.jsonl.zst", "index.jsonl"):
        content = (path / name).read_bytes()
        (path / name).write_bytes(content[: data.draw(st.integers(0, len(content)), label=name)])
    with RunWriter(path) as writer:
        mended = open_run(path)
        assert [mended.episode(row) for row in mended.rows] == played[: len(mended.rows)]
        for episode in played[len(mended.rows) :]:
            writer.write(episode, told(episode))
    run = open_run(path)
    assert [run.episode(row) for row in run.rows] == played
    assert run.rows == whole


def test_a_run_is_read_while_it_grows(tmp_path: Path, played: list[Episode]) -> None:
    """Each refresh brings what was added, all or in pieces."""
    with RunWriter(tmp_path / "run") as writer:
        writer.write_info({})
        run = Run(tmp_path / "run")
        for episode in played:
            writer.write(episode, told(episode))
        assert [len(run.refresh(4)), run.share_read < 1, len(run.refresh(4)), run.share_read] == [4, True, 2, 1.0]
        with (tmp_path / "run" / "index.jsonl").open("ab") as index:
            index.write(b'{"number": 2, "off')
        assert (run.refresh(), run.damaged) == ([], 0)


def test_the_later_of_two_records_of_an_episode_counts(tmp_path: Path, played: list[Episode]) -> None:
    """As where an error was run again."""
    again = Episode.from_dict({**played[0].to_dict(), "group": "again"})
    run = open_run(recorded(tmp_path / "run", [*played, again]))
    assert len(run.rows) == len(played)
    assert run.episode(run.rows[0]).group == "again"


def test_a_run_has_one_writer(tmp_path: Path) -> None:
    """The same command twice would mix two runs."""
    with RunWriter(tmp_path / "run"), pytest.raises(ArgumentError, match="written already"):
        RunWriter(tmp_path / "run")


@pytest.mark.parametrize("content", [b"", b"{}\n", b"\xff\xfe\n", b"[1]\n", b"9" * 5000 + b"\n"])
def test_a_damaged_index_is_no_crash(tmp_path: Path, played: list[Episode], content: bytes) -> None:
    """Its lines are passed over, and counted."""
    path = recorded(tmp_path / "run", played)
    with (path / "index.jsonl").open("ab") as file:
        file.write(content)
    run = open_run(path)
    assert (len(run.rows), run.damaged) == (6, 1 if content else 0)


@pytest.mark.parametrize(
    "field", [{"turns": "2"}, {"success": 1}, {"episode_return": "much"}, {"offset": None}, {"key": 0}, {"cost": "one"}]
)
def test_a_row_of_wrong_types_is_damaged(tmp_path: Path, played: list[Episode], field: dict[str, Any]) -> None:
    """What reads rows may sort and add them; numbers that are not finite are read by their names."""
    path = recorded(tmp_path / "run", played)
    last = open_run(path).rows[-1].to_dict()
    with (path / "index.jsonl").open("a") as file:
        file.write(json.dumps({**last, "key": "worse", **field}) + "\n")
        file.write(json.dumps({**last, "key": "endless", "episode_return": "Infinity"}) + "\n")
    run = open_run(path)
    assert (len(run.rows), run.damaged) == (7, 1)
    assert run.rows[-1].episode_return == float("inf")


def test_an_episode_of_several_agents_in_a_file_has_a_row(tmp_path: Path) -> None:
    """One for each seat; of all of them together, where it is asked for."""
    write_episodes(tmp_path / "run.jsonl", [duel("black")])
    assert [row.seat for row in open_run(tmp_path / "run.jsonl").rows] == ["white", "black"]
    run = Run(tmp_path / "run.jsonl", joint=True)
    (row,) = run.rows
    assert (row.model, row.turns, row.success) == ("white=openai:tiny, black=random", 3, True)
    assert run.record(row) == duel("black")


def test_a_damaged_frame_is_an_error_that_names_it(tmp_path: Path, played: list[Episode]) -> None:
    """And no other episode is lost."""
    path = recorded(tmp_path / "run", played)
    run = open_run(path)
    content = bytearray((path / "episodes.jsonl.zst").read_bytes())
    content[run.rows[1].offset + 20] ^= 0xFF
    (path / "episodes.jsonl.zst").write_bytes(content)
    with pytest.raises(EpisodeFileError, match="episode 2: it is no record"):
        run.episode(run.rows[1])
    assert run.episode(run.rows[2]) == played[2]


def test_a_damaged_frame_costs_one_episode_where_the_index_is_lost(tmp_path: Path, played: list[Episode]) -> None:
    """Those after it are found again, by readers and by the next session."""
    path = recorded(tmp_path / "run", played)
    content = bytearray((path / "episodes.jsonl.zst").read_bytes())
    content[open_run(path).rows[1].offset + 20] ^= 0xFF
    (path / "episodes.jsonl.zst").write_bytes(content)
    (path / "index.jsonl").unlink()
    others = [played[0], *played[2:]]
    read = open_run(path)
    assert [read.episode(row) for row in read.rows] == others
    for _ in range(2):
        RunWriter(path).close()
        run = open_run(path)
        assert [run.episode(row) for row in run.rows] == others
    assert read.refresh() == run.rows == read.rows
    assert read.superseded == []


def test_long_names_are_cut_and_stay_apart(tmp_path: Path, played: list[Episode]) -> None:
    """Two rows that begin alike are two rows."""
    with RunWriter(tmp_path / "run") as writer:
        names = [writer.write(played[0], {"row": "r" * 10_000 + end}).row for end in ("a", "b")]
    assert [len(name) for name in names] == [300, 300]
    assert names[0] != names[1]


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    """With what a run is, and a run that is inside."""
    with RunWriter(tmp_path / "mine") as writer:
        writer.write_info({})
    for path, said in ((tmp_path / "nothing", "no run "), (tmp_path, "mine")):
        with pytest.raises(ArgumentError, match=said):
            open_run(path)
