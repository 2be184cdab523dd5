"""Results of a ``MultiAgentEnv`` in the form that a slot of a vector environment has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from gem_core.env.multi_agent import JointResetResult, JointStepResult, MultiAgentEnv
from gem_core.types import TERMINAL_STATE, ResetResult, StepResult


def joint_reset(env: MultiAgentEnv, result: JointResetResult) -> ResetResult:
    """Return what ``reset`` returned as an observation and an info.

    The observation is ``{agent: observation}``. The info has ``agents`` (``{agent: info}``), ``terminations`` and
    ``truncations`` of those who take part, and ``possible_agents``.
    """
    observations, infos = result
    info = {
        "agents": infos,
        "terminations": dict(env.terminations),
        "truncations": dict(env.truncations),
        "possible_agents": list(env.possible_agents),
    }
    return cast("ResetResult", (observations, info))


def joint_step(result: JointStepResult) -> StepResult:
    """Return what ``step`` returned as the five values of a slot.

    Observation and reward are dictionaries by agent. The flags are of the episode: ``terminated`` if it is over and the
    task ended for somebody, ``truncated`` if everybody was cut off. The info is as that of ``joint_reset``; the first
    error of an agent is the error of the episode.
    """
    observations, rewards, terminations, truncations, infos = result
    over = all(terminations[agent] or truncations[agent] for agent in terminations)
    terminated = over and any(terminations.values())
    info: dict[str, Any] = {"agents": infos, "terminations": terminations, "truncations": truncations}
    error = next((each["error"] for each in infos.values() if each.get("error") is not None), None)
    if over and error is not None:
        info["error"] = error
    return cast("StepResult", (observations, rewards, terminated, over and not terminated, info))


def lost_step(error: Mapping[str, Any], *, joint: bool) -> StepResult:
    """Return the result of a step that failed, for one agent or for several."""
    if not joint:
        return TERMINAL_STATE, 0.0, False, True, {"error": error}
    info = {"agents": {}, "terminations": {}, "truncations": {}, "error": error}
    return cast("StepResult", ({}, {}, False, True, info))
