"""The backend ``ray`` on one machine: it does what every backend does, and keeps faults to their actor."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import gem_core as gem
from gem_core.errors import EnvFaultError
from gem_core.vector import NoRoomError

pytestmark = [pytest.mark.usefixtures("local_ray"), pytest.mark.skipif(sys.platform == "win32", reason="POSIX")]

LONG_S = 120.0
"""Ends what hangs, by no means what is slow."""


def observed(vector: gem.VectorEnv, turns: list[list[str]]) -> list[list[Any]]:
    """Return what each slot observes, its rewards, flags and infos, from reset on."""
    observations, infos = vector.reset()
    seen: list[list[Any]] = [[each] for each in zip(observations, infos, strict=True)]
    for actions in turns:
        for slot, each in enumerate(zip(*vector.step(actions), strict=True)):
            seen[slot].append(each)
    return seen


def kinds(infos: list[dict[str, Any]]) -> list[str | None]:
    """Return the kind of the error that ended the episode of each slot."""
    errors = [info.get("final_info", {}).get("error") for info in infos]
    return [error and error["kind"] for error in errors]


def test_trajectories_are_those_of_sync(vec: Callable[..., gem.VectorEnv]) -> None:
    """The same seed and actions give the same, over the ends of episodes, with several environments an actor."""
    turns = [[f"{turn} {slot}" for slot in range(5)] for turn in range(30)]
    here = gem.make_vec("raytoy:Tally-v0", 5, backend="sync", seed=1)
    assert observed(vec(5, options={"num_actors": 2}), turns) == observed(here, turns)


def test_several_agents_play_as_in_this_process(vec: Callable[..., gem.VectorEnv]) -> None:
    """Joint episodes, and the random actions of each seat, are those of the backend ``sync``."""

    def agent(observation: Any, context: Any) -> str:
        return str(context.sample_random_action())

    alone = gem.make_vec("raytoy:Pair-v0", 2, backend="sync", seed=1)
    expected = {joint.key: joint for joint in gem.rollout(alone, agents=agent, episodes=4)}
    played = {joint.key: joint for joint in gem.rollout(vec(2, "raytoy:Pair-v0"), agents=agent, episodes=4)}
    assert played == expected
    assert all(joint.turns == 3 for joint in played.values())


@pytest.mark.thorough
@pytest.mark.parametrize(("order", "kind"), [("exit 3", "died"), ("hang", "timeout")])
def test_an_actor_that_is_lost_ends_its_episodes(vec: Callable[..., gem.VectorEnv], order: str, kind: str) -> None:
    """Also in code that lets no other thread run; the slots of the other actor go on."""
    vector = vec(4, options={"num_actors": 2}, step_timeout=5.0)
    vector.reset()
    assert kinds(vector.step(["a", order, "a", "a"]).infos) in ([None, kind, None, "collateral"], [None, kind] * 2)
    assert vector.step(["a"] * 4).rewards.tolist() == [2.0, 1.0, 2.0, 1.0]


def test_an_actor_killed_in_a_step_is_a_truncated_slot(
    vec: Callable[..., gem.VectorEnv], workers: list[Any], tmp_path: Path
) -> None:
    """The next reset starts another actor."""
    import ray

    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    vector = vec(1)
    vector.reset()
    vector.send([f"await {pipe}"])
    # Opened for writing once the environment has opened it for reading, and then never written to.
    with open(pipe, "w"):
        ray.kill(workers[0].actor)
        received = vector.recv(timeout=LONG_S)
    assert kinds(received.infos) == ["died"]
    assert "ray.kill" in received.infos[0]["final_info"]["error"]["message"]
    assert len(workers) == 2


@pytest.mark.thorough
def test_a_runtime_env_that_cannot_be_made_ends_the_run(vec: Callable[..., gem.VectorEnv], tmp_path: Path) -> None:
    """Trying again would not help."""
    vector = vec(2, options={"runtime_env": {"working_dir": (tmp_path / "missing.zip").as_uri()}})
    with pytest.raises(EnvFaultError, match=r"missing\.zip"):
        vector.reset()


def test_no_room_for_any_actor_is_an_error(vec: Callable[..., gem.VectorEnv]) -> None:
    """It names the option, in place of waiting for ever."""
    vector = vec(2, options={"num_cpus": 99, "start_timeout": 1})
    with pytest.raises(NoRoomError, match=r"'num_cpus': 99"):
        vector.reset()


@pytest.mark.thorough
def test_actors_that_have_just_ended_leave_their_cpus(vec: Callable[..., gem.VectorEnv], workers: list[Any]) -> None:
    """By default there is an actor for each CPU, one run after another; and no more than slots."""
    for _ in range(3):
        vector = vec(2, options={"num_actors": None})
        vector.reset()
        vector.close()
    assert len(workers) == 6
    vec(1, options={"num_actors": 9}).reset()
    assert len(workers) == 7


@pytest.mark.thorough
def test_close_closes_environments_and_ends_actors(
    vec: Callable[..., gem.VectorEnv], workers: list[Any], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """What does not close is counted; the program's own connection is not ours to cut."""
    import ray
    from ray.exceptions import ActorDiedError

    kwargs = [{"folder": str(tmp_path), "hangs": slot == 1} for slot in range(4)]
    vector = vec(4, [("raytoy:Farewell-v0", each) for each in kwargs], options={"num_actors": 2})
    vector.reset()
    vector.close()
    assert len(list(tmp_path.iterdir())) == 3
    assert "were left: 1" in caplog.text
    assert ray.is_initialized()

    def ask_for_ever(actor: Any) -> None:
        while True:  # Ray ends an actor some time after it was told to
            ray.get(actor.__ray_ready__.remote(), timeout=LONG_S)

    for worker in workers:
        with pytest.raises(ActorDiedError):
            ask_for_ever(worker.actor)


@pytest.mark.thorough
def test_a_connection_that_the_program_cuts_ends_the_run(
    ray_folder: str, vec: Callable[..., gem.VectorEnv], tmp_path: Path
) -> None:
    """Also in the middle of a step. The last test here: it ends the Ray of the others."""
    import ray

    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    vector = vec(1)
    vector.reset()
    vector.send([f"await {pipe}"])
    with open(pipe, "w"):
        ray.shutdown()
        with pytest.raises(EnvFaultError, match="connection to Ray"):
            vector.recv(timeout=LONG_S)
