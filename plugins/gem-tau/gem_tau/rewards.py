"""The reward of a conversation: by the final database, and by what the assistant said to the user."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from gem_tau.database import Database, fork
from gem_tau.folders import TaskSet
from gem_tau.tasks import Action, Task


class Reward(NamedTuple):
    """A reward and the components that it is the product of."""

    value: float
    """0 or 1."""

    components: dict[str, float]
    """0 or 1 for each name in the task's ``reward_basis``."""


def reward(
    task_set: TaskSet, task: Task, database: Database, said: Iterable[str], calls: Sequence[Action] = ()
) -> Reward:
    """Compute the reward of a conversation that has ended as it should.

    Args:
        task_set: What the task is from.
        task: The task.
        database: The database as the assistant has left it.
        said: What the assistant said to the user, message by message.
        calls: The assistant's calls of tools; only tasks whose ``reward_basis`` has ``ACTION`` look at them.

    Returns:
        The product of the task's components. ``DB``: the hash of the database is that of a fresh one on which the
        reference actions were replayed. ``COMMUNICATE``: each output occurs in a message, whatever the case and
        without the commas of the message. ``ACTION``: each reference action is among the calls.
    """
    components: dict[str, float] = {}
    if "DB" in task.reward_basis:
        components["DB"] = float(task_set.digest.same(database, replay(task_set, task.actions)))
    if "COMMUNICATE" in task.reward_basis:
        messages = [text.lower().replace(",", "") for text in said]
        heard = all(any(output.lower() in message for message in messages) for output in task.outputs)
        components["COMMUNICATE"] = float(heard)
    if "ACTION" in task.reward_basis:
        done = all(any(action.matches(call) for call in calls) for action in task.actions)
        components["ACTION"] = float(done)
    return Reward(float(all(components.values())), components)


def replay(task_set: TaskSet, actions: Iterable[Action]) -> Database:
    """Return a fresh database on which actions were called."""
    database = fork(task_set.database)
    for action in actions:
        task_set.domain.call(database, action.name, action.arguments)
    return database
