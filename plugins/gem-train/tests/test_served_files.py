"""``openenv_server.py`` and ``tinker_rollouts.py``: what they make of a turn, a failed tool, a failed environment."""

from __future__ import annotations

import asyncio
import base64
import dataclasses
from types import SimpleNamespace
from typing import Any, Generic, TypeVar

import pydantic
import pytest
from failing_envs import Divide, register
from trainer_files import import_trainer

from gem_core.errors import EnvFaultError
from gem_train.adapters import ChatSession, images_as_urls

A, B, C = TypeVar("A"), TypeVar("B"), TypeVar("C")


class Environment(Generic[A, B, C]):
    """OpenEnv's."""


class Model(pydantic.BaseModel):
    """OpenEnv's base of actions and observations."""

    model_config = pydantic.ConfigDict(extra="forbid")


class Observation(Model):
    """OpenEnv's."""

    done: bool = False
    reward: bool | int | float | None = None


class State(pydantic.BaseModel):
    """OpenEnv's."""

    model_config = pydantic.ConfigDict(extra="allow")
    episode_id: str | None = None
    step_count: int = 0


OPENENV: dict[str, dict[str, Any]] = {
    "uvicorn": {},
    "openenv": {},
    "openenv.core": {},
    "openenv.core.client_types": {"StepResult": list},
    "openenv.core.env_client": {"EnvClient": Environment},
    "openenv.core.env_server": {"create_fastapi_app": lambda *given, **named: (given, named)},
    "openenv.core.env_server.interfaces": {"Environment": Environment},
    "openenv.core.env_server.types": {"Action": Model, "Observation": Observation, "State": State},
}


@pytest.fixture
def openenv(monkeypatch: pytest.MonkeyPatch) -> Any:
    return import_trainer(monkeypatch, "openenv_server", OPENENV)


def test_openenv_gives_the_reward_of_each_turn(openenv: Any) -> None:
    """And messages, the end and the success; the state counts turns, and the seed binds."""

    async def play() -> Any:
        env = openenv.GemEnvironment(register("Whole"))
        assert env.state == State()
        first = await env.reset_async(seed=3, episode_id="e")
        steps = [await env.step_async(openenv.ChatAction(response="answer")) for _ in range(3)]
        return first, steps, env.state

    first, steps, state = asyncio.run(play())
    assert first.messages == ChatSession(register("Whole")).reset_sync(3)
    assert (first.done, first.reward) == (False, None)
    assert [step.reward for step in steps] == [1.0, 2.0, 3.0]
    assert [step.done for step in steps] == [False, False, True]
    assert [step.success for step in steps] == [None, None, True]
    assert steps[0].messages == [{"role": "user", "content": "Turn 1."}]
    assert state == State(episode_id="e", step_count=3, seed=3, rewards=[1.0, 2.0, 3.0])


def test_openenv_gives_no_reward_for_an_error(openenv: Any) -> None:
    """It says what failed; an environment that cannot start is an error of the request."""
    env = openenv.GemEnvironment(register("FailsInTurn", fails_in_turn=2))
    env.reset()
    assert env.step(openenv.ChatAction(response="one")).error is None
    failed = env.step(openenv.ChatAction(response="two"))
    assert (failed.done, failed.truncated, failed.reward, failed.success) == (True, True, None, None)
    assert "the server is gone" in failed.error["message"]
    with pytest.raises(EnvFaultError, match="no server"):
        openenv.GemEnvironment(register("FailsInReset", fails_in_reset=True)).reset()


