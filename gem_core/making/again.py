"""``Recipe``: makes an environment again from the arguments of its constructors."""

from __future__ import annotations

import dataclasses
from typing import Any, Self

import gymnasium
from gymnasium.utils import RecordConstructorArgs

from gem_core.arguments import RemembersArguments, check_arguments, signature_of
from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.errors import ArgumentError


@dataclasses.dataclass(frozen=True)
class Recipe:
    """The classes and arguments of an environment and its wrappers, made by ``make`` or by hand.

    Args:
        kind: The class of the outermost wrapper, or of the task.
        args: Its positional arguments, with a recipe in place of an environment; other values, such as rows, are
            shared.
        kwargs: Its keyword arguments, likewise.
        layer: Attributes of a wrapper that ``make`` has set.
        spec: What ``make`` made the task from.
        render_mode: The task's.
    """

    kind: type[AnyEnv]
    args: tuple[Any, ...]
    kwargs: dict[str, Any]
    layer: dict[str, Any]
    spec: Any
    render_mode: str | None

    @classmethod
    def of(cls, env: AnyEnv) -> Self:
        """Return the recipe of an environment.

        Raises:
            ArgumentError: A wrapper of Gymnasium's does not record its arguments.
        """
        if isinstance(env, RemembersArguments):
            args, kwargs = env._init_args
        elif isinstance(env, gymnasium.Wrapper) and isinstance(env, RecordConstructorArgs):
            args, kwargs = (env.env,), env._saved_kwargs
        else:
            raise ArgumentError(
                f"{type(env).__name__} does not record its arguments, so it cannot be made again; derive a wrapper "
                "from gymnasium.utils.RecordConstructorArgs, and an environment from gem_core.Env"
            )

        def of(value: Any) -> Any:
            return cls.of(value) if isinstance(value, gymnasium.Env) else value

        task = env.unwrapped
        layer = {name: getattr(env, name) for name in ("registered_as", "hidden_in_spec") if isinstance(env, Wrapper)}
        own_args, own_kwargs = tuple(map(of, args)), {name: of(value) for name, value in kwargs.items()}
        return cls(type(env), own_args, own_kwargs, layer, task.spec, task.render_mode)

    def make(self, **overrides: Any) -> AnyEnv:
        """Make the environment.

        Args:
            **overrides: Keyword arguments of the task to change.

        Raises:
            ArgumentError: The task does not take one of them; the message names those it takes.
        """

        def made_of(value: Any) -> Any:
            return value.make(**overrides) if isinstance(value, Recipe) else value

        args, kwargs = self.args, self.kwargs
        if any(isinstance(value, Recipe) for value in (*args, *kwargs.values())):
            args, kwargs = tuple(map(made_of, args)), {name: made_of(value) for name, value in kwargs.items()}
        elif overrides:
            signature = signature_of(self.kind)
            by_position = dict(zip(signature.parameters if signature else (), args, strict=False))
            args, kwargs = (), {**by_position, **kwargs, **overrides}
            check_arguments(self.kind, (), kwargs, f"environment {self.spec.id if self.spec else self.kind.__name__!r}")
        env = self.kind(*args, **kwargs)
        for name, value in self.layer.items():
            setattr(env, name, value)
        task = env.unwrapped
        if task.spec is None and self.spec is not None:
            task.spec = dataclasses.replace(self.spec, kwargs={**self.spec.kwargs, **overrides})
            if task.render_mode != self.render_mode:
                task.render_mode = self.render_mode
        return env
