"""Calls in the forms that models are trained to emit, to the letter of their chat templates."""

from __future__ import annotations

import re

import pytest
from calling import (
    A1,
    A2,
    CALLS_END,
    CODE,
    HARMONY,
    J1,
    J2,
    KIMI,
    M2,
    P1,
    P2,
    RUN,
    SEED,
    called,
    cohere,
    dsml,
    glm,
    hy3,
    invoke,
    kimi,
    lfm2,
    qwen,
    step,
    step3,
    v3,
    v31,
)


def prefixed(text: str) -> str:
    return re.sub(r"<(/?)(?=\w)", r"<\1antml:", text)


ONE_CALL = {
    "1 Hermes": f"<tool_call>\n{J1}\n</tool_call>",
    "1 Hermes in one line": f"<tool_call>{J1}</tool_call>",
    "1 Hermes, opened twice": f"<tool_call>\n<tool_call>\n{J1}\n</tool_call>",
    "1 Hermes, end taken by a stop string": f"<tool_call>\n{J1}\n",
    "1 Hermes, a Python dict": "<tool_call>{'name': 'python', 'arguments': {'code': 'print(6*7)'}}</tool_call>",
    "1 Granite 4": '<tool_call>{"name": "python", "arguments": "{\\"code\\": \\"print(6*7)\\"}"}</tool_call>',
    "2 Qwen3-Coder": qwen(),
    "2 without the outer tag": qwen()[len("<tool_call>\n") : -len("\n</tool_call>")],
    "2 without </parameter>": qwen().replace("</parameter>\n", ""),
    "2 without line breaks": qwen().replace("\n", ""),
    "2 cut behind </function>": qwen().removesuffix("</tool_call>"),
    "2 cut in the value": qwen().partition("\n</parameter>")[0],
    "3 Llama 3": P1,
    "3 with its stop token": f"{P1}<|eot_id|>",
    "3 with a type": '{"type": "function", "name": "python", "parameters": {"code": "print(6*7)"}}',
    "3 nested": f'{{"type": "function", "function": {J1}}}',
    "3 arguments": J1,
    "3 a Python dict": "{'name': 'python', 'parameters': {'code': 'print(6*7)'}}",
    "3 in a fence": f"```json\n{P1}\n```",
    "3 behind a sentence": f"I compute it.\n\n{P1}",
    "4 python_tag and JSON": f"<|python_tag|>{P1}<|eom_id|>",
    "5 custom tag": f"<function=python>{A1}</function>",
    "5 with an attribute": f'<function name="python">{A1}</function>',
    "5 with its stop token": f"<function=python>{A1}</function><|eom_id|>",
    "6 pythonic": '[python(code="print(6*7)")]',
    "6 pythonic, other quotes": "[python(code='print(6*7)')]",
    "6 pythonic, Llama 4": '<|python_start|>[python(code="print(6*7)")]<|python_end|>',
    "6 pythonic, one call": 'python(code="print(6*7)")',
    "7 Mistral": f"[TOOL_CALLS] [{J1}]</s>",
    "7 with an id": f'[TOOL_CALLS] [{J1[:-1]}, "id": "abcDEF123"}}]',
    "8 Mistral v13": f"[TOOL_CALLS]python[ARGS]{A1}",
    "8 Mistral v11": f"[TOOL_CALLS]python[CALL_ID]abcDEF123[ARGS]{A1}",
    "8 without [ARGS]": f"[TOOL_CALLS]python{A1}",
    "9 DeepSeek V3": f"<｜tool▁calls▁begin｜>{v3()}{CALLS_END}",
    "9 cut": f"<｜tool▁calls▁begin｜>{v3().partition('<｜tool▁call▁end｜>')[0]}",
    "10 DeepSeek V3.1": f"<｜tool▁calls▁begin｜>{v31()}{CALLS_END}",
    "10 without the outer mark": v31(),
    "11 DeepSeek V3.2": dsml(),
    "11 DeepSeek V4": dsml(outer="tool_calls"),
    "11 with JSON": f'<｜DSML｜function_calls>\n<｜DSML｜invoke name="python">\n{A1}\n</｜DSML｜invoke>\n',
    "11 without marks": dsml().replace("｜DSML｜", ""),
    "11 with marks in part": dsml().replace("</｜DSML｜parameter>", "</parameter>"),
    "11 without the outer tag": dsml().partition("\n")[2].rpartition("\n")[0],
    "12 Kimi K2": KIMI.format(kimi()),
    "12 numbered on": KIMI.format(kimi(number=17)),
    "12 without the prefix": KIMI.format(kimi().replace("functions.", "").replace(":0", "")),
    "12 singular": KIMI.replace("calls", "call").format(kimi()),
    "12 without the section": kimi(),
    "13 GLM 4.5": glm(),
    "13 GLM 4.7": glm().replace("\n", ""),
    "13 with a backslash and an n": glm().replace("\n", "\\n"),
    "13 cut": glm().removesuffix("\n</tool_call>"),
    "14 harmony": f"{HARMONY}<|call|>",
    "14 without <|call|>": HARMONY,
    "14 without a space": HARMONY.replace(" <|constrain|>", "<|constrain|>"),
    "14 behind analysis": f"<|channel|>analysis<|message|>Hm.<|end|><|start|>assistant{HARMONY}<|call|>",
    "14 recipient in the role": f"<|start|>assistant to=functions.python<|channel|>commentary json<|message|>{A1}",
    "14 recipient first": f" to=functions.python<|channel|>commentary <|constrain|>json<|message|>{A1}<|call|>",
    "14 code": f"<|channel|>commentary to=functions.python code<|message|>{A1}<|call|>",
    "14 built-in": f"<|channel|>analysis to=python code<|message|>{CODE}<|call|>",
    "14 marks left out by the server": f"commentary to=functions.python json{A1}",
    "15 MiniMax M1": f"<tool_calls>\n{J1}\n</tool_calls>",
    "15 with a spare brace": f"<tool_calls>\n{J1}}}\n</tool_calls>",
    "16 MiniMax M2": M2,
    "17 Granite 3.0": f"<|tool_call|>[{J1}]",
    "17 Granite 3.1": f"<tool_call>[{J1}]",
    "17 Granite 20b": f"<function_call> {J1}",
    "18 InternLM": f"<|action_start|><|plugin|>\n{P1}<|action_end|>",
    "18 with a space": f"<|action_start|> <|plugin|>\n{J1}<|action_end|>",
    "19 Phi-4-mini": f"functools[{J1}]",
    "20 xLAM": f"[{J1}]",
    "20 in a fence": f"```json\n[{J1}]\n```",
    "20 behind [TOOL_CALLS]": f"[TOOL_CALLS][{J1}]",
    "20 in a tag": f"<tool_call>[{J1}]</tool_call>",
    "20 behind thinking": f"<think>Hm.</think>\n[{J1}]",
    "21 Hunyuan A13B": f"<tool_calls>[{J1}]</tool_calls>",
    "21 in its answer": f"<think>Hm.</think>\n<answer><tool_calls>[{J1}]</tool_calls></answer>",
    "22 Hunyuan 3": hy3(),
    "22 with a suffix": hy3(":opensource"),
    "22 with another": hy3(":v2"),
    "22 without the outer tag": hy3(":v2").partition("\n")[2].rpartition("\n")[0],
    "23 Step3": f"<｜tool_calls_begin｜>\n{step3()}\n<｜tool_calls_end｜>",
    "24 Seed-OSS": SEED,
    "24 in one line": SEED.replace(">\nprint", ">print").replace(")\n<", ")<"),
    "26 Cohere": f"<|START_THINKING|>I compute.<|END_THINKING|>{cohere(CODE)}",
    "LFM2": lfm2('python(code="print(6*7)")'),
    "LFM2 in JSON": lfm2(J1),
    "Nemotron": f"<TOOLCALL>[{J1}]</TOOLCALL>",
    "LongCat": f"<longcat_tool_call>{J1}</longcat_tool_call>",
    "LongCat in elements": glm().replace("arg_", "longcat_arg_").replace("tool_call", "longcat_tool_call"),
    "28 invoke": f"<function_calls>\n{invoke()}\n</function_calls>",
    "28 without the outer tag": invoke(),
    "28 with a prefix": prefixed(f"<function_calls>\n{invoke()}\n</function_calls>"),
    "28 with a prefix, without the outer tag": prefixed(invoke()),
    "29 OLMo 3": '<function_calls>python(code="print(6*7)")</function_calls>',
    "30 FunctionGemma": "<start_function_call>call:python{code:<escape>print(6*7)<escape>}<end_function_call>",
    "30 Gemma 4": '<|tool_call>call:python{code:<|"|>print(6*7)<|"|>}<tool_call|>',
    "31 ReAct": f"Thought: I compute.\nAction: python\nAction Input: {A1}\nObservation:",
    "31 without the end": f"Thought: I compute.\nAction: python\nAction Input: {A1}",
    "31 raw": f"Thought: I compute.\nAction: python\nAction Input: {CODE}\nObservation:",
    "31 fenced": f"Action: python\nAction Input:\n```python\n{CODE}\n```\nObservation: 42",
    "31 bold": f"**Action:** python\n**Action Input:** {A1}",
    "31 JSON in a fence": f"Action: python\nAction Input: ```json\n{A1}\n```\nObservation:",
    "33 fence": f"```python\n{CODE}\n```",
    "33 fence, cut": f"```python\n{CODE}\n",
    "33 fence and ToRA's stop": f"```python\n{CODE}\n```\n```output\n",
    "33 CodeAct": f"<thought>I compute.</thought>\n<execute> {CODE} </execute>",
    "33 CodeAct, cut": f"I compute. <execute> {CODE} ",
    "33 smolagents": f"Thought: I compute.\n<code>\n{CODE}\n</code>",
    "33 smolagents, cut": f"Thought: I compute.\n<code>\n{CODE}\n",
    "33 smolagents in a line": f"I compute: <code>{CODE}</code>",
    "33 ReTool": f"<code>\n```python\n{CODE}\n```\n</code>",
    "the tool's tag": f"<python>{CODE}</python>",
    "the tool's tag, spaced": f"< python >{CODE}</ python >",
    "the tool's tag, cut": f"I compute. <python>{CODE}",
    "tool_use": '{"type": "tool_use", "id": "t1", "name": "python", "input": {"code": "print(6*7)"}}',
    "a comma too many": '<tool_call>{"name": "python", "arguments": {"code": "print(6*7)",},}</tool_call>',
    "other keys": '<tool_call>{"tool_name": "python", "args": {"code": "print(6*7)"}}</tool_call>',
    "gem-llm": f"<tool_call><tool_name>python</tool_name><arguments>{A1}</arguments></tool_call>",
}


