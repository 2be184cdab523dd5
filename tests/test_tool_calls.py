"""What counts as a call in the text of a response, what is told to the agent, and that none of it reaches the task."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

import pydantic
import pytest
from hypothesis import given
from hypothesis import strategies as st
from toys import Calculator, EchoEnv

import gem_core as gem
from gem_core.registry.lookup import Registry
from gem_core.registry.specs import CallFormatSpec
from gem_core.tools.env import ToolEnv


class Lookup(gem.Tool):
    """Has one text and an option; fenced blocks are calls too."""

    name = "lookup"
    fences = ("lookup",)
    concurrency = "inline"

    class Parameters(pydantic.BaseModel):
        """A text."""

        query: str
        top_k: int = 3

    def call(self, arguments: Parameters, session: Any) -> str:
        return f"[{arguments.query}|{arguments.top_k}]"


class Recorder(EchoEnv):
    """Keeps what reached it; is answered in fenced blocks of text."""

    def __init__(self) -> None:
        super().__init__()
        self.heard: list[str] = []

    def step(self, action: str) -> Any:
        self.heard.append(action)
        return super().step(action)


def around(*tools: gem.Tool, **options: Any) -> ToolEnv:
    env = ToolEnv(Recorder(), list(tools) or [Lookup(), Calculator()], **{"max_tool_uses": None, **options})
    env.reset()
    return env


def answer(action: str, **options: Any) -> tuple[str, Any] | str | None:
    """Return name and arguments of the call that was executed, or what is told of one that was refused.

    None where the task got the response, to the letter; it hears nothing of the others.
    """
    env = around(**options)
    info = env.step(action)[4]
    heard = env.unwrapped.heard  # type: ignore[attr-defined]  # of Recorder
    assert heard == ([] if "tool" in info else [action])
    if "tool" not in info:
        return None
    assert info["tool"]["uses"] == 1
    if info["tool"]["failed"]:
        return str(info["feedback"]).partition("\n")[2].partition("\nYou may")[0]
    return info["tool"]["name"], info["tool"]["arguments"]


def query(text: str) -> tuple[str, Any]:
    return "lookup", {"query": text}


def json_call(name: str, **arguments: Any) -> str:
    return f"<tool_call>{json.dumps({'name': name, 'arguments': arguments})}</tool_call>"


QUERY = query("x")
CALL = "<lookup>x</lookup>"
INNER = json_call("calculator", left=1, right=1)


@pytest.mark.parametrize(
    ("action", "expected"),
    [
        # JSON, as models write it; a program in a string is what it is.
        ('I look: <tool_call>{"name": "lookup", "arguments": {"query": "x"}}</tool_call>', QUERY),
        ('<tool_call>{"name": "lookup", "parameters": {"query": "x"}} ', QUERY),
        ('<tool_call>{"name": "lookup", "arguments": "{\\"query\\": \\"x\\"}"}</tool_call>', QUERY),
        ('<tool_call>{"name": "lookup", "arguments": "x"}</tool_call>', QUERY),
        (json_call("lookup", query="print('</tool_call>')\n[1, ]"), query("print('</tool_call>')\n[1, ]")),
        ('<tool_call>{"name": "lookup", "arguments": {"query": "a\nb,]"}}</tool_call>', query("a\nb,]")),
        # In a block of another language, unless that is the task's answer.
        (f"```xml\n{CALL}\n```", QUERY),
        (f"```text\nprint('{CALL}')\n```", None),
        (f"```text\nmine\n```\n{CALL}", QUERY),
        ("<lookup>\n```text\nx\n```\n</lookup>", query("```text\nx\n```")),
        # A tag around a fence is one call.
        *((f"<lookup>\n{fence}\nx\n{fence[:3]}\n</lookup>", QUERY) for fence in ("```lookup", "```", "~~~lookup")),
        # Of two nested calls the outer one is executed.
        (f"<lookup>{INNER}</lookup>", query(INNER)),
        (json_call("lookup", query="<lookup>y</lookup>"), query("<lookup>y</lookup>")),
        ("```lookup\nso <lookup>y</lookup>\n```", query("so <lookup>y</lookup>")),
        # Behind thinking, between two blocks, or in one that is never closed, as where the server stopped at the call.
        (f"<think>maybe <lookup>y</lookup></think>{CALL}", QUERY),
        (f"maybe <lookup>y</lookup></think>{CALL}", QUERY),
        (f"<think>is it <lookup> or so</think> {CALL}", QUERY),
        (f"<think>a</think> {CALL} <think>{CALL}</think> 42", QUERY),
        (f"<think>I am not done and {CALL}", QUERY),
        ("<think>a</think>```lookup\nx\n```\n", QUERY),
        # Beside an answer or a quotation, or in backticks as a whole.
        (f"`<lookup>` it is: {CALL}", QUERY),
        (f"`{CALL}`", QUERY),
        (f"<answer>{CALL}</answer>", QUERY),
        (f"I write <answer> later. {CALL} <answer>42</answer>", QUERY),
        (f"<answer>42</answer> {CALL}", QUERY),
        # The server stopped at its end.
        ("<lookup>x", QUERY),
        ("```lookup\nx", QUERY),
    ],
)
def test_a_call_is_executed(action: str, expected: Any) -> None:
    """Or, where it is part of the task's answer, left to the task."""
    assert answer(action) == expected


