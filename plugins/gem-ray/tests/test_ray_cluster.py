"""The backend ``ray`` on a cluster of two nodes, which goes on when a program, an actor or a node does not."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import gem_core as gem

pytestmark = pytest.mark.thorough

FAR = {"num_actors": 1, "num_cpus": 0, "resources": {"far": 1}}
"""Options for one actor on the node that is not ours."""


@pytest.fixture
def vec(cluster: Any) -> Iterator[Callable[..., gem.VectorEnv]]:
    """Make vector environments on the cluster, closed with the test."""
    made: list[gem.VectorEnv] = []

    def make(num_envs: int, options: dict[str, Any], **kwargs: Any) -> gem.VectorEnv:
        backend = ("ray", {"address": cluster.address, **options})
        made.append(gem.make_vec("raytoy:Tally-v0", num_envs, backend=backend, seed=1, **kwargs))
        return made[-1]

    yield make
    for each in made:
        each.close()


def places(executors: list[Any]) -> list[str]:
    """Return the node of each actor of the only vector environment."""
    return [link.place.node for link in executors[0].links]


def undisturbed(num_envs: int, turns: int) -> list[str]:
    """Return the observations of the last of some turns, in this process."""
    vector = gem.make_vec("raytoy:Tally-v0", num_envs, backend="sync", seed=1)
    vector.reset()
    return [str(each) for each in [vector.step(["a"] * num_envs) for _ in range(turns)][-1].observations]


def test_actors_are_spread_over_the_nodes(vec: Callable[..., gem.VectorEnv], executors: list[Any]) -> None:
    """By default; the connection that was made for them ends with them, and the cluster goes on."""
    import ray

    vector = vec(4, {"num_actors": 2})
    vector.reset()
    assert len(set(places(executors))) == 2
    assert vector.step(["a"] * 4).observations == undisturbed(4, 1)
    vector.close()
    assert not ray.is_initialized()


def test_on_another_node_the_slot_that_ended_the_process_is_known(
    vec: Callable[..., gem.VectorEnv], executors: list[Any]
) -> None:
    """Though nothing of its memory can be read from here."""
    import ray

    vector = vec(3, FAR)
    vector.reset()
    assert places(executors) != [ray.get_runtime_context().get_node_id()]
    step = vector.step(["a", "exit 3", "a"])
    assert step.truncated.tolist() == [False, True, False]
    assert step.infos[1]["final_info"]["error"]["kind"] == "died"
    expected = undisturbed(3, 2)
    observations = vector.step(["a"] * 3).observations
    assert [observations[0], observations[2]] == [expected[0], expected[2]]


def test_on_another_node_what_hangs_is_killed(vec: Callable[..., gem.VectorEnv]) -> None:
    """Also in code that lets no other thread of its process run."""
    vector = vec(3, FAR, step_timeout=3.0)
    vector.reset()
    step = vector.step(["a", "hang", "a"])
    assert step.truncated.tolist() == [False, True, False]
    assert step.infos[1]["final_info"]["error"]["kind"] == "timeout"
    assert vector.faults == 1


def test_a_script_that_ends_without_closing_leaves_no_actor(cluster: Any, tmp_path: Path) -> None:
    """Its own environments went to the actors by value; Ray says nothing to its terminal."""
    script = tmp_path / "script.py"
    script.write_text(
        textwrap.dedent(
            f"""
            import json, sys
            import gem_core as gem

            class DoubleEnv(gem.Env):
                def reset(self, seed=None, options=None):
                    super().reset(seed=seed)
                    return "begin", {{}}

                def step(self, action):
                    return SEPARATOR.join([action, action]), 1.0, False, False, {{}}

            SEPARATOR = "-"
            gem.register("mine:Double-v0", DoubleEnv)
            options = {{"num_actors": 2, "address": "{cluster.address}"}}
            vec = gem.make_vec("mine:Double-v0", 2, backend=("ray", options))
            vec.reset()
            from ray._private.state import actors
            kind = "EnvActor", "ALIVE"
            ids = [key for key, row in actors().items() if (row["ActorClassName"], row["State"]) == kind]
            print(json.dumps([vec.step(["a", "b"]).observations, ids]))
            """
        )
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    observations, ids = json.loads(done.stdout)
    assert observations == ["a-a", "b-b"]
    assert {_state(cluster, actor_id) for actor_id in ids} == {"DEAD"}


def test_the_end_of_a_node_is_survived(
    cluster: Any, vec: Callable[..., gem.VectorEnv], executors: list[Any], tmp_path: Path
) -> None:
    """What ran there is truncated once, and goes on where there is room. The last test: the node does not come back."""
    import ray

    vector = vec(4, {"num_actors": 2})
    vector.reset()
    ours = ray.get_runtime_context().get_node_id()
    assert sorted(place == ours for place in places(executors)) == [False, True]
    lost = places(executors).index(next(place for place in places(executors) if place != ours))
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    vector.send({lost: f"await {pipe}", lost + 2: "a"})
    with open(pipe, "w"):
        cluster.remove_node(cluster.far, allow_graceful=False)
        received = vector.recv(min_envs=2, timeout=120.0)
    by_slot = dict(zip(received.slots, received.infos, strict=True))
    assert by_slot[lost]["final_info"]["error"]["kind"] == "died"
    assert by_slot[lost + 2] == {"turn": 1}
    vector.step(["a"] * 4)
    assert set(places(executors)) == {ours}


def _state(cluster: Any, actor_id: str) -> str:
    """Return what the cluster says of an actor."""
    import ray
    from ray._private.state import actors

    ray.init(address=cluster.address, log_to_driver=False, ignore_reinit_error=True)
    try:
        return str(actors(actor_id=actor_id)["State"])
    finally:
        ray.shutdown()
