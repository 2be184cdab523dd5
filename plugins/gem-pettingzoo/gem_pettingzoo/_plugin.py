"""What this distribution offers; it imports no environment."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core.registry import EnvSpec, hookimpl


@hookimpl
def gem_register_envs() -> Iterable[EnvSpec]:
    """Three of PettingZoo's classic games, with its names of agents and numbers of actions."""
    yield _classic("rps-v2", "RockPaperScissorsEnv", "Rock, paper, scissors at once, in 15 rounds.", 0)
    yield _classic("tictactoe-v3", "TicTacToeEnv", "Tic-tac-toe on 3 by 3 squares.", 1)
    yield _classic("connect_four-v3", "ConnectFourEnv", "Four in a row on 7 columns of 6 places.", 0)


def _classic(name: str, env_class: str, summary: str, first: int) -> EnvSpec:
    return EnvSpec(
        id=f"pz:{name}",
        entry_point=f"gem_pettingzoo.classic:{env_class}",
        summary=f"{summary[:-1]}; two agents.",
        tags=("game", "text", "multi-agent"),
        requires=("package:gem-pettingzoo[classic]",),
        seats=(f"player_{first}", f"player_{first + 1}"),
    )
