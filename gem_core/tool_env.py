"""``ToolEnv``: puts tools around any task."""

from __future__ import annotations

import inspect
import logging
import weakref
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Mapping, Sequence
from typing import Any, TypeVar, cast

import pydantic

from gem_core.background import finish_or_start, in_thread
from gem_core.env import observation_from
from gem_core.errors import ArgumentError, StateNotSupported
from gem_core.spaces import is_part
from gem_core.tool_calls import json_call, native_calls
from gem_core.tools import CALL_CLOSE, CALL_OPEN, Tool, ToolCall, ToolResult, first_call
from gem_core.types import Concurrency, Observation, ResetResult, Response, StepResult
from gem_core.wrapper import AnyEnv, Wrapper, reset_needed
from gem_core.wrappers.views import joined, told_apart

T = TypeVar("T")

logger = logging.getLogger("gem_core")

ToolChoice = Tool | str | tuple[str, Mapping[str, Any]]
"""A tool, the name of a registered one, or such a name with its options."""


class ToolEnv(Wrapper):
    """Lets an agent use tools in a task.

    A response that calls a tool is answered by the tool; any other goes to the task. Calls are read as tags and fenced
    blocks (see ``Tool``) and as ``<tool_call>{"name": …, "arguments": …}</tool_call>``. The first complete call of a
    response is executed; what follows it is left out of ``info["parsed_action"]``. Native calls
    (``Response.tool_calls``) win over text: all are executed, in order, and answered under their ids in
    ``info["messages"]``. A call that fails or cannot be read is told to the agent, and never reaches the task as an
    answer.

    ``info["tool"]`` says what a tool step did: ``name``, ``arguments``, ``failed`` and ``error`` of the call, the last
    of several; ``calls``, the same for each; and the counters ``uses``, ``successes`` and ``failures`` of the episode.
    ``info["tools"]`` holds the schemas at reset.

    Args:
        env: The task.
        tools: Tools, or names of registered ones, or names with their options; what a name stands for may be several.
        tool_reward: Added for each call that could be read.
        tool_success_reward: Added for each call that succeeded.
        tool_error_reward: Added for each call that failed or could not be read.
        max_tool_uses: Calls in an episode, those that could not be read included; after that every response goes to the
            task. None for no limit.
        instructions: Whether the first observation ends by explaining the tools; or the text to do so.
    """

    def __init__(
        self,
        env: AnyEnv,
        tools: Sequence[ToolChoice],
        *,
        tool_reward: float = 0.0,
        tool_success_reward: float = 0.0,
        tool_error_reward: float = 0.0,
        max_tool_uses: int | None = 5,
        instructions: bool | str = True,
    ) -> None:
        super().__init__(env)
        self.tools = _by_name([tools] if isinstance(tools, str | Tool) else tools)
        if max_tool_uses is not None and (not isinstance(max_tool_uses, int) or max_tool_uses < 0):
            raise ArgumentError(f"max_tool_uses must be a whole number from 0 up or None, not {max_tool_uses!r}")
        self.tool_reward = tool_reward
        self.tool_success_reward = tool_success_reward
        self.tool_error_reward = tool_error_reward
        self.max_tool_uses = max_tool_uses
        self.instructions = instructions
        self.needs = _needs(self.tools.values())
        self._answer_fences = {language.casefold() for language in getattr(env.unwrapped, "answer_fences", ())}
        self._live = False
        self._suffix: Observation | None = None
        self._uses = self._successes = self._failures = 0
        self._sessions: dict[str, Any] = {}
        # Also runs when the wrapper is collected and when the interpreter exits.
        self._finalizer = weakref.finalize(self, _close_sessions, self.tools, self._sessions)

    # The hooks.

    def before_reset(self, seed: int | None, options: dict[str, Any] | None) -> Awaitable[None] | None:
        """Close the sessions of the episode that is over."""
        self._live = False
        self._uses = self._successes = self._failures = 0
        if not self._sessions:
            return None
        closing = _close_all(self.tools, self._take_sessions())
        return closing if self.needs == "async" else _finish_now(closing)

    def after_reset(self, result: ResetResult) -> ResetResult:
        """Explain the tools."""
        observation, info = result
        feedback, suffix = told_apart(observation, info)
        self._suffix = suffix if "suffix" in info else None
        self._live = True
        info["tools"] = [tool.schema() for tool in self.tools.values()]
        text = self.instructions if isinstance(self.instructions, str) else self._instructions()
        if self.instructions and text:
            feedback = joined([feedback, text if text.endswith("\n") else f"{text}\n"])
            observation = observation_from(feedback, suffix)
            if self._suffix is not None:
                info["feedback"] = feedback
        return observation, info

    def before_step(self, action: str) -> str | StepResult | Awaitable[str | StepResult]:
        """Answer a response that calls tools."""
        if self._uses_left() == 0:
            return action
        calls = native_calls(Response.of(action).tool_calls or [], self.tools)
        if not calls:
            call = self.find_call(action)
            if call is None:
                return action
            calls = [call]
        if not self._live:
            raise reset_needed(self)
        answering = self._answer(action, calls)
        return answering if self.needs == "async" else _finish_now(answering)

    def after_step(self, action: str, result: StepResult) -> StepResult:
        """Remember how things stand, for the tool steps that follow."""
        info = result[4]
        self._suffix = info["suffix"] if "feedback" in info and "suffix" in info else None
        self._live = not (result[2] or result[3])
        return result

    def close(self) -> None:
        """Close the sessions, then the task."""
        _close_sessions(self.tools, self._take_sessions())
        super().close()

    # Reading and executing calls.

    def find_call(self, action: str) -> ToolCall | None:
        """Return the first complete call in a response, or the first that is begun; None for an answer to the task."""
        found = [json_call(action, self.tools)]
        for tool in self.tools.values():
            fences = not any(language.casefold() in self._answer_fences for language in tool.fences)
            found.append(tool.parse(action, fences=fences))
        return first_call(found)

    async def _answer(self, action: str, calls: list[ToolCall]) -> StepResult:
        outcomes, reward = [], 0.0
        for call in calls:
            if self._uses_left() == 0:
                outcomes.append((call, ToolResult("No tool calls were left: this one was not executed.", failed=True)))
                continue
            self._uses += 1
            result = await self._outcome(call)
            if result.failed:
                self._failures += 1
            else:
                self._successes += 1
            reward += self.tool_reward if call.error is None else 0.0
            reward += self.tool_error_reward if result.failed else self.tool_success_reward
            outcomes.append((call, result))
        return self._answered(action, outcomes, reward)

    async def _outcome(self, call: ToolCall) -> ToolResult:
        if call.error is not None:
            return ToolResult(f"The call could not be read: {call.error}", failed=True)
        tool = self.tools[call.name]
        try:
            arguments = tool.validate(call.arguments)
        except Exception as error:  # noqa: BLE001 - a validator of the tool's own may fail in any way
            return ToolResult(_validation_message(error), failed=True)
        try:
            if call.name not in self._sessions:
                self._sessions[call.name] = await _run(self.needs, tool, tool.open)
            return await self._call(tool, arguments)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a failing tool is an observation for the agent
            message = f"{type(error).__name__}: {error}".strip()[:2000]
            return ToolResult(f"The tool failed: {message}", failed=True)

    async def _call(self, tool: Tool, arguments: Any) -> ToolResult:
        outcome = await _run(self.needs, tool, tool.call, arguments, self._sessions[tool.name])
        result = outcome if isinstance(outcome, ToolResult) else ToolResult(outcome)
        content = result.content
        if isinstance(content, str) or (isinstance(content, list) and all(map(is_part, content))):
            return result
        raise TypeError(
            f"{tool.name} returned {type(content).__name__}, not text, content parts or a ToolResult of them"
        )

    def _answered(self, action: str, outcomes: list[tuple[ToolCall, ToolResult]], reward: float) -> StepResult:
        outputs = [joined([_title(call, result), result.content]) for call, result in outcomes]
        feedback = joined([*outputs, f"{self._what_is_left()}\n"])
        suffix: Observation = "" if self._suffix is None else self._suffix
        last = outcomes[-1][0]
        calls = [_described(call, result) for call, result in outcomes]
        info: dict[str, Any] = {
            "feedback": feedback,
            "suffix": suffix,
            "parsed_action": _parsed_action(str(action), last),
            "tool": {
                **calls[-1],
                "calls": calls,
                "uses": self._uses,
                "successes": self._successes,
                "failures": self._failures,
            },
        }
        if last.id is not None:
            info["messages"] = self._messages(outcomes)
        return observation_from(feedback, suffix), reward, False, False, info

    def _messages(self, outcomes: list[tuple[ToolCall, ToolResult]]) -> list[dict[str, Any]]:
        messages = []
        for number, (call, result) in enumerate(outcomes, start=1):
            pieces: list[Observation] = [_title(call, result), result.content] if result.failed else [result.content]
            if number == len(outcomes):
                pieces.append(self._what_is_left())
            messages.append({"role": "tool", "tool_call_id": call.id, "content": joined(pieces)})
        return messages

    def _uses_left(self) -> int | None:
        return None if self.max_tool_uses is None else max(self.max_tool_uses - self._uses, 0)

    def _what_is_left(self) -> str:
        left = self._uses_left()
        if left is None:
            return "You may call a tool again, or give your answer."
        if left == 0:
            return "No tool calls are left. Give your answer to the task now."
        return f"Tool calls left: {left}. Call a tool again, or give your answer."

    def _instructions(self) -> str:
        if self.max_tool_uses == 0:
            return ""
        limit = "" if self.max_tool_uses is None else f" You have {self.max_tool_uses} tool calls."
        lines = [
            "You may use tools before you answer. Make one call in a response: the result comes back to you, and "
            f"nothing that you write behind the call is read.{limit}",
            *(tool.instructions() for tool in self.tools.values()),
            f'Any tool can also be called as {CALL_OPEN}{{"name": …, "arguments": {{…}}}}{CALL_CLOSE}.',
        ]
        return "\n".join(lines)

    def _take_sessions(self) -> dict[str, Any]:
        taken = dict(self._sessions)
        self._sessions.clear()
        return taken

    def _get_state(self) -> dict[str, Any]:
        if self._suffix is not None and not isinstance(self._suffix, str):
            raise StateNotSupported("the task's suffix holds content parts, whose images are not plain data")
        return {
            "live": self._live,
            "counters": [self._uses, self._successes, self._failures],
            "suffix": self._suffix,
            "sessions": {name: self.tools[name].get_session_state(s) for name, s in self._sessions.items()},
        }

    def _set_state(self, state: dict[str, Any]) -> None:
        _close_sessions(self.tools, self._take_sessions())
        self._uses, self._successes, self._failures = state["counters"]
        self._suffix, self._live = state["suffix"], bool(state["live"])
        for name, session in state["sessions"].items():
            self._sessions[name] = self.tools[name].set_session_state(session)