@pytest.mark.parametrize("text", ["<think>y</think>", "<answer>y</answer>", "print('<lookup>')", "`<calculator>`"])
def test_thinking_answers_and_quotations_inside_a_call_belong_to_it(text: str) -> None:
    """As in a program that prints them, in each form of a call."""
    assert answer(f"<lookup>{text}</lookup>") == query(text)
    assert answer(json_call("lookup", query=text)) == query(text)
    assert answer(f"<think>hm</think>\n```lookup\n{text}\n```\nmore") == query(text)


@pytest.mark.parametrize(
    "action",
    [
        "<b>x</b> </lookup> <looking>x</looking>",
        "<answer>x</answer>",
        # Thinking, whether it was opened in the response or by the template before it.
        f"<think>shall I write {CALL}?</think> 42",
        f"shall I write {CALL}?</think> 42",
        f"<think>{CALL}</think><think>{CALL}</think> 42",
        "<think>is it <lookup> or so</think> 42 </lookup>",
        "<think>```lookup\nx\n```\n</think> 42",
        "<think><tool_call>{</think> 42",
        # What is in backticks, a lone tag in quotation marks, and whatever stands within the tag of an answer.
        f"I would write `{CALL}`, or ``{CALL}``, between `<lookup>` and `</lookup>`, but I know it: 42",
        'I called the "<lookup>" before; it is 42',
        "With '<tool_call>' one calls; it is 42",
        f"<answer>Write {CALL} to ask</answer>",
        "I put it into <answer> now: <answer>a <lookup> b</answer>",
    ],
)
def test_what_is_no_call_is_the_tasks(action: str) -> None:
    """Thoughts, answers, quotations and other tags."""
    assert answer(action) is None


