"""The plugin declares its backend without importing Ray, and refuses what is wrong before it starts one."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

import gem_core as gem
from gem_core.errors import ArgumentError
from gem_core.testing import check_plugin


def test_the_plugin_keeps_to_the_rules() -> None:
    check_plugin("gem-ray")


def test_declaring_imports_no_ray() -> None:
    code = "import sys, gem_ray._plugin as p; list(p.gem_register_vector_backends()); sys.exit('ray' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_a_wrong_option_names_the_right_one(toys: None) -> None:
    with pytest.raises(ArgumentError, match=r"vector backend 'ray': .*'num_actor'\. Did you mean 'num_actors'\?"):
        gem.make_vec("raytoy:Tally-v0", 2, backend=("ray", {"num_actor": 2}))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_actors": 0}, "num_actors must be a positive whole number, not 0"),
        ({"num_cpus": -1}, "num_cpus must be a number from 0 up, not -1"),
        ({"num_gpus": "all"}, "num_gpus must be a number from 0 up, not 'all'"),
    ],
)
def test_a_value_that_cannot_be_is_refused(toys: None, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError) as raised:
        gem.make_vec("raytoy:Tally-v0", 2, backend=("ray", options))
    assert str(raised.value) == message


def test_a_ray_client_is_refused(toys: None) -> None:
    with pytest.raises(ArgumentError, match="Ray Client"):
        gem.make_vec("raytoy:Tally-v0", 2, backend=("ray", {"address": "ray://127.0.0.1:10001"}))
