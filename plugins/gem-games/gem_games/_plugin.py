"""What this distribution offers; it imports no game."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from gem_core.registry import AgentSpec, EnvSpec, hookimpl
from gem_games.textarena.listing import textarena_specs

_GUESS = "gem_games.guess_the_number:GuessTheNumberEnv"
_MASTERMIND = "gem_games.mastermind:MastermindEnv"
_HANOI = "gem_games.tower_of_hanoi:TowerOfHanoiEnv"
_MINESWEEPER = "gem_games.minesweeper:MinesweeperEnv"
_FIFTEEN = "gem_games.fifteen_puzzle:FifteenPuzzleEnv"
_SUDOKU = "gem_games.sudoku:SudokuEnv"
_2048 = "gem_games.game_2048:Game2048Env"
_SOKOBAN = "gem_games.sokoban:SokobanEnv"


@hookimpl
def gem_register_envs() -> Iterable[EnvSpec]:
    """The games: those for one have the parameters and turn limits of gem-llm's, whose baselines are published."""
    guess = "Find a hidden number by 'higher' and 'lower'"
    yield _game("GuessTheNumber-v0", _GUESS, f"{guess}.", min_number=1, max_number=50, max_turns=10)
    yield _game("GuessTheNumber-v0-easy", _GUESS, f"{guess}; 1 to 10.", min_number=1, max_number=10, max_turns=4)
    yield _game("GuessTheNumber-v0-hard", _GUESS, f"{guess}; 1 to 50.", min_number=1, max_number=50, max_turns=7)
    yield _game(
        "GuessTheNumber-v0-random", _GUESS, f"{guess}; any range.", min_number=None, max_number=None, max_turns=None
    )
    code = "Find a secret code by black and white pegs"
    yield _game("Mastermind-v0-easy", _MASTERMIND, f"{code}; 2 of 6.", code_length=2, num_numbers=6, max_turns=10)
    yield _game("Mastermind-v0-hard", _MASTERMIND, f"{code}; 4 of 8.", code_length=4, num_numbers=8, max_turns=30)
    yield _game(
        "Mastermind-v0-random", _MASTERMIND, f"{code}; any size.", code_length=None, num_numbers=None, max_turns=None
    )
    tower = "Move a tower of disks to another peg"
    yield _game("TowerofHanoi-v0-easy", _HANOI, f"{tower}; 3 disks.", num_disks=3, max_turns=10)
    yield _game("TowerofHanoi-v0-hard", _HANOI, f"{tower}; 5 disks.", num_disks=5, max_turns=35)
    yield _game("TowerofHanoi-v0-random", _HANOI, f"{tower}; 3 to 5 disks.", num_disks=None, max_turns=None)
    yield from _wiki_game()
    yield from _wordle()
    yield from _hangman()
    yield from _crosswords()
    yield from _word_search()
    yield from _minesweeper()
    yield from _fifteen_puzzle()
    yield from _sudoku()
    yield from _game_2048()
    yield from _sokoban()
    yield from _joint_games()
    yield from textarena_specs()


@hookimpl
def gem_register_agents() -> Iterable[AgentSpec]:
    """Solvers, each for one game."""
    agents, joint = "gem_games.agents", "gem_games.joint_agents"
    return [
        AgentSpec(name="bisect", entry_point=f"{agents}:BisectionAgent", summary="Wins GuessTheNumber by bisection."),
        AgentSpec(
            name="mastermind", entry_point=f"{agents}:MastermindAgent", summary="Wins Mastermind by elimination."
        ),
        AgentSpec(name="hanoi", entry_point=f"{agents}:HanoiAgent", summary="Solves TowerofHanoi in the fewest moves."),
        AgentSpec(
            name="wikigame",
            entry_point="gem_games.wiki.agent:WikiGameAgent",
            summary="Wins WikiGame with the shipped articles, in the fewest turns.",
        ),
        AgentSpec(name="tictactoe", entry_point=f"{joint}:TicTacToeAgent", summary="Never loses TicTacToe."),
        AgentSpec(name="kuhn", entry_point=f"{joint}:KuhnAgent", summary="Plays KuhnPoker by an equilibrium."),
        AgentSpec(
            name="negotiator",
            entry_point=f"{joint}:NegotiationAgent",
            summary="Plays Negotiation by proposals, which become more modest; negotiator:greedy asks for more.",
        ),
    ]


def _game(name: str, entry_point: str, summary: str, seats: tuple[str, ...] = (), **kwargs: object) -> EnvSpec:
    tags = ("game", "text", "multi-agent") if seats else ("game", "text")
    return EnvSpec(id=f"game:{name}", entry_point=entry_point, kwargs=kwargs, summary=summary, tags=tags, seats=seats)


def _wiki_game() -> Iterator[EnvSpec]:
    entry, wiki = "gem_games.wiki_game:WikiGameEnv", "Go from one article to another by links"
    yield _game("WikiGame-v0-easy", entry, f"{wiki}; 2 or 3 apart.", max_turns=30, min_distance=2, max_distance=3)
    yield _game("WikiGame-v0-hard", entry, f"{wiki}; 4 to 6 apart.", max_turns=15, min_distance=4, max_distance=6)
    yield _game("WikiGame-v0-random", entry, f"{wiki}; any distance.", max_turns=None, min_distance=2, max_distance=9)


def _wordle() -> Iterator[EnvSpec]:
    path, text = "gem_games.wordle:WordleEnv", "Find a secret word by green and yellow letters"
    yield _game("Wordle-v0-easy", path, f"{text}; 3 letters.", word_length=3, only_real_words=True, max_turns=15)
    yield _game("Wordle-v0-hard", path, f"{text}; 5 letters.", word_length=5, only_real_words=True, max_turns=25)
    yield _game("Wordle-v0-random", path, f"{text}; 3 to 5.", word_length=None, only_real_words=True, max_turns=None)


