# /// script
# requires-python = ">=3.11"
# dependencies = ["openenv>=0.10,<0.11", "uvicorn", "gem-core", "gem-games", "gem-train"]
# [tool.gem.table]
# framework = 'OpenEnv'
# rewards = 'yes'
# images = 'as data URLs'
# groups = 'sessions with one seed'
# tools = 'native or in text'
# failures = '`error`, reward None: the trainer leaves it out'
# ///
r"""OpenEnv: any environment of GEM as a server, and a client that plays it over WebSocket.

Shows an ``Environment`` of OpenEnv 0.10 around a ``ChatSession``: seeds bind, rewards come with every turn, sessions
run side by side, each with an environment of its own. TRL, verifiers and others have clients for such servers.

Install and run it here, in an environment of its own::

    python scripts/trainers.py openenv_server
    python examples/trainers/openenv_server.py

Serve for real; a trainer on a GPU connects to it as to any server of OpenEnv::

    GEM_ENV=game:GuessTheNumber-v0 uvicorn --app-dir examples/trainers --factory openenv_server:app --port 8000

What OpenEnv cannot take: several agents (give ``ChatSession`` one seat, see ``gem.single_agent``); groups, which are
sessions that the trainer resets to one seed. It has no word for a failure that is not the agent's: the observation then
has ``error``, ``done`` and a ``reward`` of None, never 0, and the trainer has to leave the episode out. A tool that
fails is told to the model, and the episode goes on. Images are sent as data URLs.
"""

from __future__ import annotations

import asyncio
import os
import re
import socket
import sys
import threading
import uuid
from typing import Any

import uvicorn
from openenv.core.client_types import StepResult
from openenv.core.env_client import EnvClient
from openenv.core.env_server import create_fastapi_app
from openenv.core.env_server.interfaces import Environment
from openenv.core.env_server.types import Action, Observation, State

import gem_core as gem
from gem_train.adapters import ChatSession, ChatStep, images_as_urls
from gem_train.adapters.trial import check

GUESS = "game:GuessTheNumber-v0-easy"


# What passes over the wire.


class ChatAction(Action):
    """A whole response of the model."""

    response: str = ""
    tool_calls: list[dict[str, Any]] | None = None  # in the OpenAI chat format, where the model calls tools natively
    finish_reason: str | None = None  # "length" for a response that was cut off


class ChatObservation(Observation):
    """What the environment appends to the chat; ``done`` and ``reward`` are OpenEnv's own."""

    messages: list[dict[str, Any]]
    tools: list[dict[str, Any]] | None = None  # schemas, at reset
    truncated: bool = False  # done, but cut off from outside
    success: bool | None = None  # None while it is not known
    error: dict[str, Any] | None = None  # a failure that is not the agent's: leave the episode out


# The server.


class GemEnvironment(Environment[ChatAction, ChatObservation, State]):
    """One session: an environment of GEM as a chat."""

    SUPPORTS_CONCURRENT_SESSIONS = True

    def __init__(self, env_id: str, **kwargs: Any) -> None:
        super().__init__()
        self.session = ChatSession(env_id, **kwargs)
        self.episode_id: str | None = None

    async def reset_async(
        self, seed: int | None = None, episode_id: str | None = None, options: dict[str, Any] | None = None
    ) -> ChatObservation:
        """Begin an episode; an environment that fails is an error of the request."""
        self.episode_id = episode_id or uuid.uuid4().hex
        messages = await self.session.reset(seed, options)
        return ChatObservation(messages=images_as_urls(messages), tools=self.session.tools)

    async def step_async(self, action: ChatAction, timeout_s: float | None = None) -> ChatObservation:
        """Take a response."""
        return observation_of(self.session, await self.session.step(response_of(action)))

    def reset(self, seed: int | None = None, episode_id: str | None = None, **kwargs: Any) -> ChatObservation:
        """``reset_async`` for plain code."""
        return asyncio.run(self.reset_async(seed, episode_id, **kwargs))

    def step(self, action: ChatAction, timeout_s: float | None = None, **kwargs: Any) -> ChatObservation:
        """``step_async`` for plain code."""
        return asyncio.run(self.step_async(action, timeout_s))

    @property
    def state(self) -> State:
        """The episode and how far it is; extra fields of OpenEnv's ``State``."""
        if self.episode_id is None:
            return State()
        episode = self.session.episode
        return State(
            episode_id=self.episode_id, step_count=episode.turns, seed=episode.seed, rewards=self.session.rewards
        )

    def close(self) -> None:
        """Close the environment when the session ends."""
        self.session.close()


