"""After a change of a native game: how long steps and resets take beside gem-llm's, with the same actions.

Each side plays in a process of its own, one game after another; the processes alternate. A figure is the median over
all episodes of a process, and the table shows the medians of these. gem-llm is asked for its classes, not its
ids, so that both sides run on the same parameters also where an id is ours alone. What it prints goes nowhere.

A further game is one more row of ``GAMES``; one that a side cannot start is named, and left out.
"""

from __future__ import annotations

import json
import math
from typing import NamedTuple

import harness

WORST_BUDGET = 1.5
STEP_BUDGET = 1 / 2
RESET_BUDGET = 1 / 3
SOKOBAN_BUDGET = 1 / 5
FIGURES = {"step_us": "step", "reset_us": "reset", "seeded_us": "seeded reset"}


class Work(NamedTuple):
    """What one game does on both sides.

    Args:
        peer: The peer's module and class, as in ``"guess_the_number:GuessTheNumberEnv"``, below ``gem.envs.game_env``.
        actions: Answers in their order, played until the game ends.
        episodes: How often in each process.
        parameters: Keyword arguments for the peer; ours come with the id.
    """

    peer: str
    actions: list[str]
    episodes: int
    parameters: dict[str, object]


MOVES = ["up", "left", "down", "right"]
CODES = ["1 2 3 4", "5 6 7 8", "1 3 5 7", "2 4 6 8", "8 7 6 5", "4 3 2 1"]
TOWER = ["A C", "A B", "C B", "A C", "B A", "B C", "A C"]
CELLS = [f"{row} {column}" for row in range(8) for column in range(8)]
# The answers are fixed, so a game may end early by its own chance, on either side.
GAMES = {
    "game:GuessTheNumber-v0": Work(
        "guess_the_number:GuessTheNumberEnv",
        ["3", "47", "12", "40", "20", "33", "9", "25", "50"],
        300,
        {"min_number": 1, "max_number": 50, "max_turns": 10},
    ),
    "game:Mastermind-v0-hard": Work(
        "mastermind:MastermindEnv", CODES, 300, {"code_length": 4, "num_numbers": 8, "max_turns": 30}
    ),
    "game:TowerofHanoi-v0-hard": Work("tower_of_hanoi:TowerofHanoiEnv", TOWER, 300, {"num_disks": 5, "max_turns": 35}),
    "game:Minesweeper-v0-hard": Work(
        "minesweeper:MinesweeperEnv",
        [f"reveal {cell}" for cell in CELLS],
        100,
        {"rows": 8, "cols": 8, "num_mines": 12, "max_turns": 64},
    ),
    "game:FifteenPuzzle-v0-hard": Work(
        "fifteen_puzzle:FifteenPuzzleEnv", MOVES * 12, 100, {"num_rows": 4, "max_turns": 50}
    ),
    "game:Sudoku-v0-easy": Work(
        "sudoku:SudokuEnv",
        ["1 1 1", "1 2 1", "2 1 2", "2 2 3", "3 3 4", "4 4 1", "3 4 2"],
        50,
        {"clues": 10, "max_turns": 15, "scale": 4},
    ),
    "game:Sudoku-v0-hard": Work(
        "sudoku:SudokuEnv",
        [f"{cell} {number}" for cell in CELLS[9:] for number in (3, 7)],
        3,
        {"clues": 50, "max_turns": 50, "scale": 9},
    ),
    "game:Game2048-v0-hard": Work("game_2048:Game2048Env", MOVES * 12, 100, {"target_tile": 512, "max_turns": 50}),
    "game:Sokoban-v0-easy": Work(
        "sokoban:SokobanEnv", MOVES * 4, 10, {"dim_room": (6, 6), "num_boxes": 2, "max_turns": 20}
    ),
    "game:Crosswords-v0-easy": Work(
        "crosswords:CrosswordsEnv",
        [f"{row} {column} E" for row in range(5) for column in range(5)],
        50,
        {"hardcore": False, "max_turns": 30, "num_words": 3},
    ),
}
NOT_STARTED = "game:Wordle-*, game:Hangman-*, game:WordSearch-* (gem-llm's want a download), game:WikiGame-* (a server)"