@pytest.mark.parametrize("text", ONE_CALL.values(), ids=ONE_CALL)
def test_a_call_is_read(text: str) -> None:
    """Alone, and behind thinking; nothing of it reaches the task."""
    assert called(text) == RUN
    assert called(f"<think>I might call `{J2}`.</think>\n{text}") == RUN


@pytest.mark.parametrize("token", ["<end_code>", "<|im_end|>\n", "<|eot_id|>", " </s>", "<｜end▁of▁sentence｜>"])
def test_a_token_at_the_end_of_a_turn_is_no_part_of_a_call(token: str) -> None:
    """Where the server leaves it in."""
    for text in (f"<code>\n{CODE}\n</code>", f"```py\n{CODE}\n```", f"<execute>{CODE}", f'python(code="{CODE}")'):
        assert called(text + token) == RUN
    assert called(f"Action: python\nAction Input: {CODE}{token}") == RUN


TWO_CALLS = {
    "1": f"<tool_call>\n{J1}\n</tool_call>¦\n<tool_call>\n{J2}\n</tool_call>",
    "2": f"{qwen()}¦\n{qwen('print(1)')}",
    "3": f"{P1}¦; {P2}",
    "4": f"<|python_tag|>{P1}¦; {P2}",
    "5": f"<function=python>{A1}</function>¦<function=python>{A2}</function>",
    "6": '[python(code="print(6*7)")¦, python(code="print(1)")]',
    "7": f"[TOOL_CALLS] [{J1}¦, {J2}]",
    "8": f"[TOOL_CALLS]python[ARGS]{A1}¦[TOOL_CALLS]python[ARGS]{A2}",
    "9": f"<｜tool▁calls▁begin｜>{v3()}¦\n{v3(A2)}{CALLS_END}",
    "10": f"<｜tool▁calls▁begin｜>{v31()}¦{v31(A2)}{CALLS_END}",
    "11": dsml().replace("\n</｜DSML｜function_calls>", "¦\n") + dsml("print(1)").partition("\n")[2],
    "12": KIMI.format(f"{kimi()}¦{kimi(A2, 1)}"),
    "13": f"{glm()}¦\n{glm('print(1)')}",
    "15": f"<tool_calls>\n{J1}¦\n{J2}\n</tool_calls>",
    "16": f"<minimax:tool_call>\n{invoke()}¦\n{invoke('print(1)')}\n</minimax:tool_call>",
    "17": f"<|tool_call|>[{J1}¦, {J2}]",
    "17b": f"<function_call> {J1}¦\n<function_call> {J2}",
    "19": f"functools[{J1}¦, {J2}]",
    "20": f"[{J1}¦, {J2}]",
    "LFM2": lfm2('python(code="print(6*7)")¦', 'python(code="print(1)")'),
    "Nemotron": f"<TOOLCALL>[{J1}¦, {J2}]</TOOLCALL>",
    "21": f"<tool_calls>[{J1}¦, {J2}]</tool_calls>",
    "23": f"<｜tool_calls_begin｜>\n{step3()}¦\n{step3('print(1)')}\n<｜tool_calls_end｜>",
    "24": f"{SEED}¦\n{SEED.replace('6*7', '1')}",
    "26": cohere(CODE, "print(1)").replace("}},", "}}¦,"),
    "28": f"<function_calls>\n{invoke()}¦\n{invoke('print(1)')}\n</function_calls>",
    "29": '<function_calls>python(code="print(6*7)")¦\npython(code="print(1)")</function_calls>',
    "31": f"Action: python\nAction Input: {A1}¦\nObservation: 42\nAction: python\nAction Input: {A2}",
    "33": f"<execute>{CODE}</execute>¦ then <execute>print(1)</execute>",
}


