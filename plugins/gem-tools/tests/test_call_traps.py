"""What parsers of tool calls fall into: ends in values, types, quotations, cuts, answers that look like calls."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
from calling import (
    A1,
    CALLS_END,
    CODE,
    HARMONY,
    J1,
    KIMI,
    M2,
    P1,
    P2,
    RUN,
    SEED,
    Python,
    Recorder,
    around,
    called,
    cohere,
    dsml,
    glm,
    invoke,
    kimi,
    lfm2,
    qwen,
    refused,
    step,
    step3,
    v3,
    v31,
)
from hypothesis import example, given
from hypothesis import strategies as st
from test_call_formats import ONE_CALL

import gem_core as gem
from gem_core.registry import registry
from gem_core.registry.specs import CallFormatSpec
from gem_core.tools.env import ToolEnv

FORMATS = [record for record in registry().specs(CallFormatSpec) if "gem_tools" in str(record.entry_point)]
PRINTED = [
    "print('</tool_call>', '</arg_value>', '</invoke>')",
    "print('</parameter>')\nprint('</function>')",
    "# a tag\n</function>\n</invoke> and more\nprint(1)",
    "if a < b and b > c:\n    print([1, 2][0]); print({'a': 1})",
    "    print('indented')\n    print('twice')",
    "print(\"a\\nb\", 'c')  # `quoted`",
    "print(r'\\boxed{42}', '<answer>42</answer>', '<search>x</search>')",
]


@pytest.mark.parametrize("code", PRINTED)
def test_a_value_may_hold_what_looks_like_its_end(code: str) -> None:
    """One value is decoded, or read up to what may follow it; no indentation is lost (traps 4, 5 and 6)."""
    call = {"name": "python", "arguments": {"code": code}}
    given = json.dumps(call["arguments"])
    for text in (
        f"<tool_call>{json.dumps(call)}</tool_call>",
        f"{json.dumps(call)}; {P2}",
        f"functools[{json.dumps(call)}]",
        f"[python(code={code!r})]",
        f"<function=python>{given}</function>",
        f"[TOOL_CALLS]python[ARGS]{given}",
        f"<｜tool▁calls▁begin｜>{v31(given)}{CALLS_END}",
        f"<｜tool▁calls▁begin｜>{v3(given)}{CALLS_END}",
        KIMI.format(kimi(given)),
        HARMONY.replace(A1, given),
        f'<|tool_call>call:python{{code:<|"|>{code}<|"|>}}<tool_call|>',
        qwen(code),
        glm(code),
        dsml(code),
        f"<function_calls>\n{invoke(code)}\n</function_calls>",
        lfm2(f"python(code={code!r})"),
        f"<｜tool_calls_begin｜>\n{step3(code)}\n<｜tool_calls_end｜>",
    ):
        assert called(text) == ("python", {"code": code}), text


def test_a_value_without_a_declared_type_stays_text() -> None:
    """Trap 6: as in schemas of servers, which may say nothing, or refer to what is elsewhere."""

    class Served(gem.Tool):
        name = "served"
        concurrency = "inline"

        def parameters_schema(self) -> dict[str, Any]:
            kinds = {
                "any": {},
                "text": {"$ref": "#/$defs/Text"},
                "lost": {"$ref": "#/x"},
                "number": {"type": "integer"},
                "either": {"type": ["null", "string"]},
                "some": {"anyOf": [{"type": "integer"}, {"type": "null"}]},
            }
            return {"properties": kinds, "$defs": {"Text": {"type": "string"}}}

        def validate(self, arguments: Any) -> Any:
            return arguments

        def call(self, arguments: Any, session: Any) -> str:
            return "done"

    env = ToolEnv(Recorder(), [Served()])
    env.reset()
    names = ["any", "text", "lost", "number", "either", "some", "unknown"]
    given = "".join(f"<parameter={name}>1</parameter>" for name in names)
    called = env.step(f"<tool_call><function=served>{given}</function></tool_call>")[4]["tool"]["arguments"]
    assert [name for name, value in called.items() if value == 1] == ["number", "some"]
    assert {str(value) for value in called.values()} == {"1"}


def test_one_tag_may_hold_several_bodies() -> None:
    """Trap 1: the next character tells; each is in the table above, and a body in another family's tag is read too."""
    for tag in ("tool_call", "tool_calls", "function_calls"):
        for body in (J1, f"[{J1}]", invoke(), f"<function=python>{A1}</function>", 'python(code="print(6*7)")'):
            assert called(f"<{tag}>{body}</{tag}>") == RUN


