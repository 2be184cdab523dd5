"""The backend ``ray`` on one machine: it does what every backend does, and keeps faults to their slots."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import gem_core as gem
from gem_core.types import TERMINAL_STATE

pytestmark = [pytest.mark.usefixtures("local_ray"), pytest.mark.skipif(sys.platform == "win32", reason="POSIX")]

LONG_S = 120.0
"""Ends what hangs, by no means what is slow."""


@pytest.fixture
def vec() -> Iterator[Callable[..., gem.VectorEnv]]:
    """Make vector environments on Ray, closed with the test."""
    made: list[gem.VectorEnv] = []

    def make(num_envs: int, env_id: str = "raytoy:Tally-v0", *, options: Any = None, **kwargs: Any) -> gem.VectorEnv:
        backend = ("ray", {"num_actors": 1, **(options or {})})
        made.append(gem.make_vec(env_id, num_envs, backend=backend, **{"seed": 1, **kwargs}))
        return made[-1]

    yield make
    for each in made:
        each.close()


def observed(vector: gem.VectorEnv, turns: list[list[str]]) -> list[list[Any]]:
    """Return what each slot observes, its rewards, flags and infos, from reset on."""
    observations, infos = vector.reset()
    seen: list[list[Any]] = [[each] for each in zip(observations, infos, strict=True)]
    for actions in turns:
        for slot, each in enumerate(zip(*vector.step(actions), strict=True)):
            seen[slot].append(each)
    return seen


def plain(num_envs: int, turns: list[list[str]]) -> list[list[Any]]:
    """Return what is observed of the toys in this process."""
    return observed(gem.make_vec("raytoy:Tally-v0", num_envs, backend="sync", seed=1), turns)


def test_trajectories_are_those_of_sync(vec: Callable[..., gem.VectorEnv]) -> None:
    """The same seed and actions give the same, over the ends of episodes, with several environments an actor."""
    turns = [[f"{turn} {slot}" for slot in range(5)] for turn in range(30)]
    assert observed(vec(5, options={"num_actors": 2}), turns) == plain(5, turns)


def test_several_agents_play_as_in_this_process(vec: Callable[..., gem.VectorEnv]) -> None:
    """Joint episodes, and the random actions of each seat, are those of the backend ``sync``."""

    def agent(observation: Any, context: Any) -> str:
        return str(context.sample_random_action())

    alone = gem.make_vec("raytoy:Pair-v0", 2, backend="sync", seed=1)
    expected = {joint.key: joint for joint in gem.rollout(alone, agents=agent, episodes=4)}
    played = {joint.key: joint for joint in gem.rollout(vec(2, "raytoy:Pair-v0"), agents=agent, episodes=4)}
    assert played == expected
    assert all(joint.turns == 3 for joint in played.values())


def test_an_exception_ends_one_episode(vec: Callable[..., gem.VectorEnv]) -> None:
    vector = vec(3)
    vector.reset()
    step = vector.step(["raise it", "a", "a"])
    assert step.truncated.tolist() == [True, False, False]
    assert step.infos[0]["final_info"]["error"]["message"] == "step raised ValueError: it"
    assert step.infos[0]["final_obs"] == TERMINAL_STATE
    assert vector.faults == 1


@pytest.mark.thorough
def test_only_the_slot_that_ends_the_process_is_truncated(vec: Callable[..., gem.VectorEnv]) -> None:
    """The others of its actor go on as if nothing had been."""
    turns = [["a"] * 3, ["a", "exit 3", "a"], ["a"] * 3]
    seen = observed(vec(3), turns)
    undisturbed = plain(3, [["a"] * 3] * 3)
    assert [seen[0], seen[2]] == [undisturbed[0], undisturbed[2]]
    _, reward, terminated, truncated, info = seen[1][2]
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["final_info"]["error"]["kind"] == "died"
    assert info["final_info"]["error"]["message"].startswith("its worker process died on Ray: ")


@pytest.mark.thorough
def test_what_hangs_is_killed_past_step_timeout(vec: Callable[..., gem.VectorEnv]) -> None:
    """Also in code that lets no other thread run; a slot that waited behind it is not blamed."""
    turns = [["a"] * 3, ["a", "hang", "a"], ["a"] * 3]
    seen = observed(vec(3, step_timeout=3.0), turns)
    undisturbed = plain(3, [["a"] * 3] * 3)
    assert [seen[0], seen[2]] == [undisturbed[0], undisturbed[2]]
    error = seen[1][2][4]["final_info"]["error"]
    assert error == {"kind": "timeout", "message": "a step or reset took longer than step_timeout, 3 s"}


@pytest.mark.thorough
def test_an_idle_actor_that_is_killed_costs_nothing(vec: Callable[..., gem.VectorEnv], executors: list[Any]) -> None:
    """Nothing ran: what was there is replayed in a new actor."""
    import ray

    vector = vec(2)
    seen = observed(vector, [["a", "a"]])
    (old,) = executors[0].links
    ray.kill(old.actor)
    old._reading.join(LONG_S)
    seen = [[*each, step] for each, step in zip(seen, zip(*vector.step(["a", "a"]), strict=True), strict=True)]
    assert seen == plain(2, [["a", "a"]] * 2)
    assert vector.faults == 0


def test_an_actor_killed_in_a_step_is_a_truncated_slot(
    vec: Callable[..., gem.VectorEnv], executors: list[Any], tmp_path: Path
) -> None:
    """The one that ran; the other, which waited for its turn, goes on."""
    import ray

    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    vector = vec(2)
    vector.reset()
    vector.send([f"await {pipe}", "a"])
    # Opened for writing once the environment has opened it for reading, and then never written to.
    with open(pipe, "w"):
        ray.kill(executors[0].links[0].actor)
        received = vector.recv(min_envs=2, timeout=LONG_S)
    by_slot = dict(zip(received.slots, received.infos, strict=True))
    assert by_slot[0]["final_info"]["error"]["kind"] == "died"
    assert "killed by `ray.kill`" in by_slot[0]["final_info"]["error"]["message"]
    assert by_slot[1] == {"turn": 1}


@pytest.mark.thorough
def test_what_cannot_be_replayed_is_collateral(vec: Callable[..., gem.VectorEnv]) -> None:
    vector = vec(2, "raytoy:Dice-v0")
    vector.reset()
    step = vector.step(["exit 1", "a"])
    assert [info["final_info"]["error"]["kind"] for info in step.infos] == ["died", "collateral"]


def test_a_straggler_holds_up_nobody(vec: Callable[..., gem.VectorEnv], tmp_path: Path) -> None:
    """In one actor, the results of the others are there while it waits."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    vector = vec(4, "raytoy:Blocking-v0")
    vector.reset()
    vector.send([f"await {pipe}", "a", "a", "a"])
    assert sorted(vector.recv(min_envs=3, timeout=LONG_S).slots) == [1, 2, 3]
    vector.send({2: "a"})
    assert vector.recv(timeout=LONG_S).slots == [2]
    assert vector.under_way == 1
    pipe.write_text("at last")
    received = vector.recv(timeout=LONG_S)
    assert (received.slots, received.observations) == ([0], ["at last"])