# Run in each side's own process; prints one figure for each game and kind of work, in microseconds.
PLAY = r"""
import contextlib, io, json, statistics, sys, time

def timed(call):
    started = time.perf_counter()
    result = call()
    return result, (time.perf_counter() - started) * 1e6

def play(env, actions, episodes):
    steps, resets, seeded = [], [], []
    for episode in range(episodes):
        seeded.append(timed(lambda: env.reset(seed=episode))[1])
        count, spent = 0, 0.0
        for action in actions:
            result, took = timed(lambda: env.step(action))
            count, spent = count + 1, spent + took
            if result[2] or result[3]:
                break
        steps.append(spent / count)
        resets.append(timed(env.reset)[1])
    return dict(zip(("step_us", "reset_us", "seeded_us"), map(statistics.median, (steps, resets, seeded))))

figures = {}
for game_id, (maker, actions, episodes, parameters) in json.loads(sys.argv[1]).items():
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            env = make(game_id, maker, parameters)
            done = play(env, ["\\boxed{%s}" % action for action in actions], episodes)
        figures.update({f"{game_id} {name}": value for name, value in done.items()})
    except Exception as error:  # whatever a side cannot do is named in the report
        figures[f"{game_id} fault"] = 1.0
        print(f"{game_id}: {type(error).__name__}: {error}", file=sys.stderr)
print(json.dumps(figures))
"""
OURS = "import gem_core\ndef make(game_id, maker, parameters):\n    return gem_core.make(game_id)\n"
PEER = """
import importlib
def make(game_id, maker, parameters):
    module, _, name = maker.partition(":")
    return getattr(importlib.import_module("gem.envs.game_env." + module), name)(**parameters)
"""


def main() -> None:
    """Measure all games that both sides have and print the table and the verdicts."""
    sides = harness.arguments()
    work = json.dumps(GAMES)
    cases = {
        "ours": [*harness.snippet(sides.ours, OURS + PLAY), work],
        "peer": [*harness.snippet(sides.peer, PEER + PLAY), work],
    }
    results = harness.measure(cases, repeats=max(3, sides.repeats // 4), warm_up=1)
    ours, peer = results["ours"], results["peer"]
    started = [game for game in GAMES if f"{game} fault" not in {**ours.figures, **peer.figures}]
    ratios = {
        figure: {game: ours.median(f"{game} {figure}") / peer.median(f"{game} {figure}") for game in started}
        for figure in FIGURES
    }
    report(started, ratios, ours, peer)
    for side, case in results.items():
        missing = [game for game in GAMES if f"{game} fault" in case.figures]
        if missing:
            print(f"  not started by {'gem_core' if side == 'ours' else 'gem-llm'}: {', '.join(missing)}")
    print(f"  not compared: {NOT_STARTED}")


def report(games: list[str], ratios: dict[str, dict[str, float]], ours: harness.Case, peer: harness.Case) -> None:
    """Print the table of games and the verdicts against the budgets."""
    rows = []
    for game in games:
        row = [game]
        for figure in FIGURES:
            name = f"{game} {figure}"
            row.append(f"{ours.median(name):.1f} / {peer.median(name):.1f} = {ratios[figure][game]:.2f}")
        rows.append(row)
    harness.print_table("Games, microseconds, ours / gem-llm's = ratio of medians", ["game", *FIGURES.values()], rows)
    for figure, budget in (("step_us", STEP_BUDGET), ("reset_us", RESET_BUDGET), ("seeded_us", RESET_BUDGET)):
        mean = math.exp(sum(math.log(ratio) for ratio in ratios[figure].values()) / len(games))
        worst = max(games, key=lambda game: ratios[figure][game])
        over = ratios[figure][worst]
        print(
            f"  {FIGURES[figure]}: geometric mean {mean:.2f}, budget {budget:.2f}: {harness.verdict(mean, budget)};",
            end=" ",
        )
        print(f"worst {over:.2f} ({worst}), budget {WORST_BUDGET}: {harness.verdict(over, WORST_BUDGET)}")
    sokoban = max(ratios[figure]["game:Sokoban-v0-easy"] for figure in ("reset_us", "seeded_us"))
    print(f"  Sokoban's reset: {sokoban:.3f}, budget {SOKOBAN_BUDGET}: {harness.verdict(sokoban, SOKOBAN_BUDGET)}")


if __name__ == "__main__":
    main()
