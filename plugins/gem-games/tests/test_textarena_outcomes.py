"""Who has won a game of TextArena, and who may sit at its table."""

from __future__ import annotations

from typing import Any

import pytest

from gem_core.errors import ArgumentError, UnknownAgentError
from gem_games.textarena.env import TextArenaEnv
from gem_games.textarena.listing import textarena_specs


def ended(env: TextArenaEnv, rewards: dict[int, float]) -> Any:
    """Play a turn in which the game ends with these rewards; return its info."""
    env.reset(seed=1)

    def act(action: str) -> None:
        env.table.done = True
        env.table.game.state.rewards = rewards

    env.table.act = act
    return env.step("[1]")[4]


@pytest.mark.parametrize(("reward", "correct"), [(1, True), (0.99, False), (0.25, False), (0.0, False), (-1.0, False)])
def test_a_puzzle_is_solved_by_its_full_reward(reward: float, correct: bool) -> None:
    """Less than 1 is the share that was done when the turns ran out."""
    assert ended(TextArenaEnv("Mastermind-v0"), {0: reward})["correct"] is correct


@pytest.mark.parametrize(
    ("rewards", "correct"),
    [
        ({0: 1.0, 1: 1 / 3, 2: -1 / 3, 3: -1.0}, False),
        ({0: -1.0, 1: 1.0, 2: 1 / 3, 3: -1 / 3}, True),
        ({0: 1, 1: 1, 2: -1, 3: -1}, True),
        ({0: 0, 1: 0, 2: 0, 3: 0}, False),
    ],
)
def test_a_seat_wins_that_no_other_exceeds(rewards: dict[int, float], correct: bool) -> None:
    """The second place of four is paid more than 0, and is no victory; a draw is none either."""
    assert ended(TextArenaEnv("Poker-v0", players=4, seat=1), rewards)["correct"] is correct


@pytest.mark.parametrize("game", ["Blackjack-v0", "Set-v0"])
def test_a_score_is_neither_won_nor_lost(game: str) -> None:
    env = TextArenaEnv(game)
    assert ended(env, {0: 3.0})["correct"] is None
    assert env.reset(seed=1)[1]["correct"] is None  # so that an episode that is cut off has not failed


def test_the_best_button_of_bandit_wins() -> None:
    """In textarena 0.7.4 it gives 0, and each other one more than that."""
    env = TextArenaEnv("Bandit-v0")
    for best in (True, False):
        env.reset(seed=1)
        game = env.table.game
        means = dict(game.state.game_state["ground_truth"])
        choose = max if best else min
        for _ in range(game.num_turns):
            assert not env.step("[red]")[2]
        _, reward, terminated, _, info = env.step(f"[{choose(means, key=means.__getitem__)}]")
        assert terminated
        assert info["correct"] is best
        assert (reward == 1.0) is best
        assert ("Congratulations" in info["textarena"]["reason"]) is best


def test_opponents_may_be_named_by_seat() -> None:
    """An agent, or the name of one; who is left out plays at random."""
    asked = []

    def says(observation: str) -> str:
        asked.append(observation)
        return "[1]"

    env = TextArenaEnv("Poker-v0", players=3, seat=0, opponents={2: says})
    env.reset(seed=2)
    for _ in range(5):
        if env.step(env.sample_random_action())[2]:
            break
    assert asked
    named = TextArenaEnv("TicTacToe-v0", players=2, opponents={1: "random"})
    named.reset(seed=1)
    assert "Player 1" in named.step("[4]")[0]


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"opponents": {5: "random"}}, "opponents names seat 5, and the other seats are [1]"),
        ({"opponents": {0: "random"}}, "opponents names seat 0, and the other seats are [1]"),
        ({"opponents": ["random"] * 2}, "opponents must be 1, one for each other seat, not 2"),
        (
            {"players": 3},
            "players=3 is not for TicTacToe-v0, which can be played by 2: "
            "The number of players has to be 2, received 3",
        ),
        (
            {"game": "Sodoku"},
            "textarena has no game 'Sodoku'. Did you mean 'Sudoku-v0'? Run 'gem list ta'",
        ),
    ],
)
def test_a_table_that_cannot_be_is_refused(kwargs: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        TextArenaEnv(**{"game": "TicTacToe-v0", "players": 2, **kwargs})
    assert str(caught.value) == message


def test_an_opponent_of_no_such_name_is_refused() -> None:
    with pytest.raises(UnknownAgentError, match=r"no agent 'bisec'\. Did you mean 'bisect'\?"):
        TextArenaEnv("TicTacToe-v0", players=2, opponents="bisec")


@pytest.mark.parametrize("game", ["PublicGoodsGame-v0", "MarketEntryGame-v0"])
@pytest.mark.parametrize("opponents", ["random", lambda _: "what?"])
def test_who_is_eliminated_is_not_asked_again(game: str, opponents: Any) -> None:
    """In textarena 0.7.4 that goes on for ever, and so does the search for the next player when all are out."""
    env = TextArenaEnv(game, players=3, opponents=opponents)
    env.reset(seed=1)
    for _ in range(60):
        _, reward, terminated, truncated, info = env.step("what?")
        if terminated:
            break
    assert (terminated, truncated, info["correct"]) == (True, False, False)
    assert reward <= 0


@pytest.mark.parametrize(
    "game", ["QuantumTicTacToe-v0", "SpiteAndMalice-v0", "PublicGoodsGame-v0", "MarketEntryGame-v0"]
)
def test_games_that_start_alone_and_are_none_have_two_seats(game: str) -> None:
    """Each seat can be held, and the other one is played by whom one likes."""
    spec = next(spec for spec in textarena_specs() if spec.kwargs["game"] == game)
    assert spec.kwargs["players"] == 2
    assert spec.summary.endswith("; two players.")
    asked = []

    def opponent(observation: str, context: Any) -> str:
        asked.append(observation)
        return str(context.sample_random_action())

    env = TextArenaEnv(game, players=2, seat=1, opponents=opponent)
    env.reset(seed=3)
    for _ in range(40):
        result = env.step(env.sample_random_action())
        assert "error" not in result[4]
        if result[2]:
            break
    assert asked