def test_marks_that_look_alike_are_told_apart() -> None:
    """Trap 2: the name stands before or behind the separator, and bars are of two kinds."""
    assert "no tool 'function'" in refused(v31().replace("python", "function"))
    assert called(f"<|tool_call|>[{J1}]") == called('<|tool_call>call:python{code:"print(6*7)"}') == RUN


@pytest.mark.parametrize("code", ["{1, 2}", "{n: n for n in range(3)}", '{"a": 1}', "[python for python in [1]]"])
def test_code_for_the_tool_python_is_taken_as_it_is(code: str) -> None:
    """Trap 3: in some forms it is no JSON, whatever it begins with."""
    assert called(f"<|channel|>analysis to=python code<|message|>{code}<|call|>") == ("python", {"code": code})


@pytest.mark.parametrize(
    "thought",
    [
        f"<think>{J1} or <tool_call>{J1}</tool_call></think>",
        f"<tool_call>{J1}</tool_call></think>",
        f"[THINK][TOOL_CALLS]python[ARGS]{A1}[/THINK]",
        f"<seed:think>{SEED}</seed:think>",
        f"<|START_THINKING|>{cohere(CODE)}<|END_THINKING|>",
        f"◁think▷{J1}◁/think▷",
        f"<|channel>thought\n{J1}<channel|>",
        f"{M2}</mm:think>",
        "<|channel|>analysis<|message|>functions.python? <python>1</python><|end|><|start|>assistant<|channel|>final",
    ],
)
def test_calls_in_closed_thinking_are_thoughts(thought: str) -> None:
    """Trap 7, in each family's marks; but harmony's own channel of calls counts, even if it is that of analysis."""
    assert called(f"{thought} It is 42.") is None
    assert called(f"<|channel|>analysis to=functions.python<|message|>{A1}<|call|>") == RUN


def test_a_quoted_call_is_not_executed() -> None:
    """Trap 8: in backticks, or if the answer is given already, a call is only spoken of."""
    for text in (
        f"One calls it as `<tool_call>{J1}</tool_call>`, `[TOOL_CALLS]` or `<execute>1</execute>`.",
        f"The answer is \\boxed{{42}}.\n{J1}",
        f"{P1}\n\n<answer>42</answer>",
        '[python(code="print(6*7)")] \\boxed{42}',
    ):
        assert called(text) is None
    assert called(f"<tool_call>{J1}</tool_call> gives \\boxed{{42}}") == RUN


def test_a_call_that_was_cut_off_by_length_is_not_executed() -> None:
    """Trap 9: what a stop string took is known; half a program is not."""
    for text in ("<python>print(6*7)", "```python\nprint(6*7)", "<execute>print(6*7)", qwen().partition("\n</par")[0]):
        assert called(gem.Response(text, finish_reason="stop")) == RUN
        told = refused(gem.Response(text, finish_reason="length"))
        assert "never closed" in told
        assert "the response was cut off at the limit of its length" in told
    assert called(gem.Response(f"<tool_call>{J1}", finish_reason="length")) == RUN
    for cut in (J1[:-20], P1[:-3], f"<tool_call>{J1[:-9]}", f"[TOOL_CALLS]python{A1[:-5]}"):
        assert refused(cut)


@pytest.mark.parametrize("name", ["plan-trip", "functions.plan-trip", "plan-trip:3", "functions.plan-trip:12"])
def test_names_are_freed_of_what_some_families_add(name: str) -> None:
    """Trap 11: a namespace, a number, hyphens; and line breaks in strings as they are."""
    text = f'<|tool_call_begin|>{name}<|tool_call_argument_begin|>{{"city": "Os\nlo", "days": 2}}<|tool_call_end|>'
    assert called(text) == ("plan-trip", {"city": "Os\nlo", "days": 2})