def _title(call: ToolCall, result: ToolResult) -> str:
    return f"{'Error from' if result.failed else 'Output of'} {call.name or 'the tool call'}:"


def _described(call: ToolCall, result: ToolResult) -> dict[str, Any]:
    return {
        **result.info,
        "name": call.name or None,
        "arguments": dict(call.arguments),
        "failed": result.failed,
        "error": call.error,
    }


def _parsed_action(action: str, call: ToolCall) -> str | None:
    if call.id is not None:
        return action
    return action[: call.end] if call.end else None


def _by_name(choices: Iterable[ToolChoice]) -> dict[str, Tool]:
    """Return the tools that were chosen by their names, in order."""
    tools: dict[str, Tool] = {}
    origins: dict[str, str] = {}
    for choice in choices:
        origin, found = _resolved(choice)
        for tool in found:
            if tool.name in tools:
                raise ArgumentError(
                    f"two tools have one name, {tool.name!r}: {origins[tool.name]} and {origin}; calls could not be "
                    "told apart, so leave one out, or give it another name by its options"
                )
            tools[tool.name], origins[tool.name] = tool, origin
    return tools


def _resolved(choice: ToolChoice) -> tuple[str, list[Tool]]:
    """Return where tools come from, in words, and the tools."""
    if isinstance(choice, Tool):
        return f"an instance of {type(choice).__name__}", [choice]
    from gem_core.making import construct
    from gem_core.registry import registry

    name, options = _name_and_options(choice)
    made = construct(registry().tool(name), **options)
    found = list(made) if isinstance(made, Sequence) and not isinstance(made, str) else [made]
    for tool in found:
        if not isinstance(tool, Tool):
            raise ArgumentError(f"the entry point of tool {name!r} returned {type(tool).__name__}, not a Tool")
    return f"one of {name!r}", found


