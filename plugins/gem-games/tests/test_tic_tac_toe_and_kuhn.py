"""TicTacToe and KuhnPoker: rules and rewards by small cases, and solvers that are checked exactly."""

from __future__ import annotations

from fractions import Fraction
from itertools import permutations
from typing import Any

import pytest

import gem_core as gem
from gem_core.errors import AgentError, ArgumentError
from gem_core.rollouts import Context, load_agent
from gem_games.joint_agents import KuhnAgent, TicTacToeAgent
from gem_games.kuhn_poker import CARDS, chips_won, legal_moves
from gem_games.kuhn_strategy import best_response, equilibrium, expected_value, exploitability
from gem_games.tic_tac_toe import TicTacToeEnv, best_moves, free_cells


def context(episode: object = 0, env_id: str = "game:X-v0") -> Context:
    return Context(str(episode), env_id, None, 0, {}, [], [])


def moved(env: Any, answers: str) -> tuple[Any, ...]:
    """Give answers in turn and return what the last step did."""
    env.reset(seed=0)
    for answer in answers.split():
        result = env.step({env.acting[0]: f"I think \\boxed{{{answer}}}"})
    return tuple(result)


@pytest.mark.parametrize(
    ("cells", "rewards", "correct"),
    [
        ("1 4 2 5 3", {"X": 1.0, "O": -1.0}, {"X": True, "O": False}),
        ("1 5 2 3 4 7", {"X": -1.0, "O": 1.0}, {"X": False, "O": True}),
        ("1 2 3 4 6 5 7 9 8", {"X": 0.0, "O": 0.0}, {"X": False, "O": False}),
        ("1 2 3 4 5 6 8 7 9", {"X": 1.0, "O": -1.0}, {"X": True, "O": False}),  # by the last free cell
    ],
)
def test_tic_tac_toe_is_won_lost_and_drawn(cells: str, rewards: Any, correct: Any) -> None:
    _, given, terminations, truncations, infos = moved(gem.make("game:TicTacToe-v0"), cells)
    assert given == rewards
    assert {seat: info["correct"] for seat, info in infos.items()} == correct
    assert terminations == {"X": True, "O": True}
    assert not any(truncations.values())


def test_tic_tac_toe_observations() -> None:
    """A seat is told both moves since it acted last and shown the board; a cell that is taken is refused."""
    env = gem.make("game:TicTacToe-v0")
    observations, *_ = moved(env, "5 1")
    assert observations == {
        "X": "You took cell 5. O took cell 1.\n O | 2 | 3\n---+---+---\n 4 | X | 6\n---+---+---\n 7 | 8 | 9\n"
        "You play X. Answer like \\boxed{5}, with the number of a free cell."
    }
    env.reset(seed=0)
    observations, *_ = env.step({"X": "Not \\boxed{4}, rather \\boxed{3}, so \\boxed{that}."})
    assert "X took cell 3.\n" in observations["O"]  # the last that can be read
    observations, *_ = moved(env, "5 5")
    assert observations["O"].startswith("Cell 5 is taken by X. Tries left: 2.\n")
    observations, *_ = moved(env, "5 10")
    assert observations["O"].startswith("'10' is not a cell from 1 to 9. Tries left: 2.\n")


def test_perfect_player_never_loses() -> None:
    """Whatever it draws among its moves, in either seat, against every game that the other seat can play."""
    lost, seen = set(), set()

    def walk(board: str, turn: str, perfect: str) -> None:
        if (board, perfect) in seen:
            return
        seen.add((board, perfect))
        other = "O" if turn == "X" else "X"
        for cell in best_moves(board, turn) if turn == perfect else free_cells(board):
            env.reset(seed=0)
            env.board = board
            if turn == "O":
                env.agent_selector.next()
            _, rewards, *_ = env.step({turn: f"\\boxed{{{cell}}}"})
            if env.agents:
                walk(env.board, other, perfect)
            elif rewards[perfect] < 0:
                lost.add(env.board)

    env = TicTacToeEnv()
    walk("123456789", "X", "X")
    walk("123456789", "X", "O")
    assert lost == set()


def test_perfect_player_takes_the_win_and_reads_a_history() -> None:
    """It plays from the last board of a text, and draws other openings in other episodes."""
    env = gem.make("game:TicTacToe-v0")
    first, _ = env.reset(seed=0)
    observations, *_ = moved(env, "1 4 2 5")
    agent = TicTacToeAgent()
    assert agent(f"{first['X']}\n{observations['X']}", context()) == "\\boxed{3}"
    assert agent([{"role": "user", "content": observations["X"]}], context()) == "\\boxed{3}"
    assert {agent(first["X"], context(episode)) for episode in range(200)} == {f"\\boxed{{{n}}}" for n in range(1, 10)}
    assert agent(first["X"], context(7)) == agent(first["X"], context(7))


