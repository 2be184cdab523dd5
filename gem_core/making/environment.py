"""Make an environment from a record: requirements, entry point, arguments, guard and wrappers."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from functools import partial
from typing import Any, Self, cast

import gymnasium
from gymnasium.envs.registration import EnvSpec as GymnasiumSpec
from gymnasium.envs.registration import WrapperSpec as GymnasiumWrapperSpec

from gem_core.arguments import check_arguments, takes_keyword
from gem_core.env.base import Env
from gem_core.env.checks import check_seats
from gem_core.env.guard import Guard
from gem_core.env.multi_agent import MultiAgentEnv
from gem_core.env.seats import SeatWrappers
from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.errors import ArgumentError, RegistrationError
from gem_core.making.layers import Wrappers, check_options, choices, layers_of
from gem_core.registry.entry_points import call_entry_point, load_entry_point
from gem_core.registry.lookup import registry
from gem_core.registry.requirements import check_requirements
from gem_core.registry.specs import EnvSpec
from gem_core.wrappers.rendering import TEXT_MODES, Rendered
from gem_core.wrappers.turn_limit import TurnLimit

Layers = tuple[tuple[str, dict[str, Any]], ...]
"""Wrappers by name or entry point, each with its options, innermost first."""

_ABSENT = object()


@dataclasses.dataclass
class MadeSpec(GymnasiumSpec):
    """What an environment was made from, as its ``spec``: it can be made again, with the same wrappers and arguments.

    ``record`` is what is registered, ``kwargs`` the arguments in force, and ``wrappers`` what was put around the task:
    names or entry points with their options, innermost first; by seat, where several agents differ in them. Copies
    share the values of ``kwargs``: data sets are referenced, never copied.
    """

    id: str = ""
    record: EnvSpec | None = None
    wrappers: Layers | Mapping[str, Layers] = ()

    def __post_init__(self) -> None:
        # Gymnasium's own would parse the id in its syntax, which has no variants.
        record = cast("EnvSpec", self.record)
        self.id, self.namespace, self.name, self.version = record.id, record.namespace, record.name, record.version
        self.entry_point, self.nondeterministic = record.entry_point, not record.deterministic

    def make(self, wrappers: Wrappers = (), **kwargs: Any) -> AnyEnv:
        """Make the same environment again, with some arguments changed and ``wrappers`` around it."""
        record, arguments = cast("EnvSpec", self.record), {**self.kwargs, **kwargs}
        if isinstance(self.stack, Mapping) or isinstance(wrappers, Mapping):
            return make_from(record, arguments, self.stack, wrappers)
        return make_from(record, arguments, [*self.stack, *choices(wrappers)])

    @property
    def stack(self) -> Layers | Mapping[str, Layers]:
        """All wrappers, innermost first: ours, and those of Gymnasium's that were put around them since."""
        if isinstance(self.wrappers, Mapping):
            return self.wrappers
        theirs = tuple(_as_layer(wrapper) for wrapper in self.additional_wrappers)
        if self.max_episode_steps is not None:  # how Gymnasium's TimeLimit records itself
            theirs += (("gymnasium.wrappers:TimeLimit", {"max_episode_steps": self.max_episode_steps}),)
        return (*self.wrappers, *theirs)

    def wrappers_of(self, seat: str) -> Layers:
        """Return the wrappers around one seat, in an environment of several agents."""
        return self.wrappers.get(seat, ()) if isinstance(self.wrappers, Mapping) else self.wrappers

    def with_kwargs(self, overrides: Mapping[str, Any]) -> Self:
        """Return a copy whose keyword arguments are changed."""
        return dataclasses.replace(self, kwargs={**self.kwargs, **overrides}) if overrides else self

    def with_wrapper(self, name: str, options: Mapping[str, Any]) -> Self:
        """Return a copy with one more wrapper outside."""
        wrappers = (*cast("Layers", self.stack), (name, dict(options)))
        return dataclasses.replace(self, wrappers=wrappers, additional_wrappers=(), max_episode_steps=None)

    def recorded(self) -> dict[str, Any]:
        """Return ``id``, ``kwargs`` over the registered ones and ``wrappers``, as the record of an episode has them."""
        record = cast("EnvSpec", self.record)
        limit = {} if record.max_turns is None else {"max_turns": record.max_turns}
        registered = {**limit, **record.kwargs}
        kwargs = {name: value for name, value in self.kwargs.items() if registered.get(name, _ABSENT) is not value}
        return {"id": self.id, "kwargs": kwargs, "wrappers": _as_lists(self.wrappers)}

    def to_json(self) -> str:
        """Return the id, the arguments and the wrappers as JSON, for ``from_json``."""
        return json.dumps({"id": self.id, "kwargs": self.kwargs, "wrappers": self.stack})

    @staticmethod
    def from_json(json_env_spec: str) -> MadeSpec:
        """Return the specification that ``to_json`` wrote; its id is looked up in the registry."""
        fields = json.loads(json_env_spec)
        wrappers = _as_layers(fields["wrappers"])
        return MadeSpec(kwargs=fields["kwargs"], record=registry().env(fields["id"]), wrappers=wrappers)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return dataclasses.replace(self)


