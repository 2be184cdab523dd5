"""The index of a file of episodes: it finds what is there, whatever the file holds and however it changes."""

from __future__ import annotations

import json
import os
import warnings
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded import broken, failed, maze, write_all

from gem_core import Episode, read_episodes, write_episodes
from gem_core.errors import ArgumentError, EpisodeFileError
from gem_eval.episode_file import Entry, EpisodeFile

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
            GOOD.replace(b'"seed": 7', b'"seed": {"a": [1]}'),
            GOOD.replace(b'"transitions": [', b'"transitions": [7, '),
            b"[" * 100_000,
        ]
    ),
)


def entries(path: Path) -> list[Entry]:
    """The whole episodes, with an index kept for any size."""
    with EpisodeFile(path, index_from_bytes=0) as file:
        return list(file.entries())


def bytes_indexed_when_opened(path: Path) -> int:
    """How much of the file its index covers, before any line is read."""
    with EpisodeFile(path, index_from_bytes=0) as file:
        return round(file.share_indexed * file.size)


def figures(episode: Episode) -> tuple[object, ...]:
    """What an entry says of an episode."""
    return (episode.id, episode.success, episode.episode_return, episode.turns, episode.group)


def test_an_entry_says_what_the_episode_says(tmp_path: Path) -> None:
    """Every figure of the list, for success, failure and error."""
    path = tmp_path / "run.jsonl"
    write_episodes(path, [maze(), failed(), broken()])
    assert [entry[3:] for entry in entries(path)] == [
        ("maze:Room-v0", True, 0.75, 3, None, 7, "g1", None, None),
        ("maze:Room-v0", False, 0.25, 2, None, 7, "g1", None, None),
        ("chat:Talk-v0", None, 0.0, 1, "timeout: no answer in 5 s", 3, None, None, None),
    ]


@settings(deadline=None)
@given(st.lists(LINES, max_size=8), st.booleans(), st.integers(0, 8))
def test_any_file_is_indexed_as_it_is_read(
    tmp_path_factory: pytest.TempPathFactory, lines: list[bytes], ends: bool, first: int
) -> None:
    """What read_episodes yields is listed under its line, with or without an index, whole or in part."""
    path = tmp_path_factory.mktemp("any") / "run.jsonl"
    path.write_bytes(b"\n".join(lines) + (b"\n" if ends else b""))
    with EpisodeFile(path, index_from_bytes=0) as file:
        for _, _entry in zip(range(first), file.entries(), strict=False):
            pass
    found = entries(path)
    assert found == entries(path)
    readable = []
    with EpisodeFile(path) as file:
        assert list(file.entries()) == found
        for entry in found:
            assert file.line(entry).rstrip(b"\n") == lines[entry.number - 1]
            assert file.entry(entry.number) == entry
            readable.append(figures(file.read(entry)))
        assert {*(entry.number for entry in [*found, *file.damaged])} == {
            number for number, line in enumerate(lines, start=1) if line.strip()
        }
    if not any(b"9" * 400 in line for line in lines):  # There read_episodes itself gives up.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            assert readable == [figures(episode) for episode in read_episodes(path)]