def test_kuhn_deals_each_pair_of_cards() -> None:
    """All six, about as often as each other."""
    env: Any = gem.make("game:KuhnPoker-v0")
    deals = []
    for seed in range(1_200):
        env.reset(seed=seed)
        deals.append((env.cards["first"], env.cards["second"]))
    assert set(deals) == set(permutations(CARDS, 2))
    assert min(map(deals.count, set(deals))) > 150


@pytest.mark.parametrize(
    ("moves", "jack_first", "king_first"),
    [
        ("check check", -1, 1),
        ("check bet fold", -1, -1),
        ("check bet call", -2, 2),
        ("bet fold", 1, 1),
        ("bet call", -2, 2),
    ],
)
def test_kuhn_pays_the_pot(moves: str, jack_first: int, king_first: int) -> None:
    """The higher card wins, unless somebody folds; a call doubles the stake."""
    history = tuple(moves.split())
    for won, cards in ((jack_first, ("jack", "queen")), (king_first, ("king", "queen"))):
        assert chips_won(*cards, history) == won
        env: Any = gem.make("game:KuhnPoker-v0")
        env.reset(seed=0)
        env.cards = dict(zip(env.possible_agents, cards, strict=True))
        for move in history:
            assert move in legal_moves(env.history)
            _, rewards, _, _, infos = env.step({env.acting[0]: f"\\boxed{{{move.upper()}}}"})
        assert rewards == {"first": won, "second": -won}
        assert infos["first"]["correct"] == (won > 0)
        assert ("king" in infos["second"]["final_obs"]) == (cards[0] == "king" and history[-1] != "fold")


def test_kuhn_observations() -> None:
    """A seat sees its own card alone, and the moves so far; a move that is not possible now is refused."""
    env: Any = gem.make("game:KuhnPoker-v0")
    env.reset(seed=0)
    env.cards = {"first": "queen", "second": "king"}
    env.step({"first": "\\boxed{check}"})
    observations, *_ = env.step({"second": "\\boxed{bet}"})
    assert observations["first"] == (
        "You check. The second player bets.\nYou are the first player and hold the queen. "
        "Moves so far: first check, second bet.\nAnswer \\boxed{call} or \\boxed{fold}."
    )
    observations, *_ = env.step({"first": "\\boxed{check}"})
    assert observations["first"].startswith("You cannot check now, only call or fold. Tries left: 2.\n")


@pytest.mark.parametrize("alpha", [Fraction(0), Fraction(1, 7), Fraction(1, 3)])
def test_equilibrium_of_kuhn_is_exact(alpha: Fraction) -> None:
    """The first seat wins -1/18 in a game, against any equilibrium, and no strategy does better against it."""
    strategy = equilibrium(alpha)
    assert expected_value(strategy, equilibrium()) == Fraction(-1, 18)
    assert exploitability(strategy) == 0


def test_exploitability_of_other_strategies() -> None:
    """Of one that puts in a chip half the time, and of one that always does, worked out by hand."""
    even = dict.fromkeys(equilibrium(), Fraction(1, 2))
    assert expected_value(even, even) == Fraction(1, 8)
    always = dict.fromkeys(even, Fraction(1))
    # Against it, either seat wins 2 with the king, 0 with the queen, and loses 1 with the jack by a fold.
    assert exploitability(always) == Fraction(1, 3)
    assert best_response(always)["jack", ("bet",)] == 0
    assert exploitability(even) == Fraction(11, 24)


def test_solvers_refuse_other_games() -> None:
    board = gem.make("game:TicTacToe-v0").reset(seed=0)[0]["X"]
    hand = gem.make("game:KuhnPoker-v0").reset(seed=0)[0]["first"]
    assert load_agent("kuhn:1/4")(hand, context()) in ("\\boxed{check}", "\\boxed{bet}")
    for name, observation in (("kuhn", board), ("tictactoe", hand)):
        with pytest.raises(AgentError, match=name if name == "tictactoe" else "game:X-v0"):
            load_agent(name)(observation, context())
    for alpha in ("0.4", "-1", "nan", "a third"):
        with pytest.raises(ArgumentError, match="alpha"):
            KuhnAgent(alpha)


def test_kuhn_agent_plays_the_equilibrium() -> None:
    """In each of the twelve places it puts in a chip as often as it should, over many episodes."""
    agent = KuhnAgent("1/4")
    for (card, history), chip in equilibrium(Fraction(1, 4)).items():
        seat = ("first", "second")[len(history) % 2]
        turns = ", ".join(f"{who} {move}" for who, move in zip(("first", "second"), history, strict=False))
        seen = f"…\nYou are the {seat} player and hold the {card}. Moves so far: {turns or 'none'}.\nAnswer."
        answers = [agent(seen, context(episode)) for episode in range(2_000)]
        assert set(answers) <= {f"\\boxed{{{move}}}" for move in legal_moves(history)}
        share = sum(answer in ("\\boxed{bet}", "\\boxed{call}") for answer in answers) / len(answers)
        assert share == pytest.approx(float(chip), abs=0 if chip in (0, 1) else 0.04)
