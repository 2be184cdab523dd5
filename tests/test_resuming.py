"""Runs that were stopped and go on: from their file, or from the episodes themselves."""

from __future__ import annotations

import asyncio
import json
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toys import by_key, sampling_agent

import gem_core as gem
from gem_core.errors import ArgumentError, EpisodeFileError, RequestError
from gem_core.records.files import EpisodeFileWarning, EpisodeWriter, read_episodes, write_episodes
from gem_core.records.plans import PlanItem, group_plan
from gem_core.rollouts.agent import Context

COUNTDOWN = "toy:Countdown-v0"
SUMS = "toy:Sums-v0"


def keys(episodes: Any) -> list[str]:
    return [episode.key for episode in by_key(episodes)]


class StoppedError(Exception):
    """What stops an agent in the middle of an episode."""


def stopping(after: int) -> Any:
    """Return an agent that samples, and raises at one of its questions."""
    left = after

    def agent(observation: gem.Observation, context: Context) -> str:
        nonlocal left
        left -= 1
        if left < 0:
            raise StoppedError
        return context.sample_random_action()

    return agent


def written(path: Path, episodes: Iterator[gem.Episode]) -> None:
    """Write episodes as they come, until what stops them."""
    with EpisodeWriter(path, append=True) as writer:
        try:
            for episode in episodes:
                writer.write(episode)
        except StoppedError:
            pass


