"""What counts as a call in the text of a response, what is told to the agent, and that none of it reaches the task."""

from __future__ import annotations

import itertools
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
from gem_core.tools.calls import WELL_KNOWN
from gem_core.tools.env import ToolEnv


class Lookup(gem.Tool):
    """Has one text and an option; fenced blocks are calls too."""

    name = "lookup"
    description = "Looks something up."
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


def called(action: str, **options: Any) -> tuple[str, Any] | None:
    """Return name and arguments of the call that was executed; None where the task got the response."""
    env = around(**options)
    info = env.step(action)[4]
    if "tool" not in info:
        assert env.unwrapped.heard == [action]
        return None
    assert env.unwrapped.heard == []
    assert not info["tool"]["failed"], info["feedback"]
    return info["tool"]["name"], info["tool"]["arguments"]


def refused(action: str, **options: Any) -> str:
    """Return what the agent is told of a call that cannot be read; it is a use, and nothing reaches the task."""
    env = around(**options)
    info = env.step(action)[4]
    assert env.unwrapped.heard == []
    assert (info["tool"]["uses"], info["tool"]["failures"]) == (1, 1)
    return str(info["feedback"]).partition("\n")[2].partition("\nYou may")[0]


QUERY = ("lookup", {"query": "x"})


@pytest.mark.parametrize(
    "content",
    [
        '{"name": "lookup", "arguments": {"query": "x"}}',
        '{"name": "lookup", "parameters": {"query": "x"}}',
        '{"name": "lookup", "arguments": "{\\"query\\": \\"x\\"}"}',
        '{"name": "lookup", "arguments": "x"}',
    ],
)
def test_json_calls_as_models_write_them(content: str) -> None:
    """The form of the instructions; gem-tools reads those of model families."""
    assert called(f"I look: <tool_call>{content}</tool_call>") == QUERY


def test_a_json_call_may_hold_what_looks_like_its_end_and_line_breaks() -> None:
    """A program in a string is what it is, commas included."""
    program = "print('</tool_call>')\n[1, ]"
    assert called(json_call("lookup", query=program)) == ("lookup", {"query": program})
    raw = '<tool_call>{"name": "lookup", "arguments": {"query": "a\nb,]"}}</tool_call>'
    assert called(raw) == ("lookup", {"query": "a\nb,]"})


def json_call(name: str, **arguments: Any) -> str:
    return f"<tool_call>{json.dumps({'name': name, 'arguments': arguments})}</tool_call>"


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ('{"name": "lookup", "arguments": "{\\"query\\": "}', "its arguments are no valid JSON: Expecting value"),
        ('{"name": "calculator", "arguments": "12"}', "its arguments must be an object of names and values"),
        ('{"name": "calculator", "arguments": "twelve"}', "its arguments are no valid JSON: Expecting value"),
        ('{"name": "lookup", "arguments": null}', "The arguments are not valid. query: Field required"),
        ('{"name": "lookup", "arguments": {"query": "x",,}}', "is no valid JSON"),
        ('{"arguments": {}}', "a call must be an object of the form"),
        ("[]", "a call must be an object of the form"),
        ('{"name": "lookup", "arguments": {"query": "x"}} and more', "is no valid JSON: Extra data"),
        ("", "is no valid JSON"),
    ],
)
def test_json_that_cannot_be_read_is_told(content: str, told: str) -> None:
    """In words that say what was expected."""
    assert told in refused(f"<tool_call>{content}</tool_call>")


def test_a_tool_without_a_text_form_takes_its_arguments_in_a_tag() -> None:
    """Agents write it so, and what else stands there is told."""
    assert called('<calculator>{"left": 1, "right": 2}</calculator>') == ("calculator", {"left": 1, "right": 2})
    told = "between <calculator> and </calculator> must stand its arguments as a JSON object"
    assert told in refused("<calculator>1 + 2</calculator>")
    assert told in refused("<calculator>[1]</calculator>")
    assert "<calculator> is never closed by </calculator>" in refused("<calculator>1")
    assert "left: Field required" in refused("<calculator></calculator>")


@pytest.mark.parametrize("tag", ["Lookup", "lokup", "lookupp", "lokoup", "lookop", "Calculators"])
def test_a_tag_that_is_a_tool_but_for_one_letter_is_told(tag: str) -> None:
    """It was surely meant for the tool, and would be a wrong answer."""
    assert f"no tool '{tag}'. Did you mean" in refused(f"<{tag}>x</{tag}>")


@pytest.mark.parametrize("tag", WELL_KNOWN)
def test_a_tag_that_models_call_tools_by_is_told(tag: str) -> None:
    """Also where there is no such tool, and none like it."""
    assert f"no tool '{tag}'. There are: lookup, calculator" in refused(f"so: <{tag}>x</{tag}>")


