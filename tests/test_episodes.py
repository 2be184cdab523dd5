"""Records and their files: what is written is what is read."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from gem_core.errors import EpisodeFileError
from gem_core.records.episode import Episode, Transition
from gem_core.records.files import (
    EpisodeFileWarning,
    EpisodeWriter,
    episode_lines,
    read_episodes,
    read_records,
    whole_file,
    write_episodes,
)
from gem_core.records.joint import JointEpisode
from gem_core.records.plain_json import ImageFolder, to_plain
from gem_core.types import Response

ANY_TEXT = st.text(st.characters(codec=None, categories=None), max_size=30)


def episode(**fields: Any) -> Episode:
    turn = Transition("first", Response("a", token_ids=[1, 2], logprobs=[-0.5, -1.0]), 0.5, False, False, {"x": 1})
    last = Transition("second", Response("b"), 1.0, True, False, {"correct": True})
    defaults: dict[str, Any] = {
        "id": "toy:A-v0",
        "seed": 3,
        "observation": "first",
        "info": {"seed": 3},
        "transitions": [turn, last],
        "final_observation": "end",
    }
    return Episode(**{**defaults, **fields})


def written(path: Path, *episodes: Episode) -> list[Episode]:
    write_episodes(path, episodes)
    return list(read_episodes(path))


@given(action=ANY_TEXT, observation=ANY_TEXT)
def test_any_text_is_read_back(tmp_path_factory: pytest.TempPathFactory, action: str, observation: str) -> None:
    """Lone surrogates and control characters included."""
    turn = Transition(observation, Response(action), 0.0, True, False, {"text": action})
    (read,) = written(tmp_path_factory.mktemp("run") / "run.jsonl", episode(transitions=[turn]))
    assert (read.transitions[0].action, read.transitions[0].observation) == (action, observation)


@pytest.mark.parametrize(
    "value",
    [
        "\ud83d\ude00",
        {"__image__": "x"},
        {"__text__": []},
        {"__plain__": {"__plain__": 1}},
    ],
)
def test_text_and_keys_that_json_would_confuse_are_read_back(tmp_path: Path, value: Any) -> None:
    """Surrogates side by side stay two, and keys that the file itself uses stay what they are."""
    (read,) = written(tmp_path / "run.jsonl", episode(info={"value": value}))
    assert read.info == {"value": value}


def ended(last: dict[str, Any], first: dict[str, Any] | None = None, *, terminated: bool, **reported: Any) -> Episode:
    """Return an episode of one turn, with the info of its reset and of its end."""
    turn = Transition("o", Response("a", **reported), 0.0, terminated, not terminated, last)
    return episode(transitions=[turn], info=first or {})


@pytest.mark.parametrize(
    ("record", "success", "cut_off"),
    [
        (ended({"correct": True}, terminated=True), True, None),
        (ended({}, terminated=True), None, None),
        (ended({}, terminated=False), False, "turns"),
        (ended({"correct": True}, terminated=False), True, "turns"),
        (ended({}, {"correct": None}, terminated=False), None, "turns"),
        (ended({"context_overflow": True}, terminated=False), False, "tokens"),
        (ended({"context_overflow": True, "correct": True}, terminated=True), True, None),
        (ended({"correct": False}, terminated=True, finish_reason="length"), False, "tokens"),
        (ended({}, terminated=False, finish_reason="length"), False, "tokens"),
        (ended({"error": {"kind": "x", "message": "y"}}, terminated=False), None, None),
        (episode(transitions=[], info={"context_overflow": True}), False, "tokens"),
        (episode(transitions=[], info={}), False, "turns"),
    ],
)
def test_an_episode_that_was_cut_off_is_not_solved(record: Episode, success: bool | None, cut_off: str | None) -> None:
    """Unknown is only what the task never tells: it ended in silence, or said so at its beginning."""
    assert (record.success, record.cut_off) == (success, cut_off)


def test_a_line_cut_off_is_reported_and_every_whole_episode_read(tmp_path: Path) -> None:
    """At every place where a writer can be interrupted."""
    path = tmp_path / "run.jsonl"
    write_episodes(path, [episode(seed=1), episode(seed=2)])
    data = path.read_bytes()
    second = data.index(b"\n") + 1
    for cut in (second + 1, (second + len(data)) // 2, len(data) - 2):
        path.write_bytes(data[:cut])
        with pytest.warns(EpisodeFileWarning, match=r"line 2: passed over, .* The line is cut off"):
            assert [read.seed for read in read_episodes(path)] == [1]
    write_episodes(path, [episode(seed=3)], append=True)  # begins on a line of its own
    with pytest.warns(EpisodeFileWarning, match="line 2: passed over"):
        assert [read.seed for read in read_episodes(path)] == [1, 3]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"nonsense", "it is no valid JSON"),
        (b"9" * 10_000, "it is no valid JSON"),
        (b"{}", "there is no schema_version"),
        (b'{"schema_version": 99}', "it has form 99, and this version reads 1; upgrade gem-core"),
        (b'{"schema_version": 1, "transitions": [], "id": 3}', "the record of an episode is damaged"),
        (b'{"schema_version": 1, "transitions": [{"action": {"text": "a", "evil": 1}}]}', "is damaged"),
        (
            b'{"schema_version": 1, "transitions": [{"action": {"text": "a"}, "observation": "", "reward": 1%s}]}'
            % (b"0" * 400),
            "OverflowError",
        ),
    ],
)
def test_damaged_lines_are_passed_over_with_the_reason(tmp_path: Path, line: bytes, reason: str) -> None:
    """Whatever stands in the file, the rest is read."""
    path = tmp_path / "run.jsonl"
    write_episodes(path, [episode()])
    path.write_bytes(line + b"\n" + path.read_bytes() + b"\n\n")
    with pytest.warns(EpisodeFileWarning) as caught:
        assert list(read_episodes(path)) == [episode()]
    assert reason in str(caught[0].message)
    assert len(caught) == 1, "empty lines are nothing to report"


@given(st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | ANY_TEXT, st.lists, max_leaves=10))
def test_records_of_anything_are_refused_or_read(value: Any) -> None:
    """No shape of a record crashes the reader."""
    for field in ("observation", "info", "transitions", "kwargs", "seed", "id", "wrappers"):
        record = {**episode().to_dict(), field: value}
        with contextlib.suppress(EpisodeFileError):
            Episode.from_dict(record)


@pytest.mark.parametrize("mode", ["1", "P", "RGBA", "I;16", "CMYK", "F"])
def test_images_are_read_back_without_loss(tmp_path: Path, mode: str) -> None:
    """Each is a side file named by its hash, written once."""
    pixels = Image.effect_noise((5, 4), 60)
    image = Image.new(mode, (5, 4), 7) if mode in ("I;16", "F", "I") else pixels.convert(mode)
    observation = [{"type": "text", "text": "Look"}, {"type": "image", "image": image}]
    original = episode(observation=observation, final_observation=observation)
    (read,) = written(tmp_path / "run.jsonl", original)
    assert read == original
    shown = read.observation[1]["image"]  # type: ignore[index]  # it is a list of parts
    assert (shown.mode, shown.size, shown.tobytes()) == (image.mode, image.size, image.tobytes())
    assert len(list((tmp_path / "run.images").iterdir())) == 1


def test_a_file_that_fails_half_way_is_as_it_was(tmp_path: Path) -> None:
    """Readers see the old content until the new one is complete; a link stays a link, and nothing else is left."""
    path, link = tmp_path / "file", tmp_path / "link"
    path.write_bytes(b"old")
    link.symlink_to(path)
    with pytest.raises(TypeError), whole_file(link) as file:
        file.writelines([b"half", None])  # type: ignore[list-item]
    assert path.read_bytes() == b"old"
    with whole_file(link) as file:
        file.write(b"new")
        file.flush()
        assert path.read_bytes() == b"old"
    assert (path.read_bytes(), link.is_symlink()) == (b"new", True)
    assert {each.name for each in tmp_path.iterdir()} == {"file", "link"}


def test_a_recorded_file_is_read_and_written_as_it_was(tmp_path: Path) -> None:
    """Of one agent, with tools, a view and a group, and of several; written by the version 0.1.0 of November 2026."""
    recorded = Path(__file__).parent / "recorded.jsonl"
    first, second, joint = records = list(read_records(recorded))
    assert write_episodes(tmp_path / "again.jsonl", records) == 3
    assert (first.final_info["episode"]["r"], first.transitions[1].action.token_ids) == (first.episode_return, [1])
    assert isinstance(joint, JointEpisode)
    assert joint.returns.keys() == joint.agents.keys() == {"first", "second"}
    lines, again = (path.read_text().splitlines() for path in (recorded, tmp_path / "again.jsonl"))
    assert list(map(json.loads, lines)) == list(map(json.loads, again))
    second.repeat = 0
    assert first == second, "durations differ, and do not count"
    second.info["seed"] = 0
    assert first != second


def test_a_file_that_cannot_be_read_or_written_is_named(tmp_path: Path) -> None:
    """The error gives the path and the reason."""
    with pytest.raises(EpisodeFileError, match=r"none\.jsonl: No such file"):
        list(read_episodes(tmp_path / "none.jsonl"))
    (tmp_path / "file").write_text("")
    with pytest.raises(EpisodeFileError, match="cannot write"):
        EpisodeWriter(tmp_path / "file" / "run.jsonl")


class Shy:
    """Cannot show itself."""

    def __repr__(self) -> str:
        raise RuntimeError("no")


class Rows(list[Any]):
    """May not be gone through."""

    def __iter__(self) -> Any:
        raise AssertionError("gone through")


def test_values_that_json_does_not_know_do_not_stop_a_run() -> None:
    """They are written as near as can be; long arguments, as the rows of a data set, are not even gone through."""
    circle: list[Any] = [1]
    deep: list[Any] = []
    circle.append(circle)
    for _ in range(5000):
        deep = [deep]
    odd = {"nan": float("nan"), "array": np.arange(3), "set": {2, 1}, 3: (1, 2), "f": np.float64(1.5), "shy": Shy()}
    assert to_plain(odd) == {"nan": "nan", "array": [0, 1, 2], "set": [1, 2], "3": [1, 2], "f": 1.5, "shy": "<Shy>"}
    assert to_plain([10**5000, 10**4000, circle]) == [hex(10**5000), 10**4000, [1, "<contains itself>"]]
    assert "nested over" in json.dumps(to_plain(deep))
    kwargs = {"rows": Rows([1] * 5000), "text": ["row"] * 1000, "high": 3}
    assert episode(kwargs=kwargs).to_dict()["kwargs"] == {"high": 3}


@pytest.mark.parametrize("name", ["../secret.png", "a" * 64 + ".png/../../x", 3, "A" * 64 + ".png"])
def test_image_names_cannot_lead_elsewhere(tmp_path: Path, name: Any) -> None:
    """A file of episodes is untrusted."""
    with pytest.raises(EpisodeFileError, match="is not the name of an image file"):
        ImageFolder(tmp_path).read(name)


def test_missing_and_damaged_images_are_reported(tmp_path: Path) -> None:
    """The episode is passed over, and the others are read."""
    path = tmp_path / "run.jsonl"
    image = Image.new("RGB", (2, 2))
    write_episodes(path, [episode(observation=[{"type": "image", "image": image}]), episode(seed=9)])
    (side_file,) = (tmp_path / "run.images").iterdir()
    for damage in (lambda: side_file.write_bytes(b"no image"), side_file.unlink):
        damage()
        with pytest.warns(EpisodeFileWarning, match="cannot be read"):
            assert [read.seed for read in read_episodes(path)] == [9]


def test_a_file_has_one_writer_at_a_time(tmp_path: Path) -> None:
    """Also while it is written anew; nothing changes in it, and then it is the turn of the next."""
    path = tmp_path / "run.jsonl"
    with EpisodeWriter(path) as writer:
        writer.write(episode())
        with pytest.raises(EpisodeFileError):
            EpisodeWriter(path)
        writer.rewrite(line.text for line in episode_lines(path))
        with pytest.raises(EpisodeFileError):
            EpisodeWriter(path, append=True)
        writer.write(episode())
    assert len(list(read_episodes(path))) == 2
    EpisodeWriter(path, append=True).close()
