"""``ChatSession``: an environment as a chat that only grows."""

from __future__ import annotations

import asyncio
import json
from types import SimpleNamespace
from typing import Any

import pydantic
import pytest

import gem_core as gem
from gem_core.env import Wrapper
from gem_core.errors import ArgumentError, EnvFaultError, NotSupportedError, ResetNeededError
from gem_train import ChatSession
from gem_train.adapters import images_as_urls

GUESS = "game:GuessTheNumber-v0-easy"


class CountEnv(gem.Env):
    """Pays the number of the turn; ends after three; raises on "break", and in ``reset`` where it is told to."""

    def __init__(self, breaks: bool = False) -> None:
        super().__init__()
        self.breaks, self.turn, self.closed = breaks, 0, False

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        if self.breaks:
            raise RuntimeError("no engine")
        self.turn = 0
        return f"Number {self.np_random.integers(1000)}, row {(options or {}).get('index')}.", {"system": "Count."}

    def step(self, action: str) -> Any:
        self.turn += 1
        if action == "break":
            raise RuntimeError("the engine is gone")
        if action == "malformed":
            return "nothing else"
        over = self.turn == 3
        return f"Turn {self.turn}.", float(self.turn), over, False, {"correct": True} if over else {}

    def close(self) -> None:
        self.closed = True


class Add(gem.Tool):
    """Adds."""

    name = "add"
    description = "Adds two numbers."
    concurrency = "inline"

    class Parameters(pydantic.BaseModel):
        """Two numbers."""

        left: int
        right: int

    def call(self, arguments: Any, session: Any) -> Any:
        if arguments.left < 0:
            raise ValueError("too small")
        return gem.ToolResult("?", fault="the sandbox is gone") if arguments.right < 0 else "the sum"


class RewriteHistory(Wrapper):
    """Sends the whole chat anew, the first message changed."""

    def after_step(self, action: str, result: Any) -> Any:
        return [{"role": "user", "content": "another beginning"}], *result[1:]


def test_messages_are_appended_and_rewards_are_kept():
    """The first messages begin with the system text; each step gives what the environment adds, and its reward."""
    with ChatSession(CountEnv()) as session:
        first = session.reset_sync(seed=5, options={"index": 7})
        assert [message["role"] for message in first] == ["system", "user"]
        assert first[1]["content"].endswith("row 7.")
        steps = [session.step_sync(text) for text in ("one", "two", "three")]
        assert [step.messages for step in steps] == [
            [{"role": "user", "content": f"Turn {turn}."}] for turn in (1, 2, 3)
        ]
        assert [step.done for step in steps] == [False, False, True]
        assert session.rewards == [1.0, 2.0, 3.0]
        assert (session.episode_return, session.success, session.error) == (6.0, True, None)
        said = [message["content"] for message in session.messages if message["role"] == "assistant"]
        assert said == ["one", "two", "three"]
        assert session.messages == session.episode.messages
        assert (session.episode.seed, session.episode.options) == (5, {"index": 7})


def test_asynchronous_form_gives_the_same_episode():
    """``await reset`` and ``await step`` do what their plain forms do."""

    async def first(session: ChatSession) -> str:
        return str((await session.reset(seed=3, options={"index": 7}))[-1]["content"])

    async def play(session: ChatSession) -> gem.Episode:
        await session.reset(seed=3)
        while not session.done:
            await session.step("\\boxed{5}")
        return session.episode

    plain = ChatSession(GUESS)
    plain.reset_sync(seed=3)
    while not plain.done:
        plain.step_sync("\\boxed{5}")
    assert asyncio.run(play(ChatSession(GUESS))) == plain.episode
    assert asyncio.run(first(ChatSession(CountEnv()))).endswith("row 7.")


def test_exception_in_step_is_an_error_and_no_loss():
    """The episode is cut off, its success unknown; an environment made from an id is made anew."""
    made: list[CountEnv] = []

    def make() -> CountEnv:
        made.append(CountEnv())
        return made[-1]

    gem.register("check:Count-v0", make)
    session = ChatSession("check:Count-v0")
    for fault, told in (("break", "RuntimeError: the engine is gone"), ("malformed", "TypeError: CountEnv: step must")):
        session.reset_sync(seed=0)
        session.step_sync("one")
        step = session.step_sync(fault)
        assert (step.messages, step.truncated, step.terminated) == ([], True, False)
        assert step.error is not None
        assert step.error["kind"] == "exception"
        assert step.error["message"].startswith(f"step raised {told}")
        assert session.error == step.error
        assert session.success is None
        assert session.rewards == [1.0, 0.0]
    session.reset_sync()
    assert [env.closed for env in made] == [True, True, False]
    bare = ChatSession(CountEnv())  # without the guard that make puts around it
    bare.reset_sync()
    assert bare.step_sync("malformed").error is not None