def test_without_tools_a_call_is_told_all_the_same() -> None:
    """As where a server offers none today."""
    env = ToolEnv(EchoEnv(), [])
    assert env.reset()[0] == "Say something."
    assert "no tool 'lookup'. There are: none" in env.step(json_call("lookup", query="x"))[0]


@pytest.mark.parametrize(
    "answer",
    [
        "<b>x</b>",
        "<look>x</look>",
        "<lokup>",
        "<lokup>x</lookupp>",
        "</lookup>",
        "<looking>x</looking>",
        "<answer>x</answer>",
    ],
)
def test_other_tags_are_the_tasks(answer: str) -> None:
    """Nobody can know that they were meant for a tool."""
    assert called(answer) is None


def test_a_tool_of_the_name_of_an_answers_tag_is_called_in_json_only() -> None:
    """The task gets its answers, and the agent is told the form that is left."""

    class Answer(Lookup):
        name = "answer"

    env = around(Answer())
    assert env.step("<answer>x</answer>")[0] == "Heard: <answer>x</answer>"
    assert "Output of answer:\n[x|3]" in env.step(json_call("answer", query="x"))[0]
    assert 'Call it with <tool_call>{"name": "answer"' in env.reset()[0]
    assert "<answer>query" not in env.reset()[0]


def test_a_tool_may_be_called_as_the_tag_of_thinking() -> None:
    """Some servers offer one; it is called in JSON, and thinking stays thinking."""

    class Think(Lookup):
        name = "think"

    env = around(Think())
    assert env.step("<think>x</think>7")[0] == "Heard: <think>x</think>7"
    assert "Output of think" in env.step(json_call("think", query="x"))[0]


CALL = "<lookup>x</lookup>"


@pytest.mark.parametrize(
    "action",
    [
        f"<think>shall I write {CALL}?</think> 42",
        f"shall I write {CALL}?</think> 42",
        f"<think>{CALL}</think><think>{CALL}</think> 42",
        "<think>is it <lookup> or so</think> 42",
        "<think>is it <lookup> or so</think> 42 </lookup>",
        "<think>```lookup\nx\n```\n</think> 42",
        "<think><tool_call>{</think> 42",
    ],
)
def test_what_is_thought_is_not_called(action: str) -> None:
    """A closed thinking block is no call, whether it was opened in the response or by the template before it."""
    assert called(action) is None


@pytest.mark.parametrize(
    "action",
    [
        f"<think>I have to look it up.</think>{CALL}",
        f"<think>maybe <lookup>y</lookup></think>{CALL}",
        f"maybe <lookup>y</lookup></think>{CALL}",
        f"<think>is it <lookup> or so</think> {CALL}",
        f"<think>a</think> {CALL} <think>{CALL}</think> 42",
        f"<think>I am not done and {CALL}",
        "<think>a</think>\n```lookup\nx\n```\n",
        "<think>a</think>```lookup\nx\n```\n",
        f"```text\nquoted </think>\n```\n{CALL}",
    ],
)
def test_a_call_beside_thinking_is_executed(action: str) -> None:
    """Behind the block, between two, or in one that is not closed, as where the server stopped at the call."""
    assert called(action) == QUERY


@pytest.mark.parametrize(
    "query", ["</think>", "<think>", "<think>y</think>", "a</think>b<think>c", "<think></think>" * 3]
)
def test_tags_of_thinking_inside_a_call_belong_to_it(query: str) -> None:
    """As in a program that prints them, in each form of a call."""
    expected = ("lookup", {"query": query})
    assert called(f"<lookup>{query}</lookup>") == expected
    assert called(json_call("lookup", query=query)) == expected
    assert called(f"```lookup\n{query}\n```") == expected
    assert called(f"<think>hm</think><lookup>{query}</lookup> more") == expected


def test_a_response_that_is_all_thinking_and_holds_a_call_is_told() -> None:
    """The call is not executed, and the thinking is no answer."""
    told = "it stands in a thinking block, where nothing is called; write it behind </think>"
    assert told in refused(f"<think>{CALL}</think>\n")
    assert told in refused(f"so {CALL}</think>")
    assert called("<think>nothing of the kind</think>") is None


def test_thinking_may_count_as_any_text() -> None:
    """For models that call tools in the middle of it."""
    assert called(f"<think>{CALL} so it is</think> 42", thinking_tag=None) == QUERY
    assert called(f"<think>{CALL} so it is</think> 42", thinking_tag="thought") == QUERY
    assert called(f"<thought>{CALL} so it is</thought> 42", thinking_tag="thought") is None


