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


def opened(path: Path) -> Run:
    """A file of which nothing is read yet."""
    return Run(path, read=False, joint=True)


def figures(episode: Episode | Row) -> tuple[object, ...]:
    """What a row says of an episode."""
    return (episode.id, episode.success, episode.episode_return, episode.turns, episode.group)


def test_a_row_says_what_the_episode_says(tmp_path: Path) -> None:
    """Every figure of the list, for success, failure and error."""
    path = tmp_path / "run.jsonl"
    write_episodes(path, [maze(), failed(), broken()])
    assert [(*figures(row), row.error, row.seed) for row in opened(path).read_all()] == [
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
    run = opened(path)
    run.refresh(first)
    found = list(run.read_all())
    assert found == list(opened(path).read_all()) == run.rows
    assert {*(row.number for row in found), *run.damage} == {
        number for number, line in enumerate(lines, start=1) if line.strip()
    }
    readable = []
    for row in found:
        assert run.line_bytes(row).rstrip(b"\n") == lines[row.number - 1]
        assert opened(path).row(row.number) == row
        assert figures(run.record(row)) == figures(row)
        readable.append(figures(row))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert readable == [figures(episode) for episode in read_episodes(path) if isinstance(episode.final_info, dict)]


def test_one_episode_needs_no_other(tmp_path: Path) -> None:
    """A line is found by counting line ends; blank lines count."""
    path = tmp_path / "run.jsonl"
    path.write_bytes(b"\n" + GOOD + b"\n\n" + GOOD)
    run = opened(path)
    assert [run.row(number).number for number in (2, 4)] == [2, 4]
    assert (run.rows, run.share_read) == ([], 0)
    blank = ": that line is blank"
    for number, reason in ((1, blank), (3, blank), (5, ", which has 4 lines"), (99, ", which has 4 lines")):
        with pytest.raises(ArgumentError) as caught:
            run.row(number)
        assert str(caught.value) == f"no episode {number} in {path}{reason}. Run 'gem show {path}'"


def test_what_can_be_read_but_once_is_refused() -> None:
    """As a pipe."""
    with pytest.raises(EpisodeFileError, match=r"it is no regular file; write it to one first"):
        Run("/dev/null")
