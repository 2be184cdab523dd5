"""``ToolEnv``: puts tools around any task."""

from __future__ import annotations

import copy
from collections.abc import Awaitable, Callable
from typing import Any

import gymnasium
import pydantic

from gem_core.env.checks import reset_needed
from gem_core.env.observations import join_observations, observation_from
from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.errors import ArgumentError
from gem_core.records.conversation import split_observation
from gem_core.tools.calls import CallReader, native_calls
from gem_core.tools.selection import ToolChoice, ToolChoices, tool_choices, tools_by_name
from gem_core.tools.sessions import ToolSessions
from gem_core.tools.tool import CALL_CLOSE, CALL_OPEN, Tool, ToolCall, ToolResult
from gem_core.types import Observation, ResetResult, Response, StepResult

__all__ = ["ToolChoice", "ToolChoices", "ToolEnv", "find_tool_env"]


class ToolEnv(Wrapper):
    """Lets an agent use tools in a task.

    A response that calls a tool is answered by the tool; any other goes to the task. Calls are read as tags and fenced
    blocks (see ``Tool``), as ``<tool_call>{"name": …, "arguments": …}</tool_call>``, and in the forms that plugins
    offer (see ``CallFormatSpec``): gem-tools has those of model families. The first complete call of a response is
    executed; what follows it is left out of ``info["parsed_action"]``. Native calls (``Response.tool_calls``) win over
    text: all are executed, in order, and answered under their ids in ``info["messages"]``. A call that fails or cannot
    be read is told to the agent, and never reaches the task as an answer.

    What stands in a thinking block is no call, as long as the block is closed; neither is what stands in a fenced block
    (``answer_fences``) or a tag (``answer_tags``) that is the task's answer, unless that begins with a call. A tool
    that has the name of such a tag is called in JSON only.

    ``info["tool"]`` says what a tool step did: ``name``, ``arguments``, ``failed`` and ``error`` of the call, the last
    of several; ``calls``, the same for each; and the counters ``uses``, ``successes`` and ``failures`` of the episode.
    A call whose ``info`` has a ``fault`` failed by the machinery, as where a server is gone: the agent is told so, and
    it earns no ``tool_error_reward``. A result with a ``fault`` of its own ends the episode as an error.
    ``info["tools"]`` holds the schemas at reset, and ``info["tool_instructions"]`` the words that explain them:
    ``text``, as in the observation, and ``native``, which take their place where an agent is offered the schemas.

    There is one around a task: ``make`` gathers all tools that it is given, and their options, into one.

    Args:
        env: The task.
        tools: Tools, classes of tools, or names of registered ones, a name or class with its options as in
            ``("search", {"top_k": 5})``; what a name stands for may be several. Names may be joined by commas.
        tool_reward: Added for each call that could be read.
        tool_success_reward: Added for each call that succeeded.
        tool_error_reward: Added for each call that failed or could not be read.
        max_tool_uses: Calls in an episode, unreadable ones included; after that every response goes to the
            task. None for no limit.
        instructions: Whether the first observation ends by explaining the tools; or the text to do so.
        thinking_tag: Name of the tag around thinking; with None, calls in it count as any other.
        call_timeout_s: Seconds that a call may take; what takes longer is given up, its session closed, and told to the
            agent. A coroutine is cancelled; a thread, which cannot be, is abandoned. None for no limit.
    """

    def __init__(
        self,
        env: AnyEnv,
        tools: ToolChoices,
        *,
        tool_reward: float = 0.0,
        tool_success_reward: float = 0.0,
        tool_error_reward: float = 0.0,
        max_tool_uses: int | None = 5,
        instructions: bool | str = True,
        thinking_tag: str | None = "think",
        call_timeout_s: float | None = None,
    ) -> None:
        super().__init__(env)
        if (there := find_tool_env(env)) is not None:
            raise ArgumentError(
                f"there are tools around this environment already: {', '.join(there.tools)}; give all tools to one "
                "ToolEnv, or to make(), which gathers them"
            )
        if max_tool_uses is not None and (type(max_tool_uses) is not int or max_tool_uses < 0):
            raise ArgumentError(f"max_tool_uses must be a whole number from 0 up or None, not {max_tool_uses!r}")
        if call_timeout_s is not None and (not isinstance(call_timeout_s, int | float) or not call_timeout_s > 0):
            raise ArgumentError(f"call_timeout_s must be a number of seconds above 0 or None, not {call_timeout_s!r}")
        if tool_reward or tool_success_reward or tool_error_reward:
            self.return_range = None
        self.tool_reward = tool_reward
        self.tool_success_reward = tool_success_reward
        self.tool_error_reward = tool_error_reward
        self.max_tool_uses = max_tool_uses
        self.instructions = instructions
        self._thinking_tag = thinking_tag
        self._call_timeout_s = call_timeout_s
        self._offer(tools_by_name(tool_choices(tools)))
        self._live = False
        self._suffix: Observation | None = None
        self._uses = self._successes = self._failures = 0

    def change_tools(self, change: Callable[[Tool], Tool]) -> None:
        """Offer another tool in the place of each, as a wrapper outside does when it is made, before any episode.

        Args:
            change: Called with each tool; returns what is offered instead, under the same name.
        """
        self._offer({name: change(tool) for name, tool in self.tools.items()})

    def _offer(self, tools: dict[str, Tool]) -> None:
        self.tools = tools
        self._reader = CallReader(
            tools,
            answer_fences=self.answer_fences,
            answer_tags=self.answer_tags,
            thinking_tag=self._thinking_tag,
        )
        self._sessions = ToolSessions(tools, self._call_timeout_s)
        self.needs = self._sessions.concurrency

    # The hooks.

    def before_reset(self, seed: int | None, options: dict[str, Any] | None) -> Awaitable[None] | None:
        """Close the sessions of the episode that is over."""
        self._live = False
        self._uses = self._successes = self._failures = 0
        closing = self._sessions.take()
        return self._sessions.finished(closing) if closing else None

    def after_reset(self, result: ResetResult) -> ResetResult:
        """Explain the tools."""
        observation, info = result
        feedback, suffix = split_observation(observation, info)
        self._suffix = suffix if "suffix" in info else None
        self._live = True
        info["tools"] = [tool.schema() for tool in self.tools.values()]
        if info.get("view") is not None:
            info["view"] = None  # a view inside the tools does not show their results
        text, native = self._instructions()
        if text:
            if self.instructions is True:
                info["tool_instructions"] = {"text": text, "native": native}
            feedback = join_observations([feedback, text if text.endswith("\n") else f"{text}\n"])
            observation = observation_from(feedback, suffix)
            if self._suffix is not None:
                info["feedback"] = feedback
        return observation, info

    def before_step(self, action: str) -> str | StepResult | Awaitable[str | StepResult]:
        """Answer a response that calls tools."""
        if self._uses_left() == 0:
            return action
        calls = native_calls(action.tool_calls or [], self.tools) if isinstance(action, Response) else []
        if not calls and (call := self.find_call(action)) is not None:
            calls = [call]
        if not calls:
            return action
        if not self._live:
            raise reset_needed(self)
        return self._sessions.finished(self._answer(action, calls))

    def after_step(self, action: str, result: StepResult) -> StepResult:
        """Remember the suffix, for the tool steps that follow."""
        info = result[4]
        self._suffix = info["suffix"] if "feedback" in info and "suffix" in info else None
        self._live = not (result[2] or result[3])
        return result

    def close(self) -> None:
        """Close the sessions, then the task."""
        self._sessions.close()
        super().close()

    # Reading and executing calls.

    def find_call(self, action: str) -> ToolCall | None:
        """Return the first complete call in a response, or the first that is begun; None for an answer to the task."""
        return self._reader.find(action)

    async def _answer(self, action: str, calls: list[ToolCall]) -> StepResult:
        outcomes, reward = [], 0.0
        for call in calls:
            if self._uses_left() == 0:
                outcomes.append((call, ToolResult("No tool calls were left: this one was not executed.", failed=True)))
                continue
            self._uses += 1
            result = await self._outcome(call)
            outcomes.append((call, result))
            reward += self.tool_reward if call.error is None else 0.0
            if "fault" in result.info:
                pass  # not the agent's failure; still a use, or a dead server would keep an episode for ever
            elif result.failed:
                self._failures += 1
                reward += self.tool_error_reward
            else:
                self._successes += 1
                reward += self.tool_success_reward
        return self._tool_step_result(action, outcomes, reward)

    async def _outcome(self, call: ToolCall) -> ToolResult:
        if call.error is not None:
            return ToolResult(f"The call could not be read: {call.error}", failed=True)
        tool = self.tools[call.name]
        try:
            arguments = tool.validate(call.arguments)
        except Exception as error:  # noqa: BLE001 - a tool's own validator may raise anything
            return ToolResult(_validation_message(error), failed=True)
        return await self._sessions.call(tool, arguments)

    def _tool_step_result(self, action: str, outcomes: list[tuple[ToolCall, ToolResult]], reward: float) -> StepResult:
        outputs = [join_observations([_title(call, result), result.content]) for call, result in outcomes]
        feedback = join_observations([*outputs, f"{self._what_is_left()}\n"])
        suffix: Observation = "" if self._suffix is None else self._suffix
        calls = [
            {
                **result.info,
                "name": call.name or None,
                "arguments": dict(call.arguments),
                "failed": result.failed,
                "error": call.error,
            }
            for call, result in outcomes
        ]
        counters = {"uses": self._uses, "successes": self._successes, "failures": self._failures}
        info: dict[str, Any] = {
            "feedback": feedback,
            "suffix": suffix,
            "parsed_action": str(action),
            "tool": {**calls[-1], "calls": calls, **counters},
        }
        last = outcomes[-1][0]
        if last.id is not None:
            info["messages"] = self._messages(outcomes)
        else:  # what follows a call in text was not read
            info["parsed_action"] = action[: last.end] if last.end else None
        fault = next((result.fault for _, result in outcomes if result.fault is not None), None)
        if fault is not None:
            self._live = False
            info["error"] = {"kind": "tool", "message": fault}
        return observation_from(feedback, suffix), reward, False, fault is not None, info

    def _messages(self, outcomes: list[tuple[ToolCall, ToolResult]]) -> list[dict[str, Any]]:
        messages = []
        for number, (call, result) in enumerate(outcomes, start=1):
            pieces: list[Observation] = [_title(call, result), result.content] if result.failed else [result.content]
            if number == len(outcomes):
                pieces.append(self._what_is_left())
            messages.append({"role": "tool", "tool_call_id": call.id, "content": join_observations(pieces)})
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

    def _instructions(self) -> tuple[str, str]:
        """Return the words that explain the tools, and those for an agent that is offered their schemas."""
        if isinstance(self.instructions, str):
            return self.instructions, ""
        most = self.max_tool_uses
        if not self.instructions or most == 0 or not self.tools:
            return "", ""
        limit = "" if most is None else f" You have {most} tool call{'' if most == 1 else 's'}."
        explained = []
        for tool in self.tools.values():
            if self._reader.leaves_fences_of(tool):
                tool = copy.copy(tool)  # so that no form is explained that would be taken for the answer
                tool.fences = ()
            in_json = tool.name in self._reader.reserved
            explained.append(tool.explained_in_json() if in_json else tool.instructions())
        lines = [
            "You may use tools before you answer. Make one call in a response: the result comes back to you, and "
            f"nothing that you write behind the call is read.{limit}",
            *explained,
            f'Any tool can also be called as {CALL_OPEN}{{"name": …, "arguments": {{…}}}}{CALL_CLOSE}.',
        ]
        hints = [hint for tool in self.tools.values() if (hint := tool.hints())]
        return "\n".join(lines), "\n".join([f"You may use tools before you answer.{limit}", *hints])

    def _own_record(self) -> tuple[str, dict[str, Any]]:
        return "tools", super()._own_record()[1]


def _title(call: ToolCall, result: ToolResult) -> str:
    return f"{'Error from' if result.failed else 'Output of'} {call.name or 'the tool call'}:"


def find_tool_env(env: AnyEnv) -> ToolEnv | None:
    """Return the wrapper that gives tools to a task, anywhere in an environment; None if there is none."""
    layer: Any = env
    while isinstance(layer, gymnasium.Wrapper):
        if isinstance(layer, ToolEnv):
            return layer
        layer = layer.env
    return None


def _validation_message(error: Exception) -> str:
    if isinstance(error, pydantic.ValidationError):
        problems = [f"{'.'.join(map(str, item['loc'])) or 'arguments'}: {item['msg']}" for item in error.errors()[:10]]
        return f"The arguments are not valid. {'; '.join(problems)}"[:2000]
    kind = "" if isinstance(error, ArgumentError) else f"{type(error).__name__}: "
    return f"The arguments are not valid. {kind}{error}"[:2000]
