"""The table: how the calls of each family begin, and what reads them. A tag that several families share stands once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal

from gem_core.registry import CallFormatSpec

_KEYS = (
    "name|tool_name|function|tool|action|arguments|parameters|args|input|tool_input|action_input|type|id|tool_call_id"
)
_PREFIX = r"(?:[A-Za-z]\w{0,20}+:)?"

Row = tuple[str, str, str, str]
"""Name, opening, reader, and the models that write it."""

_CALLS: tuple[Row, ...] = (
    # JSON, a name with arguments, or an element, which the next character tells.
    ("tool_call", r"<tool_call>", "bodies:read_body", "Hermes, Qwen, Qwen3-Coder, Granite 3.1 and 4, ERNIE, GLM"),
    ("tool_calls", r"<tool_calls>", "bodies:read_body", "MiniMax M1, Hunyuan A13B, Jamba"),
    ("hunyuan3", r"<tool_calls:\w{1,40}>", "bodies:read_body", "Hunyuan 3"),
    ("hunyuan3_inner", r"<tool_call:\w{1,40}>", "bodies:read_body", "Hunyuan 3, without the outer tag"),
    ("granite_20b", r"<function_call>", "bodies:read_body", "Granite 20b"),
    ("granite_3.0", r"<\|tool_call\|>", "bodies:read_body", "Granite 3.0"),
    ("nemotron", r"<TOOLCALL>", "bodies:read_body", "Nemotron"),
    ("longcat", r"<longcat_tool_call>", "bodies:read_body", "LongCat"),
    ("mistral", r"\[TOOL_CALLS\]", "bodies:read_body", "Mistral"),
    ("deepseek", r"<｜tool▁calls▁begin｜>", "bodies:read_body", "DeepSeek V3, R1 and V3.1"),
    ("deepseek_inner", r"<｜tool▁call▁begin｜>", "bodies:read_body", "DeepSeek V3, without the outer mark"),
    ("kimi_k2", r"<\|tool_calls?_section_begin\|>", "bodies:read_body", "Kimi K2"),
    ("kimi_k2_inner", r"<\|tool_call_begin\|>", "bodies:read_body", "Kimi K2, without the outer mark"),
    ("cohere", r"<\|START_ACTION\|>", "bodies:read_body", "Cohere Command R7B and A"),
    ("lfm2", r"<\|tool_call_start\|>", "bodies:read_body", "LFM2"),
    ("function_gemma", r"<start_function_call>", "bodies:read_body", "FunctionGemma"),
    ("gemma_4", r"<\|tool_call>", "bodies:read_body", "Gemma 4"),
    ("apertus", r"<\|tools_prefix\|>", "bodies:read_tool_keys", "Apertus"),
    # Elements.
    ("function_calls", rf"<{_PREFIX}function_calls>", "bodies:read_body", "OLMo 3, and like Anthropic's"),
    ("invoke", rf"<{_PREFIX}invoke(?:>| name=)", "bodies:read_element", "MiniMax M2, and like Anthropic's"),
    ("function", r"<function(?:=| name=)", "tagged:read_function", "Llama 3; Qwen3-Coder, without the outer tag"),
    ("minimax_m2", r"<minimax:tool_call>", "bodies:read_body", "MiniMax M2"),
    ("minimax_m3", r"\]<\]minimax\[>\[<(?:tool_call>|invoke(?= ))", "tagged:read_minimax_m3", "MiniMax M3"),
    ("seed_oss", r"<seed:tool_call>", "bodies:read_body", "Seed-OSS"),
    ("dsml", r"<｜DSML｜(?:function_calls|tool_calls)>", "bodies:read_body", "DeepSeek V3.2 and V4"),
    ("dsml_inner", r"<｜DSML｜invoke", "tagged:read_function", "DeepSeek V3.2 and V4, without the outer tag"),
    ("step3", r"<｜tool_calls_begin｜>", "bodies:read_body", "Step3"),
    # Code and queries.
    ("python_tag", r"<\|python_tag\|>", "texts:read_python_tag", "Llama 3"),
    ("python_start", r"<\|python_start\|>", "texts:read_python_tag", "Llama 4"),
    ("internlm", r"<\|action_start\|>", "texts:read_plugin", "InternLM"),
    ("search_o1", r"<\|begin_search_query\|>", "texts:read_search_query", "Search-o1"),
    ("r1_searcher", r"<\|begin_of_query\|>", "texts:read_query", "R1-Searcher"),
    ("codeact", r"<execute>", "texts:read_execute", "CodeAct"),
)

_TEXTS: tuple[Row, ...] = (
    ("phi_4_mini", r"functools\[", "bodies:read_whole_body", "Phi-4-mini"),
    ("gemma_4_bare", r"call:(?=[\w.-]{1,100}+\{)", "bodies:read_unmarked", "Gemma 4, whose marks the server left out"),
    ("tool_code", r"```tool_code", "texts:read_code_fence", "Gemma by its prompt"),
    ("harmony", r"to=", "texts:read_message", "gpt-oss"),
    ("react", r"Action", "texts:read_action", "ReAct"),
    ("smolagents", r"<code>", "texts:read_code_lines", "smolagents, ReTool"),
    (
        "own_tag",
        r"<[A-Za-z][\w.-]{0,63}+>\s*+(?=\{)",
        "tagged:read_own_tag",
        "any family, with a slip in the JSON of a tag",
    ),
)

_ANYTHING: tuple[Row, ...] = (
    ("json", rf"""\{{\s*+["'](?:{_KEYS})["']\s*+:""", "bare:read_json", "Llama 3, xLAM"),
    ("python_list", r"\[\s*+(?=[A-Za-z_][\w.-]{0,200}+\s*+\()", "bare:read_python_list", "Llama 4, ToolACE, Gemma"),
    ("python", r"\A\s*+(?=[A-Za-z_][\w.-]{0,200}+\s*+\()", "bare:read_python", "Llama 4, ToolACE, Gemma"),
)

_TABLES: Mapping[Literal["calls", "texts", "anything"], tuple[Row, ...]] = {
    "calls": _CALLS,
    "texts": _TEXTS,
    "anything": _ANYTHING,
}


def call_formats() -> Iterable[CallFormatSpec]:
    """Return a record for each form."""
    for begins, table in _TABLES.items():
        for name, opening, reader, models in table:
            yield CallFormatSpec(
                name=name,
                opening=opening,
                begins=begins,
                entry_point=f"gem_tools.call_formats.{reader}",
                summary=f"Calls of {models}.",
            )
