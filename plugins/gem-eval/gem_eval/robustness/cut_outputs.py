"""``cut_outputs``: outputs of tools and of the task that end too early."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from gem_core.env import AnyEnv, observation_from
from gem_core.records import split_observation
from gem_core.tools import ToolResult, find_tool_env
from gem_core.types import TERMINAL_STATE, Observation, StepResult
from gem_eval.robustness.changed_tool import ChangedTool
from gem_eval.robustness.perturbation import Perturbation, share

_MARK = "\n[The output is cut off here.]\n"


class CutOutputs(Perturbation):
    """Cuts off some of the outputs that answer a response, and says so at the cut.

    Of a tool's output, what the tool returned is cut, and what says how many calls are left stays. Of a task's, the
    feedback is cut, and the board behind it (``info["suffix"]``) stays; without these two keys, all of the observation.
    The first observation and the last one of an episode are never cut.

    Args:
        env: What is disturbed; inside any view of the history.
        rate: Probability that an output is cut off.
        keep: Share of its characters that is kept.

    Raises:
        ArgumentError: ``rate`` or ``keep`` is no number from 0 to 1.
    """

    def __init__(self, env: AnyEnv, rate: float = 0.3, keep: float = 0.5) -> None:
        super().__init__(env, rate)
        self.keep = share(keep, "keep")
        tools = find_tool_env(env)
        self._has_tools = tools is not None
        if tools is not None:
            tools.change_tools(lambda tool: ChangedTool(tool, after=self._cut_result))

    def after_step(self, action: str, result: StepResult) -> StepResult:
        """Cut what the task said, and what it answered native calls with."""
        observation, reward, terminated, truncated, info = result
        already_cut = self._has_tools and "tool" in info
        if terminated or truncated or already_cut or observation == TERMINAL_STATE or not self.happens():
            return result
        feedback, suffix = split_observation(observation, info)
        feedback = self._cut(feedback)
        if "feedback" in info:
            info["feedback"] = feedback
        if "messages" in info:
            info["messages"] = [{**each, "content": self._cut(each.get("content") or "")} for each in info["messages"]]
        return observation_from(feedback, suffix), reward, terminated, truncated, info

    def _cut_result(self, result: ToolResult) -> ToolResult:
        return replace(result, content=self._cut(result.content)) if self.happens() else result

    def _cut(self, output: Observation) -> Any:
        if isinstance(output, str):
            return output[: int(len(output) * self.keep)] + _MARK if output else output
        return [{**part, "text": self._cut(part["text"])} if part.get("type") == "text" else part for part in output]