def _as_layer(wrapper: GymnasiumWrapperSpec) -> tuple[str, dict[str, Any]]:
    if wrapper.kwargs is None:
        raise ArgumentError(
            f"{wrapper.name} does not record its arguments, so it cannot be made again; "
            "derive it from gymnasium.utils.RecordConstructorArgs"
        )
    return wrapper.entry_point, dict(wrapper.kwargs)


def _as_layers(listed: Any) -> Any:
    if isinstance(listed, Mapping):
        return {seat: _as_layers(stack) for seat, stack in listed.items()}
    return tuple((name, options) for name, options in listed)


def _as_lists(layers: Any) -> Any:
    if isinstance(layers, Mapping):
        return {seat: _as_lists(stack) for seat, stack in layers.items()}
    return [list(layer) for layer in layers]


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
    # Its arguments; the limit of turns is the task's own where it takes one.
    arguments = {**record.kwargs, **kwargs}
    check_requirements(record, arguments)
    render_mode = arguments.pop("render_mode", None)
    owner = f"environment {record.id!r}"
    maker = load_entry_point(record.entry_point, owner)
    limit = record.max_turns
    if limit is not None and takes_keyword(maker, "max_turns"):
        arguments, limit = {"max_turns": limit, **arguments}, None

    # The task.
    env = call_entry_point(maker, (), arguments, owner)
    if not isinstance(env, gymnasium.Env):
        raise RegistrationError(f"{record.id}: the entry point returned {type(env).__name__}, not an environment")
    try:
        task, as_text = env.unwrapped, False
        if render_mode is not None:
            as_text = _set_render_mode(task, render_mode, record)
            arguments = {**arguments, "render_mode": render_mode}
        task.spec = MadeSpec(kwargs=arguments, record=record)

        # What is around every task; one of several agents has these itself.
        if not isinstance(task, MultiAgentEnv):
            env = Guard(env)
            if limit is not None:
                env = TurnLimit(env, max_turns=limit)
                env.hidden_in_spec = True
            if as_text:
                env = Rendered(env, render_mode)

        # What was asked for.
        for stack in wrappers:
            if stack != ():
                env = wrap(env, stack)
    except BaseException:
        env.close()  # it may have started a server or a container
        raise
    return cast("AnyEnv", env)


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
    """Put wrappers and tools around an environment, innermost first; around each seat, if several agents act.

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
        wrapper = load_entry_point(layer.entry_point, layer.owner)
        env = call_entry_point(wrapper, (env,), layer.options, layer.owner)
        if not isinstance(env, gymnasium.Env):
            raise ArgumentError(f"{layer.owner} returned {type(env).__name__}, not an environment")
        if layer.name is not None and isinstance(env, Wrapper):
            env.registered_as = (layer.name, layer.options)
    return env


def check_choices(record: EnvSpec, kwargs: Mapping[str, Any], *wrappers: Wrappers) -> None:
    """Raise an error for an unknown keyword or option, as ``make_from`` would, before anything is made.

    Raises:
        ArgumentError: A keyword that the environment, or an option that a wrapper or a tool, does not have.
        EntryPointError: What a record points to cannot be imported.
    """
    if kwargs:
        owner = f"environment {record.id!r}"
        arguments = {name: value for name, value in {**record.kwargs, **kwargs}.items() if name != "render_mode"}
        check_arguments(load_entry_point(record.entry_point, owner), (), arguments, owner)
    for stack in wrappers:
        if isinstance(stack, Mapping) and record.seats:
            check_seats(stack, record.seats)
        if stack != ():
            check_options(stack)
