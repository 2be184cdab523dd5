"""``VectorAttributes``: what Gymnasium's users reach for in a vector environment, the same in every backend."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import gymnasium
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from gem_core.env.wrapper import AnyEnv
from gem_core.errors import ArgumentError, EnvFaultError, GemError
from gem_core.vector.failures import Failure

if TYPE_CHECKING:
    from gem_core.making.environment import MadeSpec
    from gem_core.vector.setup import Autoreset
    from gem_core.vector.slot import Slot, VectorConfig

_OWN_METHODS = ("close", "reset", "reset_async", "step", "step_async")


class VectorAttributes:
    """Attributes and methods of the environments in the slots; the base of ``VectorEnv``.

    They make an environment if a slot has none yet, and need slots that are not under way. In a worker process a
    value is a copy, and has to be one that can be pickled.

    Source: ``VectorEnv`` of Gymnasium, https://gymnasium.farama.org/api/vector/.
    """

    ids: list[str | None]
    """The id of each slot's own environment."""

    _closed: bool
    config: VectorConfig
    slots: list[Slot]

    if TYPE_CHECKING:
        # As VectorEnv defines them.
        def _check_open(self) -> None: ...
        def _refuse_busy(self, indices: Iterable[int]) -> None: ...
        def _asked(self, slot: Slot, target: None, function: Callable[..., Any], *args: Any) -> Any: ...

    @property
    def num_envs(self) -> int:
        """Number of slots."""
        return len(self.ids)

    @property
    def autoreset(self) -> Autoreset:
        """When the next episode begins; see ``make_vec``."""
        return self.config.autoreset

    @property
    def closed(self) -> bool:
        """Whether ``close`` was called."""
        return self._closed

    @property
    def metadata(self) -> dict[str, Any]:
        """Metadata of the first slot's environment, and ``autoreset_mode`` as Gymnasium names it."""
        return {**self._first("metadata"), "autoreset_mode": AutoresetMode[self.autoreset.upper()]}

    @property
    def render_mode(self) -> str | None:
        """Render mode of the first slot's environment."""
        return cast("str | None", self._first("render_mode"))

    @property
    def spec(self) -> MadeSpec | None:
        """The spec of the first slot's environment; its ``make`` makes another."""
        return cast("MadeSpec | None", self._first("spec"))

    @property
    def single_observation_space(self) -> spaces.Space[Any]:
        """Space of one slot's observations: the first slot's, if they differ; by agent, if several act."""
        return cast("spaces.Space[Any]", self._first("observation_space", _space))

    @property
    def single_action_space(self) -> spaces.Space[Any]:
        """Space of one slot's actions: the first slot's, if they differ; by agent, if several act."""
        return cast("spaces.Space[Any]", self._first("action_space", _space))

    @property
    def observation_space(self) -> spaces.Tuple[Any]:
        """Spaces of all slots' observations."""
        return spaces.Tuple(self._ask_all(_space, "observation_space"))

    @property
    def action_space(self) -> spaces.Tuple[Any]:
        """Spaces of all slots' actions; ``sample`` draws any text. ``sample_random_action`` draws valid actions."""
        return spaces.Tuple(self._ask_all(_space, "action_space"))

    def render(self) -> tuple[Any, ...]:
        """Return what ``render`` of each slot's environment returns: texts in the mode ``"ansi"``."""
        return self.call("render")

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of every slot's environment, or read an attribute that cannot be called.

        Args:
            name: Of the method; a wrapper's goes before the task's.
            *args: Arguments for it.
            **kwargs: Keyword arguments for it.

        Returns:
            The results, in the order of the slots.

        Raises:
            ArgumentError: It is ``reset``, ``step`` or ``close``, which this class itself has; an environment has
                nothing of this name; or a slot is under way.
            EnvFaultError: The method raised something; the environment goes on.
        """
        if name in _OWN_METHODS:
            raise ArgumentError(f"call({name!r}) would go past the vector environment; use its own {name}()")
        return self._ask_all(_call, name, args, kwargs)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute of every slot's environment, in the order of the slots.

        Raises:
            ArgumentError: An environment has no such attribute, or a slot is under way.
        """
        return self._ask_all(_get, name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of every slot's environment, until the environment is replaced.

        A plan that asks for another environment replaces it, and so does a fault. What every environment shall have is
        a keyword argument of ``make_vec``.

        Args:
            name: Name of the attribute; it is set on the task if no wrapper has it.
            values: A list or tuple with one for each slot; or one value for all.

        Raises:
            ArgumentError: The number of values is not the number of slots, or a slot is under way.
        """
        each = values if isinstance(values, list | tuple) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise ArgumentError(f"set_attr({name!r}) takes {self.num_envs} values, one for each slot, not {len(each)}")
        self._ask_all(_set, name, each)

    def _first(self, name: str, function: Callable[..., Any] | None = None) -> Any:
        return self._ask([0], function or _get, name)[0]

    def _ask_all(self, function: Callable[..., Any], *args: Any) -> tuple[Any, ...]:
        return self._ask(range(self.num_envs), function, *args)

    def _ask(self, indices: Sequence[int], function: Callable[..., Any], *args: Any) -> tuple[Any, ...]:
        """Apply a function to the environments of some slots, each in its own process."""
        self._check_open()
        self._refuse_busy(indices)
        return tuple(self._asked(self.slots[index], None, _apply, index, function, *args) for index in indices)


# Applied to an environment in its own process.


def _apply(env: AnyEnv, slot: int, function: Callable[..., Any], name: str, *args: Any) -> Any:
    try:
        return function(env, slot, name, *args)
    except GemError:
        raise
    except Exception as error:
        raise EnvFaultError(f"slot {slot}: {Failure.of(error, name).message}") from error


def _get(env: AnyEnv, slot: int, name: str) -> Any:
    try:
        return env.get_wrapper_attr(name)
    except AttributeError:
        raise ArgumentError(f"slot {slot}: {type(env.unwrapped).__name__} has no attribute {name!r}") from None


def _space(env: AnyEnv, slot: int, name: str) -> spaces.Space[Any]:
    found = _get(env, slot, name)
    if isinstance(found, spaces.Space):
        return found
    return spaces.Dict({agent: found(agent) for agent in _get(env, slot, "possible_agents")})


def _call(env: AnyEnv, slot: int, name: str, args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> Any:
    found = _get(env, slot, name)
    return found(*args, **kwargs) if callable(found) else found


def _set(env: AnyEnv, slot: int, name: str, values: list[Any]) -> None:
    # Not by Gymnasium's set_wrapper_attr, which takes what our wrappers pass on from inside for their own.
    layer: Any = env
    while isinstance(layer, gymnasium.Wrapper) and name not in vars(layer) and not hasattr(type(layer), name):
        layer = layer.env
    setattr(layer, name, values[slot])
