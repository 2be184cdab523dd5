"""Environments of GEM by ``gymnasium.make``: importing this module registers them, each as ``GEM/namespace.Name``.

An id of Gymnasium has no colon: ``game:GuessTheNumber-v0-hard`` is ``GEM/game.GuessTheNumber-v0-hard`` there::

    import gymnasium

    import gem_core.gymnasium_envs

    gymnasium.register_envs(gem_core.gymnasium_envs)
    env = gymnasium.make("GEM/game.GuessTheNumber-v0-hard", wrappers="concat")

Environments of several agents are left out: Gymnasium's interface is for one.
"""

from __future__ import annotations

from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec as GymnasiumSpec

from gem_core.api import make
from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.registry.lookup import registry

__all__ = ["GymnasiumEnv", "gymnasium_id", "make_env", "register"]

_NAMESPACE = "GEM"


class GymnasiumEnv(Wrapper):
    """What ``gymnasium.make`` returns inside its own wrappers: an environment with a ``spec`` of Gymnasium's.

    It is its own ``unwrapped``, where Gymnasium puts that ``spec``. GEM's methods are here as well, as in
    ``env.unwrapped.sample_random_action()``.
    """

    hidden_in_spec = True
    spec: Any = None

    def __init__(self, env: AnyEnv) -> None:
        super().__init__(env)
        self.metadata = dict(env.metadata)  # Gymnasium's vector environments write into it

    @property
    def unwrapped(self) -> Any:
        """This environment: what is inside belongs to GEM."""
        return self

    @property
    def _np_random(self) -> Any:  # type: ignore[override]  # a property of the task as well
        """The task's generator, which Gymnasium's ``check_env`` looks at."""
        return self.env.unwrapped._np_random


def gymnasium_id(env_id: str) -> str:
    """Return the id by which Gymnasium makes an environment of GEM."""
    return f"{_NAMESPACE}/{env_id.replace(':', '.', 1)}"


def make_env(gem_id: str, **kwargs: Any) -> GymnasiumEnv:
    """Make an environment of GEM for Gymnasium; ``register`` names this function as the entry point.

    Args:
        gem_id: Its id in GEM.
        **kwargs: As for ``gem_core.make``: arguments of the environment, ``wrappers`` and ``render_mode``.
    """
    return GymnasiumEnv(make(gem_id, **kwargs))


def register() -> None:
    """Register with Gymnasium what the registry of GEM has by now; call it again after registering more.

    It goes into Gymnasium's table at once: its ``register`` looks through all ids for each new one.
    """
    for record in registry().envs():
        name = gymnasium_id(record.id)
        if record.seats or name in gymnasium.registry:
            continue
        gymnasium.registry[name] = GymnasiumSpec(
            id=name,
            entry_point=f"{__name__}:{make_env.__name__}",
            nondeterministic=not record.deterministic,
            kwargs={"gem_id": record.id},
        )


register()
