"""A Ray of our own begins with the first vector environment that needs it, and ends with the last."""

from __future__ import annotations

import pytest

import gem_core as gem
from gem_core.errors import EnvFaultError


@pytest.mark.thorough
def test_it_ends_with_the_last_that_uses_it(ray_folder: str, capfd: pytest.CaptureFixture[str]) -> None:
    """Nothing of it is written to the terminal."""
    import ray

    init = {"num_cpus": 1, "object_store_memory": 80 * 1024 * 1024, "_temp_dir": ray_folder}
    backend = ("ray", {"address": "local", "init": init})
    with gem.make_vec("raytoy:Tally-v0", 2, backend=backend) as first:
        first.reset()
        with gem.make_vec("raytoy:Tally-v0", 2, backend=backend) as second:
            second.close()
            assert ray.is_initialized()
        assert first.step(["a", "a"]).rewards.tolist() == [1.0, 1.0]
    assert not ray.is_initialized()
    assert capfd.readouterr() == ("", "")


@pytest.mark.thorough
def test_an_address_without_ray_is_an_error_that_says_what_to_do(ray_folder: str) -> None:
    with pytest.raises(EnvFaultError, match=r"'auto'.*ray start --head"):
        gem.make_vec("raytoy:Tally-v0", 2, backend=("ray", {"address": "auto"}))
