"""``fork``: an independent copy in the same state, of tasks, wrappers, tools and several agents."""

from __future__ import annotations

import pickle
import threading
from typing import Any

import pytest
from guess_env import GuessEnv
from toys import Notebook

import gem_core as gem
from gem_core.errors import StateNotSupported
from gem_core.wrappers import Concat, EpisodeStats


def rest(env: Any) -> list[Any]:
    """Play on, and begin the next episode; durations apart."""
    results = [env.step("0") for _ in range(4)] + [env.reset(), env.step("0")]
    for result in results:
        result[-1].get("episode", {}).pop("t", None)
    return results


@pytest.mark.parametrize("copied", [lambda env: env.fork(), lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("make", [GuessEnv, lambda: EpisodeStats(Concat(GuessEnv(high=10**9)))])
def test_fork_goes_on_as_the_first_one(copied: Any, make: Any) -> None:
    """Through wrappers, with the generators of the task and of actions, and into the next episode; so by pickle."""
    env = make()
    env.reset(seed=3)
    early = copied(env)  # before a generator has started
    assert early.step("0") == env.step("0")
    env.sample_random_action()
    other = copied(env)
    assert type(other) is type(env)
    assert other.sample_random_action() == env.sample_random_action()
    assert rest(env) == rest(other)
    assert other.unwrapped is not env.unwrapped


def test_stepping_a_fork_leaves_the_first_one() -> None:
    """Both ways, lists of a task included."""
    env: Any = GuessEnv()
    env.guesses = []
    env.reset(seed=3)
    other = env.fork()
    other.step("0")
    other.guesses.append("0")
    assert (env.turn, env.guesses) == (0, [])
    env.step("0")
    env.step("0")
    assert other.turn == 1


def test_what_cannot_be_copied_says_so() -> None:
    """With the class, and inside wrappers too; an error of the library's own comes through."""

    class Connected(GuessEnv):
        def __deepcopy__(self, memo: dict[int, Any]) -> Any:
            raise StateNotSupported("a connection")

    env: Any = GuessEnv()
    env.lock = threading.Lock()
    with pytest.raises(StateNotSupported, match="Concat"):
        Concat(env).fork()
    with pytest.raises(StateNotSupported, match=r"^a connection$"):
        Concat(Connected()).fork()


def test_sessions_of_tools_are_copied() -> None:
    """A fork has the notes so far, and its own from there on; counters as well."""
    env = gem.ToolEnv(GuessEnv(), [Notebook()])
    env.reset(seed=1)
    env.step("<note>a</note>")
    other = env.fork()
    assert other.step("<note>b</note>") == env.step("<note>b</note>")
    assert "a\nb\nb" not in env.fork().step("<note>c</note>")[0]
