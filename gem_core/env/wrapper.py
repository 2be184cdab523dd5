"""``Wrapper``: the base class of wrappers, written once for plain and asynchronous code."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Awaitable
from typing import Any, cast

import gymnasium

from gem_core.arguments import RemembersArguments, signature_of
from gem_core.background import in_thread, on_library_loop, run_sync
from gem_core.docs import page_url
from gem_core.env.base import AsyncEnv, Env, reset_arguments
from gem_core.env.checks import refuse_action
from gem_core.env.multi_agent import MultiAgentEnv
from gem_core.errors import ArgumentError
from gem_core.types import Concurrency, ResetResult, StepResult

AnyEnv = gymnasium.Env[Any, str]
"""An ``Env``, a ``Wrapper``, or a wrapper of Gymnasium's around either."""

_RANK: dict[Concurrency, int] = {"inline": 0, "thread": 1, "async": 2, "process": 3}


class Wrapper(RemembersArguments, gymnasium.Wrapper[Any, str, Any, str]):
    """Changes an environment by hooks before and after its methods.

    A subclass overrides the hooks that it needs; ``reset``, ``step``, ``reset_async`` and ``step_async`` are made from
    them. A hook may be a coroutine function: it always runs on the library's event loop, where plain code waits for it.

    Public attributes that a wrapper does not have are read from the environment inside, so they are never stale.
    """

    needs: Concurrency = "inline"
    """What the hooks themselves need; ``"thread"`` when they block. See ``Env.concurrency``."""

    hidden_in_spec = False
    """Whether ``make`` puts it there by itself, so that ``spec`` does not list it."""

    env: AnyEnv
    registered_as: tuple[str, dict[str, Any]] | None = None
    """The name by which ``make`` put it there, with its options."""

    _plain_only = False

    def __init__(self, env: AnyEnv) -> None:
        if isinstance(env, MultiAgentEnv) and type(self).step is Wrapper.step:  # its hooks take one agent's results
            example = f"make(id, wrappers={{{next(iter(env.possible_agents), 'seat')!r}: [{type(self).__name__}]}})"
            page = page_url("several-agents/#wrappers-around-seats")
            raise ArgumentError(f"{type(self).__name__} goes around a seat, as in {example}. See {page}")
        super().__init__(env)

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Record whether a subclass overrides ``reset`` or ``step`` itself, as in Gymnasium."""
        super().__init_subclass__(**kwargs)
        own = vars(cls)
        if "_plain_only" not in own and not {"reset_async", "step_async"} & own.keys():
            cls._plain_only = cls._plain_only or bool({"reset", "step"} & own.keys())

    # The hooks.

    def before_reset(self, seed: int | None, options: dict[str, Any] | None) -> Awaitable[None] | None:
        """Run before the environment is reset; release what belongs to the episode that is over."""
        return None

    def after_reset(self, result: ResetResult) -> ResetResult | Awaitable[ResetResult]:
        """Return the observation and info of a reset, changed as wanted."""
        return result

    def before_step(self, action: str) -> str | StepResult | Awaitable[str | StepResult]:
        """Return the action for the environment, or a whole result instead of a step."""
        return action

    def after_step(self, action: str, result: StepResult) -> StepResult | Awaitable[StepResult]:
        """Return the environment's result, changed as wanted; ``action`` is what the agent gave, to the letter."""
        return result

    # The methods made from them.

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Begin an episode; see ``Env.reset``."""
        before = self.before_reset(seed, options)
        if before is not None:
            run_sync(self._coroutine("before_reset", before))
        after = self.after_reset(self.env.reset(**reset_arguments(seed, options)))
        return after if isinstance(after, tuple) else run_sync(self._coroutine("after_reset", after))

    def step(self, action: str) -> StepResult:
        """Answer one response of the agent; see ``Env.step``."""
        if not isinstance(action, str):
            refuse_action(action)
        before = self.before_step(action)
        if not isinstance(before, str | tuple):
            before = run_sync(self._coroutine("before_step", before))
        if isinstance(before, tuple):
            return before
        after = self.after_step(action, cast("StepResult", self.env.step(before)))
        return after if isinstance(after, tuple) else run_sync(self._coroutine("after_step", after))

    async def reset_async(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """``reset`` for code that runs in an event loop, without blocking it."""
        if self._plain_only:
            return await in_thread(lambda: self.reset(**reset_arguments(seed, options)))
        await self.run_hook("before_reset", seed, options)
        return cast("ResetResult", await self.run_hook("after_reset", await reset_async(self.env, seed, options)))

    async def step_async(self, action: str) -> StepResult:
        """``step`` for code that runs in an event loop, without blocking it."""
        if self._plain_only:
            # Its coroutines would go around what it overrides, so its plain methods are run, off the loop.
            return await in_thread(self.step, action)
        if not isinstance(action, str):
            refuse_action(action)
        before = await self.run_hook("before_step", action)
        if isinstance(before, tuple):
            return before
        return cast("StepResult", await self.run_hook("after_step", action, await step_async(self.env, before)))

    async def run_hook(self, name: str, *args: Any) -> Any:
        """Return what a hook returns, a coroutine's result included, without blocking the event loop.

        Args:
            name: Of the hook, as ``"before_step"``.
            *args: What it takes.
        """
        hook = getattr(self, name)
        in_place = self.needs in ("inline", "async") or inspect.iscoroutinefunction(hook)
        value = hook(*args) if in_place else await in_thread(hook, *args)
        if isinstance(value, str | tuple) or (value is None and name == "before_reset"):
            return value
        return await on_library_loop(self._coroutine(name, value))

    def _coroutine(self, hook: str, value: Any) -> Awaitable[Any]:
        if inspect.isawaitable(value):
            return value
        raise TypeError(f"{type(self).__name__}.{hook} returned {value!r}; see Wrapper.{hook}")

    # Passed on to the environment inside.

    @property
    def concurrency(self) -> Concurrency:
        """What the whole stack needs, this wrapper and all inside it; coroutine hooks need ``"async"``."""
        hooks = [self.before_reset, self.after_reset, self.before_step, self.after_step]
        own: Concurrency = "async" if any(map(inspect.iscoroutinefunction, hooks)) else "inline"
        return most_demanding(own, self.needs, concurrency_of(self.env))

    @property
    def spec(self) -> Any:  # type: ignore[override]  # Gymnasium has a property, too
        """The ``MadeSpec`` of the environment, this wrapper included; None for one that ``make`` did not make."""
        inner: Any = self.env.spec
        if inner is None or self.hidden_in_spec:
            return inner
        return inner.with_wrapper(*(self.registered_as or self._own_record()))

    def _own_record(self) -> tuple[str, dict[str, Any]]:
        args, kwargs = self._init_args
        signature = signature_of(type(self))
        names = list(signature.parameters) if signature else []
        options = {**dict(zip(names, args, strict=False)), **kwargs}
        options.pop(names[0] if names else "", None)  # the environment
        return f"{type(self).__module__}:{type(self).__qualname__}", options

    def __getattr__(self, name: str) -> Any:
        # Only names that the wrapper does not have come here. Private ones are never passed on, so that copying and
        # pickling a half-made wrapper cannot recurse.
        if name.startswith("_") or name == "env":
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        if hasattr(type(self), name):
            # A property of this wrapper failed with an AttributeError of its own: show that one, and never let the
            # environment's attribute stand in for it.
            return object.__getattribute__(self, name)
        inner = self.env
        return getattr(inner, name) if isinstance(inner, Env | Wrapper) else inner.get_wrapper_attr(name)


def concurrency_of(env: AnyEnv) -> Concurrency:
    """Return what an environment and all its wrappers need, those of Gymnasium included.

    Raises:
        ArgumentError: It is another environment of Gymnasium, and none of GEM.
    """
    if isinstance(env, Env | Wrapper):
        return env.concurrency
    try:
        return cast("Concurrency", env.get_wrapper_attr("concurrency"))
    except AttributeError:
        name = type(env.unwrapped).__name__
        raise ArgumentError(f"{name} is not an environment of GEM; derive its class from gem_core.Env") from None


def most_demanding(*needs: Concurrency) -> Concurrency:
    """Return the concurrency of what consists of several parts."""
    return max(needs, key=_RANK.__getitem__)


async def reset_async(env: AnyEnv, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
    """Reset any environment from a coroutine without blocking its loop."""
    if isinstance(env, Env | Wrapper):
        coroutine = env.reset_async(**reset_arguments(seed, options))
        return await (on_library_loop(coroutine) if isinstance(env, AsyncEnv) else coroutine)
    reset = functools.partial(env.reset, seed=seed, options=options)
    return cast("ResetResult", reset() if concurrency_of(env) == "inline" else await in_thread(reset))


async def step_async(env: AnyEnv, action: str) -> StepResult:
    """Step any environment from a coroutine without blocking its loop."""
    if isinstance(env, Env | Wrapper):
        coroutine = env.step_async(action)
        return await (on_library_loop(coroutine) if isinstance(env, AsyncEnv) else coroutine)
    result = env.step(action) if concurrency_of(env) == "inline" else await in_thread(env.step, action)
    return cast("StepResult", result)