@pytest.mark.parametrize(
    ("action", "told"),
    [
        ('<tool_call>{"name": "calculator", "arguments": "twelve"}</tool_call>', "its arguments are no valid JSON"),
        ('<tool_call>{"name": "lookup", "arguments": null}</tool_call>', "query: Field required"),
        ('<tool_call>{"name": "lookup", "arguments": {"query": "x",,}}</tool_call>', "is no valid JSON"),
        ("<tool_call>{", "<tool_call>"),
        ("<tool_call>[]</tool_call>", "a call must be an object of the form"),
        ("<tool_call>" + "[" * 100_000 + "</tool_call>", "is no valid JSON: it is nested too deeply"),
        ('<tool_call>{"name": "lookup", "x": NaN}</tool_call>', "is no valid JSON: NaN is no finite number"),
        ('<tool_call>{"name": "lookup", "x": 1e999}</tool_call>', "is no valid JSON: 1e999 is no finite number"),
        (json_call("calculater"), "no tool 'calculater'. Did you mean 'calculator'? There are: lookup, calculator"),
        (json_call("calculator", left="x", right=1), "left: Input should be a valid number"),
        ("<lookup>", "<lookup> is never closed by </lookup>"),
        ("```lookup\n", "the fenced block is never closed"),
        (gem.Response("<lookup>x", finish_reason="length"), "cut off at the limit of its length"),
    ],
)
def test_a_call_that_cannot_be_read_is_told(action: str, told: str) -> None:
    """In words that say what was expected; it is a use, and the task hears nothing."""
    assert told in str(answer(action))


def test_the_first_complete_call_counts_and_what_follows_is_left_out() -> None:
    """Also behind thinking, whose place in the text is kept, and behind a tag that is never closed."""
    info = around().step(f"<think>{CALL}</think>{CALL} and {CALL}")[4]
    assert info["parsed_action"] == f"<think>{CALL}</think>{CALL}"
    assert info["tool"]["uses"] == 1
    assert answer(f"<lookup> {INNER}") == ("calculator", {"left": 1, "right": 1})


def test_without_tools_a_call_is_told_all_the_same() -> None:
    """As where a server offers none today."""
    env = ToolEnv(EchoEnv(), [])
    assert env.reset()[0] == "Say something."
    assert "no tool 'lookup'. There are: none" in env.step(json_call("lookup", query="x"))[0]


@pytest.mark.parametrize("tag", ["answer", "think"])
def test_a_tool_of_the_name_of_a_tag_of_the_tasks_is_called_in_json_only(tag: str) -> None:
    """The task gets its answers and thinking stays thinking; the agent is told the form that is left."""

    class Named(Lookup):
        name = tag

    env = around(Named())
    response = f"<{tag}>x</{tag}>7"
    assert env.step(response)[0] == f"Heard: {response}"
    assert f"Output of {tag}:\n[x|3]" in env.step(json_call(tag, query="x"))[0]
    explained = str(env.reset()[0])
    assert f'Call it with <tool_call>{{"name": "{tag}"' in explained
    assert f"<{tag}>query" not in explained


def test_the_tag_of_thinking_may_be_another_or_none() -> None:
    """For models that call tools in the middle of it."""
    assert answer(f"<think>{CALL}</think> 42", thinking_tag=None) == answer(f"<think>{CALL}</think>", thinking_tag="x")
    assert answer(f"<thought>{CALL} so it is</thought> 42", thinking_tag="thought") is None


def read_shout(opening: re.Match[str], tools: Mapping[str, gem.Tool]) -> gem.ToolCall | None:
    """Read ``NAME! text!``, as no model writes it."""
    found = re.compile(r" ([^!]*)(!?)").match(opening.string, opening.end())
    if found is None or opening[1].lower() not in tools:
        return None
    error = None if found[2] else "nobody hears it"
    return gem.ToolCall(opening[1].lower(), {"query": found[1]}, opening.start(), found.end(), error)


