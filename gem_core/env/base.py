"""``Env``: the base class of every environment, and its contract."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium
import numpy as np

from gem_core.arguments import RemembersArguments
from gem_core.background import in_thread, run_sync
from gem_core.env.seeding import checked_seed, fresh_seed, generator_at, next_seed, stable_hash
from gem_core.env.spaces import Text
from gem_core.errors import SamplingNotSupported
from gem_core.types import Concurrency, ResetResult, StepResult

if TYPE_CHECKING:
    from gymnasium import spaces


_SET_FROM_OUTSIDE = -1
"""Gymnasium's number for the seed of a generator that was set from outside."""


class Env(RemembersArguments, gymnasium.Env[Any, str]):
    r"""A task: what is asked, how its state moves, and what is rewarded.

    A subclass overrides ``reset`` and ``step``, as in Gymnasium, and draws all its randomness from ``np_random``::

        class Reverse(Env):
            def reset(self, seed=None, options=None):
                super().reset(seed=seed)
                self.word = "".join(self.np_random.permutation(list("stressed")))
                return f"Write {self.word!r} backwards inside \\boxed{{}}.", {}

            def step(self, action):
                right = extract_last_boxed_answer(action) == self.word[::-1]
                return TERMINAL_STATE, float(right), True, False, {"correct": right}

    It may override ``sample_random_action``, ``gold_action``, ``render`` and ``close``; and ``__deepcopy__``, where it
    holds something that ``fork`` cannot copy. Where ``reset`` takes ``options={"index": i}``, it sets ``num_tasks``.
    ``gem_core.testing.check_env`` tries whether it keeps what this class promises.

    A response is untrusted text of a model: any string gives an observation and a reward, in bounded time.

    Source: the interface is that of ``gymnasium.Env``, https://gymnasium.farama.org/api/env/.
    """

    concurrency: ClassVar[Concurrency] = "inline"
    """How vector environments run it beside others.

    ``"inline"``: microseconds of pure Python. ``"thread"``: blocks on input and output or a subprocess. ``"process"``:
    computes for long, or uses fenced global state. ``"async"``: derive from ``AsyncEnv``.
    """

    answer_fences: ClassVar[tuple[str, ...]] = ()
    """Languages of fenced blocks that are answers of this task, so that tools leave them alone."""

    answer_tags: ClassVar[tuple[str, ...]] = ("answer",)
    """Tags around answers of this task; a tool of such a name is called in JSON only."""

    num_tasks: int | None = None
    """How many tasks ``reset(options={"index": i})`` chooses from, as the rows of a data set; None if it cannot.

    Plans then cover the tasks, each once in an epoch.
    """

    endless_tasks: bool = False
    """Whether ``options={"index": i}`` also takes numbers from ``num_tasks`` up, for fresh tasks of later epochs."""

    return_range: tuple[float, float] | None = None
    """The lowest and the highest return that an episode can have; None if unknown.

    Standard errors and intervals of scores stay within it. A wrapper that changes rewards declares its own.
    """

    # Frames a second: what Gymnasium's checker asks of whatever can be rendered; text has none.
    metadata: dict[str, Any] = {"render_modes": ["ansi", "human"], "render_fps": 4}  # noqa: RUF012 - as in Gymnasium
    """The render modes that ``make`` offers: a text of the state, returned by ``render`` or printed at every step."""

    spec: Any = None
    """The ``MadeSpec`` that ``make`` made it from; None for one that was made by its class."""

    _generator: np.random.Generator | None = None
    _action_generator: np.random.Generator | None = None

    @functools.cached_property
    def action_space(self) -> spaces.Space[Any]:  # type: ignore[override]
        """Any text."""
        return Text()

    @functools.cached_property
    def observation_space(self) -> spaces.Space[Any]:  # type: ignore[override]
        """Text, unless a subclass says otherwise."""
        return Text()

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Begin an episode. Subclasses call ``super().reset(seed=seed)`` first.

        Args:
            seed: Start the stream of this seed. None draws the next episode of the stream that was started last, or of
                a fresh one; its own seed is then reported in ``info["seed"]``, and starts the same episode again.
            options: Choices that the environment offers, as ``{"index": 3}`` in a data set.

        Returns:
            The first observation and an info dictionary of plain JSON.
        """
        if seed is not None:
            seed = checked_seed(seed)
        elif self._np_random_seed in (None, _SET_FROM_OUTSIDE):
            seed = fresh_seed()
        else:
            seed = next_seed(self._np_random_seed)
        self._np_random_seed = seed
        self._generator = self._action_generator = None
        return "", {}

    def step(self, action: str) -> StepResult:
        """Answer one whole response of the agent.

        Returns:
            ``(observation, reward, terminated, truncated, info)``. ``terminated``: the task is over, by success,
            failure or a turn budget that it announces itself. ``truncated``: cut off from outside.
        """
        raise NotImplementedError(f"{type(self).__name__} must define step(self, action)")

    def task_row(self, index: int) -> Mapping[str, Any]:
        """Return what is known of a task before it is asked, for those who choose among tasks and for no agent.

        ``"task_id"`` is what ``info["task_id"]`` of its episodes says; a data set adds the columns of the row.

        Args:
            index: From 0, as in ``options={"index": index}``.
        """
        return {"task_id": str(index)}

    def sample_random_action(self) -> str:
        """Return a valid response in the present state, drawn from ``action_random``.

        Raises:
            SamplingNotSupported: The environment cannot sample actions.
        """
        raise SamplingNotSupported(f"{type(self).__name__} does not override sample_random_action")

    def gold_action(self) -> str | None:
        """Return a response that solves the task from the present state, or is the next turn of a solution.

        For audits of the task, which play it and expect success. It is never shown to an agent, and changes nothing.

        Returns:
            A whole response, as an agent would write it; None if no solution is known.
        """
        return None

    def render(self) -> Any:
        """Return a drawing of the present state as text, over several lines, for people; no agent sees it.

        Returns:
            The text; None without a render mode, and if the last observation shows the whole state.
        """
        return None

    # Gymnasium's own ``np_random`` reads and sets ``_np_random``.

    @property
    def _np_random(self) -> np.random.Generator:
        """The generator of the task, which starts when it is first used: many small tasks never use it."""
        if self._generator is None:
            self._generator = generator_at(self.np_random_seed)
        return self._generator

    @_np_random.setter
    def _np_random(self, value: np.random.Generator | None) -> None:
        self._generator = value

    @property
    def np_random_seed(self) -> int:
        """The seed of the present episode; -1 after ``np_random`` was set from outside."""
        if self._np_random_seed is None:
            self._np_random_seed = fresh_seed()
        return self._np_random_seed

    @property
    def action_random(self) -> np.random.Generator:
        """The generator of ``sample_random_action``, apart from the task's: sampling never changes an episode."""
        if self._action_generator is None:
            self._action_generator = generator_at(stable_hash(self.np_random_seed, "actions"))
        return self._action_generator

    def seed_actions(self, seed: int) -> None:
        """Start ``action_random`` from ``seed`` for the rest of this episode."""
        self._action_generator = generator_at(checked_seed(seed))

    @property
    def env_id(self) -> str | None:
        """The id that it was made by, or None."""
        return None if self.spec is None else self.spec.id

    async def reset_async(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """``reset`` for code that runs in an event loop, without blocking it."""
        reset = functools.partial(self.reset, **reset_arguments(seed, options))
        return reset() if self.concurrency == "inline" else await in_thread(reset)

    async def step_async(self, action: str) -> StepResult:
        """``step`` for code that runs in an event loop, without blocking it."""
        return self.step(action) if self.concurrency == "inline" else await in_thread(self.step, action)


class AsyncEnv(Env):
    """An environment written as coroutines: a subclass overrides ``reset_async`` and ``step_async``.

    They always run on the library's own event loop; ``reset`` and ``step`` wait for them there.
    """

    concurrency: ClassVar[Concurrency] = "async"

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Wait for ``reset_async``."""
        return run_sync(self.reset_async(**reset_arguments(seed, options)))

    async def reset_async(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Begin an episode. Subclasses await ``super().reset_async(seed)`` first."""
        return Env.reset(self, seed, options)

    def step(self, action: str) -> StepResult:
        """Wait for ``step_async``."""
        return run_sync(self.step_async(action))

    async def step_async(self, action: str) -> StepResult:
        """Answer one whole response of the agent."""
        raise NotImplementedError(f"{type(self).__name__} must define step_async(self, action)")


def reset_arguments(seed: int | None, options: dict[str, Any] | None) -> dict[str, Any]:
    """Return the keywords for an author's ``reset``, which need not know ``options`` while there are none."""
    return {"seed": seed, "options": options} if options else {"seed": seed}
