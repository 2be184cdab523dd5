"""``ChatSession``: one environment as a chat, for trainers that run the loop of an episode themselves."""

from __future__ import annotations

import secrets
from contextlib import suppress
from typing import Any, NamedTuple, Self

from gem_core import Episode, MultiAgentEnv, PlanItem, Response, Transition, make
from gem_core.env import AnyEnv, checked_reset, checked_result, reset_async, step_async
from gem_core.errors import ArgumentError, EnvFaultError, NotSupportedError, ResetNeededError
from gem_core.failures import author_frames, failure_info
from gem_core.records import EpisodeStart
from gem_core.rollouts import new_episode
from gem_core.types import TERMINAL_STATE, Info, ResetResult, StepResult
from gem_train.text import encodable

Message = dict[str, Any]


class ChatStep(NamedTuple):
    """The result of one response.

    Args:
        messages: What the environment appends to the chat after the response, as role ``"user"``, or ``"tool"`` for
            native calls; empty where it has nothing more to say.
        reward: Of this turn. Where ``error`` is given it says nothing.
        terminated: Whether the task is over.
        truncated: Whether the episode was cut off from outside.
        info: What ``step`` returned.
    """

    messages: list[Message]
    reward: float
    terminated: bool
    truncated: bool
    info: Info

    @property
    def done(self) -> bool:
        """Whether the episode is over, in either way."""
        return self.terminated or self.truncated

    @property
    def error(self) -> dict[str, Any] | None:
        """``{"kind", "message"}`` of a failure that was not the agent's; None for a turn that counts.

        Leave the episode out of training: its rewards are no verdict on what the agent did.
        """
        return self.info.get("error")