def test_a_call_in_a_block_of_another_language_is_executed() -> None:
    """Models wrap their calls; but what is the task's answer is left alone, whatever stands in it."""
    assert called(f"```xml\n{CALL}\n```") == QUERY
    assert called(f"```json\n{json_call('lookup', query='x')}\n```") == QUERY
    assert called(f"```text\nprint('{CALL}')\n```") is None
    assert called(f"```text\nmine\n```\n{CALL}") == QUERY
    assert called("<lookup>\n```text\nx\n```\n</lookup>") == ("lookup", {"query": "```text\nx\n```"})


def test_of_two_nested_calls_the_outer_one_is_executed() -> None:
    """What it holds is its argument."""
    assert called("<lookup><calculator>1</calculator></lookup>") == ("lookup", {"query": "<calculator>1</calculator>"})
    inner = json_call("calculator", left=1, right=1)
    assert called(f"<lookup>{inner}</lookup>") == ("lookup", {"query": inner})
    assert called(json_call("lookup", query="<lookup>y</lookup>")) == ("lookup", {"query": "<lookup>y</lookup>"})
    inner = "so <lookup>y</lookup>"
    assert called(f"```lookup\n{inner}\n```") == ("lookup", {"query": inner})


def test_a_call_counts_once_and_what_follows_is_left_out() -> None:
    """Also behind thinking, whose place in the text is kept."""
    info = around().step(f"<think>{CALL}</think>{CALL} and {CALL}")[4]
    assert info["parsed_action"] == f"<think>{CALL}</think>{CALL}"
    assert info["tool"]["uses"] == 1


@pytest.mark.parametrize(
    "answer",
    [
        "I would write it between `<lookup>` and `</lookup>`, but I know it: 42",
        'I called the "<lookup>" before; it is 42',
        "With '<tool_call>' one calls; it is 42",
        "<answer>Use the <lookup> tag</answer>",
        f"<answer>Write {CALL} to ask</answer>",
        "I put it into <answer> now: <answer>a <calculator> b</answer>",
    ],
)
def test_what_only_speaks_of_a_call_is_the_tasks(answer: str) -> None:
    """A lone tag in quotation marks, and whatever stands within the tag of an answer."""
    assert called(answer) is None


@pytest.mark.parametrize(
    "action",
    [
        f"`<lookup>` it is: {CALL}",
        f"`{CALL}`",
        f"<answer>{CALL}</answer>",
        f"I write <answer> later. {CALL} <answer>42</answer>",
        f"{CALL} <answer>42</answer>",
        f"<answer>42</answer> {CALL}",
    ],
)
def test_a_call_beside_an_answer_or_a_quotation_is_executed(action: str) -> None:
    """As is one that is all that an answer holds: nobody answers with a call."""
    assert called(action) == QUERY


def test_an_answer_and_a_quotation_inside_a_call_belong_to_it() -> None:
    """As in a program that prints them."""
    for query in ("<answer>y</answer>", "print('<lookup>')", "`<calculator>`"):
        assert called(f"<lookup>{query}</lookup>") == ("lookup", {"query": query})
        assert called(json_call("lookup", query=query)) == ("lookup", {"query": query})
    assert "<lookup> is never closed by </lookup>" in refused("<lookup>y <answer>42</answer>")


@pytest.mark.parametrize("call", ["<lookup query='x'>", '<lookup query="x"/>', "<lookup/>", "<lookup />"])
def test_a_tag_with_more_than_the_name_is_told(call: str) -> None:
    """It was meant for the tool, and would be a wrong answer."""
    told = "its tag takes no attributes; what it is given is written between <lookup> and </lookup>"
    assert told in refused(f"so: {call}")
    assert called(f"<answer>{call}</answer>") is None
    assert called(f"<think>{call}</think> 42") is None


