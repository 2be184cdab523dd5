"""TextArena's random player: what it plays is valid, in every game that runs here."""

from __future__ import annotations

import random
from types import SimpleNamespace

import pytest

from gem_games.textarena.env import TextArenaEnv
from gem_games.textarena.listing import EXTRA, textarena_specs
from gem_games.textarena.moves import NO_MOVE, SAMPLERS, random_move
from gem_games.textarena.moves_boards import SAMPLERS as BOARDS
from gem_games.textarena.moves_cards import SAMPLERS as CARDS
from gem_games.textarena.moves_puzzles import SAMPLERS as PUZZLES

SPECS = list(textarena_specs())
RUNNABLE = [spec for spec in SPECS if spec.requires == (EXTRA,) and not spec.seats]
TURNS = 20
COMES_TO_NOTHING = {
    "IndianPoker": "the ante leaves less than no chips, with which even folding is refused",
    "SpellingBee": "no word of the letters is left that is as long as the last one",
    "WordChains": "each word is a letter longer than the last one, and none is left",
}
"""Games that can come to where nothing is valid within so few turns, and why."""
NOT_KNOWN = {"Crosswords", "Minesweeper", "Sudoku"}
"""Games that take what is wrong for invalid, which a player cannot know."""


@pytest.fixture
def refused(monkeypatch):
    """Collect what TextArena takes for an invalid move."""
    import textarena.state

    TextArenaEnv("TicTacToe-v0", players=2)  # mends these classes, if nothing has before
    reasons = []
    for state in vars(textarena.state).values():
        if isinstance(state, type) and "set_invalid_move" in vars(state):

            def note(self, *args, original=state.set_invalid_move, **kwargs):
                reasons.append(kwargs.get("reason") or args)
                return original(self, *args, **kwargs)

            monkeypatch.setattr(state, "set_invalid_move", note)
    return reasons


def _play(env, seed, turns=TURNS):
    """Play a game of random moves; return the last info."""
    env.reset(seed=seed)
    for _ in range(turns):
        *_, terminated, truncated, info = env.step(env.sample_random_action())
        if terminated or truncated:
            break
    return info


@pytest.mark.parametrize("spec", RUNNABLE, ids=lambda spec: spec.id)
@pytest.mark.few(30)
def test_random_players_make_no_invalid_moves(spec, refused):
    """All seats play random moves, which TextArena takes; it is invalid only to play where nothing is valid."""
    env = TextArenaEnv(**spec.kwargs)
    info = _play(env, seed=11)
    assert "error" not in info
    family = spec.kwargs["game"].partition("-")[0]
    if family in NOT_KNOWN:
        return
    if family in COMES_TO_NOTHING:
        assert len(refused) == env.table.actions.count(NO_MOVE)
    else:
        assert refused == []


def test_every_game_that_can_be_made_has_a_sampler():
    made = {spec.kwargs["game"].partition("-")[0] for spec in RUNNABLE}
    assert made - set(SAMPLERS) == set()


@pytest.mark.parametrize("game", ["Chess-v0", "Wordle-v0", "LiarsDice-v0", "TwoDollar-v0", "Mastermind-v0"])
def test_a_move_depends_on_the_generator_alone(game):
    env = TextArenaEnv(**next(dict(spec.kwargs) for spec in SPECS if spec.kwargs["game"] == game))
    env.reset(seed=3)
    before = random.getstate()
    drawn = [random_move(env.table, random.Random(seed)) for seed in range(20)]
    assert drawn == [random_move(env.table, random.Random(seed)) for seed in range(20)]
    assert random.getstate() == before
    assert len(set(drawn)) > 1


@pytest.mark.parametrize("game", ["Sudoku-v0-easy", "Crosswords-v0", "Minesweeper-v0"])
def test_the_random_player_does_not_know_the_solution(game, refused):
    assert not any(_play(TextArenaEnv(game), seed=seed, turns=100)["correct"] for seed in range(5))
    assert refused or game == "Minesweeper-v0"