class ChatSession:
    """One environment as a chat to which messages are only appended.

    ``reset`` returns the first messages, ``step`` takes a response and returns those that follow it. The record of the
    episode, with the reward of every turn, is in ``episode``. Each method has a form for plain code, ``reset_sync`` and
    ``step_sync``; one session is used from one place at a time.

    Messages have a question mark for what UTF-8 cannot hold, a lone surrogate, which tokenizers and servers refuse; the
    record keeps it.

    An environment that raises in ``step`` ends the episode with ``ChatStep.error``, as in a rollout; one that was made
    from an id is then made anew by the next ``reset``.

    Args:
        env: The id of an environment; or one that is made already, which then belongs to the session.
        system: System text that takes the place of the task's own; None for that of the task.
        native_tools: Whether the trainer offers the model the schemas in ``tools``, so that no text explains them.
        **kwargs: Passed to ``make`` with an id, ``wrappers`` among them.

    Raises:
        ArgumentError: Several agents act in the environment; or keyword arguments come with one that is made already.
        UnknownEnvError: There is no such environment.
    """

    def __init__(
        self, env: str | AnyEnv, *, system: str | None = None, native_tools: bool = False, **kwargs: Any
    ) -> None:
        if not isinstance(env, str) and kwargs:
            raise ArgumentError(
                f"{', '.join(kwargs)}: keyword arguments go with the id of an environment, and this one is made already"
            )
        self._id, self._kwargs = env if isinstance(env, str) else None, kwargs
        self._env: AnyEnv | None = make(env, **kwargs) if isinstance(env, str) else env
        if isinstance(self._env.unwrapped, MultiAgentEnv):
            seats = self._env.unwrapped.possible_agents
            self.close()
            raise ArgumentError(
                f"several agents act in {env!r:.100}: give ChatSession one seat of it, as "
                f"gem.single_agent({env!r:.100}, {seats[0]!r}, others='random')"
            )
        self._system, self._native_tools = system, native_tools
        self._episode: Episode | None = None
        self._live = False
        self._messages: list[Message] = []

    # An episode.

    async def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> list[Message]:
        """Begin an episode.

        Args:
            seed: Of the episode: the same seed and options start the same task. None draws one (``episode.seed``).
            options: Passed to the environment, as ``{"index": 3}`` for a row of a data set.

        Returns:
            The first messages: the system text, where there is one, and the task.

        Raises:
            EnvFaultError: The environment failed; no episode has begun.
        """
        env, seed = self._before_reset(seed)
        try:
            result = checked_reset(await reset_async(env, seed, options))
        except Exception as error:
            raise self._failed_reset(error) from error
        return self._begin(env, result, seed, options)

    def reset_sync(self, seed: int | None = None, options: dict[str, Any] | None = None) -> list[Message]:
        """``reset`` for plain code."""
        env, seed = self._before_reset(seed)
        try:
            result = checked_reset(env.reset(seed=seed, options=options) if options else env.reset(seed=seed))
        except Exception as error:
            raise self._failed_reset(error) from error
        return self._begin(env, result, seed, options)

    async def step(self, response: str) -> ChatStep:
        """Take a whole response of the model: text, or a ``Response`` that also carries native calls, tokens and more.

        A response that was cut off by length (``finish_reason="length"``) is taken as it is; ``episode.cut_off`` tells.

        Raises:
            ResetNeededError: No episode is under way.
            ArgumentError: The response is no text.
        """
        env = self._before_step(response)
        try:
            result = checked_result(await step_async(env, response))
        except Exception as error:  # noqa: BLE001 - an environment may raise anything
            result = self._failed_step(error)
        return self._add(Response.of(response), result)

    def step_sync(self, response: str) -> ChatStep:
        """``step`` for plain code."""
        env = self._before_step(response)
        try:
            result = checked_result(env.step(response))
        except Exception as error:  # noqa: BLE001 - an environment may raise anything
            result = self._failed_step(error)
        return self._add(Response.of(response), result)

    # What is known of it.

    @property
    def episode(self) -> Episode:
        """The record of the present episode, or of the last one.

        Raises:
            ResetNeededError: None has begun.
        """
        if self._episode is None:
            raise ResetNeededError("no episode has begun: call reset() first")
        return self._episode

    @property
    def messages(self) -> list[Message]:
        """The chat so far, responses included."""
        return [dict(message) for message in self._messages]

    @property
    def tools(self) -> list[dict[str, Any]]:
        """Schemas of the tools, as the OpenAI chat API takes them; known after ``reset``, empty without tools."""
        return list(self.episode.info.get("tools", ()))

    @property
    def done(self) -> bool:
        """Whether no episode is under way."""
        return not self._live

    @property
    def rewards(self) -> list[float]:
        """The reward of each turn, in order."""
        return [turn.reward for turn in self.episode.transitions]

    @property
    def episode_return(self) -> float:
        """Sum of the rewards, undiscounted."""
        return self.episode.episode_return

    @property
    def success(self) -> bool | None:
        """Whether the task was solved; None for unknown. An episode that was left before its end is not solved."""
        return self.episode.success

    @property
    def error(self) -> dict[str, Any] | None:
        """The failure that ended the episode and was not the agent's; None for an episode that counts."""
        return self.episode.error

    def close(self) -> None:
        """Close the environment. The record stays."""
        self._live = False
        env, self._env = self._env, None
        if env is not None:
            env.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    # The parts that both forms share.

    def _before_reset(self, seed: int | None) -> tuple[AnyEnv, int]:
        self._live = False
        if self._env is None:
            if self._id is None:
                raise ResetNeededError(
                    "this session is closed, and has no id to make its environment again; make another"
                )
            self._env = make(self._id, **self._kwargs)
        return self._env, secrets.randbelow(2**53) if seed is None else seed

    def _begin(self, env: AnyEnv, result: ResetResult, seed: int, options: dict[str, Any] | None) -> list[Message]:
        observation, info = result
        start = EpisodeStart(PlanItem(options=options), (0,), 0, seed, seed)
        self._episode = episode = new_episode(_described(env), start, observation, info)
        episode.reads, episode.system = "messages", self._system
        episode.native_tools = self._native_tools and bool(info.get("tools"))
        self._messages = encodable(episode.messages)
        self._live = True
        return self.messages

    def _before_step(self, response: object) -> AnyEnv:
        if not self._live or self._env is None:
            raise ResetNeededError("the episode is over or has not begun: call reset() before the next step()")
        if not isinstance(response, str):
            raise ArgumentError(
                f"a response is a str or a Response, not {response!r:.100}; give '' for one without text"
            )
        self._live = False  # until its result is here: a step that was cancelled leaves an unknown state
        return self._env

    def _add(self, response: Response, result: StepResult) -> ChatStep:
        observation, reward, terminated, truncated, info = result
        episode, before = self.episode, self._messages
        turn = Transition(episode.final_observation, response, reward, terminated, truncated, info)
        episode.transitions.append(turn)
        episode.final_observation = observation
        self._messages = encodable(episode.messages)
        if self._messages[: len(before)] != before:
            raise NotSupportedError(
                f"{episode.id} rewrites messages that were sent already, and this chat only grows; "
                "make the environment without the wrapper that does so, or with a view that is append_only"
            )
        self._live = not (terminated or truncated)
        return ChatStep([dict(each) for each in self._messages[len(before) + 1 :]], reward, terminated, truncated, info)

    def _failed_reset(self, error: Exception) -> EnvFaultError:
        self._discard()
        return EnvFaultError(f"{self._id or 'the environment'}: reset raised {type(error).__name__}: {error}")

    def _failed_step(self, error: Exception) -> StepResult:
        self._discard()
        failure = failure_info("exception", f"step raised {type(error).__name__}: {error}", author_frames(error))
        return TERMINAL_STATE, 0.0, False, True, {"error": failure}

    def _discard(self) -> None:
        """Close an environment that failed, if another can be made in its place."""
        if self._id is not None:
            env, self._env = self._env, None
            if env is not None:
                with suppress(Exception):  # what failed first is told
                    env.close()


def _described(env: AnyEnv) -> dict[str, Any]:
    """Return the id, arguments and wrappers of an environment, as the record of an episode holds them."""
    spec: Any = env.spec
    return dict(spec.recorded()) if spec else {"id": type(env.unwrapped).__name__, "kwargs": {}, "wrappers": []}
