"""The backend ``ray`` on a cluster of two nodes, which goes on when a program, an actor or a node does not."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import gem_core as gem

pytestmark = pytest.mark.thorough


def nodes(vector: gem.VectorEnv) -> list[str]:
    """Return the node on which each slot lives."""
    return [str(each) for each in vector.step(["node"] * len(vector)).observations]


def test_actors_are_spread_over_the_nodes(cluster: Any, vec: Callable[..., gem.VectorEnv]) -> None:
    """By default; the connection that was made for them ends with them, and the cluster goes on."""
    import ray

    vector = vec(4, options={"address": cluster.address, "num_actors": 2})
    vector.reset()
    there = nodes(vector)
    assert there[0] != there[1]
    assert there[:2] == there[2:]
    vector.close()
    assert not ray.is_initialized()


def test_the_end_of_a_node_is_survived(
    cluster: Any, vec: Callable[..., gem.VectorEnv], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """What ran there is truncated once, and shares the actor that lives: no CPU is free for another.

    The last test: the node does not come back.
    """
    import ray

    options = {"address": cluster.address, "num_actors": 2, "num_cpus": 2, "start_timeout": 20}
    vector = vec(4, options=options)
    vector.reset()
    lost = [slot for slot, node in enumerate(nodes(vector)) if node != ray.get_runtime_context().get_node_id()]
    assert len(lost) == 2
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    vector.send({lost[0]: f"await {pipe}", lost[1]: "a"})
    with open(pipe, "w"):
        cluster.remove_node(cluster.far, allow_graceful=False)
        infos = vector.recv(min_envs=2, timeout=120.0).infos
    infos += vector.step(["a"] * 4).infos
    assert sorted(info["final_info"]["error"]["kind"] for info in infos if "final_info" in info) == [
        "collateral",
        "died",
    ]
    assert len(set(nodes(vector))) == 1
    assert "share" in caplog.text