def test_random_snakes_keep_off_walls_and_bodies_while_they_can():
    env = TextArenaEnv("Snake-v0", players=2)
    env.reset(seed=1)
    game = env.table.game
    own, other = game.state.game_state["snakes"].values()
    own.positions, other.positions = type(own.positions)([(0, 0)]), type(own.positions)([(5, 5)])
    assert BOARDS["Snake"](game, random.Random(1)) == ["[up]", "[right]"]
    other.positions = type(own.positions)([(1, 0), (1, 1)])
    assert BOARDS["Snake"](game, random.Random(1)) == ["[up]"]
    own.positions = type(own.positions)([(0, 0), (0, 1)])
    assert len(BOARDS["Snake"](game, random.Random(1))) == 4


def test_random_players_of_surround_keep_off_walls_and_trails_while_they_can():
    env = TextArenaEnv("Surround-v0", players=2)
    env.reset(seed=1)
    game = env.table.game
    right, top = game.width - 1, game.height - 1
    game.state.game_state["players"][0].position = (right, top)
    game.state.game_state["board"][top - 1][right] = 1
    assert BOARDS["Surround"](game, random.Random(1)) == ["[left]"]


def test_where_nothing_is_valid_the_game_ends(refused):
    """The words of WordChains grow by a letter each, until there is none; whose turn it is then has lost."""
    env = TextArenaEnv("WordChains-v0", players=2)
    info = _play(env, seed=4, turns=40)
    assert env.table.done
    assert env.table.actions[-1] == NO_MOVE
    assert info["textarena"]["turn_count"] > 3


def test_a_game_that_is_over_has_no_moves():
    env = TextArenaEnv("MemoryGame-v0", players=2)
    _play(env, seed=1, turns=200)
    assert env.table.done
    assert env.sample_random_action() == NO_MOVE


def test_santorini_does_not_stall():
    info = _play(TextArenaEnv("SantoriniBaseFixed-v0", players=2), seed=1, turns=200)
    assert "error" not in info
    assert "correct" in info


def test_a_road_of_tak_wins():
    """In textarena 0.7.4 the winning move raises."""
    rows = iter(range(4))
    env = TextArenaEnv("Tak-v0", players=2, opponents=lambda observation: f"[place () {{({next(rows)},3): [F1]}}]")
    env.reset(seed=1)
    for row in range(env.table.game.board_size):
        _, reward, terminated, _, info = env.step(f"[place () {{({row},0): [F0]}}]")
    assert (reward, terminated, info["correct"]) == (1.0, True, True)


@pytest.mark.parametrize(("game", "players"), [("Golf-v0", 3), ("Briscola-v0", 4)])
def test_one_of_many_wins(game, players):
    """In textarena 0.7.4 the last move of these games raises with more than two players."""
    env = TextArenaEnv(game, players=players)
    info = _play(env, seed=1, turns=100)
    assert sorted(env.table.rewards().values()) == [-1.0] * (players - 1) + [1.0]
    assert "error" not in info


def test_defused_bombs_of_stratego_are_forgotten():
    """In textarena 0.7.4 a game like these raises when a miner has moved on."""
    for seed in range(3):
        assert "error" not in _play(TextArenaEnv("Stratego-v0", players=2), seed=seed, turns=200)


def _state(**game_state):
    return SimpleNamespace(state=SimpleNamespace(game_state=game_state, current_player_id=0))


def test_2048_lists_the_ways_that_change_the_board():
    board = [[2, 0], [4, 0]]
    assert PUZZLES["2048"](_state(board=board), random.Random(1)) == ["[Right]"]


def test_chopsticks_lists_attacks_and_splits():
    moves = CARDS["Chopsticks"](_state(hands={0: [0, 2], 1: [1, 0]}), random.Random(1))
    assert moves == ["[attack 1 0]", "[split 1 1]", "[split 2 0]"]


def test_hanoi_lists_what_fits():
    moves = PUZZLES["TowerOfHanoi"](_state(towers={"A": [3, 2], "B": [1], "C": []}), random.Random(1))
    assert moves == ["[A C]", "[B A]", "[B C]"]
