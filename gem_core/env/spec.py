"""``EnvRecipe``: the ``spec`` of an environment: the record, arguments and wrappers that it was made from."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from typing import Any, Self, cast

from gymnasium.envs.registration import EnvSpec as GymnasiumSpec
from gymnasium.envs.registration import WrapperSpec as GymnasiumWrapperSpec

from gem_core.errors import ArgumentError
from gem_core.registry.specs import EnvSpec

_ABSENT = object()

Layers = tuple[tuple[str, dict[str, Any]], ...]
"""Wrappers by name or entry point, each with its options, innermost first."""

SeatLayers = Mapping[str, Layers]
"""Wrappers by seat, where several agents differ in them."""


@dataclasses.dataclass
class EnvRecipe(GymnasiumSpec):
    """The record, the arguments and the wrappers of an environment that was made.

    ``kwargs`` holds the arguments in force, ``record`` our own record, ``wrappers`` what was put around the task.
    Copies share the values of ``kwargs``: data sets are referenced, never copied. ``gem_core.making`` adds ``make``.
    """

    record: EnvSpec | None = None
    wrappers: Layers | SeatLayers = ()

    def __post_init__(self) -> None:
        # Gymnasium's own would parse the id in its syntax, which has no variants.
        record = cast("EnvSpec", self.record)
        self.namespace, self.name, self.version = record.namespace, record.name, record.version

    @property
    def stack(self) -> Layers | SeatLayers:
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

    def listed_wrappers(self) -> list[Any] | dict[str, list[Any]]:
        """Return the wrappers as lists, as the record of an episode holds them."""
        if isinstance(self.wrappers, Mapping):
            return {seat: [list(layer) for layer in layers] for seat, layers in self.wrappers.items()}
        return [list(layer) for layer in self.wrappers]

    def overrides(self) -> dict[str, Any]:
        """Return the keyword arguments that differ from the registered ones."""
        record = cast("EnvSpec", self.record)
        limit = {} if record.max_turns is None else {"max_turns": record.max_turns}
        registered = {**limit, **record.kwargs}
        return {name: value for name, value in self.kwargs.items() if registered.get(name, _ABSENT) is not value}

    def with_kwargs(self, overrides: Mapping[str, Any]) -> Self:
        """Return a copy whose keyword arguments are changed."""
        return dataclasses.replace(self, kwargs={**self.kwargs, **overrides}) if overrides else self

    def with_wrapper(self, name: str, options: Mapping[str, Any]) -> Self:
        """Return a copy with one more wrapper outside."""
        stack = cast("Layers", self.stack)
        return dataclasses.replace(
            self, wrappers=(*stack, (name, dict(options))), additional_wrappers=(), max_episode_steps=None
        )

    def to_json(self) -> str:
        """Return the id, the arguments and the wrappers as JSON, for ``from_json``."""
        return json.dumps({"id": self.id, "kwargs": self.kwargs, "wrappers": self.stack})

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return dataclasses.replace(self)


def _as_layer(wrapper: GymnasiumWrapperSpec) -> tuple[str, dict[str, Any]]:
    if wrapper.kwargs is None:
        raise ArgumentError(
            f"{wrapper.name} does not record its arguments, so it cannot be made again; "
            "derive it from gymnasium.utils.RecordConstructorArgs"
        )
    return wrapper.entry_point, dict(wrapper.kwargs)
