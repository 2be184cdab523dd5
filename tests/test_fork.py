"""``fork``: an independent copy in the same state, of tasks, wrappers, tools and several agents."""

from __future__ import annotations

import pickle
import threading
from typing import Any

import pydantic
import pytest

import gem_core as gem
from gem_core.errors import StateNotSupported
from gem_core.types import ResetResult, StepResult
from gem_core.wrappers import Concat, EpisodeStats


class Dice(gem.Env):
    """Shows dice that it throws, and counts them in a list."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        super().reset(seed=seed)
        self.thrown: list[int] = []
        return "Throw.", {}

    def step(self, action: str) -> StepResult:
        self.thrown.append(int(self.np_random.integers(1, 7)))
        over = len(self.thrown) == 5
        return gem.TERMINAL_STATE if over else f"{self.thrown}", 0.0, over, False, {}

    def sample_random_action(self) -> str:
        return str(self.action_random.integers(1000))


class Notes(gem.Tool):
    """Keeps notes."""

    name = "note"
    concurrency = "inline"

    class Parameters(pydantic.BaseModel):
        """One text."""

        text: str

    def open(self) -> list[str]:
        return []

    def call(self, arguments: Any, session: list[str]) -> str:
        session.append(arguments.text)
        return " ".join(session)


def rest(env: Any) -> list[Any]:
    """Play on, and begin the next episode."""
    return [env.step(str(turn)) for turn in range(3)] + [env.reset(), env.step("x")]


def begun(env: Any) -> Any:
    """Return an environment after one step."""
    env.reset(seed=3)
    env.step("x")
    return env


@pytest.mark.parametrize("copied", [lambda env: env.fork(), lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("wrappers", [[], [Concat, EpisodeStats]])
def test_fork_goes_on_as_the_first_one(copied: Any, wrappers: list[Any]) -> None:
    """Through wrappers, with the generators of the task and of actions, and into the next episode; so by pickle."""
    env: Any = Dice()
    for wrapper in wrappers:
        env = wrapper(env)
    begun(env)
    env.sample_random_action()
    other = copied(env)
    assert type(other) is type(env)
    assert other.sample_random_action() == env.sample_random_action()
    other_thrown = other.unwrapped.thrown
    results, others = rest(env), rest(other)
    for result in (*results, *others):
        result[-1].pop("episode_stats", None)
    assert results == others
    assert other_thrown is not env.unwrapped.thrown


def test_forks_are_independent() -> None:
    """From the start of an episode, when no generator has started; stepping one leaves the other."""
    env = Dice()
    env.reset(seed=3)
    other = env.fork()
    assert env.step("x") == other.step("x")
    other.step("x")
    assert (len(env.thrown), len(other.thrown)) == (1, 2)


def test_what_cannot_be_copied_says_so() -> None:
    """With the class, and inside wrappers too."""
    env = Dice()
    env.lock = threading.Lock()
    with pytest.raises(StateNotSupported, match="Concat cannot be forked"):
        Concat(env).fork()


def test_rows_are_shared_by_forks() -> None:
    """However many there are; a fork asks the same row."""
    rows = [{"question": f"{number}+1?", "answer": str(number + 1)} for number in range(9)]
    env = gem.DatasetEnv(rows)
    env.reset(seed=1)
    other = env.fork()
    assert other.rows is env.rows
    assert env.step("\\boxed{3}") == other.step("\\boxed{3}")


def test_sessions_of_tools_are_copied() -> None:
    """A fork has the notes so far, and its own from there on; counters as well."""
    call = '<tool_call>{"name": "note", "arguments": {"text": "%s"}}</tool_call>'
    env = gem.ToolEnv(Dice(), [Notes()])
    env.reset(seed=1)
    env.step(call % "a")
    other = env.fork()
    assert other.step(call % "b") == env.step(call % "b")
    assert "a b b" not in env.fork().step(call % "c")[0]


def test_session_with_a_connection_is_not_forked() -> None:
    """The error of its own class comes through."""

    class Session:
        def __deepcopy__(self, memo: dict[int, Any]) -> Any:
            raise StateNotSupported("a connection")

    class Remote(Notes):
        def open(self) -> Any:
            return Session()

        def call(self, arguments: Any, session: Any) -> str:
            return "done"

    env = gem.ToolEnv(Dice(), [Remote()])
    env.reset(seed=1)
    env.fork()
    env.step("<note>x</note>")
    with pytest.raises(StateNotSupported, match="a connection"):
        env.fork()
