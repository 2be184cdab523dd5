"""Make an environment from a record: requirements, entry point, arguments, guard and wrappers."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from functools import partial, reduce
from typing import Any, cast

import gymnasium

from gem_core.arguments import check_arguments, takes_keyword
from gem_core.env.base import Env
from gem_core.env.guard import Guard
from gem_core.env.joint_checks import check_seats
from gem_core.env.multi_agent import MultiAgentEnv
from gem_core.env.seat_wrappers import SeatWrappers
from gem_core.env.spec import EnvRecipe
from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.errors import ArgumentError, RegistrationError
from gem_core.making.layers import Layer, Wrappers, check_options, choices, layers_of
from gem_core.registry.entry_points import call_entry_point, load_entry_point
from gem_core.registry.lookup import registry
from gem_core.registry.requirements import check_requirements
from gem_core.registry.specs import EnvSpec
from gem_core.wrappers.rendering import TEXT_MODES, Rendered
from gem_core.wrappers.turn_limit import TurnLimit


@dataclasses.dataclass
class MadeSpec(EnvRecipe):
    """What ``make`` made an environment from: it can be made again, with the same wrappers and arguments."""

    def make(self, wrappers: Wrappers = (), **kwargs: Any) -> AnyEnv:
        """Make the same environment again, with some arguments changed and ``wrappers`` around it."""
        record, arguments = cast("EnvSpec", self.record), {**self.kwargs, **kwargs}
        if isinstance(self.stack, Mapping) or isinstance(wrappers, Mapping):
            return make_from(record, arguments, self.stack, wrappers)
        return make_from(record, arguments, [*self.stack, *choices(wrappers)])

    @staticmethod
    def from_json(json_env_spec: str) -> MadeSpec:
        """Return the specification that ``to_json`` wrote; its id is looked up in the registry."""
        fields = json.loads(json_env_spec)
        wrappers = _as_layers(fields["wrappers"])
        return dataclasses.replace(_made_spec(registry().env(fields["id"]), fields["kwargs"]), wrappers=wrappers)


def _as_layers(listed: Any) -> Any:
    """Return wrappers that were read from JSON, by seat or not, as a specification holds them."""
    if isinstance(listed, Mapping):
        return {seat: _as_layers(stack) for seat, stack in listed.items()}
    return tuple((name, options) for name, options in listed)


def _made_spec(record: EnvSpec, kwargs: dict[str, Any]) -> MadeSpec:
    return MadeSpec(
        id=record.id,
        entry_point=record.entry_point,
        nondeterministic=not record.deterministic,
        kwargs=kwargs,
        record=record,
    )


def make_from(record: EnvSpec, kwargs: Mapping[str, Any], *wrappers: Wrappers) -> AnyEnv:
    """Make the environment of a record.

    Args:
        record: What is made.
        kwargs: Keyword arguments over those of the record; ``render_mode`` is handled here.
        *wrappers: What is put around it, innermost first.

    Raises:
        MissingRequirementError: Something has to be installed, started or set first.
        EntryPointError: What the record points to cannot be imported.
        ArgumentError: A keyword that the environment, or an option that a wrapper, does not have.
    """
    arguments = {**record.kwargs, **kwargs}
    check_requirements(record, arguments)
    render_mode = arguments.pop("render_mode", None)
    owner = f"environment {record.id!r}"
    maker = load_entry_point(record.entry_point, owner)
    limit = record.max_turns
    if limit is not None and takes_keyword(maker, "max_turns"):
        arguments, limit = {"max_turns": limit, **arguments}, None
    env = call_entry_point(maker, (), arguments, owner)
    if not isinstance(env, gymnasium.Env):
        raise RegistrationError(f"{record.id}: the entry point returned {type(env).__name__}, not an environment")
    try:
        return reduce(wrap, wrappers, _finish_env(env, record, arguments, render_mode, limit))
    except BaseException:
        env.close()  # it may have started a server or a container
        raise


def _finish_env(
    env: AnyEnv, record: EnvSpec, arguments: dict[str, Any], render_mode: str | None, limit: int | None
) -> AnyEnv:
    """Give a task its render mode, record, guard and limit of turns; one of several agents has both of these itself."""
    task = env.unwrapped
    as_text = False
    if render_mode is not None:
        as_text = _set_render_mode(task, render_mode, record)
        arguments = {**arguments, "render_mode": render_mode}
    task.spec = _made_spec(record, arguments)
    if isinstance(task, MultiAgentEnv):
        return env
    guarded: AnyEnv = Guard(env)
    if limit is not None:
        guarded = TurnLimit(guarded, max_turns=limit)
        guarded.implicit = True
    return Rendered(guarded, cast("str", render_mode)) if as_text else guarded


def _set_render_mode(task: AnyEnv, render_mode: str, record: EnvSpec) -> bool:
    """Set the render mode of a task; tell whether ``Rendered`` is to show its text."""
    own: list[str] = task.metadata.get("render_modes", [])
    several = isinstance(task, MultiAgentEnv)
    modes = own if several else list(dict.fromkeys([*own, *TEXT_MODES]))
    if render_mode not in modes:
        raise ArgumentError(
            f"{record.id}: no render mode {render_mode!r}; it offers {', '.join(map(repr, modes)) or 'none'}"
        )
    # A class that lists "human" itself also shows itself, as Gymnasium's do.
    shows_itself = render_mode == "human" and "human" in own and task.metadata is not Env.metadata
    as_text = render_mode in TEXT_MODES and not several and not shows_itself
    task.render_mode = "ansi" if as_text else render_mode
    return as_text


def wrap(env: AnyEnv, wrappers: Wrappers) -> AnyEnv:
    """Put wrappers and tools around an environment, innermost first; around each seat, where several agents act.

    Raises:
        ArgumentError: They are named by seat, and the environment has no such seat, or one agent.
    """
    if isinstance(env, MultiAgentEnv):
        by_seat = wrappers if isinstance(wrappers, Mapping) else dict.fromkeys(env.possible_agents, wrappers)
        around = {seat: partial(wrap, wrappers=stack) for seat, stack in by_seat.items() if choices(stack)}
        return SeatWrappers(env, around) if around else env
    if isinstance(wrappers, Mapping):
        raise ArgumentError(
            f"wrappers by seat ({', '.join(map(repr, wrappers))}) are for an environment of several agents, and "
            f"{env.get_wrapper_attr('env_id') or type(env.unwrapped).__name__} has one; give a list"
        )
    for layer in layers_of(wrappers):
        env = _apply_layer(env, layer)
    return env


def _apply_layer(env: AnyEnv, layer: Layer) -> AnyEnv:
    wrapper = load_entry_point(layer.entry_point, layer.owner)
    wrapped = call_entry_point(wrapper, (env,), layer.options, layer.owner)
    if not isinstance(wrapped, gymnasium.Env):
        raise ArgumentError(f"{layer.owner} returned {type(wrapped).__name__}, not an environment")
    if layer.name is not None and isinstance(wrapped, Wrapper):
        wrapped.made_as = (layer.name, layer.options)
    return cast("AnyEnv", wrapped)


def check_choices(record: EnvSpec, kwargs: Mapping[str, Any], wrappers: Wrappers) -> None:
    """Raise an error for an unknown keyword or option, as ``make_from`` would, before anything is made.

    Raises:
        ArgumentError: A keyword that the environment, or an option that a wrapper or a tool, does not have.
        EntryPointError: What a record points to cannot be imported.
    """
    if kwargs:
        owner = f"environment {record.id!r}"
        arguments = {name: value for name, value in {**record.kwargs, **kwargs}.items() if name != "render_mode"}
        check_arguments(load_entry_point(record.entry_point, owner), (), arguments, owner)
    if isinstance(wrappers, Mapping) and record.seats:
        check_seats(wrappers, record.seats)
    check_options(wrappers)
