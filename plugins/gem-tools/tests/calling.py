"""Tools that take code, a query and values, and calls of them as chat templates write them."""

from __future__ import annotations

from typing import Any

import pydantic

import gem_core as gem
from gem_core.tools.env import ToolEnv


class Recorder(gem.Env):
    """Keeps what reached it; is answered in fenced blocks of text."""

    answer_fences = ("text",)

    def __init__(self) -> None:
        super().__init__()
        self.heard: list[str] = []

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        return "Say something.", {}

    def step(self, action: str) -> Any:
        self.heard.append(action)
        return f"Heard: {action}", 0.0, False, False, {}


class Python(gem.Tool):
    """Takes code; blocks of Python are calls."""

    name = "python"
    fences = ("python", "py")
    concurrency = "inline"

    class Parameters(pydantic.BaseModel):
        """A program."""

        code: str

    def call(self, arguments: Parameters, session: Any) -> str:
        return arguments.code


class Search(gem.Tool):
    """Takes a query."""

    name = "search"
    concurrency = "inline"

    class Parameters(pydantic.BaseModel):
        """A query, and how many are wanted."""

        query: str
        top_k: int = 3

    def call(self, arguments: Parameters, session: Any) -> str:
        return arguments.query


class Trip(gem.Tool):
    """Takes values of every kind."""

    name = "plan-trip"
    concurrency = "inline"

    class Parameters(pydantic.BaseModel):
        """Where to, for how long, and with whom."""

        city: str
        days: int
        note: str | None = None
        people: list[str] = []
        quick: bool = False

    def call(self, arguments: Parameters, session: Any) -> str:
        return arguments.model_dump_json()


def around(**options: Any) -> ToolEnv:
    env = ToolEnv(Recorder(), [Python(), Search(), Trip()], **{"max_tool_uses": None, **options})
    env.reset()
    return env


def step(action: str, **options: Any) -> dict[str, Any] | None:
    """Return ``info`` of a step that was a call; None where the task got the response."""
    env = around(**options)
    info = env.step(action)[4]
    assert (env.unwrapped.heard == []) is ("tool" in info)
    return info if "tool" in info else None


def called(action: str, **options: Any) -> tuple[str, Any] | None:
    """Return name and arguments of the call that was executed; None where the task got the response."""
    info = step(action, **options)
    if info is None:
        return None
    assert not info["tool"]["failed"], info["feedback"]
    return info["tool"]["name"], info["tool"]["arguments"]


def refused(action: str, **options: Any) -> str:
    """Return what is told of a call that cannot be read."""
    info = step(action, **options)
    assert info is not None
    assert info["tool"]["uses"] == info["tool"]["failures"] == 1
    return str(info["feedback"]).partition("\n")[2].partition("\nYou may")[0]


CODE = "print(6*7)"
RUN = ("python", {"code": CODE})
J1 = '{"name": "python", "arguments": {"code": "print(6*7)"}}'
J2 = J1.replace("6*7", "1")
P1, P2 = (text.replace("arguments", "parameters") for text in (J1, J2))
A1 = '{"code": "print(6*7)"}'
A2 = A1.replace("6*7", "1")


def qwen(code: str = CODE) -> str:
    return f"<tool_call>\n<function=python>\n<parameter=code>\n{code}\n</parameter>\n</function>\n</tool_call>"


def glm(code: str = CODE) -> str:
    return f"<tool_call>python\n<arg_key>code</arg_key>\n<arg_value>{code}</arg_value>\n</tool_call>"


def dsml(code: str = CODE, outer: str = "function_calls") -> str:
    return (
        f'<｜DSML｜{outer}>\n<｜DSML｜invoke name="python">\n<｜DSML｜parameter name="code" string="true">{code}'
        f"</｜DSML｜parameter>\n</｜DSML｜invoke>\n</｜DSML｜{outer}>"
    )


def invoke(code: str = CODE) -> str:
    return f'<invoke name="python">\n<parameter name="code">{code}</parameter>\n</invoke>'


def v3(arguments: str = A1) -> str:
    return f"<｜tool▁call▁begin｜>function<｜tool▁sep｜>python\n```json\n{arguments}\n```<｜tool▁call▁end｜>"


def v31(arguments: str = A1) -> str:
    return f"<｜tool▁call▁begin｜>python<｜tool▁sep｜>{arguments}<｜tool▁call▁end｜>"


def kimi(arguments: str = A1, number: int = 0) -> str:
    return f"<|tool_call_begin|>functions.python:{number}<|tool_call_argument_begin|>{arguments}<|tool_call_end|>"


def step3(code: str = CODE) -> str:
    return (
        '<｜tool_call_begin｜>function<｜tool_sep｜><steptml:invoke name="python">\n<steptml:parameter name="code">'
        f"{code}</steptml:parameter>\n</steptml:invoke><｜tool_call_end｜>"
    )


def hy3(suffix: str = "") -> str:
    s = suffix
    return (
        f"<tool_calls{s}>\n<tool_call{s}>python<tool_sep{s}>\n<arg_key{s}>code</arg_key{s}>\n<arg_value{s}>{CODE}"
        f"</arg_value{s}>\n</tool_call{s}>\n</tool_calls{s}>"
    )


def cohere(*codes: str) -> str:
    items = [
        f'    {{"tool_call_id": "{place}", "tool_name": "python", "parameters": {{"code": "{code}"}}}}'
        for place, code in enumerate(codes)
    ]
    return "<|START_ACTION|>[\n" + ",\n".join(items) + "\n]<|END_ACTION|>"


SEED = qwen().replace("tool_call", "seed:tool_call")
M2 = f"<minimax:tool_call>\n{invoke()}\n</minimax:tool_call>"
CALLS_END = "<｜tool▁calls▁end｜><｜end▁of▁sentence｜>"
KIMI = "<|tool_calls_section_begin|>{}<|tool_calls_section_end|>"
HARMONY = f"<|channel|>commentary to=functions.python <|constrain|>json<|message|>{A1}"


def lfm2(*calls: str) -> str:
    return f"<|tool_call_start|>[{', '.join(calls)}]<|tool_call_end|>"
