"""The layers of a stack, and its guard."""

from __future__ import annotations

import gymnasium

from gem_core.env.guard import Guard
from gem_core.env.wrapper import AnyEnv
from gem_core.testing.joint import JointView, is_joint


def layers_of(env: AnyEnv) -> list[AnyEnv]:
    """Return an environment's wrappers and its task, outermost first."""
    layers = [env]
    while isinstance(layers[-1], gymnasium.Wrapper):
        layers.append(layers[-1].env)
    return layers


def guarded(env: AnyEnv) -> AnyEnv:
    """Put a ``Guard`` around a stack that has none, as ``make`` does; around one of several agents, a ``JointView``."""
    if is_joint(env):
        return JointView(env)
    return unchecked(env if any(isinstance(layer, Guard) for layer in layers_of(env)) else Guard(env))


def unchecked(env: AnyEnv) -> AnyEnv:
    """Make the guard of a stack pass results unchecked, since the promises check them."""
    for layer in layers_of(env):
        if isinstance(layer, Guard):
            layer.checks_results = False
    return env
