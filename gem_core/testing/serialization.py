"""Making an environment once more, in this process or in another."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, cast

import gymnasium

from gem_core.env.base import Env
from gem_core.env.guard import Guard
from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.making.environment import make_from, wrap
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.specs import EnvSpec
from gem_core.testing.comparing import json_loss, shown
from gem_core.testing.contract import NotTriedError


def layers_of(env: AnyEnv) -> list[AnyEnv]:
    """Return an environment's wrappers and its task, outermost first."""
    layers = [env]
    while isinstance(layers[-1], gymnasium.Wrapper):
        layers.append(layers[-1].env)
    return layers


def guarded(env: AnyEnv) -> AnyEnv:
    """Put a ``Guard`` around a stack that has none; ``make`` gives every environment one."""
    return unchecked(env if any(isinstance(layer, Guard) for layer in layers_of(env)) else Guard(env))


def unchecked(env: AnyEnv) -> AnyEnv:
    """Let the guard of a stack pass results as they are: it is for the promises to judge them."""
    for layer in layers_of(env):
        if isinstance(layer, Guard):
            layer.checks_results = False
    return env


def remade(env: AnyEnv) -> AnyEnv:
    """Call all constructors of a stack again, with the arguments that they were called with.

    ``spawn`` does the same; it is a promise of its own here, which must not decide the others.
    """
    if not isinstance(env, gymnasium.Wrapper):
        args, kwargs = env._init_args if isinstance(env, Env) else ((), {})
        task = type(env)(*args, **kwargs)
        task.spec, task.render_mode = env.spec, env.render_mode
        return task
    inner = remade(env.env)
    if not isinstance(env, Wrapper):
        return cast("AnyEnv", type(env)(inner, **getattr(env, "_saved_kwargs", {})))
    args, kwargs = env._init_args
    wrapper = type(env)(inner, *args[1:], **kwargs) if args else type(env)(**{**kwargs, "env": inner})
    wrapper.made_as, wrapper.implicit = env.made_as, env.implicit
    return wrapper


def recipe_of(env: AnyEnv) -> dict[str, Any]:
    """Return plain data from which ``build`` makes the environment in another process.

    Raises:
        NotTriedError: Something of it cannot be found there; the message says what.
    """
    task, spec = env.unwrapped, env.spec
    recipe: dict[str, Any] = {"files": {}, "record": None, "args": [], "wrappers": []}
    record = getattr(spec, "record", None)
    if record is not None:
        made = cast("Any", spec)
        entry_point, recipe["kwargs"], wrappers = record.entry_point, dict(made.kwargs), made.wrappers
        recipe["record"] = {
            "id": record.id,
            "deterministic": record.deterministic,
            "max_turns": record.max_turns,
        }
    else:
        entry_point = type(task)
        args, kwargs = cast("Env", task)._init_args
        recipe["args"], recipe["kwargs"] = list(args), dict(kwargs)
        wrappers = tuple(_record_of(layer) for layer in reversed(layers_of(env)[:-1]))
    recipe["entry_point"] = _importable(entry_point, recipe["files"])
    for name, options in wrappers:
        _note_file(name.partition(":")[0], recipe["files"])
        recipe["wrappers"].append([name, options])
    loss = json_loss(recipe)
    if loss is not None:
        raise NotTriedError(f"its arguments cannot be handed to another process: {loss}")
    return recipe


def build(recipe: Mapping[str, Any]) -> AnyEnv:
    """Make the environment of a recipe in this process."""
    for module, file in recipe["files"].items():
        _import_from(module, file)
    wrappers = [(name, options) for name, options in recipe["wrappers"]]
    if recipe["record"] is not None:
        record = EnvSpec(entry_point=recipe["entry_point"], kwargs=recipe["kwargs"], **recipe["record"])
        return guarded(make_from(record, {}, wrappers))
    maker = load_entry_point(recipe["entry_point"], "the environment under check")
    return guarded(wrap(maker(*recipe["args"], **recipe["kwargs"]), wrappers))


def _record_of(layer: AnyEnv) -> tuple[str, dict[str, Any]]:
    if not isinstance(layer, Wrapper):
        raise NotTriedError(f"Gymnasium's wrapper {type(layer).__name__} inside the stack cannot be handed over")
    if layer.made_as is not None:
        return layer.made_as
    _, options = layer._own_record()
    return _importable(type(layer), {}), options


def _importable(entry_point: str | Callable[..., Any], files: dict[str, str]) -> str:
    """Return ``"module:name"`` of what another process can import, and note where the module's file is."""
    if isinstance(entry_point, str):
        _note_file(entry_point.partition(":")[0], files)
        return entry_point
    module, name = getattr(entry_point, "__module__", None), getattr(entry_point, "__qualname__", None)
    if not module or not name:
        raise NotTriedError(f"{shown(entry_point)} has no name by which another process could import it")
    if module == "__main__" or "<" in name:
        raise NotTriedError(
            f"{module}:{name} cannot be imported by another process; define it at the top of a module of its own"
        )
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    if found is not entry_point:
        raise NotTriedError(f"{module}:{name} is not what was given, so another process could not import it")
    _note_file(module, files)
    return f"{module}:{name}"


def _note_file(module: str, files: dict[str, str]) -> None:
    file = getattr(sys.modules.get(module), "__file__", None)
    if file is not None:
        files[module] = os.path.abspath(file)


def _import_from(module: str, file: str) -> None:
    """Import a module by name; by its file where the name leads nowhere, or elsewhere.

    Test modules are such: pytest's import mode ``importlib`` gives them names that only it can resolve.
    """
    if module not in sys.modules:
        with suppress(ImportError):
            importlib.import_module(module)
    loaded = getattr(sys.modules.get(module), "__file__", None)
    if loaded is not None and os.path.realpath(loaded) == os.path.realpath(file):
        return
    spec = importlib.util.spec_from_file_location(module, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"cannot import {module!r}")
    sys.modules[module] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[module])


def encoded(message: Mapping[str, Any]) -> str:
    """Return a message as one line; broken Unicode stays what it is."""
    return json.dumps(message, ensure_ascii=True) + "\n"