def test_arguments_may_be_json_in_a_string() -> None:
    """Trap 12, in every form of JSON."""
    nested = json.dumps({"name": "plan-trip", "arguments": json.dumps({"city": "Oslo", "days": 2})})
    for text in (nested, f"<tool_calls>[{nested}]</tool_calls>", f"functools[{nested}]"):
        assert called(text) == ("plan-trip", {"city": "Oslo", "days": 2})


@pytest.mark.parametrize(
    ("literal", "value"),
    [
        (r"'a\d\\d\n'", "a\\d\\d\n"),
        ("'''a\n\"b\"'''", 'a\n"b"'),
        ("'a\nb'", "a\nb"),
        (r"r'\n'", "\\n"),
        (r"'\x41\u00e9'", "Aé"),
        ('"a" "b"', "ab"),
    ],
)
def test_texts_in_python_are_read(literal: str, value: str) -> None:
    """With Python's escapes, and with line breaks and escapes that it does not know."""
    assert called(f"[python(code={literal})]") == ("python", {"code": value})


def test_marks_of_papers_and_headers_of_harmony_that_are_no_calls() -> None:
    """Traps 14 and 15: they are no tokens of the models, or no message to a tool."""
    assert called("<begin_of_search>white rhino<end_of_search>") is None
    assert called("<|channel|>final<|message|>I wrote to=functions.python before.<|return|>") is None


EXAMPLES = [*ONE_CALL.values(), "<|begin_of_query|>", "<|begin_search_query|>"]
OPENINGS = {
    record.name: [found[0] for text in EXAMPLES for found in re.finditer(record.opening, text)] for record in FORMATS
}


def test_every_row_of_the_table_is_tried() -> None:
    """Trap 16: names of parsers move, letters do not; no row is without an example above."""
    assert len(FORMATS) > 25
    assert [name for name, found in OPENINGS.items() if not found] == []


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[TOOL_CALLS] soon", "behind [TOOL_CALLS] is no valid JSON: Expecting value"),
        (f"<function=python>{A1[:-1]}", "its arguments are no valid JSON: Expecting ',' delimiter"),
        ("<function=python></function>", "code: Field required"),
        ("<function=python>print(1)</function>", "neither JSON nor parameters"),
        ("<|tool_call>call:python{code:print}<tool_call|>", "its arguments are no valid JSON"),
        ("<function_calls>python(code=open(1))</function_calls>", "its arguments are no literals of Python"),
        ("[python(code=6*7)]", "its arguments are no literals of Python"),
        (f"<function=pythn>{A1}</function>", "no tool 'pythn'. Did you mean 'python'?"),
        (f"<function_calls>{invoke().replace('python', 'bash')}</function_calls>", "no tool 'bash'. There are: python"),
        (KIMI.format(kimi().replace("python", "bash")), "no tool 'functions.bash:0'. There are: python, search"),
        (HARMONY.replace("python", "bash"), "no tool 'functions.bash'. There are: python, search"),
        ("Action: bash\nAction Input: ls\nObservation:", "no tool 'bash'. There are: python, search"),
        ('{"type": "function", "name": "bash", "parameters": {}}', "no tool 'bash'. There are: python, search"),
        ('{"name": "python", "arguments": {"code": "print("1")"}}', "no valid JSON"),
        ("<execute>", "stands no </execute>"),
        ("<tool_call><tool_name>python</tool_name>1</tool_call>", "no valid JSON"),
        ("<|begin_search_query|>", "stands no <|end_search_query|>"),
        ('{"name": "plan-trip", "arguments": "Oslo"}', "its arguments are no valid JSON: Expecting value"),
    ],
)
def test_what_looks_like_a_call_and_cannot_be_read_is_told(text: str, told: str) -> None:
    """It is a use, and never the answer."""
    assert told in refused(text)


def test_a_form_without_a_name_needs_a_tool_that_takes_it() -> None:
    """Of code, or of a query; whatever its name."""

    class Shell(Python):
        name = "interpreter"
        fences = ()

    env = ToolEnv(Recorder(), [Shell()])
    env.reset()
    assert env.step("<execute>1</execute>")[4]["tool"]["name"] == "interpreter"
    told = "no tool takes query alone. There are: interpreter"
    assert told in env.step("<|begin_search_query|>x<|end_search_query|>")[0]