def test_exception_in_reset_is_raised():
    """There is no episode then, plain or asynchronous."""
    session = ChatSession(CountEnv(breaks=True))
    with pytest.raises(EnvFaultError, match="reset raised RuntimeError: no engine"):
        session.reset_sync()
    with pytest.raises(EnvFaultError, match="no engine"):
        asyncio.run(session.reset())
    with pytest.raises(ResetNeededError):
        session.step_sync("one")


def test_steps_outside_an_episode_and_other_types_are_refused():
    """Before the first reset, after the end, after ``close``; and a response that is no text."""
    session = ChatSession(CountEnv())
    with pytest.raises(ResetNeededError):
        session.step_sync("early")
    with pytest.raises(ResetNeededError):
        _ = session.episode
    session.reset_sync()
    with pytest.raises(ArgumentError, match="give '' for one without text"):
        session.step_sync(None)  # type: ignore[arg-type]
    session.close()
    with pytest.raises(ResetNeededError):
        session.step_sync("late")
    with pytest.raises(ResetNeededError, match="make another"):
        session.reset_sync()


def test_tools_are_offered_in_text_or_natively():
    """A native call is answered under its id, a failed one too; the words that explain the text form are left out."""

    def call(left: int, right: int) -> gem.Response:
        function = {"name": "add", "arguments": json.dumps({"left": left, "right": right})}
        return gem.Response("", tool_calls=[{"id": "c1", "type": "function", "function": function}])

    session = ChatSession(GUESS, wrappers=[Add()], native_tools=True)
    (task,) = session.reset_sync(seed=0)
    assert "<tool_call>" not in task["content"]
    assert session.tools[0]["function"]["name"] == "add"
    (answer,) = session.step_sync(call(1, 2)).messages
    assert (answer["role"], answer["tool_call_id"]) == ("tool", "c1")
    assert "the sum" in str(answer["content"])
    (answer,) = session.step_sync(call(-1, 2)).messages
    assert "too small" in str(answer["content"])
    assert session.error is None
    step = session.step_sync(call(1, -2))
    assert step.truncated
    assert step.error == {"kind": "tool", "message": "the sandbox is gone"}

    in_text = ChatSession(GUESS, wrappers=[Add()])
    assert "<tool_call>" in in_text.reset_sync(seed=0)[-1]["content"]
    (answer,) = in_text.step_sync(
        '<tool_call>{"name": "add", "arguments": {"left": 1, "right": 1}}</tool_call>'
    ).messages
    assert (answer["role"], "the sum" in answer["content"]) == ("user", True)


def test_text_of_messages_can_be_encoded():
    """A lone surrogate, which tokenizers and servers refuse, is a question mark; the record keeps it."""
    session = ChatSession(GUESS, wrappers=[Add()])
    session.reset_sync(seed=0)
    call = '<tool_call>{"name": "\\udc00", "arguments": {}}</tool_call>'
    (answer,) = session.step_sync(f"\ud800{call}").messages
    assert "\udc00" in str(session.episode.messages[-1]["content"])
    assert "?" in answer["content"]
    json.dumps(session.messages, ensure_ascii=False).encode()


def test_history_that_is_rewritten_is_refused():
    """A trainer has tokenized it already."""
    session = ChatSession(RewriteHistory(CountEnv()))
    session.reset_sync()
    with pytest.raises(NotSupportedError, match="rewrites messages"):
        session.step_sync("one")


def test_cancelled_step_ends_the_episode():
    """Nobody knows what the environment did meanwhile."""

    class Slow(gem.AsyncEnv):
        async def reset_async(self, seed: int | None = None, options: Any = None) -> Any:
            await super().reset_async(seed)
            return "Wait.", {}

        async def step_async(self, action: str) -> Any:
            await asyncio.Event().wait()

    async def cancel() -> ChatSession:
        session = ChatSession(Slow())
        await session.reset()
        task = asyncio.ensure_future(session.step("go"))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        return session

    session = asyncio.run(cancel())
    assert session.done
    with pytest.raises(ResetNeededError):
        session.step_sync("again")


def test_images_become_data_urls():
    """For messages that go through JSON."""
    image = SimpleNamespace(save=lambda file, format: file.write(b"pixels"))
    parts = [{"type": "text", "text": "Look."}, {"type": "image", "image": image}]
    (message,) = images_as_urls([{"role": "user", "content": parts}])
    assert message["content"] == [
        parts[0],
        {"type": "image_url", "image_url": {"url": "data:image/png;base64,cGl4ZWxz"}},
    ]