@pytest.mark.thorough
def test_observations_of_megabytes_arrive(vec: Callable[..., gem.VectorEnv]) -> None:
    """They take Ray's way for large things."""
    vector = vec(2)
    vector.reset()
    for _ in range(3):
        assert [len(each) for each in vector.step(["big 3000000", "big 5"]).observations] == [3_000_000, 5]


@pytest.mark.thorough
def test_runtime_env_reaches_the_actor(vec: Callable[..., gem.VectorEnv]) -> None:
    vector = vec(1, options={"runtime_env": {"env_vars": {"GEM_RAY_TEST": "here"}}})
    vector.reset()
    assert vector.step(["variable GEM_RAY_TEST"]).observations == ["here"]


@pytest.mark.thorough
def test_a_runtime_env_that_cannot_be_made_is_said_once(vec: Callable[..., gem.VectorEnv], tmp_path: Path) -> None:
    """Trying again would not help."""
    vector = vec(2, options={"runtime_env": {"working_dir": (tmp_path / "missing.zip").as_uri()}})
    with pytest.raises(gem.GemError, match="an actor could not be started on Ray"):
        vector.reset()


@pytest.mark.thorough
def test_rollouts_sample_in_the_actors(vec: Callable[..., gem.VectorEnv]) -> None:
    """A random agent asks the environments; the episodes say what they were made from."""
    from gem_core.agents import RandomAgent

    theirs = list(gem.rollout(vec(3, options={"num_actors": 2}), RandomAgent(), episodes=6))
    ours = list(gem.rollout(gem.make_vec("raytoy:Tally-v0", 3, backend="sync", seed=1), RandomAgent(), episodes=6))
    assert len(theirs) == 6
    actions = [
        {episode.seed: [each.action for each in episode.transitions] for episode in some} for some in (theirs, ours)
    ]
    assert actions[0] == actions[1]
    assert {episode.id for episode in theirs} == {"raytoy:Tally-v0"}


@pytest.mark.thorough
def test_close_leaves_no_actor_and_keeps_the_connection(
    vec: Callable[..., gem.VectorEnv], executors: list[Any]
) -> None:
    """The program's own connection is not ours to cut."""
    import ray
    from ray._private.state import actors

    vector = vec(3, options={"num_actors": 2})
    vector.reset()
    ids = [link.actor._actor_id.hex() for link in executors[0].links]
    vector.close()
    assert ray.is_initialized()
    assert [actors(actor_id=each)["State"] for each in ids] == ["DEAD", "DEAD"]


@pytest.mark.thorough
def test_there_are_no_more_actors_than_slots(vec: Callable[..., gem.VectorEnv], executors: list[Any]) -> None:
    """By default, and when more are asked for."""
    for number in (None, 9):
        vector = vec(1, options={"num_actors": number, "num_cpus": 0.5})
        vector.reset()
        assert len(executors[-1].links) == 1
