"""``solo``: the assistant's seat alone, with the user simulated inside: what trainers of one agent use."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gem_core import Env, single_agent
from gem_tau.env import ASSISTANT, USER, TauEnv


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
