"""Make an environment again from the arguments that it was made with."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, cast

import gymnasium

from gem_core.env.base import Env
from gem_core.env.guard import Guard
from gem_core.env.seats import SeatWrappers
from gem_core.env.wrapper import AnyEnv, Wrapper
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


def remaker(env: AnyEnv) -> Callable[[], AnyEnv]:
    """Return a function that calls all constructors of a stack again, with the original arguments.

    ``spawn`` does the same; it is a promise of its own here, which must not decide the others.
    """
    set_by_make: dict[str, Any] = {}
    if isinstance(env, Wrapper | SeatWrappers):
        args, kwargs = env._init_args
        if isinstance(env, Wrapper):
            set_by_make = {"registered_as": env.registered_as, "hidden_in_spec": env.hidden_in_spec}
    elif isinstance(env, gymnasium.Wrapper):
        args, kwargs = (None,), getattr(env, "_saved_kwargs", {})
    else:
        args, kwargs = env._init_args if isinstance(env, Env) else ((), {})
        set_by_make = {"spec": env.spec, "render_mode": env.render_mode}
        return partial(_remade, type(env), None, args, kwargs, set_by_make)
    args, kwargs = (None, *args[1:]) if args else (), {name: kwargs[name] for name in kwargs if name != "env"}
    return partial(_remade, type(env), remaker(env.env), args, kwargs, set_by_make)


def _remade(
    kind: type,
    remake_inner: Callable[[], AnyEnv] | None,
    args: tuple[Any, ...],
    kwargs: dict[str, Any],
    set_by_make: dict[str, Any],
) -> AnyEnv:
    if remake_inner is not None:
        # The inner environment was given by position or by name.
        args, kwargs = ((remake_inner(), *args[1:]), kwargs) if args else ((), {**kwargs, "env": remake_inner()})
    else:  # a task that is made of another, as by single_agent, must not share it
        args = tuple(map(_remade_env, args))
        kwargs = {name: _remade_env(value) for name, value in kwargs.items()}
    env = cast("AnyEnv", kind(*args, **kwargs))
    for name, value in set_by_make.items():
        setattr(env, name, value)
    return env


def _remade_env(argument: Any) -> Any:
    return remaker(argument)() if isinstance(argument, gymnasium.Env) else argument