ANSWERS = [
    "",
    '{"name": "Al", "age": 3}',
    '[{"name": "Al", "arguments": ["for", "against"]}]',
    '{"name": "bash", "arguments": {"command": "ls"}}',
    '{"name": "python"}',
    '{"language": "python", "code": "print(1)"}',
    f"so: {J1} it is",
    "['python', 'search']",
    "[f(x=1)]",
    "python\nis a snake",
    "search\n\nthe house",
    "def search(query):\n    return query\n\nprint(search(1))",
    "```text\n<python>1</python>\n```",
    "<code>print</code> writes, <code>input</code> reads.",
    r"$\left[ x \right]_{0}^{1}$ and \[ f(x) = \{1, 2\} \] so \boxed{\{1\}}",
    "Action: move[up]",
    "Action: press the button\nReason: it is red",
    "The action input is 3; to=me",
    "I start it:\n>>> python\nimport os",
    "python\n<|content|>print(1)",
    "functools.partial(f, 1)",
    "I passed functools[0] on.",
    "From: a@b.c\nto=functions",
    f"<answer>{J1}</answer>",
    f"```text\n{J1}\n```",
]


@pytest.mark.parametrize("answer", ANSWERS)
def test_an_answer_stays_an_answer(answer: str) -> None:
    """Nothing in it names a tool in a form of calls."""
    assert called(answer) is None


def test_answers_in_code_stay_the_tasks() -> None:
    """A task that is answered in blocks of Python keeps them, whatever stands in them; marks of calls still call."""

    class Coding(Recorder):
        answer_fences = ("python", "py", "")

    env = ToolEnv(Coding(), [Python()], max_tool_uses=None)
    env.reset()
    for code in ("print(1)", J1, "<python>1</python>", '[python(code="1")]', "python\n{}"):
        answer = f"```python\n{code}\n```"
        assert env.step(answer)[0] == f"Heard: {answer}"
    for call in ("<python>1</python>", "<execute>1</execute>", J1, "<code>\n1\n</code>"):
        assert "Output of python" in env.step(call)[0]


PIECES = [
    *sorted({found for each in OPENINGS.values() for found in each if found.strip()}),
    *('{"name": "python", ', '"arguments": ', A1, J1, *'{}[]()"`\\,:=.', "'", "```", "\ud800", "\n", " "),
    *("</tool_call>", "</parameter>", "<parameter=code>", "</function>", "</invoke>", 'name="python">', "python"),
    *("<arg_key>", "</arg_key>", "<arg_value>", "</arg_value>", "<think>", "</think>", "<answer>", "</answer>"),
    *("\\boxed{42}", "Action: python\n", ": ", "functions.python", "<|message|>", "<|call|>", "[ARGS]", "<escape>"),
    *("<｜tool▁sep｜>", "<tool_sep>", '<|"|>', "<search>", "</search>", "print(1)", "code="),
]
TEXTS = st.lists(st.sampled_from(PIECES) | st.text(max_size=2), max_size=20).map("".join)


@example("<invoke name=nosuch>")  # never closed, and of no tool
@given(TEXTS)
def test_every_text_is_read(text: str) -> None:
    """Never an exception; and what is executed is how the response begins."""
    info = step(text)
    if info is not None:
        assert info["parsed_action"] is None or text.startswith(info["parsed_action"])
        assert info["tool"]["error"] or info["parsed_action"]
        json.dumps(info["tool"], allow_nan=False)


@pytest.mark.parametrize("piece", [piece for piece in PIECES if piece.strip()])
@pytest.mark.few(25)
def test_long_texts_of_any_piece_are_read(piece: str) -> None:
    """In time that grows with the length: where it grew with its square, this would take minutes."""
    text = piece * (200_000 // len(piece))
    for before in (
        "",
        "<tool_call>",
        "<function=python><parameter=code>",
        '{"name": "python", "arguments": {"code": "',
    ):
        around().find_call(before + text)