def response_of(action: ChatAction) -> gem.Response:
    """Return what the environment is stepped with."""
    return gem.Response(action.response, tool_calls=action.tool_calls, finish_reason=action.finish_reason)


def observation_of(session: ChatSession, step: ChatStep) -> ChatObservation:
    """Return the observation of a step. Where the machinery failed there is no reward: 0 would be a verdict."""
    return ChatObservation(
        messages=images_as_urls(step.messages),
        done=step.done,
        reward=None if step.error is not None else step.reward,
        truncated=step.truncated,
        success=session.success if step.done else None,
        error=step.error,
    )


def app(env_id: str | None = None, max_sessions: int = 64) -> Any:
    """Return the application that serves an environment: ``env_id``, or that of the variable ``GEM_ENV``."""
    name = env_id or os.environ.get("GEM_ENV", GUESS)
    return create_fastapi_app(
        lambda: GemEnvironment(name), ChatAction, ChatObservation, max_concurrent_envs=max_sessions
    )


# The client.


class GemClient(EnvClient[ChatAction, ChatObservation, dict[str, Any]]):
    """Plays an environment on a server."""

    def _step_payload(self, action: ChatAction) -> dict[str, Any]:
        return action.model_dump(exclude_defaults=True)

    def _parse_result(self, payload: dict[str, Any]) -> StepResult[ChatObservation]:
        reward, done = payload.get("reward"), payload.get("done", False)
        return StepResult(ChatObservation(**payload["observation"], reward=reward, done=done), reward, done)

    def _parse_state(self, payload: dict[str, Any]) -> dict[str, Any]:
        return payload


def bisect(text: str) -> str:
    """Answer the game by bisection; a model would read the text instead."""
    low, high = map(int, re.findall(r"from (\d+) to (\d+)", text)[-1])
    low = max([low, *(int(number) + 1 for number in re.findall(r"higher than (\d+)", text))])
    high = min([high, *(int(number) - 1 for number in re.findall(r"lower than (\d+)", text))])
    return f"\\boxed{{{(low + high) // 2}}}"


async def play(url: str, seed: int) -> tuple[list[dict[str, Any]], list[float | None], bool | None]:
    """Play one episode; return the chat, the reward of each turn, and whether it was solved."""
    async with GemClient(base_url=url) as client:
        result = await client.reset(seed=seed)
        chat, rewards = list(result.observation.messages), []
        while not result.done:
            response = bisect(chat[-1]["content"])
            result = await client.step(ChatAction(response=response))
            chat += [{"role": "assistant", "content": response}, *result.observation.messages]
            rewards.append(result.reward)
        return chat, rewards, result.observation.success


async def try_it(url: str) -> None:
    """Play over the wire and check what the first lines of this file promise."""
    (chat, rewards, success), again, other = await asyncio.gather(play(url, 7), play(url, 7), play(url, 8))
    for message in chat:
        print(f"[{message['role']}] {message['content']}")
    print(f"rewards {rewards}, solved: {success}")
    check(success is True and rewards[-1] == 1.0, "the game was solved, and every turn has its reward")
    check(again == (chat, rewards, success), "one seed gives one episode, in another session too")
    check(other[0] != chat, "another seed gives another")

    local = ChatSession(GUESS)
    check(local.reset_sync(7) == chat[:1], "the server shows what a local environment shows")
    async with GemClient(base_url=url) as left, GemClient(base_url=url) as right:
        await left.reset(seed=1)
        await right.reset(seed=2)
        await left.step(ChatAction(response="\\boxed{1}"))
        states = await left.state(), await right.state()
        check([state["step_count"] for state in states] == [1, 0], "sessions do not share their state")
        cut = await right.step(ChatAction(response="I think", finish_reason="length"))
        check(cut.done and cut.observation.success is False, "a response that was cut off is scored by the task")


def main() -> int:
    """Serve on a free port of this machine, and play."""
    listening = socket.create_server(("127.0.0.1", 0))  # it listens already: a client's connection waits until it runs
    server = uvicorn.Server(uvicorn.Config(app(GUESS), log_level="warning"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
    thread.start()
    try:
        asyncio.run(try_it(f"http://127.0.0.1:{listening.getsockname()[1]}"))
    finally:
        server.should_exit = True
        thread.join()
    return 0


if __name__ == "__main__":
    sys.exit(main())
