"""After a change of joint rollouts or ta:*: what self-play costs beside a bare loop over TextArena, same moves.

Ours is the loop over ``ta:…-multi``, with a view for each seat, rewards and infos. The bare loop is TextArena's own:
``ta.make``, ``reset``, then ``get_observation`` and ``step`` until the game is done. The moves were drawn by random
players beforehand. The two play each game in turn; a figure is the median over all games, steps and resets apart, and a
reset of the bare loop is a new ``ta.make``, since an environment that is used again shows what earlier games have said.
The rewards of both are compared.
"""

from __future__ import annotations

import argparse
import importlib
import json
import statistics
import sys
import time
from typing import Any

import harness

GAMES = ("TicTacToe-v0", "KuhnPoker-v0", "ConnectFour-v0", "SimpleNegotiation-v0", "IteratedPrisonersDilemma-v0")
FIGURES = ("step_us", "reset_us")


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--ours", default=sys.executable, help="interpreter that has gem_core and gem-games[textarena]")
    parser.add_argument("--peer", help="not used here; 'make bench' names it to every benchmark")
    parser.add_argument("--games", type=int, default=300, help="games of each kind")
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(measured(options.games)))
        return
    figures = harness.run_once([options.ours, __file__, "--measure", "--games", str(options.games)])
    rows = []
    for game in GAMES:
        row = [game]
        for figure in FIGURES:
            ours, bare = (figures[f"{game} {side} {figure}"] for side in ("ours", "bare"))
            row.append(f"{ours:.1f} / {bare:.1f} = {ours / bare:.2f}")
        rows.append(row)
    harness.print_table("Self-play, microseconds, ours / bare TextArena = ratio of medians", ["game", *FIGURES], rows)


def measured(games: int) -> dict[str, float]:
    """Return the medians of both sides for each game, taken in this process."""
    import gem_core

    figures: dict[str, float] = {}
    for game in GAMES:
        env = gem_core.make(f"ta:{game}-multi")
        moves = [drawn(env, seed) for seed in range(games)]
        times: dict[str, list[float]] = {}
        for seed, actions in enumerate(moves):
            ours, bare = play_ours(env, seed, actions, times), play_bare(game, seed, actions, times)
            if ours != bare:
                sys.exit(f"error: {game} with seed {seed} pays {ours} here, and {bare} in the bare loop")
        figures |= {f"{game} {name}": statistics.median(values) * 1e6 for name, values in times.items()}
    return figures


def drawn(env: Any, seed: int) -> list[str]:
    """Return the moves of a game of random players."""
    observations, _ = env.reset(seed=seed)
    actions = []
    while env.agents:
        (agent,) = observations
        actions.append(env.sample_random_action(agent))
        observations, *_ = env.step({agent: actions[-1]})
    return actions


def play_ours(env: Any, seed: int, actions: list[str], times: dict[str, list[float]]) -> list[float]:
    """Play these moves in our environment; return the rewards by seat."""
    started = time.perf_counter()
    observations, _ = env.reset(seed=seed)
    dealt = time.perf_counter()
    for action in actions:
        observations, *_ = env.step(dict.fromkeys(observations, action))
    note(times, "ours", started, dealt, len(actions))
    return list(env.cumulative.values())


def play_bare(game: str, seed: int, actions: list[str], times: dict[str, list[float]]) -> list[float]:
    """Play these moves in TextArena's own environment; return the rewards by seat."""
    textarena: Any = importlib.import_module("textarena")
    started = time.perf_counter()
    env: Any = textarena.make(game)
    env.reset(num_players=2, seed=seed)
    dealt = time.perf_counter()
    for action in actions:
        env.get_observation()
        env.step(action=action)
    note(times, "bare", started, dealt, len(actions))
    rewards, _ = env.close()
    return [float(rewards[seat]) for seat in range(2)]


def note(times: dict[str, list[float]], side: str, started: float, dealt: float, steps: int) -> None:
    """Keep how long a reset and a step took, in seconds."""
    times.setdefault(f"{side} reset_us", []).append(dealt - started)
    times.setdefault(f"{side} step_us", []).append((time.perf_counter() - dealt) / steps)


if __name__ == "__main__":
    main()
