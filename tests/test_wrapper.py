"""``Wrapper``: hooks, plain and asynchronous, and what a stack of wrappers passes on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import gymnasium
import pytest
from echo_env import TRACE, AsyncEchoEnv, AsyncNoting, EchoEnv, Noting, ShortCut, ThreadEchoEnv, ThreadNoting
from gymnasium import wrappers as gym_wrappers
from hypothesis import given
from hypothesis import strategies as st

import gem_core as gem
from gem_core.background import background_loop
from gem_core.env.guard import Guard
from gem_core.env.wrapper import Wrapper, concurrency_of, step_async
from gem_core.errors import ArgumentError, BridgeError, ResetNeededError
from gem_core.making.again import Recipe
from gem_core.registry import lookup as registry
from gem_core.wrappers.episode_stats import EpisodeStats
from gem_core.wrappers.turn_limit import TurnLimit


@pytest.fixture(autouse=True)
def echo_env(own_registry: registry.Registry) -> None:
    """The core's records and one environment, and an empty trace."""
    gem.register("test:Echo-v0", EchoEnv)
    TRACE.clear()


def on_own_loop(coroutine: Coroutine[Any, Any, Any]) -> Any:
    """Run a coroutine on a loop that is not the library's."""
    return asyncio.run(coroutine)


def on_library_loop(coroutine: Coroutine[Any, Any, Any]) -> Any:
    """Run a coroutine on the library's loop."""
    return asyncio.run_coroutine_threadsafe(coroutine, background_loop()).result(30)


LOOPS = [on_own_loop, on_library_loop]
WAYS = [None, on_own_loop]
"""Plain code, and coroutines."""

# Hooks.


def test_hooks_run_from_outside_in_and_back() -> None:
    """Before-hooks run outermost first, after-hooks innermost first, and after_step sees the agent's own action."""
    env = Noting(Noting(EchoEnv(), "a"), "b")
    assert env.reset(seed=3) == ("helloab", {})
    assert env.step("x")[0] == "xba1ab"
    assert TRACE == [
        ("b", "before_reset", 3, None),
        ("a", "before_reset", 3, None),
        ("reset", 3, None),
        ("a", "after_reset"),
        ("b", "after_reset"),
        ("b", "before_step", "x"),
        ("a", "before_step", "xb"),
        ("step", "xba"),
        ("a", "after_step", "xb"),
        ("b", "after_step", "x"),
    ]


def trace_of(play: Callable[[], Any]) -> tuple[Any, list[Any]]:
    """Return the results of a call, durations apart, and what was written meanwhile."""
    TRACE.clear()
    results = play()
    for result in results:
        result[-1].get("episode", {}).pop("t", None)
    return results, list(TRACE)


STACKS = st.lists(st.sampled_from([Noting, ThreadNoting, AsyncNoting, ShortCut, EpisodeStats, TurnLimit]), max_size=4)


@given(
    st.sampled_from([EchoEnv, ThreadEchoEnv, AsyncEchoEnv]),
    STACKS,
    st.lists(st.sampled_from(["x", "stop", ""]), max_size=2),
    st.sampled_from([None, {"index": 1}]),
    st.sampled_from(LOOPS),
)
def test_plain_and_asynchronous_code_do_the_same(
    task: type[Any], stack: list[Any], actions: list[str], options: Any, run: Any
) -> None:
    """Any stack gives the same results and calls the same hooks, whichever way and on whichever loop it is run."""

    def make() -> Any:
        env = Guard(task())
        for number, wrapper in enumerate(stack):
            extra = {TurnLimit: (5,)}.get(wrapper, (str(number),) if issubclass(wrapper, Noting) else ())
            env = wrapper(env, *extra)
        return env

    def plain() -> Any:
        env = make()
        return [env.reset(7, options), *(env.step(action) for action in actions)]

    async def asynchronous() -> Any:
        env = make()
        return [await env.reset_async(7, options), *[await env.step_async(action) for action in actions]]

    assert trace_of(plain) == trace_of(lambda: run(asynchronous()))