def _hangman() -> Iterator[EnvSpec]:
    path, text = "gem_games.hangman:HangmanEnv", "Find a word by asking for letters"
    yield _game("Hangman-v0-easy", path, f"{text}; 3 letters.", word_length=3, hardcore=False, max_turns=10)
    yield _game("Hangman-v0-hard", path, f"{text}; 7 letters.", word_length=7, hardcore=False, max_turns=20)
    yield _game("Hangman-v0-random", path, f"{text}; 3, 5 or 7.", word_length=None, hardcore=False, max_turns=None)


def _crosswords() -> Iterator[EnvSpec]:
    path, text = "gem_games.crosswords:CrosswordsEnv", "Fill a crossword from its clues"
    yield _game("Crosswords-v0-easy", path, f"{text}; easy ones.", hardcore=False, max_turns=30, num_words=3)
    yield _game("Crosswords-v0-hard", path, f"{text}; hard ones.", hardcore=True, max_turns=40, num_words=3)
    yield _game("Crosswords-v0-random", path, f"{text}; any ones.", hardcore=None, max_turns=None, num_words=None)


def _word_search() -> Iterator[EnvSpec]:
    path, text = "gem_games.word_search:WordSearchEnv", "Find hidden words in a grid of letters"
    yield _game("WordSearch-v0-easy", path, f"{text}; common ones.", hardcore=False, max_turns=20, num_words=5)
    yield _game("WordSearch-v0-hard", path, f"{text}; rare, long ones.", hardcore=True, max_turns=20, num_words=5)
    yield _game("WordSearch-v0-random", path, f"{text}; any ones.", hardcore=None, max_turns=None, num_words=None)


def _minesweeper() -> Iterator[EnvSpec]:
    field = "Reveal all cells that hide no mine"
    name = "Minesweeper-v0"
    yield _game(f"{name}-easy", _MINESWEEPER, f"{field}; 5x5.", rows=5, cols=5, num_mines=5, max_turns=25)
    yield _game(f"{name}-hard", _MINESWEEPER, f"{field}; 8x8.", rows=8, cols=8, num_mines=12, max_turns=64)
    yield _game(
        f"{name}-random", _MINESWEEPER, f"{field}; 5x5 to 8x8.", rows=None, cols=None, num_mines=None, max_turns=None
    )


def _fifteen_puzzle() -> Iterator[EnvSpec]:
    tiles = "Slide numbered tiles into order"
    yield _game("FifteenPuzzle-v0-easy", _FIFTEEN, f"{tiles}; 2x2.", num_rows=2, max_turns=10)
    yield _game("FifteenPuzzle-v0-hard", _FIFTEEN, f"{tiles}; 4x4.", num_rows=4, max_turns=50)
    yield _game("FifteenPuzzle-v0-random", _FIFTEEN, f"{tiles}; 2x2 to 4x4.", num_rows=None, max_turns=None)


def _sudoku() -> Iterator[EnvSpec]:
    grid = "Fill a grid so that each row, column and box has every number"
    yield _game("Sudoku-v0-easy", _SUDOKU, f"{grid}; 4x4.", clues=7, max_turns=15, scale=4)
    yield _game("Sudoku-v0-hard", _SUDOKU, f"{grid}; 9x9.", clues=34, max_turns=50, scale=9)
    yield _game("Sudoku-v0-random", _SUDOKU, f"{grid}; 4x4 or 9x9.", clues=None, max_turns=None, scale=None)


def _game_2048() -> Iterator[EnvSpec]:
    tile = "Slide and merge tiles"
    yield _game("Game2048-v0-easy", _2048, f"{tile} up to 64.", target_tile=64, max_turns=50)
    yield _game("Game2048-v0-hard", _2048, f"{tile} as far as 50 turns go; 512.", target_tile=512, max_turns=50)
    yield _game(
        "Game2048-v0-extreme-hard", _2048, f"{tile} as far as 100 turns go; 2048.", target_tile=2048, max_turns=100
    )
    yield _game("Game2048-v0-random", _2048, f"{tile} up to 16, 32 or 64.", target_tile=None, max_turns=None)


def _sokoban() -> Iterator[EnvSpec]:
    boxes = "Push boxes onto goals"
    yield _game("Sokoban-v0-easy", _SOKOBAN, f"{boxes}; 2 boxes.", dim_room=(6, 6), num_boxes=2, max_turns=20)
    yield _game("Sokoban-v0-hard", _SOKOBAN, f"{boxes}; 4 boxes.", dim_room=(8, 8), num_boxes=4, max_turns=50)
    yield _game("Sokoban-v0-random", _SOKOBAN, f"{boxes}; 2 or 5 boxes.", dim_room=None, num_boxes=None, max_turns=None)


def _joint_games() -> Iterator[EnvSpec]:
    yield _game(
        "TicTacToe-v0", "gem_games.tic_tac_toe:TicTacToeEnv", "Three in a row on a 3x3 board; seats X, O.", ("X", "O")
    )
    yield _game(
        "KuhnPoker-v0",
        "gem_games.kuhn_poker:KuhnPokerEnv",
        "Bet on the higher of two cards; seats first, second.",
        ("first", "second"),
    )
    yield _game(
        "Negotiation-v0",
        "gem_games.negotiation:NegotiationEnv",
        "Share out items of hidden values, or make no deal; seats first, second.",
        ("first", "second"),
        max_turns=10,
    )
    yield _game(
        "RockPaperScissors-v0",
        "gem_games.rock_paper_scissors:RockPaperScissorsEnv",
        "Choose at the same time; seats left, right.",
        ("left", "right"),
        rounds=1,
    )
