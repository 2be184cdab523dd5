"""``TauEnv``: an assistant with tools, and the user whom it serves, as two agents of one environment."""

from __future__ import annotations

import copy
import json
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

from gem_core import Env, MultiAgentEnv, Response, single_agent
from gem_core.data import chosen_index
from gem_core.errors import ArgumentError, DatasetError
from gem_core.parsing import visible_text
from gem_core.tools import CALL_CLOSE, CALL_OPEN, CallReader, DescribedTool, ToolCall, native_calls
from gem_core.types import TERMINAL_STATE, Info
from gem_tau.database import fork
from gem_tau.folders import TaskSet, read_folder
from gem_tau.prompts import GREETING, NOTHING_SAID, STOP, STOPS, tool_instructions, user_system
from gem_tau.rewards import reward
from gem_tau.tasks import Action, Task

ASSISTANT, USER = "assistant", "user"

Verdict = tuple[dict[str, float], dict[str, bool], dict[str, bool], dict[str, Info]]


class TauEnv(MultiAgentEnv):
    """A user asks a company's assistant for something; the assistant has tools and a policy.

    The user writes first. A response of the assistant that calls a tool is answered by the tool, and the assistant acts
    again; any other is said to the user, without its thinking. The user never sees calls and results, and the assistant
    never sees the user's instruction. Calls are read in the forms in which models are trained to write them, and
    natively (``Response.tool_calls``); the first call of a response is executed, and further native ones are answered
    as not executed.

    The episode ends when the user writes ``###STOP###`` or the assistant calls the tool that hands over to a human. The
    assistant's reward is then 1.0 if the database is as the reference actions leave it and all outputs of the task were
    told to the user, else 0.0. It is 0.0 too when both are truncated because the assistant has acted
    ``max_assistant_steps`` times. The user's reward is always 0.0.

    The first info of each seat has ``system``, which is the policy or the user's instruction; the assistant's also has
    ``tools``. The assistant's last one has ``correct``, and in ``tau`` the components of the reward, ``DB`` and
    ``COMMUNICATE``. The user is never judged: its first one has ``correct`` None.

    Args:
        folder: Data of tau-bench or tau2-bench, see ``read_folder``, which is read once in a process;
            ``gem_tau:sample`` is the shop of this plugin.
        split: Only the tasks of this split, such as ``test``; None for all.
        max_assistant_steps: Responses of the assistant after which the episode is truncated.

    Raises:
        ArgumentError: ``max_assistant_steps`` is no positive whole number.
        DatasetError: The folder cannot be read, or has no task whose reward can be computed.

    Source: tau-bench, arXiv:2406.12045.
    """

    possible_agents = (ASSISTANT, USER)

    shared_by_forks = ("task_set",)

    def __init__(self, folder: str | Path, *, split: str | None = None, max_assistant_steps: int = 30) -> None:
        super().__init__()
        if type(max_assistant_steps) is not int or max_assistant_steps < 1:
            raise ArgumentError(f"max_assistant_steps must be a positive whole number, not {max_assistant_steps!r}")
        self.task_set = _task_set(str(folder), split, Path(folder).resolve())
        self.num_tasks = len(self.task_set.tasks)
        if not self.num_tasks:
            raise DatasetError(f"{folder} has no task whose reward can be computed; see 'gem tau check'")
        self.max_assistant_steps = max_assistant_steps
        self._tools = {schema["function"]["name"]: DescribedTool(schema["function"]) for schema in self.task_set.tools}
        self._reader = CallReader(self._tools)
        self._index = self._responses = 0

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        if "_database" in vars(self):
            memo[id(self._database)] = fork(self._database)  # records are never changed in place
        return super().__deepcopy__(memo)

    @property
    def task(self) -> Task:
        """The task of this episode."""
        return self.task_set.tasks[self._index]

    def task_row(self, index: int) -> dict[str, Any]:
        """Return the id of a task as ``task_id``; see ``Env.task_row``."""
        return {"task_id": self.task_set.tasks[index].id}

    def begin_episode(self, options: dict[str, Any] | None) -> dict[str, Info]:
        """Draw a task, or take the one of ``options={"index": i}``."""
        count = len(self.task_set.tasks)
        self._index = chosen_index(options, count) if options else int(self.np_random.integers(count))
        self._database = fork(self.task_set.database)
        self._calls: list[Action] = []
        self._said: list[str] = []
        self._responses = 0
        self._shown = {ASSISTANT: TERMINAL_STATE, USER: GREETING}
        self.agent_selector.override(USER)
        known = {"task_id": self.task.id, "index": self._index}
        explained = f"\n\n{tool_instructions(self.task_set.tools)}"
        assistant = {
            **known,
            "system": f"{self.task_set.policy.strip()}{explained}",
            "tools": copy.deepcopy(self.task_set.tools),
            "tool_instructions": {"text": explained, "native": ""},
        }
        # The user is never judged, not even where an episode is cut off.
        return {ASSISTANT: assistant, USER: {**known, "system": user_system(self.task.instruction), "correct": None}}

    def observe(self, agent: str) -> str:
        """Return what was said to the agent, or what its tool returned."""
        return self._shown[agent]

    def process_actions(self, actions: dict[str, str]) -> Verdict:
        """Say what the user says, or what the assistant says, or call a tool."""
        if USER in actions:
            return self._hear_user(visible_text(actions[USER]))
        response = actions[ASSISTANT]
        self._responses += 1
        calls = self._calls_in(response)
        if calls:
            return self._call(response, calls)
        words = visible_text(response)
        self._said.append(words)
        self._shown[USER] = words or NOTHING_SAID
        return {}, {}, {}, {ASSISTANT: {"parsed_action": words}}

    def sample_random_action(self, agent: str) -> str:  # type: ignore[override]  # an agent has to be named
        """Return a short message, or as the assistant a call of any tool; the user stops once in five times."""
        draw = int(self.action_random.integers(0, 5))
        if agent == USER:
            return "Yes, please." if draw else STOP
        if draw < 2:
            return "What can I do for you?"
        tool = list(self._tools.values())[int(self.action_random.integers(0, len(self._tools)))]
        arguments = dict.fromkeys(tool.parameters_schema().get("properties", {}), "1")
        return f"{CALL_OPEN}{json.dumps({'name': tool.name, 'arguments': arguments})}{CALL_CLOSE}"

    def gold_action(self, agent: str) -> str | None:  # type: ignore[override]  # an agent has to be named
        """Return the next of the reference actions as a call, and after the last one what the user has to be told."""
        if agent == USER:
            return None
        actions = self.task.actions
        if len(self._calls) < len(actions):
            action = actions[len(self._calls)]
            return f"{CALL_OPEN}{json.dumps({'name': action.name, 'arguments': action.arguments})}{CALL_CLOSE}"
        return " ".join([*self.task.outputs, "Everything is done."])

    def _hear_user(self, words: str) -> Verdict:
        self._shown[ASSISTANT] = words or NOTHING_SAID
        if self._responses and any(stop in words for stop in STOPS):  # the first message ends nothing, as in tau-bench
            return self._end({})
        return self._truncate({}) if self._responses >= self.max_assistant_steps else ({}, {}, {}, {})

    def _calls_in(self, response: str) -> list[ToolCall]:
        calls = native_calls(response.tool_calls or [], self._tools) if isinstance(response, Response) else []
        written = None if calls else self._reader.find(response)
        return calls if written is None else [written]

    def _call(self, response: str, calls: list[ToolCall]) -> Verdict:
        call = calls[0]
        result = self._execute(call)
        failed = call.error is not None or result.startswith("Error: ")
        self._shown[ASSISTANT] = result if call.error else f"Output of {call.name}:\n{result}"
        info: Info = {
            "parsed_action": _executed(response, call),
            "tool": {"name": call.name, "arguments": dict(call.arguments), "failed": failed, "error": call.error},
        }
        if call.id is not None:
            others = [(other, "Not executed: only the first call of a response is.") for other in calls[1:]]
            info["messages"] = [
                {"role": "tool", "tool_call_id": each.id, "content": text} for each, text in [(call, result), *others]
            ]
        if call.error is None and call.name in self.task_set.domain.ends:
            return self._end(info)
        if self._responses >= self.max_assistant_steps:
            return self._truncate(info)
        self.agent_selector.override(ASSISTANT)
        return {}, {}, {}, {ASSISTANT: info}

    def _execute(self, call: ToolCall) -> str:
        if call.error is not None:
            return f"The call could not be read: {call.error}"
        self._calls.append(Action(call.name, dict(call.arguments)))
        return self.task_set.domain.call(self._database, call.name, call.arguments)

    def _end(self, info: Info) -> Verdict:
        self._shown[USER] = TERMINAL_STATE
        value, components = reward(self.task_set, self.task, self._database, self._said, self._calls)
        info = {**info, "correct": value == 1.0, "tau": components}
        return {ASSISTANT: value}, dict.fromkeys(self.agents, True), {}, {ASSISTANT: info}

    def _truncate(self, info: Info) -> Verdict:
        self._shown[USER] = TERMINAL_STATE
        return {}, {}, dict.fromkeys(self.agents, True), {ASSISTANT: {**info, "correct": False}}


def solo(
    folder: str | Path, *, split: str | None = None, user: Any = "tau-user:patient", max_assistant_steps: int = 30
) -> Env:
    """Make a ``TauEnv`` for the assistant alone.

    Args:
        folder: See ``TauEnv``.
        split: See ``TauEnv``.
        user: Who plays the user: an agent or the name of one, as ``openai:MODEL``; of a list, one is drawn for each
            episode.
        max_assistant_steps: See ``TauEnv``.
    """
    env = TauEnv(folder, split=split, max_assistant_steps=max_assistant_steps)
    return single_agent(env, ASSISTANT, {USER: user})


def _executed(response: str, call: ToolCall) -> str | None:
    """Return what was executed of a response: up to the end of the call, or all of it where the call is native."""
    if call.id is not None:
        return str(response)
    return response[: call.end] if call.end else None


@lru_cache(maxsize=4)
def _task_set(folder: str, split: str | None, where: Path) -> TaskSet:
    """Read a folder once for all environments: a task set takes some 10 MB, and is never changed."""
    return read_folder(folder, split)
