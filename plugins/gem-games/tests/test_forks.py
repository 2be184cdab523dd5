"""A fork of any game goes on as the first one does, and so does one that went through pickle."""

from __future__ import annotations

import pickle
from typing import Any

import pytest

import gem_core as gem


def played(env: Any, most: int) -> list[Any]:
    """Step with random actions, up to the end of the episode."""
    records: list[Any] = []
    over = False
    while not over and len(records) < most:
        if getattr(env, "possible_agents", None):
            records.append(env.step({agent: env.sample_random_action(agent) for agent in env.acting}))
            over = not env.acting
        else:
            records.append(env.step(env.sample_random_action()))
            over = records[-1][2] or records[-1][3]
    return records


@pytest.mark.parametrize("copied", [lambda env: env.fork(), lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("env_id", gem.list_envs("game"))
def test_fork_goes_on_identically(env_id: str, copied: Any) -> None:
    """Before the first action and in the middle, with what is drawn and rendered, and into the next episode."""
    env: Any = gem.make(env_id, **({} if gem.spec(env_id).seats else {"render_mode": "ansi"}))
    env.reset(seed=5)
    whole = len(played(env, 20))
    for turns in (0, whole // 2):
        env.reset(seed=5)
        played(env, turns)
        other = copied(env)
        others = [other.render(), played(other, 20), other.reset(), played(other, 20)]
        assert [env.render(), played(env, 20), env.reset(), played(env, 20)] == others