@settings(deadline=None)
@given(st.binary(max_size=300))
def test_any_index_is_checked(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    """What is no index, or that of another file, changes nothing."""
    path = tmp_path_factory.mktemp("any") / "run.jsonl"
    write_episodes(path, [maze(), broken()])
    expected = entries(path)
    index = path.with_name("run.jsonl.index")
    head, _, rest = index.read_bytes().partition(b"\n")
    for damaged in (content, head, head + b"\n" + content, head + b"\n" + rest + content, head[:-1] + b"\n" + rest):
        index.write_bytes(damaged)
        found = entries(path)
        assert [entry.id for entry in found[:2]] == [entry.id for entry in expected]


def test_an_index_is_kept_beside_a_large_file_only(tmp_path: Path) -> None:
    """A small file leaves nothing behind."""
    path = tmp_path / "run.jsonl"
    write_episodes(path, [maze()])
    with EpisodeFile(path) as file:
        list(file.entries())
    assert [*tmp_path.iterdir()] == [path]
    entries(path)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["run.jsonl", "run.jsonl.index"]
    assert bytes_indexed_when_opened(path) == path.stat().st_size


def test_an_index_begun_is_gone_on_with(tmp_path: Path) -> None:
    """Leaving after the first episode keeps what was found."""
    path = tmp_path / "run.jsonl"
    write_episodes(path, [maze()] * 5)
    with EpisodeFile(path, index_from_bytes=0) as file:
        next(file.entries())
        assert 0 < file.share_indexed < 1
    assert bytes_indexed_when_opened(path) == path.stat().st_size / 5
    assert len(entries(path)) == 5


def test_an_appended_file_is_indexed_from_where_it_ended(tmp_path: Path) -> None:
    """The old part is not read again."""
    path = tmp_path / "run.jsonl"
    write_episodes(path, [maze()] * 3)
    entries(path)
    before = path.stat().st_size
    write_episodes(path, [broken()], append=True)
    assert bytes_indexed_when_opened(path) == before
    assert [entry.id for entry in entries(path)] == ["maze:Room-v0"] * 3 + ["chat:Talk-v0"]


def test_a_torn_line_that_is_mended_is_read_again(tmp_path: Path) -> None:
    """The last line is not kept before its end is there."""
    path = tmp_path / "run.jsonl"
    path.write_bytes(GOOD + b"\n" + GOOD[:100])
    assert len(entries(path)) == 1
    path.write_bytes(GOOD + b"\n" + GOOD)
    assert [entry.number for entry in entries(path)] == [1, 2]


@pytest.mark.parametrize("longer", [False, True])
def test_a_rewritten_file_is_indexed_anew(tmp_path: Path, longer: bool) -> None:
    """Of the same size but another time, or longer with another beginning."""
    path = tmp_path / "run.jsonl"
    path.write_bytes(GOOD + b"\n")
    entries(path)
    before = path.stat()
    path.write_bytes(GOOD.replace(b"maze:Room", b"maze:Hall") + b"\n" * (2 if longer else 1))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns + 1))
    assert bytes_indexed_when_opened(path) == 0
    assert [entry.id for entry in entries(path)] == ["maze:Hall-v0"]


def test_a_truncated_file_is_indexed_anew(tmp_path: Path) -> None:
    """No entry points behind its end."""
    path = tmp_path / "run.jsonl"
    write_episodes(path, [maze(), maze()])
    entries(path)
    path.write_bytes(GOOD + b"\n")
    assert len(entries(path)) == 1


def test_an_index_that_cannot_be_written_is_no_obstacle(tmp_path: Path) -> None:
    """Nothing is kept or left behind, and nothing is said. A folder at its place stops root, too."""
    path = tmp_path / "run.jsonl"
    write_episodes(path, [maze()])
    (tmp_path / "run.jsonl.index").mkdir()
    assert len(entries(path)) == 1
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["run.jsonl", "run.jsonl.index"]


def test_a_file_may_be_closed_twice(tmp_path: Path) -> None:
    """The second time does nothing."""
    path = tmp_path / "run.jsonl"
    write_episodes(path, [maze()])
    file = EpisodeFile(path, index_from_bytes=0)
    assert len(list(file.entries())) == 1
    file.close()
    file.close()


def test_an_index_is_no_more_readable_than_its_file(tmp_path: Path) -> None:
    """It holds ids and errors of the episodes."""
    path = tmp_path / "run.jsonl"
    write_episodes(path, [maze()])
    path.chmod(0o600)
    entries(path)
    assert (tmp_path / "run.jsonl.index").stat().st_mode & 0o777 == 0o600


def test_one_episode_needs_no_index(tmp_path: Path) -> None:
    """A line is found by counting line ends; blank lines count."""
    path = tmp_path / "run.jsonl"
    path.write_bytes(b"\n" + GOOD + b"\n\n" + GOOD)
    with EpisodeFile(path) as file:
        assert [file.entry(number).number for number in (2, 4)] == [2, 4]
        assert file.share_indexed == 0
        blank = ": that line is blank"
        for number, reason in ((1, blank), (3, blank), (5, ", which has 4 lines"), (99, ", which has 4 lines")):
            with pytest.raises(ArgumentError) as caught:
                file.entry(number)
            assert str(caught.value) == f"no episode {number} in {path}{reason}. Run 'gem show {path}'"


def test_images_are_not_needed_for_reading(tmp_path: Path) -> None:
    """An episode whose image is gone is shown all the same."""
    path = write_all(tmp_path / "run.jsonl")
    for image in (tmp_path / "run.images").iterdir():
        image.unlink()
    with EpisodeFile(path) as file:
        assert [file.read(entry).turns for entry in file.entries()] == [3, 2, 1, 1, 3]


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    """With the reason."""
    with pytest.raises(EpisodeFileError) as caught:
        EpisodeFile(tmp_path / "none.jsonl")
    assert str(caught.value) == f"cannot read {tmp_path / 'none.jsonl'}: No such file or directory"
    with pytest.raises(EpisodeFileError, match=r"it is no regular file; write it to one first"):
        EpisodeFile(tmp_path)