@pytest.mark.parametrize("text", TWO_CALLS.values(), ids=TWO_CALLS)
def test_of_two_calls_the_first_is_executed(text: str) -> None:
    """And ``parsed_action`` is the response up to its end."""
    info = step(text.replace("¦", ""))
    assert info is not None
    assert (info["tool"]["name"], info["tool"]["arguments"]) == RUN
    assert info["parsed_action"] == text.partition("¦")[0]


@pytest.mark.parametrize(
    "text",
    [
        "<search>white rhino</search>",
        "<think>Who?</think><search>white rhino",
        "< search >white rhino</ search >",
        "<search >white rhino< /search>",
        "<think>I need it. <|begin_search_query|>white rhino<|end_search_query|>",
        "<|begin_search_query|>white rhino",
        "<|begin_of_query|>white rhino<|end_of_query|>",
        "<|begin_of_query|> white rhino ",
        "Action: search\nAction Input: white rhino\nObservation:",
        "<tool_call>search<arg_key>query</arg_key><arg_value>white rhino</arg_value></tool_call>",
        "[search(query='white rhino')]",
        'search("white rhino")',
    ],
)
def test_a_query_goes_to_the_tool_that_takes_one(text: str) -> None:
    """By its name, or in a form that names none; also where a stop string took the end."""
    name, arguments = called(text) or ("", {})
    assert (name, arguments["query"].strip()) == ("search", "white rhino")


