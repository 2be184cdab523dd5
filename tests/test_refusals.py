"""What ``make`` and ``make_vec`` refuse: results that are none, unknown keywords, and what is asked after the end."""

from __future__ import annotations

from typing import Any

import pytest
from vector_envs import INLINE

import gem_core as gem
from gem_core.background import run_sync
from gem_core.errors import ArgumentError, ClosedError, UnknownWrapperError

ODD: dict[str, tuple[Any, str]] = {
    "all": ((None, "bad", False, False, {}), "reward must .* 'bad'"),
    "observation": ((None, 0.0, False, False, {}), "observation must .* NoneType"),
    "reward": (("a", None, False, False, {}), "reward must .* None"),
    "text": (("a", "1", False, False, {}), "reward must .* '1'"),
    "infinite": (("a", float("inf"), False, False, {}), "reward must .* inf"),
    "terminated": (("a", 0.0, "no", False, {}), "terminated must .* 'no'"),
    "truncated": (("a", 0.0, False, None, {}), "truncated must .* None"),
    "info": (("a", 0.0, False, False, None), "info must .* NoneType"),
    "shape": ("abcde", "step must return .* 'abcde'"),
}
"""What an environment returned, by the action, and what is said of it."""


class OddEnv(gem.Env):
    """Returns what it is asked for."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        return "What?", {}

    def step(self, action: str) -> Any:
        return ODD[action][0] if action in ODD else ("a", 1, 0, 1, {})


gem.register("odd:One-v0", OddEnv)


@pytest.mark.parametrize("action", ODD)
def test_a_result_that_is_none_is_refused_by_make_as_by_a_vector_environment(action: str) -> None:
    """With what was wrong of it."""
    env: Any = gem.make("odd:One-v0")
    vector = gem.make_vec("odd:One-v0", 1)
    env.reset(seed=1)
    vector.reset(seed=1)
    with pytest.raises((TypeError, ValueError), match=f"^OddEnv: .*{ODD[action][1]}$") as caught:
        env.step(action)
    with pytest.raises(caught.type):
        run_sync(env.step_async(action))
    told = vector.step([action]).infos[0]["final_info"]["error"]["message"]
    assert told == f"step raised {caught.type.__name__}: {caught.value}"


def test_whole_numbers_serve_as_reward_and_flags() -> None:
    """They mean the same, and are passed on as they are."""
    env = gem.make("odd:One-v0")
    env.reset(seed=1)
    assert env.step("fine") == ("a", 1, 0, 1, {})


@pytest.mark.parametrize("wrappers", ["", "concat", "episode_stats,messages"])
def test_an_action_that_is_no_text_is_refused(wrappers: str) -> None:
    """Before any wrapper has to do with it, in plain code and in coroutines."""
    env: Any = gem.make("odd:One-v0", wrappers=wrappers)
    env.reset(seed=1)
    for call in (lambda: env.step(5), lambda: run_sync(env.step_async(5))):
        with pytest.raises(ArgumentError, match="5 of type int"):
            call()


def test_a_class_that_is_called_as_the_core_s_is_another() -> None:
    """A third party's ToolEnv is a wrapper like any other."""

    class ToolEnv(gem.Wrapper):
        def __init__(self, env: Any, tools: int) -> None:
            super().__init__(env)
            self.number = tools

    env: Any = gem.make("odd:One-v0", wrappers=[(ToolEnv, {"tools": 3})])
    assert (type(env), env.number) == (ToolEnv, 3)


@pytest.mark.parametrize("backend", ["sync", "process"])
def test_a_keyword_that_there_is_not_is_refused(backend: str) -> None:
    """Of an environment, of one of several, and of a wrapper: at the first reset, as by ``make``."""
    for ids, options in (
        ([(INLINE, {"foo": 3}), INLINE], {}),
        (INLINE, {"wrappers": [("concat", {"foo": 3})]}),
        (INLINE, {"wrappers": "concad"}),
    ):
        with pytest.raises((ArgumentError, UnknownWrapperError), match=r"'foo'.* It accepts: |'concad'"):
            gem.make_vec(ids, 2, backend=backend, **options).reset(seed=1)


@pytest.mark.parametrize("backend", ["sync", "async", "process"])
def test_what_is_closed_stays_closed(backend: str) -> None:
    """Whatever is asked afterwards is refused, and closing once more does nothing."""
    vector = gem.make_vec(INLINE, 2, backend=backend)
    vector.reset(seed=1)
    vector.send(["a", "a"])
    vector.close()
    for call in (
        vector.reset,
        lambda: vector.step(["a", "a"]),
        lambda: vector.send({0: "a"}),
        vector.recv,
        lambda: vector.describe(0),
        lambda: run_sync(vector.step_async(["a", "a"])),
        lambda: next(gem.rollout(vector, lambda observation: "a", episodes=1)),
    ):
        with pytest.raises(ClosedError):
            call()
    vector.close()
