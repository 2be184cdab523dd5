"""How often a model's responses hold nothing that an environment could read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gem_core
from gem_core.records import Episode, PlanItem
from gem_core.rollouts import close_agent, load_agent, prepare_agent
from gem_eval.auditing.results import EnvAudit, Problem
from gem_eval.auditing.stage import Stage


def count_unreadable(
    found: EnvAudit, model: str, options: Mapping[str, Any], kwargs: Mapping[str, Any], *, limit: int, seed: int
) -> None:
    """Let a model play the rows of an audit, and add the share of its responses that held no answer.

    Args:
        found: The audit of the environment, which is filled in.
        model: Name of an agent, as ``load_agent`` takes it.
        options: Keyword arguments for it.
        kwargs: Keyword arguments of the environment.
        limit: Rows that are played at most.
        seed: Of the choice of rows, and of the episodes.
    """
    stage = Stage(found.id, kwargs, limit=limit, seed=seed)
    plan = [PlanItem(found.id, seed=row.seed, options=row.options or None, kwargs=kwargs) for row in stage.rows]
    stage.close()
    agent = load_agent(model, **options)
    prepare_agent(agent)
    read = unreadable = errors = 0
    examples: list[str] = []
    try:
        for episode in gem_core.rollout(found.id, agent, plan=plan, seed=seed):
            errors += episode.error is not None
            for number, turn in enumerate(episode.transitions):
                if "parsed_action" in turn.info:
                    read += 1
                    unreadable += turn.info["parsed_action"] is None
                    if turn.info["parsed_action"] is None and len(examples) < 3:
                        examples.append(_example(episode, number))
    finally:
        close_agent(agent)
    if errors:
        message = f"{errors} of {len(plan)} episodes of {model} ended in an error"
        found.problems.append(Problem("model", errors / len(plan), message, fails=False))
    if not read:
        message = "whether a response could be read is not known: no info has 'parsed_action'"
        found.problems.append(Problem("unreadable", 0.0, message, fails=False))
        return
    found.unreadable = unreadable / read
    if unreadable:
        message = f"{unreadable} of {read} responses of {model} hold no answer that could be read"
        found.problems.append(Problem("unreadable", found.unreadable, message, tuple(examples), fails=False))


def _example(episode: Episode, number: int) -> str:
    response = str(episode.transitions[number].action)
    shown = response if len(response) <= 160 else f"{response[:80]} … {response[-80:]}"
    return f"{episode.id} seed {episode.seed}, turn {number + 1}: {shown!r}"