TRIP = ("plan-trip", {"city": "42", "days": 3, "note": "null", "people": ["Al", "Bo"], "quick": True})


@pytest.mark.parametrize(
    "text",
    [
        "<tool_call><function=plan-trip><parameter=city>42</parameter><parameter=days>3</parameter>"
        '<parameter=note>null</parameter><parameter=people>["Al", "Bo"]</parameter><parameter=quick>True</parameter>'
        "</function></tool_call>",
        '<function_calls><invoke name="plan-trip"><parameter name="city">42</parameter><parameter name="days">\n3\n'
        "</parameter><parameter name=\"note\">null</parameter><parameter name=\"people\">['Al', 'Bo']</parameter>"
        '<parameter name="quick">true</parameter></invoke></function_calls>',
        "<tool_call>plan-trip\n<arg_key>city</arg_key>\n<arg_value>42</arg_value>\n<arg_key>days</arg_key>\n"
        "<arg_value>3</arg_value>\n<arg_key>note</arg_key><arg_value>null</arg_value><arg_key>people</arg_key>"
        '<arg_value>["Al", "Bo"]</arg_value><arg_key>quick</arg_key><arg_value>true</arg_value></tool_call>',
        '<｜DSML｜function_calls><｜DSML｜invoke name="plan-trip"><｜DSML｜parameter name="city" string="true">42'
        '</｜DSML｜parameter><｜DSML｜parameter name="days" string="false">3</｜DSML｜parameter>'
        '<｜DSML｜parameter name="note" string="true">null</｜DSML｜parameter><｜DSML｜parameter name="people" '
        'string="false">["Al", "Bo"]</｜DSML｜parameter><｜DSML｜parameter name="quick" string="false">true'
        "</｜DSML｜parameter></｜DSML｜invoke></｜DSML｜function_calls>",
        '<function_calls>plan-trip(city="42", days=3, note="null", people=["Al", "Bo"], quick=true)</function_calls>',
        '<|tool_call>call:plan-trip{city:<|"|>42<|"|>,days:3,note:<|"|>null<|"|>,people:[<|"|>Al<|"|>,<|"|>Bo<|"|>],'
        "quick:true}<tool_call|>",
    ],
)
def test_values_are_typed_by_the_schema(text: str) -> None:
    """What may be text stays text, "42" and "null" included; what else there is, is JSON or Python (trap 6)."""
    assert called(text) == TRIP