def test_openenv_tells_the_model_of_a_failed_tool(openenv: Any) -> None:
    """Under the id of its call; the episode goes on."""
    env = openenv.GemEnvironment(register("Whole"), wrappers=[Divide()])
    assert [tool["function"]["name"] for tool in env.reset().tools] == ["divide"]
    function = {"name": "divide", "arguments": '{"left": 1, "right": 0}'}
    call = {"id": "c7", "type": "function", "function": function}
    step = env.step(openenv.ChatAction(tool_calls=[call]))
    (message,) = step.messages
    assert (message["role"], message["tool_call_id"], step.done, step.reward) == ("tool", "c7", False, 0.0)
    assert "division by zero" in message["content"]
    cut = env.step(openenv.ChatAction(response="half a", finish_reason="length"))
    assert cut.reward == 1.0
    assert env.session.episode.transitions[-1].action.cut_off


def test_images_become_data_urls() -> None:
    """Text beside them stays as it is."""
    image = SimpleNamespace(save=lambda file, format: file.write(b"pixels"))
    parts = [{"type": "text", "text": "Look."}, {"type": "image", "image": image}]
    (message,) = images_as_urls([{"role": "user", "content": parts}])
    url = f"data:image/png;base64,{base64.b64encode(b'pixels').decode()}"
    assert message["content"] == [parts[0], {"type": "image_url", "image_url": {"url": url}}]


# Tinker cookbook.


@dataclasses.dataclass
class Prompt:
    """``tinker.ModelInput``: here the messages, with a length."""

    messages: list[Any]

    @property
    def length(self) -> int:
        """Number of tokens: ten for each message."""
        return 10 * len(self.messages)


class Renderer:
    """The cookbook's: a token is a place in ``SAID``, and 0 ends a message."""

    said = ("", "one", "divide", "half a")
    tokenizer = SimpleNamespace(decode=lambda tokens: " ".join(Renderer.said[token] for token in tokens))

    def get_stop_sequences(self) -> list[int]:
        return [0]

    def build_generation_prompt(self, messages: list[Any]) -> Prompt:
        return Prompt(list(messages))

    def create_conversation_prefix_with_tools(self, tools: list[Any], system_prompt: str) -> list[Any]:
        return [{"role": "system", "content": f"{system_prompt} {[tool['name'] for tool in tools]}"}]

    def parse_response(self, tokens: list[int]) -> Any:
        message: dict[str, Any] = {"role": "assistant", "content": self.tokenizer.decode(tokens)}
        if 2 in tokens:
            body = {"name": "divide", "arguments": '{"left": 1, "right": 0}'}
            message["tool_calls"] = [SimpleNamespace(id=None, function=SimpleNamespace(model_dump=lambda: body))]
        return message, "stop_sequence"


def fields(*names: str) -> type:
    """Return a dataclass with required fields, and ``metrics``."""
    metrics = ("metrics", dict, dataclasses.field(default_factory=dict))
    return dataclasses.make_dataclass("Fields", [*names, metrics])


STEP = fields("reward", "episode_done", "next_observation", "next_stop_condition")
TYPES = {
    **dict.fromkeys(["Env", "EnvGroupBuilder", "RLDataset", "RLDatasetBuilder", "ActionExtra"], object),
    "StepResult": STEP,
    "InitialObservationOverflow": fields("reward"),
}
TINKER: dict[str, dict[str, Any]] = {
    "chz": {"chz": dataclasses.dataclass},
    "tinker": {"ModelInput": Prompt},
    "tinker_cookbook": {},
    "tinker_cookbook.completers": dict.fromkeys(["StopCondition", "TokenCompleter", "TokensWithLogprobs"], object),
    "tinker_cookbook.renderers": {"Renderer": Renderer, "get_renderer": lambda *given, **named: Renderer()},
    "tinker_cookbook.rl": {"types": SimpleNamespace(**TYPES)},
    "tinker_cookbook.rl.data_processing": dict.fromkeys(["assemble_training_data", "compute_advantages"]),
    "tinker_cookbook.rl.rollout_strategy": {"RetryOnFailure": None},
    "tinker_cookbook.rl.rollouts": {"do_group_rollout": None},
    "tinker_cookbook.tokenizer_utils": {"get_tokenizer": lambda name: name, "register_tokenizer": None},
}