def test_before_step_may_answer_itself() -> None:
    """A whole result from before_step goes out at once: neither the task nor the same wrapper's after_step sees it."""
    env = Noting(ShortCut(Noting(EchoEnv(), "a")), "b")
    env.reset()
    TRACE.clear()
    assert env.step("stop") == ("stoppedb", -1.0, False, True, {})
    assert TRACE == [("b", "before_step", "stop"), ("b", "after_step", "stop")]


@pytest.mark.parametrize("run", LOOPS)
def test_wrapper_in_the_style_of_gymnasium_works_in_coroutines(run: Any) -> None:
    """A wrapper that overrides step instead of the hooks does the same in asynchronous code."""

    class OwnStep(Wrapper):
        def step(self, action: str) -> Any:
            return ("own", *self.env.step(action)[1:])

    class Heir(OwnStep):
        def after_reset(self, result: Any) -> Any:
            return "heir", result[1]

    env = Heir(Guard(AsyncEchoEnv()))
    assert run(env.reset_async(1))[0] == "heir"
    assert run(env.step_async("x"))[0] == env.step("x")[0] == "own"


@pytest.mark.parametrize("hook", ["after_reset", "before_step", "after_step"])
@pytest.mark.parametrize("run", WAYS)
def test_hook_that_forgot_its_return_is_named(hook: str, run: Any) -> None:
    """A hook that returns None gives a TypeError with the name of wrapper and hook."""
    forgetful: Any = type("Forgetful", (Wrapper,), {hook: lambda self, *args: None})
    env = forgetful(EchoEnv())

    def play() -> None:
        for plain, coroutine in ((env.reset, env.reset_async), (lambda: env.step("x"), lambda: env.step_async("x"))):
            run(coroutine()) if run else plain()

    with pytest.raises(TypeError, match=rf"Forgetful\.{hook} .*None"):
        play()


class ShortReset(EchoEnv):
    """Knows no options, as a newcomer writes it."""

    def reset(self, seed: int | None = None) -> Any:  # type: ignore[override]
        return super().reset(seed)


class KeywordReset(ThreadEchoEnv):
    """Has Gymnasium's own signature."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:  # type: ignore[override]
        return super().reset(seed, options)


class KeywordWrapper(Wrapper):
    """Likewise."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:  # type: ignore[override]
        return self.env.reset(seed=seed, options=options)


@pytest.mark.parametrize("task", [ShortReset, KeywordReset])
@pytest.mark.parametrize("outer", [gym_wrappers.OrderEnforcing, KeywordWrapper])
def test_reset_of_an_author_is_reached(task: Any, outer: Any) -> None:
    """Without options, or by keywords alone, from plain code and coroutines, under wrappers of both kinds."""
    env = Noting(outer(Noting(Guard(task()))))
    assert env.reset(seed=1) == asyncio.run(env.reset_async(1)) == ("helloaa", {"seed": 1})


# The library's loop.


def test_coroutines_of_an_environment_always_run_on_one_loop() -> None:
    """From plain code and from any loop; plain code on the library's own is told to await instead."""
    env: Any = Guard(AsyncEchoEnv())
    env.reset()
    assert env.loop is background_loop()
    assert asyncio.run(env.step_async("x"))[0] == "x1"
    assert on_library_loop(env.step_async("z"))[0] == "z2"

    async def main() -> None:
        env.step("x")

    with pytest.raises(BridgeError, match="step_async"):
        on_library_loop(main())


@pytest.mark.parametrize("task", [EchoEnv, ThreadEchoEnv, AsyncEchoEnv])
def test_wrapper_of_gymnasium_is_stepped_from_a_coroutine(task: Any) -> None:
    """A stack with a wrapper of Gymnasium's on top is stepped without blocking."""
    env = gym_wrappers.TimeLimit(Guard(task()), 5)
    env.reset()
    assert asyncio.run(step_async(env, "x"))[0] == "x1"


# Concurrency.


