"""Checks tasks by their reference actions: they must get the reward, and without one of the writes they must not."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from gem_tau.database import Database, fork
from gem_tau.folders import TaskSet
from gem_tau.rewards import replay, reward
from gem_tau.tasks import Action, Task


@dataclass(frozen=True)
class DroppedWrite:
    """A replay in which one write was left out."""

    position: int
    """Index in the task's actions."""

    name: str
    """Tool that was not called."""

    effect: Literal["final", "redundant", "none"]
    """``none`` if the call changes nothing, ``redundant`` if the other actions lead to the same final database."""

    error: str
    """What the tool answers where it fails; empty where it does not."""

    reward: float
    """Reward without it."""


@dataclass(frozen=True)
class Check:
    """How the reference actions of a task fare."""

    task: str
    """Id of the task."""

    reward: float
    """Reward of the reference actions, with the outputs said."""

    hash: str
    """Hash of the database that they lead to."""

    dropped: list[DroppedWrite] = field(default_factory=list)
    """Each write left out in turn, where that was asked for."""


def check_task(task_set: TaskSet, task: Task, *, drop_one_write: bool = False) -> Check:
    """Replay the reference actions of a task, and again without each of its writes."""
    database = replay(task_set, task.actions)
    reference = task_set.digest(database)
    writes = [each for each in range(len(task.actions)) if task.actions[each].name in task_set.domain.writes]
    return Check(
        task=task.id,
        reward=_reward(task_set, task, database, task.actions),
        hash=reference,
        dropped=[_drop(task_set, task, position, reference) for position in writes] if drop_one_write else [],
    )


def _drop(task_set: TaskSet, task: Task, position: int, reference: str) -> DroppedWrite:
    action = task.actions[position]
    before = replay(task_set, task.actions[:position])
    after = fork(before)
    answer = task_set.domain.call(after, action.name, action.arguments)
    rest = task.actions[:position] + task.actions[position + 1 :]
    database = replay(task_set, rest)
    effect: Literal["final", "redundant", "none"] = "final"
    if task_set.digest.same(before, after):
        effect = "none"
    elif task_set.digest(database) == reference:
        effect = "redundant"
    return DroppedWrite(
        position=position,
        name=action.name,
        effect=effect,
        error=answer if answer.startswith("Error") else "",
        reward=_reward(task_set, task, database, rest),
    )


def _reward(task_set: TaskSet, task: Task, database: Database, calls: tuple[Action, ...]) -> float:
    return reward(task_set, task, database, task.outputs, calls).value