@pytest.fixture
def tinker(monkeypatch: pytest.MonkeyPatch) -> Any:
    return import_trainer(monkeypatch, "tinker_rollouts", TINKER)


def test_tinker_keeps_the_reward_of_each_turn(tinker: Any) -> None:
    """On the transition, with the chat that grew as the next observation, and the verdict as a metric of the last."""

    async def play() -> Any:
        builder = tinker.GemGroupBuilder(register("Whole"), 3, 2, "model", "renderer")
        first, second = await builder.make_envs()
        openings = [(await each.initial_observation())[0].messages for each in (first, second)]
        steps = [await first.step([1, 0], extra={"stop_reason": "stop"}) for _ in range(3)]
        await builder.cleanup()
        return openings, steps, first.session

    openings, steps, session = asyncio.run(play())
    assert openings[0] == openings[1]  # a group shares a start
    assert [step.reward for step in steps] == [1.0, 2.0, 3.0]
    assert [step.episode_done for step in steps] == [False, False, True]
    assert [step.metrics for step in steps] == [{}, {}, {"correct": 1.0}]
    assert [message["content"] for message in steps[0].next_observation.messages[-2:]] == ["one ", "Turn 1."]
    assert session.episode.transitions[0].action.token_ids == [1, 0]
    assert str(session.episode.transitions[0].action) == "one"


def test_tinker_raises_what_is_no_verdict(tinker: Any) -> None:
    """So that the strategy leaves the episode out, or tries anew."""

    async def fail(**how: Any) -> None:
        name = "FailsInTurn" if "fails_in_turn" in how else "FailsInReset"
        env = tinker.GemEnv(ChatSession(register(name, **how)), Renderer(), seed=0)
        await env.initial_observation()
        await env.step([1, 0])
        await env.step([1, 0])

    with pytest.raises(EnvFaultError, match="the server is gone"):
        asyncio.run(fail(fails_in_turn=2))
    with pytest.raises(EnvFaultError, match="no server"):
        asyncio.run(fail(fails_in_reset=True))


def test_tinker_tells_of_tools_and_of_cut_off_responses(tinker: Any) -> None:
    """Tools stand in the system message; a failed one answers; a response that was cut off is stepped, and flagged."""

    async def play() -> Any:
        session = ChatSession(register("Whole"), native_tools=True, wrappers=[Divide()])
        env = tinker.GemEnv(session, Renderer(), seed=0)
        opening, _ = await env.initial_observation()
        called = await env.step([2, 0], extra={"stop_reason": "stop"})
        cut = await env.step([3], extra={"stop_reason": "length"})
        return opening, called, cut, session

    opening, called, cut, session = asyncio.run(play())
    assert opening.messages[0] == {"role": "system", "content": "Be brief. ['divide']"}
    answer = called.next_observation.messages[-1]
    assert (answer["role"], answer["tool_call_id"], called.reward) == ("tool", "call_0", 0.0)
    assert "division by zero" in answer["content"]
    assert (cut.reward, cut.episode_done) == (1.0, False)
    assert [turn.action.cut_off for turn in session.episode.transitions] == [False, True]


def test_tinker_ends_an_episode_whose_context_overflows(tinker: Any) -> None:
    """With the reward of its turn, unsolved; a first prompt that is too long begins no episode."""

    async def play(limit: int) -> Any:
        env = tinker.GemEnv(ChatSession(register("Whole")), Renderer(), seed=0, max_context=limit)
        opening = await env.initial_observation()
        return await env.step([1, 0]) if isinstance(opening, tuple) else opening

    assert asyncio.run(play(20)) == TYPES["InitialObservationOverflow"](0.0, metrics=tinker.OVERFLOW)
    step = asyncio.run(play(40))
    assert (step.reward, step.episode_done) == (1.0, True)
    assert step.metrics == {"stop/context_overflow": 1.0, "correct": 0.0}
    assert not asyncio.run(play(50)).episode_done