@settings(deadline=None, max_examples=25)
@given(
    stops=st.lists(st.integers(0, 60), max_size=3),
    slots=st.lists(st.integers(1, 6), min_size=4, max_size=4),
    torn=st.integers(0, 400),
    seed=st.integers(0, 2**40),
)
def test_a_run_that_was_stopped_and_resumed_is_the_run_in_one_go(
    stops: list[int], slots: list[int], torn: int, seed: int
) -> None:
    """Stopped anywhere, several times, with other numbers of slots, and with its last line cut off."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", EpisodeFileWarning)
        path = Path(folder, "run.jsonl")
        for stop, num_envs in zip(stops, slots, strict=False):
            vector = gem.make_vec([COUNTDOWN, SUMS], num_envs, seed=seed)
            written(path, gem.rollout(vector, stopping(stop), episodes=5, resume=path))
            content = path.read_bytes()
            path.write_bytes(content[: max(0, len(content) - torn)])
        written(path, gem.rollout([COUNTDOWN, SUMS], sampling_agent, episodes=5, seed=seed, resume=path))
        whole = by_key(gem.rollout([COUNTDOWN, SUMS], sampling_agent, episodes=5, seed=seed))
        assert by_key(read_episodes(path)) == whole


def test_the_line_that_was_cut_off_is_run_again_with_a_warning(tmp_path: Path) -> None:
    """The warning names it."""
    path = tmp_path / "run.jsonl"
    write_episodes(path, gem.rollout(COUNTDOWN, sampling_agent, episodes=3, seed=1))
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.warns(EpisodeFileWarning, match="line 3: passed over"):
        assert keys(gem.rollout(COUNTDOWN, sampling_agent, episodes=3, resume=path)) == ["2"]


def test_episodes_that_are_there_go_on_without_a_file() -> None:
    """From a list, or anything that yields them; the seed is theirs. With all of them, not even a reset is run."""
    run = gem.rollout(gem.make_vec(COUNTDOWN, 2, seed=7), sampling_agent, episodes=6)
    first = [next(run), next(run)]
    rest = list(gem.rollout(COUNTDOWN, sampling_agent, episodes=6, resume=iter(first)))
    whole = by_key(gem.rollout(COUNTDOWN, sampling_agent, episodes=6, seed=7))
    assert by_key([*first, *rest]) == whole
    assert {episode.run_seed for episode in rest} == {7}

    async def by_arollout() -> list[gem.Episode]:
        return [episode async for episode in gem.arollout(COUNTDOWN, sampling_agent, episodes=6, resume=first)]

    assert by_key([*first, *asyncio.run(by_arollout())]) == whole
    assert list(gem.rollout(COUNTDOWN, stopping(0), episodes=6, resume=whole)) == []


def test_episodes_with_an_error_are_run_again() -> None:
    """Whatever it was."""

    def failing(observation: gem.Observation, context: Context) -> str:
        if context.episode in ("1.0", "3.0"):
            raise RequestError("the server is down")
        return context.sample_random_action()

    first = list(gem.rollout(COUNTDOWN, failing, episodes=5, seed=0))
    again = by_key(gem.rollout(COUNTDOWN, sampling_agent, episodes=5, resume=first))
    assert [(episode.key, episode.error) for episode in again] == [("1", None), ("3", None)]


def test_members_of_a_group_are_counted_one_by_one() -> None:
    """A group that was half done is completed."""
    plan = list(group_plan([PlanItem(), PlanItem()], 3))
    whole = by_key(gem.rollout(gem.make_vec(COUNTDOWN, 2, seed=0), sampling_agent, plan=plan))
    first = [whole[0], whole[2], whole[4]]
    rest = by_key(gem.rollout(COUNTDOWN, sampling_agent, plan=plan, resume=first))
    assert [(episode.key, episode.repeat, episode.group) for episode in rest] == [
        ("0", 1, "0"),
        ("1", 0, "1"),
        ("1", 2, "1"),
    ]
    assert by_key([*first, *rest]) == whole


def test_a_file_that_is_not_there_yet_is_an_empty_beginning(tmp_path: Path) -> None:
    """So that a program need not tell its first start from any other."""
    path = tmp_path / "runs" / "run.jsonl"
    assert len(list(gem.rollout(COUNTDOWN, sampling_agent, episodes=3, seed=0, resume=path))) == 3
    assert len(list(gem.rollout(COUNTDOWN, sampling_agent, episodes=3, seed=0, resume=[]))) == 3
    with pytest.raises(EpisodeFileError, match="Is a directory"):
        list(gem.rollout(COUNTDOWN, sampling_agent, episodes=3, resume=tmp_path))


def test_more_episodes_of_the_same_run_can_be_asked_for() -> None:
    """The plan begins as the first one did."""
    first = list(gem.rollout(COUNTDOWN, sampling_agent, episodes=4, seed=0))
    more = list(gem.rollout(COUNTDOWN, sampling_agent, episodes=7, resume=first))
    assert keys(more) == ["4", "5", "6"]
    assert by_key([*first, *more]) == by_key(gem.rollout(COUNTDOWN, sampling_agent, episodes=7, seed=0))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"episodes": 3, "seed": 6}, "seed 5.*6"),
        ({"episodes": 1}, "'2' has no place"),
        ({"plan": [PlanItem(id=COUNTDOWN)] * 3 + [PlanItem(id=SUMS)]}, f"'1' has id='{SUMS}'.*'{COUNTDOWN}'"),
        (
            {"plan": [PlanItem(id=COUNTDOWN), PlanItem(id=SUMS, options={"index": 2})] * 2},
            "'1' has options={'index': 0}.*{'index': 2}",
        ),
        (
            {"plan": [PlanItem(), PlanItem(options={"index": 0}), PlanItem(seed=9), PlanItem(options={"index": 1})]},
            "'2' has seed=.*seed=9",
        ),
        ({"plan": (PlanItem(seed=place) for place in range(4))}, "'0' has seed=.*seed=0"),
    ],
)
def test_another_run_is_refused_before_anything_is_run(options: dict[str, Any], told: str) -> None:
    """Another seed, fewer episodes, other environments, other rows, other seeds of episodes."""
    first = by_key(gem.rollout([COUNTDOWN, SUMS], sampling_agent, episodes=2, seed=5))
    with pytest.raises(ArgumentError, match=told):
        next(gem.rollout([COUNTDOWN, SUMS], stopping(0), resume=first[:3], **options))


def test_iterators_are_resumed_too() -> None:
    """Their items are counted from the first."""
    first = list(gem.rollout(COUNTDOWN, sampling_agent, plan=(PlanItem() for _ in range(2)), seed=5))
    rest = list(gem.rollout(COUNTDOWN, sampling_agent, plan=(PlanItem() for _ in range(5)), resume=first))
    assert keys(rest) == ["2", "3", "4"]


def test_episodes_of_several_runs_are_refused() -> None:
    """Nobody could say which is meant."""
    mixed = [*gem.rollout(COUNTDOWN, sampling_agent, episodes=1, seed=1)]
    mixed += gem.rollout(COUNTDOWN, sampling_agent, episodes=1, seed=2)
    with pytest.raises(ArgumentError, match=r"2 runs.* 1, 2$"):
        list(gem.rollout(COUNTDOWN, sampling_agent, episodes=3, resume=mixed))


def test_episodes_without_a_place_in_a_plan_are_refused() -> None:
    """As those of a vector environment that goes on by itself."""
    (episode,) = gem.rollout(COUNTDOWN, sampling_agent, episodes=1, seed=1)
    episode.key = "0.3"
    with pytest.raises(ArgumentError, match=r"'0\.3' has no place"):
        list(gem.rollout(COUNTDOWN, sampling_agent, episodes=3, resume=[episode]))


def test_what_is_no_episode_is_refused() -> None:
    """The error says what it is."""
    with pytest.raises(ArgumentError, match="not 3"):
        list(gem.rollout(COUNTDOWN, sampling_agent, episodes=3, resume=[3]))  # type: ignore[list-item]


def test_files_of_the_earlier_form_go_on_with_the_seed_given(tmp_path: Path) -> None:
    """They do not name the seed of their run; another is found out by the seeds of the episodes."""
    path = tmp_path / "old.jsonl"
    write_episodes(path, gem.rollout(COUNTDOWN, sampling_agent, episodes=2, seed=5))
    records = [json.loads(line) for line in path.read_text().splitlines()]
    path.write_text("".join(json.dumps({**record, "run_seed": None}) + "\n" for record in records[:1]))
    with path.open("a") as file:
        del records[1]["run_seed"]
        file.write(json.dumps(records[1]) + "\n")
    assert [episode.run_seed for episode in read_episodes(path)] == [None, None]
    assert keys(gem.rollout(COUNTDOWN, sampling_agent, episodes=4, seed=5, resume=path)) == ["2", "3"]
    with pytest.raises(ArgumentError, match="has seed="):
        list(gem.rollout(COUNTDOWN, sampling_agent, episodes=4, seed=6, resume=path))


def test_images_are_not_read_to_find_out_what_is_done(tmp_path: Path) -> None:
    """Nor are they missed."""
    path = tmp_path / "run.jsonl"
    (episode,) = gem.rollout(COUNTDOWN, sampling_agent, episodes=1, seed=5)
    image = {"type": "image", "image": {"__image__": "0" * 64 + ".png"}}
    record = {**episode.to_dict(), "observation": [image]}
    path.write_text(json.dumps(record) + "\n")
    assert keys(gem.rollout(COUNTDOWN, sampling_agent, episodes=2, resume=path)) == ["1"]
    assert [each.observation for each in read_episodes(path, images=False)] == [[image]]


def test_plan_of_a_vector_environment_is_resumed() -> None:
    """With the seed of the episodes, whatever its own is."""
    plan = [PlanItem(options={"left": 2})] * 4
    first = list(gem.rollout(gem.make_vec(COUNTDOWN, 1, plan=plan, seed=3), sampling_agent))[:2]
    rest = list(gem.rollout(gem.make_vec(COUNTDOWN, 1, plan=plan, seed=4), sampling_agent, resume=first))
    assert [(episode.key, episode.run_seed) for episode in rest] == [("2", 3), ("3", 3)]


@pytest.mark.parametrize("collect", [iter, list], ids=["as they come", "all at once"])
def test_what_is_written_to_the_file_of_a_resumed_run_is_appended(tmp_path: Path, collect: Any) -> None:
    """Also where nothing is left to run; the next run that is not resumed replaces it."""
    path = tmp_path / "run.jsonl"
    for count, new in ((2, 2), (5, 3), (5, 0)):
        rest = collect(gem.rollout(COUNTDOWN, sampling_agent, episodes=count, seed=7, resume=path))
        assert write_episodes(path, rest) == new
        assert len(list(read_episodes(path))) == count
    write_episodes(path, gem.rollout(COUNTDOWN, sampling_agent, episodes=1))
    assert len(list(read_episodes(path))) == 1
