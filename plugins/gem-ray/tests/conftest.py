"""Ray for the tests: one at a time on a machine, on the loopback address, small, and ended with the module."""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import gem_core as gem

sys.path.append(str(Path(__file__).parent))  # for ray_toys, in actors too

# Ray reads these when it is imported. The first, in spite of its name, makes it use the loopback address.
os.environ |= {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
    "RAY_AUTH_MODE": "token",
    "RAY_AUTH_TOKEN": secrets.token_hex(32),
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}

STORE_BYTES = 80 * 1024 * 1024


@pytest.fixture(scope="session")
def toys() -> None:
    """Register the toys."""
    from ray_toys import register_toys

    register_toys()


@pytest.fixture
def workers(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The workers that were started in this test, in order; ``actor`` of each is its actor."""
    from gem_ray import backend

    found: list[Any] = []

    class NotedWorker(backend.RayWorker):
        def __init__(self, *args: Any) -> None:
            super().__init__(*args)
            found.append(self)

    monkeypatch.setattr(backend, "RayWorker", NotedWorker)
    return found


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


@pytest.fixture(scope="module")
def ray_folder(toys: None) -> Iterator[str]:
    """A folder for a Ray, given to one process of this machine at a time: several Rays at once need too much memory."""
    with open(Path(tempfile.gettempdir(), "gem-ray-tests.lock"), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        # Short, since Ray puts sockets there.
        folder = tempfile.mkdtemp(prefix="gr-")
        # Where Ray notes the cluster of this machine, in a folder that is there only once a Ray of the user's has run.
        Path(folder, "ray").mkdir()
        before = os.environ.get("RAY_TMPDIR")
        os.environ["RAY_TMPDIR"] = folder
        try:
            yield folder
        finally:
            if before is None:
                del os.environ["RAY_TMPDIR"]
            else:
                os.environ["RAY_TMPDIR"] = before
            shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="module")
def local_ray(ray_folder: str) -> Iterator[None]:
    """A Ray of this machine that the program itself has started."""
    import ray

    ray.init(
        address="local",
        num_cpus=2,
        object_store_memory=STORE_BYTES,
        include_dashboard=False,
        log_to_driver=False,
        _temp_dir=ray_folder,
        _node_ip_address="127.0.0.1",
    )
    yield
    ray.shutdown()


@pytest.fixture(scope="module")
def cluster(ray_folder: str) -> Iterator[Any]:
    """A cluster of two nodes on this machine, to which nobody is connected; the second has the resource ``far``."""
    import ray
    from ray.cluster_utils import Cluster

    common = {"object_store_memory": STORE_BYTES, "node_ip_address": "127.0.0.1", "include_dashboard": False}
    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 2, "temp_dir": ray_folder, **common})
    try:
        made.far = made.add_node(num_cpus=2, resources={"far": 3}, **common)
        yield made
    finally:
        ray.shutdown()
        made.shutdown()
