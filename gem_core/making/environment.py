"""Make an environment from a record: requirements, entry point, arguments, guard and wrappers."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import Any, Self, cast

import gymnasium

from gem_core.arguments import check_arguments, takes_keyword
from gem_core.env.base import Env
from gem_core.env.guard import Guard
from gem_core.env.multi_agent import MultiAgentEnv
from gem_core.env.seats import SeatWrappers
from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.errors import ArgumentError, RegistrationError
from gem_core.making.layers import Wrappers, asked_for, layers_of
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.requirements import check_requirements
from gem_core.registry.specs import EnvSpec
from gem_core.wrappers.rendering import TEXT_MODES, Rendered
from gem_core.wrappers.turn_limit import TurnLimit

Layers = tuple[tuple[str, dict[str, Any]], ...]
"""Wrappers by name or entry point, each with its options, innermost first."""

_ABSENT = object()


@dataclasses.dataclass
class MadeSpec:
    """What an environment was made from, as its ``spec``: it can be made again, with the same wrappers and arguments.

    Copies share the values of ``kwargs``: data sets are referenced, never copied.

    Args:
        record: What is registered.
        kwargs: The arguments in force.
        wrappers: What was put around the task: names or entry points with their options, innermost first; by seat,
            where several agents differ in them.
        additional_wrappers: Wrappers of Gymnasium's, which record themselves here; they are not made again.
        max_episode_steps: Likewise, of Gymnasium's ``TimeLimit``.
    """

    record: EnvSpec
    kwargs: dict[str, Any]
    wrappers: Layers | Mapping[str, Layers] = ()
    additional_wrappers: tuple[Any, ...] = ()
    max_episode_steps: int | None = None

    @property
    def id(self) -> str:
        """The id by which it was made."""
        return self.record.id

    @property
    def nondeterministic(self) -> bool:
        """What Gymnasium's ``check_env`` reads."""
        return not self.record.deterministic

    def make(self, wrappers: Wrappers = (), **kwargs: Any) -> AnyEnv:
        """Make the same environment again, with some arguments changed and ``wrappers`` around it.

        Raises:
            ArgumentError: There are wrappers of Gymnasium's around it.
        """
        if self.additional_wrappers or self.max_episode_steps is not None:
            raise ArgumentError(f"{self.id} has wrappers of Gymnasium's around it; make env.unwrapped.spec")
        stacks: list[Any] = [self.wrappers, wrappers]
        if not any(isinstance(stack, Mapping) for stack in stacks):  # in one stack, all tools share one wrapper
            stacks = [[*self.wrappers, *([wrappers] if isinstance(wrappers, str) else wrappers)]]
        return make_from(self.record, {**self.kwargs, **kwargs}, *stacks)

    def wrappers_of(self, seat: str) -> Layers:
        """Return the wrappers around one seat, in an environment of several agents."""
        return self.wrappers.get(seat, ()) if isinstance(self.wrappers, Mapping) else self.wrappers

    def with_wrapper(self, name: str, options: Mapping[str, Any]) -> Self:
        """Return a copy with one more wrapper outside."""
        return dataclasses.replace(self, wrappers=(*self.wrappers, (name, dict(options))))

    def recorded(self) -> dict[str, Any]:
        """Return ``id``, ``kwargs`` over the registered ones and ``wrappers``, as the record of an episode has them.

        They are what ``make`` takes, as lists and dictionaries: written as JSON, they make the same environment.
        """
        limit = {} if self.record.max_turns is None else {"max_turns": self.record.max_turns}
        registered = {**limit, **self.record.kwargs}
        kwargs = {name: value for name, value in self.kwargs.items() if registered.get(name, _ABSENT) is not value}
        return {"id": self.id, "kwargs": kwargs, "wrappers": _as_lists(self.wrappers)}

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return dataclasses.replace(self)


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
    # Its arguments; the limit of turns is the task's own if it takes one.
    arguments = {**record.kwargs, **kwargs}
    check_requirements(record, arguments)
    render_mode = arguments.pop("render_mode", None)
    owner = f"environment {record.id!r}"
    maker = load_entry_point(record.entry_point, owner)
    limit = record.max_turns
    if limit is not None and takes_keyword(maker, "max_turns"):
        arguments, limit = {"max_turns": limit, **arguments}, None

    # The task.
    check_arguments(maker, (), arguments, owner)
    env = maker(**arguments)
    if not isinstance(env, gymnasium.Env):
        raise RegistrationError(f"{record.id}: the entry point returned {type(env).__name__}, not an environment")
    try:
        task: Any = env.unwrapped
        as_text = False
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
        raise ArgumentError(f"{record.id}: no render mode {render_mode!r}; it offers {', '.join(map(repr, modes))}")
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
        around = {seat: partial(wrap, wrappers=stack) for seat, stack in by_seat.items() if asked_for(stack)}
        return SeatWrappers(env, around) if around else env
    if isinstance(wrappers, Mapping):
        seats = ", ".join(map(repr, wrappers))
        raise ArgumentError(f"wrappers by seat ({seats}) are for several agents, and {env.unwrapped} has one")
    for layer in layers_of(wrappers):
        wrapper = load_entry_point(layer.entry_point, layer.owner)
        check_arguments(wrapper, (env,), layer.options, layer.owner)
        env = wrapper(env, **layer.options)
        if not isinstance(env, gymnasium.Env):
            raise ArgumentError(f"{layer.owner} returned {type(env).__name__}, not an environment")
        if layer.record is not None and isinstance(env, Wrapper):
            env.registered_as = (layer.record.name, layer.options)
    return env