def read_shout(opening: re.Match[str], tools: Mapping[str, gem.Tool]) -> gem.ToolCall | None:
    """Read ``NAME! text!``, as no model writes it."""
    found = re.compile(r" ([^!]*)(!?)").match(opening.string, opening.end())
    if found is None or opening[1].lower() not in tools:
        return None
    error = None if found[2] else "nobody hears it"
    return gem.ToolCall(opening[1].lower(), {"query": found[1]}, opening.start(), found.end(), error)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("LOOKUP! x!", "x"),
        ("HELP! me! and LOOKUP! x!", "x"),
        ("<lookup>y</lookup> LOOKUP! x!", "y"),
        ("LOOKUP! x! <lookup>y</lookup>", "x"),
        ("LOOKUP! x <lookup>y</lookup>", "y"),
        ("<think>LOOKUP! x!</think> 42", None),
        ("<answer>LOOKUP! x!</answer>", "x"),
        ("<answer>I say LOOKUP! x!</answer>", None),
        ("`LOOKUP! x!` I would say; it is 42", None),
    ],
)
def test_a_form_of_a_plugin_is_read_beside_the_others(
    text: str, expected: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of all calls the first that is complete counts, and what is thought, answered or quoted is none in any form."""
    shout = CallFormatSpec(name="shout", opening="([A-Z]+)!", entry_point=read_shout)
    monkeypatch.setattr(Registry, "specs", lambda self, kind: [shout])
    assert called(text) == (None if expected is None else ("lookup", {"query": expected}))


def test_a_form_with_the_shape_of_an_answer_is_none_beside_an_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """As bare JSON has it."""
    shout = CallFormatSpec(name="shout", opening="([A-Z]+)!", begins="anything", entry_point=read_shout)
    monkeypatch.setattr(Registry, "specs", lambda self, kind: [shout])
    assert called("LOOKUP! x!") == QUERY
    assert called("LOOKUP! x! \\boxed{42}") is None


def test_a_form_of_calls_needs_an_opening_that_can_be_searched_for() -> None:
    """It is refused when it is offered, not when a model writes."""
    for wrong in ({"opening": "("}, {"opening": 3}, {"opening": "x", "begins": "never"}):
        with pytest.raises(gem.errors.RegistrationError):
            CallFormatSpec(name="mine", entry_point=read_shout, **wrong)  # type: ignore[arg-type]


def test_a_tag_around_a_fence_and_a_fence_around_a_tag_are_one_call() -> None:
    """Models write both; what is run is the content of the inner one."""
    for fence in ("```lookup", "```", "~~~lookup"):
        assert called(f"<lookup>\n{fence}\nx\n{fence[:3]}\n</lookup>") == QUERY
    assert called("```lookup\n<lookup>\nx\n</lookup>\n```") == QUERY
    both = "```lookup\nx\n```\n```lookup\ny\n```"
    assert called(f"<lookup>{both}</lookup>") == ("lookup", {"query": both})
    two = "<lookup>x</lookup> <lookup>y</lookup>"
    assert called(f"```lookup\n{two}\n```") == ("lookup", {"query": two})


PIECES = [
    CALL,
    "<lookup>",
    "</lookup>",
    "<think>",
    "</think>",
    "<tool_call>",
    "</tool_call>",
    '{"name": "lookup", ',
    '"arguments": {',
    '"query": "x"',
    "}",
    "{",
    '"',
    "\\",
    ",",
    "```lookup\n",
    "```text\n",
    "\n```\n",
    "~~~",
    "<lokup>",
    "</lokup>",
    "<calculator>",
    "</calculator>",
    "<answer>",
    "`<lookup>`",
    "<lookup query='x'>",
    "\n",
    " ",
    "é",
    "\ud800",
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
    st.sampled_from([piece for piece in PIECES if "think" not in piece and "text" not in piece]) | st.text(max_size=3),
    max_size=12,
).map("".join)


@given(QUIET, st.sampled_from([CALL, json_call("lookup", query="x"), "\n```lookup\nx\n```\n"]), QUIET)
def test_no_text_around_a_call_takes_it_to_the_task(before: str, call: str, after: str) -> None:
    """Thinking and answers apart, whatever stands around a whole call, the task hears nothing."""
    if "`" in before or "~~~" in before:
        return  # within another block a fence opens nothing, and a call in backticks is quoted
    env = around()
    assert "tool" in env.step(before + call + after)[4]
    assert env.unwrapped.heard == []


@pytest.mark.parametrize(
    "piece",
    [
        "<lookup>",
        "<think>",
        "</think>",
        "<tool_call>",
        "<tool_call>{",
        "<think><lookup></think>",
        "<think><tool_call></think>",
        '<tool_call>"\\',
        '"\\',
        "<lokup>",
        "<calculator>",
        "```lookup\n",
        "```text\n",
        ",",
        "[",
        "<lookup></think>",
        "`<lookup>",
        "<lookup query=",
        "</answer>",
        "<answer>",
        '{"name": "lookup", ',
    ],
)
@pytest.mark.few(5)
def test_megabytes_of_any_piece_are_read(piece: str) -> None:
    """In time that grows with the length: where it grew with its square, this would take hours."""
    text = piece * (1_500_000 // len(piece))
    for action in (text, f"<tool_call>{text}</tool_call>", f"{text}</lookup>", f"{text}</think>"):
        around().find_call(action)


def test_megabytes_of_different_tags_are_read() -> None:
    """Only so many are held against the names of tools."""
    tags = (f"<lookup{''.join(end)}>" for end in itertools.islice(itertools.product("abcdefghij", repeat=5), 60_000))
    assert called("".join(tags) + "42") is None
