"""Chat views: messages, the text of a template, and budgets."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from toys import CountdownEnv, EchoEnv, Notebook

import gem_core as gem
from gem_core.env.observations import texts_of
from gem_core.errors import ArgumentError
from gem_core.tools.env import ToolEnv
from gem_core.wrappers.chat import ConcatChat, MessagesView
from gem_core.wrappers.views import Concat, ConcatWithAction


class Template:
    """A tokenizer with a small chat template in the manner of ChatML, which drops thinking of earlier turns."""

    eos_token = "<|end|>"

    def apply_chat_template(
        self, messages: list[dict[str, Any]], *, tokenize: bool, add_generation_prompt: bool, **options: Any
    ) -> str:
        assert tokenize is False
        lines = []
        for message in messages:
            content = str(message["content"]).rpartition("</think>")[2]
            lines.append(f"<|{message['role']}|>{content}<|end|>\n")
        return "".join(lines) + ("<|assistant|>" if add_generation_prompt else "") + options.get("more", "")

    def encode(self, text: str) -> list[str]:
        return text.split()


def played(view: Any, actions: list[str]) -> list[Any]:
    observations = [view.reset(seed=1, options={"left": 100})[0]]
    return observations + [view.step(action)[0] for action in actions]


def test_messages_are_a_chat() -> None:
    """User and assistant in turn, each answer as it was then."""
    assert played(MessagesView(CountdownEnv()), ["a", "b"])[-1] == [
        {"role": "user", "content": "Count down.\nLeft: 100."},
        {"role": "assistant", "content": "a"},
        {"role": "user", "content": "You said 'a'.\nLeft: 99."},
        {"role": "assistant", "content": "b"},
        {"role": "user", "content": "You said 'b'.\nLeft: 98."},
    ]


def test_concat_chat_appends_the_raw_response_and_the_bridge() -> None:
    """The template would drop earlier thinking; the text keeps what was sampled."""
    texts = played(ConcatChat(CountdownEnv(), Template()), ["<think>hm</think>a", "b"])
    assert texts[-1] == (
        "<|user|>Count down.\nLeft: 100.<|end|>\n<|assistant|><think>hm</think>a<|end|>\n"
        "<|user|>You said '<think>hm</think>a'.\nLeft: 99.<|end|>\n<|assistant|>b<|end|>\n"
        "<|user|>You said 'b'.\nLeft: 98.<|end|>\n<|assistant|>"
    ).replace("You said '<think>hm</think>a'", "a'")
    assert texts[-1].startswith(texts[-2] + "b")


def test_an_end_of_turn_in_the_response_is_not_written_twice() -> None:
    """Some trainers keep special tokens in the text."""
    texts = played(ConcatChat(EchoEnv(), Template()), ["hi<|end|>", "GEM-BRIDGE-MARK"])
    assert "hi<|end|>\n<|user|>" in texts[-1]
    assert texts[-1].endswith("GEM-BRIDGE-MARK<|end|>\n<|user|>Heard: GEM-BRIDGE-MARK<|end|>\n<|assistant|>")


def test_concat_chat_with_a_limit_renders_the_whole_chat() -> None:
    """Then nothing can be appended to."""
    view = ConcatChat(CountdownEnv(), Template(), max_turns=1, template_options={"more": "!"})
    assert not view.append_only
    assert played(view, ["a", "b"])[-1] == (
        "<|user|>Count down.\nLeft: 100.<|end|>\n<|assistant|>b<|end|>\n"
        "<|user|>You said 'b'.\nLeft: 98.<|end|>\n<|assistant|>!"
    )


def extends(earlier: Any, action: str, later: Any) -> bool:
    if isinstance(earlier, str):
        return bool(later.startswith(earlier + action))
    return bool(later[: len(earlier)] == earlier and later[len(earlier)] == {"role": "assistant", "content": action})


CHAT = [
    MessagesView,
    lambda env: MessagesView(env, max_turns=2),
    lambda env: ConcatChat(env, Template()),
]


@pytest.mark.parametrize("make", CHAT)
@given(actions=st.lists(st.text(max_size=10), min_size=3, max_size=5))
def test_append_only_is_kept(make: Any, actions: list[str]) -> None:
    """A view that declares it extends the previous observation and the raw response, and one with a limit does not."""
    view = make(CountdownEnv())
    observations = played(view, actions)
    assert view.append_only == (view.max_turns is None)
    assert all(map(extends, observations, actions, observations[1:])) == view.append_only
    assert view.observation_space.contains(observations[-1])


def words(text: str) -> int:
    return len(text.split())


@pytest.mark.parametrize("count_tokens", [words, Template()])
def test_the_budget_drops_the_oldest_turns(count_tokens: Any) -> None:
    """As few as needed, and the task stays."""
    view = ConcatWithAction(CountdownEnv(), max_tokens=13, count_tokens=count_tokens)
    observations = played(view, ["a", "b", "c"])
    assert observations[2] == "Count down.\na\nYou said 'a'.\nb\nYou said 'b'.\nLeft: 98."
    assert observations[3] == "Count down.\nb\nYou said 'b'.\nc\nYou said 'c'.\nLeft: 97."
    assert all(words(observation) <= 13 for observation in observations)


def test_a_context_that_overflows_truncates_and_is_scored() -> None:
    """It is the agent's doing: no error."""
    view = ConcatWithAction(EchoEnv(), max_tokens=6, count_tokens=words)
    view.reset()
    _, reward, terminated, truncated, info = view.step("one two three four five")
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["context_overflow"]
    assert "error" not in info


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Concat(CountdownEnv(), max_tokens=3, count_tokens=words).reset(), "which is 3"),
        (lambda: Concat(EchoEnv(), max_tokens=3), "count_tokens"),
        (lambda: Concat(EchoEnv(), max_tokens=0, count_tokens=words), "max_tokens"),
        (lambda: Concat(EchoEnv(), max_turns="3"), "max_turns"),  # type: ignore[arg-type]  # that is the point
        (lambda: ConcatChat(EchoEnv(), object()), "apply_chat_template"),
    ],
)
def test_options_that_cannot_work_are_refused(make: Any, message: str) -> None:
    """Also a budget that not even the task fits, at the first reset."""
    with pytest.raises(ArgumentError, match=message):
        make()


def test_native_calls_count_towards_the_budget() -> None:
    """A server counts what a model wrote into its calls, and its thinking where that is sent back."""
    call = {"id": "a", "type": "function", "function": {"name": "note", "arguments": '{"line": "one two three four"}'}}
    message = {"role": "assistant", "content": "", "tool_calls": [call], "reasoning_content": "well"}
    assert texts_of([message]) == ["well", "note", '{"line": "one two three four"}']
    env = MessagesView(
        ToolEnv(CountdownEnv(), [Notebook()], max_tool_uses=None),
        max_tokens=150,
        count_tokens=lambda text: len(text.split()),
    )
    env.reset(seed=1, options={"left": 100})
    long = {**call, "function": {"name": "note", "arguments": json.dumps({"line": "x"}) + " " * 5 + "y " * 200}}
    assert env.step(gem.Response("", tool_calls=[long]))[4]["context_overflow"] is True
