"""``check_agent``: lets an agent play a small task, several episodes at once, and reads what it answers."""

from __future__ import annotations

from typing import Any

from gem_core.api import make_vec
from gem_core.records.episode import Episode
from gem_core.rollouts.agent import Agent, as_agent, load_agent
from gem_core.rollouts.drivers import rollout
from gem_core.testing.findings import Findings
from gem_core.testing.small_task import SMALL_TASK, register_small_task


def check_agent(agent: str | Agent, **options: Any) -> list[str]:
    """Try what an agent promises: that it answers every observation with text, for many episodes at once.

    Args:
        agent: The name that it is registered by, as ``--agent`` takes it, or the agent.
        **options: Options of a named agent.

    Returns:
        The promises that were kept, in one sentence each.

    Raises:
        CheckError: Promises are broken; the message names each, with what was seen.
        UnknownAgentError: There is no agent of this name.
    """
    register_small_task()
    findings = Findings(f"agent {agent if isinstance(agent, str) else type(agent).__name__!r}")
    made = load_agent(agent, **options) if isinstance(agent, str) else as_agent(agent)
    episodes: list[Episode] = []

    def played() -> None:
        with make_vec(SMALL_TASK, 4, seed=1) as vector:
            episodes.extend(rollout(vector, made, episodes=8))

    findings.attempt("It plays eight episodes, four at once, and prepares and closes as often as it is asked.", played)
    errors = [episode.error for episode in episodes if episode.error]
    findings.expect("It answers every observation with text.", not errors, "; ".join(map(str, errors[:1])))
    findings.expect("It comes to the end of every episode.", len(episodes) in (0, 8), f"{len(episodes)} of 8")
    return findings.result()