def _name_and_options(choice: object) -> tuple[str, dict[str, Any]]:
    if isinstance(choice, str):
        return choice, {}
    if isinstance(choice, Sequence) and len(choice) == 2 and isinstance(choice[1], Mapping):
        return str(choice[0]), dict(choice[1])
    raise ArgumentError(f"a tool is a Tool, a name, or (name, {{options}}), not {choice!r}")


def _needs(tools: Any) -> Concurrency:
    wanted = {"async" if _has_coroutines(tool) else tool.concurrency for tool in tools}
    for need in ("process", "async", "thread"):
        if need in wanted:
            return need
    return "inline"


def _has_coroutines(tool: Tool) -> bool:
    return any(map(inspect.iscoroutinefunction, (tool.call, tool.open, tool.close)))


async def _run(needs: Concurrency, tool: Tool, method: Callable[..., Any], *args: Any) -> Any:
    """Run a method of a tool; on the loop, that of a tool that blocks goes into a thread."""
    blocks = tool.concurrency != "inline" and not inspect.iscoroutinefunction(tool.call)
    if needs == "async" and blocks and not inspect.iscoroutinefunction(method):
        return await _settled(await in_thread(method, *args))
    return await _settled(method(*args))


async def _settled(value: Any) -> Any:
    return await value if inspect.isawaitable(value) else value


