"""Tasks, and the files of tau-bench and tau2-bench that they are read from."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel, Field


@dataclass(frozen=True)
class Action:
    """One call of a tool."""

    name: str
    arguments: dict[str, Any]
    compare: tuple[str, ...] | None = None
    """Arguments by which a call is compared with this one where the reward looks at calls; None for all."""

    def matches(self, call: Action) -> bool:
        """Return whether a call of the assistant is this one, as tau2-bench compares them."""
        if self.name != call.name:
            return False
        names = call.arguments.keys() if self.compare is None else self.compare
        return {name: value for name, value in self.arguments.items() if name in names} == {
            name: value for name, value in call.arguments.items() if name in names
        }


@dataclass(frozen=True)
class Task:
    """One task of a benchmark."""

    id: str
    """``test-0`` for the first of tasks_test.json; the file's own id in tau2-bench."""

    instruction: str
    """What the simulated user is told: who they are, what they want and how they behave."""

    actions: tuple[Action, ...] = ()
    """Reference actions: the final database must be the one that they lead to."""

    outputs: tuple[str, ...] = ()
    """What the assistant must say to the user."""

    reward_basis: tuple[str, ...] = ("DB", "COMMUNICATE")
    """Components whose product is the reward, of ``DB``, ``COMMUNICATE``, ``ACTION``."""


class TauAction(BaseModel):
    """A reference action of tau-bench."""

    name: str
    kwargs: dict[str, Any]


class TauTask(BaseModel):
    """A task of tau-bench."""

    instruction: str
    actions: list[TauAction]
    outputs: list[str] = Field(default_factory=list)

    def task(self, task_id: str) -> Task:
        """Return it as a task of ours."""
        return Task(
            id=task_id,
            instruction=self.instruction,
            actions=tuple(Action(each.name, each.kwargs) for each in self.actions),
            outputs=tuple(self.outputs),
        )


def read_python_tasks(code: str) -> list[Any]:
    """Return the tasks of one of tau-bench's Python files as plain data, without running it.

    Args:
        code: A module that assigns one list of ``Task(…)`` with literal arguments.

    Raises:
        ValueError: It has no such list, or there is something else in it.
        SyntaxError: It is no Python.
    """
    lists = [node.value for node in ast.parse(code).body if isinstance(node, ast.Assign)]
    if len(lists) != 1:
        raise ValueError(f"{len(lists)} assignments in place of one")
    tasks: list[Any] = _plain(lists[0])
    return tasks


def read_python_tool(code: str) -> Any:
    """Return what ``get_info`` of one of tau-bench's Python files of tools returns, without running it.

    Raises:
        ValueError: There is no such function, or it returns something else than a literal.
        SyntaxError: It is no Python.
    """
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.FunctionDef) and node.name == "get_info" and isinstance(node.body[-1], ast.Return):
            return ast.literal_eval(node.body[-1].value or ast.Constant(None))
    raise ValueError("no function get_info that returns")


def _plain(node: ast.expr) -> Any:
    match node:
        case ast.Call(func=ast.Name(id="Task" | "Action"), args=[]):
            return {each.arg: _plain(each.value) for each in node.keywords}
        case ast.List():
            return [_plain(each) for each in node.elts]
    return ast.literal_eval(node)


class Tau2Action(BaseModel):
    """A reference action of tau2-bench."""

    name: str
    arguments: dict[str, Any]
    requestor: Literal["assistant", "user"] = "assistant"
    compare_args: list[str] | None = None


class Criteria(BaseModel):
    """What the reward of a task of tau2-bench looks at."""

    actions: list[Tau2Action] | None = None
    env_assertions: list[Any] | None = None
    communicate_info: list[str] | None = None
    nl_assertions: list[str] | None = None
    reward_basis: tuple[Literal["DB", "ENV_ASSERTION", "COMMUNICATE", "NL_ASSERTION", "ACTION"], ...] = (
        "DB",
        "COMMUNICATE",
    )


class Instructions(BaseModel):
    """What a simulated user of tau2-bench knows and wants."""

    reason_for_call: str
    task_instructions: str
    known_info: str | None = None
    unknown_info: str | None = None


class Scenario(BaseModel):
    """The simulated user of a task of tau2-bench."""

    instructions: Instructions | str
    persona: str | None = None

    def text(self) -> str:
        """Return what the simulated user is told."""
        told = self.instructions
        parts = {"Who you are": self.persona}
        if isinstance(told, str):
            parts["What you want"] = told
        else:
            parts |= {
                "Why you write": told.reason_for_call,
                "What you know": told.known_info,
                "What you do not know": told.unknown_info,
                "How you behave": told.task_instructions,
            }
        return "\n\n".join(f"{title}:\n{text.strip()}" for title, text in parts.items() if text)


class Tau2Task(BaseModel):
    """A task of tau2-bench."""

    id: str
    user_scenario: Scenario
    initial_state: dict[str, Any] | None = None
    evaluation_criteria: Criteria | None = None

    def left_out(self) -> str:
        """Return why the reward cannot be computed here; empty where it can."""
        criteria = self.evaluation_criteria or Criteria()
        if "NL_ASSERTION" in criteria.reward_basis and criteria.nl_assertions:
            return "a model would have to judge it (nl_assertions)"
        if "ENV_ASSERTION" in criteria.reward_basis and criteria.env_assertions:
            return "it asserts what the tools of its domain do not tell (env_assertions)"
        if any(action.requestor == "user" for action in criteria.actions or []):
            return "its user has tools"
        if any((self.initial_state or {}).values()):
            return "it begins in a state of its own (initial_state)"
        return ""

    def task(self) -> Task:
        """Return it as a task of ours."""
        criteria = self.evaluation_criteria or Criteria(reward_basis=())
        basis = [name for name in ("DB", "COMMUNICATE", "ACTION") if name in criteria.reward_basis]
        if criteria.actions is None and criteria.env_assertions is None:
            basis = [name for name in basis if name != "DB"]  # there is no database to compare with
        return Task(
            id=self.id,
            instruction=self.user_scenario.text(),
            actions=tuple(
                Action(each.name, each.arguments, None if each.compare_args is None else tuple(each.compare_args))
                for each in criteria.actions or []
            ),
            outputs=tuple(criteria.communicate_info or ()),
            reward_basis=tuple(basis),
        )