@pytest.mark.parametrize(
    ("text", "begins", "expected"),
    [
        ("LOOKUP! x!", "calls", "x"),
        ("HELP! me! and LOOKUP! x!", "calls", "x"),
        ("<lookup>y</lookup> LOOKUP! x!", "calls", "y"),
        ("LOOKUP! x! <lookup>y</lookup>", "calls", "x"),
        ("LOOKUP! x <lookup>y</lookup>", "calls", "y"),
        ("<think>LOOKUP! x!</think> 42", "calls", None),
        ("<answer>I say LOOKUP! x!</answer>", "calls", None),
        ("`LOOKUP! x!` I would say; it is 42", "calls", None),
        # What has the shape of an answer, as bare JSON has it, is none beside an answer.
        ("LOOKUP! x!", "anything", "x"),
        ("LOOKUP! x! \\boxed{42}", "anything", None),
        ("<answer>42</answer> LOOKUP! x!", "anything", None),
    ],
)
def test_a_form_of_a_plugin_is_read_beside_the_others(
    text: str, begins: Any, expected: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of all calls the first that is complete counts, and what is thought, answered or quoted is none in any form."""
    shout = CallFormatSpec(name="shout", opening="([A-Z]+)!", begins=begins, entry_point=read_shout)
    monkeypatch.setattr(Registry, "specs", lambda self, kind: [shout])
    assert answer(text) == (None if expected is None else query(expected))


@pytest.mark.parametrize("wrong", [{"opening": "("}, {"opening": 3}, {"opening": "x", "begins": "never"}])
def test_a_form_of_calls_needs_an_opening_that_can_be_searched_for(wrong: Any) -> None:
    """It is refused when it is offered, not when a model writes."""
    with pytest.raises(gem.errors.RegistrationError):
        CallFormatSpec(name="mine", entry_point=read_shout, **wrong)


PIECES = [
    *(CALL, "<lookup>", "</lookup>", "<think>", "</think>", "<tool_call>", "</tool_call>", '{"name": "lookup", '),
    *('"arguments": {', '"query": "x"', "}", "{", '"', "\\", ",", "```lookup\n", "```text\n", "\n```\n", "~~~"),
    *("<calculator>", "</calculator>", "<answer>", "`<lookup>`", "<lookup query='x'>", "\n", " ", "é", "\ud800"),
]
TEXTS = st.lists(st.sampled_from(PIECES) | st.text(max_size=3), max_size=25).map("".join)


@given(TEXTS)
def test_every_text_is_answered_by_the_tool_or_by_the_task(action: str) -> None:
    """By one of the two, never by an exception, and a call lies within the response."""
    env = around()
    call = env.find_call(action)
    if call is not None:
        assert 0 <= call.start <= len(action)
        assert call.error is not None or call.start < call.end <= len(action)
    info = env.step(action)[4]
    assert (env.unwrapped.heard == []) is ("tool" in info) is (call is not None)
    json.dumps(info["tool"] if call else None, allow_nan=False)


QUIET = st.lists(
    st.sampled_from([piece for piece in PIECES if not re.search("think|text|[`~]", piece)])
    | st.text("ab <>{", max_size=3),
    max_size=12,
).map("".join)


@given(QUIET, st.sampled_from([CALL, json_call("lookup", query="x"), "\n```lookup\nx\n```\n"]), QUIET)
def test_no_text_around_a_call_takes_it_to_the_task(before: str, call: str, after: str) -> None:
    """Thinking, answers and quotations apart, whatever stands around a whole call, the task hears nothing."""
    env = around()
    assert "tool" in env.step(before + call + after)[4]
    assert env.unwrapped.heard == []


HOSTILE = [
    *("<lookup>", "<think>", "</think>", "<tool_call>", "<tool_call>{", "<think><lookup></think>", '<tool_call>"\\'),
    *("<think><tool_call></think>", '"\\', "<calculator>", "```lookup\n", "```text\n", ",", "[", "`", "``", "'<a"),
    *("<lookup></think>", "`<lookup>", "<lookup query=", "</answer>", "<answer>", '{"name": "lookup", '),
]


@pytest.mark.parametrize("piece", HOSTILE)
@pytest.mark.few(5)
def test_megabytes_of_any_piece_are_read(piece: str) -> None:
    """In time that grows with the length: where it grew with its square, this would take hours."""
    text = piece * (1_500_000 // len(piece))
    for action in (text, f"<tool_call>{text}</tool_call>", f"{text}</lookup>", f"{text}</think>"):
        around().find_call(action)
