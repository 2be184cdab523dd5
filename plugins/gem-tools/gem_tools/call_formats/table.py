"""The table: how the calls of each family begin, and what reads them. A tag that several families share stands once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal

from gem_core.registry import CallFormatSpec

_KEYS = "name|tool_name|function|tool|action|arguments|parameters|args|input|tool_input|action_input|type|id"
_PREFIX = r"(?:[A-Za-z]\w{0,20}+:)?"

Row = tuple[str, str, str, str]
"""Name, opening, reader, and the models that write it."""

_ROWS: Mapping[Literal["calls", "texts", "anything"], tuple[Row, ...]] = {
    "calls": (
        # JSON, a name with arguments, or an element, which the next character tells.
        ("tool_call", r"<tool_call(?::\w{1,40})?>", "body", "Hermes, Qwen, Granite, ERNIE, GLM, Hunyuan 3"),
        ("tool_calls", r"<tool_calls(?::\w{1,40})?>", "body", "MiniMax M1, Hunyuan, Jamba"),
        ("granite", r"<function_call>|<\|tool_call\|>", "body", "Granite 3.0 and 20b"),
        ("nemotron", r"<TOOLCALL>", "body", "Nemotron"),
        ("longcat", r"<longcat_tool_call>", "body", "LongCat"),
        ("mistral", r"\[TOOL_CALLS\]", "body", "Mistral"),
        ("deepseek", r"<｜tool▁calls?▁begin｜>", "body", "DeepSeek V3, R1 and V3.1"),
        ("kimi_k2", r"<\|tool_calls?_section_begin\|>|<\|tool_call_begin\|>", "body", "Kimi K2"),
        ("cohere", r"<\|START_ACTION\|>", "body", "Cohere Command R7B and A"),
        ("lfm2", r"<\|tool_call_start\|>", "body", "LFM2"),
        ("gemma", r"<start_function_call>|<\|tool_call>", "body", "FunctionGemma, Gemma 4"),
        ("internlm", r"<\|action_start\|>\s*+<\|plugin\|>", "body", "InternLM"),
        # Elements.
        ("function_calls", rf"<{_PREFIX}function_calls>", "body", "OLMo 3, and like Anthropic's"),
        ("invoke", rf"<{_PREFIX}invoke(?= name=)", "invoke", "MiniMax M2, and like Anthropic's"),
        ("function", r"<function(?:=| name=)", "function", "Llama 3; Qwen3-Coder, without the outer tag"),
        ("minimax_m2", r"<minimax:tool_call>", "body", "MiniMax M2"),
        ("seed_oss", r"<seed:tool_call>", "body", "Seed-OSS"),
        ("dsml", r"<｜DSML｜(?:function_calls|tool_calls)>", "body", "DeepSeek V3.2 and V4"),
        ("dsml_inner", r"<｜DSML｜invoke", "function", "DeepSeek V3.2 and V4, without the outer tag"),
        ("step3", r"<｜tool_calls_begin｜>", "body", "Step3"),
        # Code and queries.
        ("python_tag", r"<\|python_tag\|>|<\|python_start\|>", "body", "Llama 3 and 4, ToolACE"),
        ("search_o1", r"<\|begin_search_query\|>", "search_query", "Search-o1"),
        ("r1_searcher", r"<\|begin_of_query\|>", "query", "R1-Searcher"),
        ("codeact", r"<execute>", "execute", "CodeAct"),
    ),
    "texts": (
        ("phi_4_mini", r"functools\[", "functools", "Phi-4-mini"),
        ("harmony", r"to=", "message", "gpt-oss"),
        ("react", r"Action:", "react", "ReAct"),
        ("smolagents", r"<code>", "code_lines", "smolagents, ReTool"),
    ),
    "anything": (
        ("json", rf"""\{{\s*+["'](?:{_KEYS})["']\s*+:""", "bare_json", "Llama 3, xLAM"),
        ("python", r"(?:\[|\A)\s*+(?=[A-Za-z_][\w.-]{0,200}+\s*+\()", "bare_python", "Llama 4, ToolACE, Gemma"),
    ),
}


def call_formats() -> Iterable[CallFormatSpec]:
    """Return a record for each form."""
    for begins, rows in _ROWS.items():
        for name, opening, reader, models in rows:
            yield CallFormatSpec(
                name=name,
                opening=opening,
                begins=begins,
                entry_point=f"gem_tools.call_formats.readers:read_{reader}",
                summary=f"Calls of {models}.",
            )