@pytest.mark.parametrize(
    ("make", "needs"),
    [
        (lambda: Noting(EchoEnv()), "inline"),
        (lambda: Noting(ThreadEchoEnv()), "thread"),
        (lambda: ThreadNoting(AsyncEchoEnv()), "async"),
        (lambda: AsyncNoting(EchoEnv()), "async"),
        (lambda: Noting(gym_wrappers.OrderEnforcing(ThreadNoting(EchoEnv()))), "thread"),
    ],
)
def test_concurrency_is_what_the_whole_stack_needs(make: Any, needs: str) -> None:
    """The most demanding part of a stack decides; hooks that are coroutines need a loop."""
    assert concurrency_of(make()) == needs


# Attributes.


def test_public_attributes_are_read_from_the_inside() -> None:
    """Anew each time, and no private ones; what nothing in the stack has is an error of the innermost class."""
    env: Any = Noting(gym_wrappers.OrderEnforcing(Guard(EchoEnv())))
    assert env.turns == 99
    env.unwrapped.turns = 3
    env.unwrapped._secret = 1
    assert env.turns == 3
    with pytest.raises(AttributeError, match=r"'EchoEnv' .* 'trun'"):
        _ = Noting(Guard(EchoEnv())).trun
    with pytest.raises(AttributeError, match=r"'Noting' .* '_secret'"):
        _ = env._secret


def test_failing_property_of_a_wrapper_shows_its_own_error() -> None:
    """An AttributeError inside a wrapper's property is not covered by the task's attribute of that name."""
    failing: Any = type("Failing", (Wrapper,), {"turns": property(lambda self: self.env.no_such_name)})
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = failing(EchoEnv()).turns


# Specification.


def test_specification_lists_wrappers() -> None:
    """In order, with their options; one put by hand by its place and arguments; make's own guard is not among them."""
    env = gem.make("test:Echo-v0", wrappers=["episode_stats", ("turn_limit", {"max_turns": 3})])
    listed = (("episode_stats", {}), ("turn_limit", {"max_turns": 3}))
    assert env.spec.wrappers == listed  # type: ignore[union-attr]
    for put in Noting(env, "q"), Noting(env, mark="q"), Noting(env=env, mark="q"):
        assert put.spec.wrappers == (*listed, ("echo_env:Noting", {"mark": "q"}))
    assert Noting(EchoEnv()).spec is None


# Another one.


class Unrecorded(gymnasium.Wrapper):
    """Does not record its arguments."""


@pytest.mark.parametrize("put", [lambda env: Noting(env, "q"), lambda env: Noting(env=env, mark="q")])
@pytest.mark.parametrize("task", [EchoEnv(3), EchoEnv(turns=3)])
def test_whole_stack_is_made_again(put: Any, task: EchoEnv) -> None:
    """With the wrappers' arguments, Gymnasium's too; overrides reach the task, given by position or keyword."""
    env = put(gym_wrappers.OrderEnforcing(TurnLimit(Guard(task), 4)))
    other: Any = Recipe.of(env).make(turns=2)
    assert str(other) == str(env)
    assert (other.mark, other.max_turns, other.turns, env.turns) == ("q", 4, 2, 3)
    assert other.unwrapped is not env.unwrapped
    with pytest.raises(ArgumentError, match="Unrecorded"):
        Recipe.of(Noting(Unrecorded(EchoEnv())))


# The guard.


@pytest.mark.parametrize("run", WAYS)
def test_guard_refuses_steps_outside_an_episode(run: Any) -> None:
    """After its end, and where a reset failed, in plain and asynchronous code."""

    class Failing(EchoEnv):
        def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
            if seed == 13:
                raise ValueError("unlucky")
            return super().reset(seed, options)

    def step() -> Any:
        return run(env.step_async("x")) if run else env.step("x")

    env = Guard(Failing(turns=1))
    env.reset(seed=1)
    with pytest.raises(ValueError, match="unlucky"):
        run(env.reset_async(13)) if run else env.reset(13)
    with pytest.raises(ResetNeededError):
        step()
    env.reset(seed=1)
    step()
    with pytest.raises(ResetNeededError):
        step()
