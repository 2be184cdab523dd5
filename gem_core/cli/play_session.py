"""What a person plays: episodes of one environment, with turns that can be taken back, kept as records."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from itertools import count
from typing import TYPE_CHECKING, Any, cast

from gem_core.agents.answer_form import AnswerForm
from gem_core.env.base import Env
from gem_core.env.observations import split_observation
from gem_core.env.results import checked_result
from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.errors import ArgumentError, NotSupportedError, SamplingNotSupported, StateNotSupported
from gem_core.records.episode import Episode, Transition
from gem_core.records.plans import EpisodeQueue, EpisodeStart, PlanItem
from gem_core.rollouts.loop import new_episode
from gem_core.types import Info, Observation, Response

if TYPE_CHECKING:
    from gem_core.making.environment import MadeSpec


class PlaySession:
    """Plays one episode after another, the same ones that a run of this seed has.

    Args:
        env: What is played, made by ``make``.
        seed: Seed of the run; None draws one, found as ``seed``.
    """

    def __init__(self, env: AnyEnv, seed: int | None = None) -> None:
        self.env = env
        self._source = EpisodeQueue(_endless_plan(env), seed)
        self.seed = self._source.seed
        self.number = 0
        """Number of the present episode, from 1; 0 before the first."""
        self.taken_back = 0
        self._states: list[dict[str, Any] | None] = []
        self._no_undo = ""

    @property
    def env_id(self) -> str:
        """Id of the environment."""
        return cast("MadeSpec", self.env.spec).id

    # Episodes.

    def begin(self) -> None:
        """Begin the next episode."""
        self.number += 1
        self._start(cast("EpisodeStart", self._source.draw(0)))

    def restart(self) -> None:
        """Begin the present episode again, from the same start."""
        self._start(self._draw)

    def _start(self, draw: EpisodeStart) -> None:
        self._draw = draw
        options = draw.item.options
        observation, info = (
            self.env.reset(seed=draw.seed, options=dict(options)) if options else self.env.reset(seed=draw.seed)
        )
        if hasattr(task := self.env.unwrapped, "seed_actions"):
            task.seed_actions(draw.action_seed)
        info["seed"] = draw.seed
        spec = cast("MadeSpec", self.env.spec)
        described = {"id": spec.id, "kwargs": spec.overrides(), "wrappers": [list(each) for each in spec.wrappers]}
        self.episode: Episode = new_episode(described, draw, observation, info)
        self.taken_back = 0
        self._states = []

    @property
    def started(self) -> bool:
        """Whether an episode has begun."""
        return hasattr(self, "episode")

    @property
    def over(self) -> bool:
        """Whether the present episode is over."""
        turns = self.episode.transitions
        return bool(turns) and (turns[-1].terminated or turns[-1].truncated)

    @property
    def observation(self) -> Observation:
        """What waits for an answer."""
        return self.episode.final_observation

    @property
    def info(self) -> Info:
        """What came with the observation."""
        return self.episode.final_info

    @property
    def tools(self) -> list[str]:
        """Names of the tools that may be called."""
        return self.episode.tools

    # Turns.

    def act(self, answer: str) -> Transition:
        """Take a turn with an answer to the letter; see ``formed``."""
        state = self._state()
        observation, reward, terminated, truncated, info = checked_result(self.env.step(answer))
        turn = Transition(self.observation, Response.of(answer), reward, terminated, truncated, info)
        self._states.append(state)
        self.episode.transitions.append(turn)
        self.episode.final_observation = observation
        return turn

    @property
    def can_undo(self) -> bool:
        """Whether there is a turn that can be taken back."""
        return bool(self._states) and self._states[-1] is not None

    def undo(self) -> Transition:
        """Take the last turn back, and return it.

        Raises:
            ArgumentError: There is none.
            StateNotSupported: The environment cannot save its state.
        """
        if not self.episode.transitions:
            raise ArgumentError("there is no turn to take back")
        state = self._states[-1]
        if state is None:
            raise StateNotSupported(f"turns of this environment cannot be taken back: {self._no_undo}")
        cast("Env | Wrapper", self.env).set_state(state)
        self._states.pop()
        turn = self.episode.transitions.pop()
        self.episode.final_observation = turn.observation
        self.taken_back += 1
        return turn

    def _state(self) -> dict[str, Any] | None:
        if not isinstance(self.env, Env | Wrapper):
            self._no_undo = f"{type(self.env).__name__} is a wrapper of Gymnasium's, which cannot save its state"
            return None
        try:
            return copy.deepcopy(self.env.get_state())
        except NotSupportedError as error:
            self._no_undo = str(error)
            return None

    # Answers.

    def random_action(self) -> str:
        """Draw a valid action in the present state.

        Raises:
            SamplingNotSupported: The environment does not say what is valid.
        """
        return cast("str", self.env.get_wrapper_attr("sample_random_action")())

    def form(self) -> AnswerForm:
        """Return the form that answers have in the present state."""
        try:
            return AnswerForm.of_example(self.random_action())
        except SamplingNotSupported:
            said, _ = split_observation(self.episode.observation, self.episode.info)
            return AnswerForm.of_instructions(said) if isinstance(said, str) else AnswerForm()

    def formed(self, answer: str) -> str:
        """Return a plain answer in the form that the environment expects."""
        return self.form().around(answer, self.tools)


def was_not_played(turn: Transition) -> bool:
    """Tell whether the environment says that it could do nothing with a response."""
    return turn.info.get("parsed_action", "") is None and not turn.info.get("correct")


def _endless_plan(env: AnyEnv) -> Iterator[PlanItem]:
    """Yield what ``gem run`` starts from: the rows of a data set in order, over and over; for others just seeds."""
    task = env.unwrapped
    if not isinstance(task, Env) or task.num_tasks is None:
        return (PlanItem() for _ in count())
    rows = task.num_tasks
    if task.endless_tasks:
        return (PlanItem(options={"index": index}) for index in count())
    return (PlanItem(options={"index": index % rows}) for index in count())
