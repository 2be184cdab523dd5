"""A file of ``gem run``, read as a run: it finds what is there, whatever the file holds and however it grows."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded import broken, failed, maze

from gem_core import Episode, read_episodes, write_episodes
from gem_core.errors import ArgumentError, EpisodeFileError
from gem_eval.records import Row, Run

GOOD = json.dumps(maze().to_dict()).encode()
LINES = st.one_of(
    st.sampled_from([GOOD, json.dumps(broken().to_dict()).encode(), GOOD[:-40], b"", b"  ", b"{}", b"[1]", b"null"]),
    st.binary(max_size=40).map(lambda line: line.replace(b"\n", b" ")),
    st.sampled_from(
        [
            b'{"schema_version": 2}',
            GOOD.replace(b'"reward": 0.25', b'"reward": ' + b"9" * 400),
            GOOD.replace(b'"reward": 0.25', b'"reward": null'),
            GOOD.replace(b'"reward": 0.25', b'"rewards": 1'),
            GOOD.replace(b'"text": "go"', b'"txt": "go"'),
            GOOD.replace(b'"info": {"correct', b'"info": 7, "was": {"correct'),
            GOOD.replace(b'"transitions": [', b'"transitions": [7, '),
            b"[" * 100_000,
        ]
    ),
)


def figures(episode: Episode | Row) -> tuple[object, ...]:
    """What a row says of an episode."""
    return (episode.id, episode.success, episode.episode_return, episode.turns, episode.group)


def test_a_row_says_what_the_episode_says(tmp_path: Path) -> None:
    """Every figure of the list, for success, failure and error."""
    path = tmp_path / "run.jsonl"
    write_episodes(path, [maze(), failed(), broken()])
    assert [(*figures(row), row.error, row.seed) for row in Run(path, joint=True).rows] == [
        ("maze:Room-v0", True, 0.75, 3, "g1", None, 7),
        ("maze:Room-v0", False, 0.25, 2, "g1", None, 7),
        ("chat:Talk-v0", None, 0.0, 1, None, "timeout: no answer in 5 s", 3),
    ]


@settings(deadline=None)
@given(st.lists(LINES, max_size=8), st.booleans(), st.integers(0, 8))
def test_any_file_has_the_rows_of_its_lines(
    tmp_path_factory: pytest.TempPathFactory, lines: list[bytes], ends: bool, first: int
) -> None:
    """What read_episodes yields is listed under its line, read at once or in pieces."""
    path = tmp_path_factory.mktemp("any") / "run.jsonl"
    path.write_bytes(b"\n".join(lines) + (b"\n" if ends else b""))
    run = Run(path, read=False, joint=True)
    run.refresh(first)
    run.refresh(torn=True)
    found = run.rows
    assert found == Run(path, joint=True).rows
    assert {*(row.number for row in found), *run.damage} == {
        number for number, line in enumerate(lines, start=1) if line.strip()
    }
    readable = []
    for row in found:
        assert run.line_bytes(row).rstrip(b"\n") == lines[row.number - 1]
        assert run.row(row.number) == row
        assert figures(run.record(row)) == figures(row)
        readable.append(figures(row))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert readable == [figures(episode) for episode in read_episodes(path) if isinstance(episode.final_info, dict)]


def test_an_episode_has_the_number_of_its_line(tmp_path: Path) -> None:
    """Blank lines count; a damaged one is told by its damage."""
    path = tmp_path / "run.jsonl"
    path.write_bytes(b"\n" + GOOD + b"\n{}\n" + GOOD)
    run = Run(path)
    assert [run.row(number).number for number in (2, 4)] == [2, 4]
    for number, error in ((1, ArgumentError), (3, EpisodeFileError), (5, ArgumentError)):
        with pytest.raises(error):
            run.row(number)


def test_what_can_be_read_but_once_is_refused() -> None:
    """As a pipe."""
    with pytest.raises(EpisodeFileError, match=r"it is no regular file; write it to one first"):
        Run("/dev/null")