def _finish_now(coroutine: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine in which nothing waits; one that does wait goes on the library's loop instead."""
    try:
        coroutine.send(None)
    except StopIteration as finished:
        return cast("T", finished.value)
    coroutine.close()
    raise ArgumentError("a plain tool waited for something; make its call() a coroutine function")


async def _close_all(tools: Mapping[str, Tool], sessions: Mapping[str, Any]) -> None:
    needs = _needs(tools.values())
    for name, session in sessions.items():
        try:
            await _run(needs, tools[name], tools[name].close, session)
        except (Exception, SystemExit):
            logger.warning("gem: closing the session of tool %r failed", name, exc_info=True)


def _close_sessions(tools: Mapping[str, Tool], sessions: dict[str, Any]) -> None:
    taken = dict(sessions)
    sessions.clear()
    if taken:
        closing = _close_all(tools, taken)
        if _needs(tools.values()) == "async":
            finish_or_start(closing)
        else:
            _finish_now(closing)


def _validation_message(error: Exception) -> str:
    if isinstance(error, RecursionError):
        return "The arguments are nested too deeply."
    if isinstance(error, ArgumentError):
        return f"The arguments are not valid. {error}"[:2000]
    if not isinstance(error, pydantic.ValidationError):
        return f"The arguments are not valid. {type(error).__name__}: {error}"[:2000]
    lines = [f"{'.'.join(map(str, item['loc'])) or 'arguments'}: {item['msg']}"[:300] for item in error.errors()[:10]]
    return "The arguments are not valid. " + "; ".join(lines)
