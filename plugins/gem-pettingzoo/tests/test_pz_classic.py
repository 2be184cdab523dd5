"""``pz:*``: PettingZoo's classic games as text, with the rewards that they give natively."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pettingzoo  # type: ignore[import-untyped]
import pytest

import gem_core as gem

BOARDS = [("pz:tictactoe-v3", "classic/tictactoe_v3"), ("pz:connect_four-v3", "classic/connect_four_v3")]
SEEDS = [
    pytest.param(range(5), id="few"),
    pytest.param(range(300), id="many", marks=pytest.mark.thorough),
]


@pytest.mark.parametrize("seeds", SEEDS)
@pytest.mark.parametrize(("ours", "native"), BOARDS)
def test_board_game_gives_the_rewards_of_the_native_one(ours: str, native: str, seeds: range) -> None:
    """Random legal moves, played in both, move the same agents, and give them the same in the end."""
    for seed in seeds:
        env: Any = gem.make(ours)
        theirs = pettingzoo.make("aec", native)
        random = np.random.default_rng(seed)
        observations, _ = env.reset(seed=seed)
        theirs.reset(seed=seed)
        wanted = dict.fromkeys(theirs.possible_agents, 0.0)
        given = dict.fromkeys(theirs.possible_agents, 0.0)
        for agent in theirs.agent_iter():
            seen, reward, terminated, truncated, _ = theirs.last()
            wanted[agent] += reward
            if terminated or truncated:
                theirs.step(None)
                continue
            assert list(observations) == [agent]
            legal = [int(number) for number in np.flatnonzero(seen["action_mask"])]
            assert f"Answer with one of {', '.join(map(str, legal))} in a box" in observations[agent]
            move = int(random.choice(legal))
            theirs.step(move)
            observations, rewards, *_, infos = env.step({agent: f"\\boxed{{{move}}}"})
            for each, reward in rewards.items():
                given[each] += reward
        assert env.agents == []
        assert given == wanted
        assert {agent: info["correct"] for agent, info in infos.items()} == {a: r > 0 for a, r in wanted.items()}


@pytest.mark.parametrize("seeds", SEEDS)
@pytest.mark.parametrize("gestures", [3, 5, 7])
def test_rock_paper_scissors_gives_the_rewards_of_the_native_one(gestures: int, seeds: range) -> None:
    """Round by round; the score that is told is that of the rewards, and the last round is an end, not a cut."""
    for seed in seeds:
        env: Any = gem.make("pz:rps-v2", num_actions=gestures, max_cycles=6)
        theirs = pettingzoo.make("parallel", "classic/rps_v2", num_actions=gestures, max_cycles=6)
        observations, _ = env.reset(seed=seed)
        theirs.reset(seed=seed)
        while env.agents:
            responses = {agent: env.sample_random_action(agent) for agent in observations}
            observations, rewards, terminations, _, infos = env.step(responses)
            assert rewards == dict(theirs.step(env.moves[-1])[1])
            shown = observations or {agent: info["final_obs"] for agent, info in infos.items()}
            for agent, text in shown.items():
                won, lost = map(int, re.findall(r"(\d+) won, (\d+) lost", text)[0])
                assert won - lost == env.cumulative[agent]
        assert all(terminations.values())
        assert theirs.agents == []


def test_first_observation_has_rules_board_and_legal_moves() -> None:
    """Until its first move an agent is told the rules, its mark, what the other did, and how to answer."""
    env: Any = gem.make("pz:tictactoe-v3")
    env.reset(seed=0)
    observations, *_ = env.step({"player_1": "I take the middle, ha! \\boxed{4}"})
    assert observations["player_2"] == (
        "This is tic-tac-toe: the players mark a free square in turn. Three own marks in a row, a column or a diagonal "
        "win; a full board without that is a draw. X begins. A free square shows its number.\n"
        "X took square 4.\n"
        "You are O.\n"
        "\n"
        "0 | 3 | 6\n"
        "--+---+--\n"
        "1 | X | 7\n"
        "--+---+--\n"
        "2 | 5 | 8\n"
        "\n"
        "Answer with one of 0, 1, 2, 3, 5, 6, 7, 8 in a box, as \\boxed{0}."
    )
    for move in (0, 3, 2, 5):
        (agent,) = observations
        observations, _, _, _, infos = env.step({agent: f"\\boxed{{{move}}}"})
    assert infos["player_1"]["final_obs"] == (
        "You won.\nYou took square 5.\nYou are X.\n\nO | X | 6\n--+---+--\n1 | X | 7\n--+---+--\nO | X | 8"
    )
    assert infos["player_2"]["final_obs"].startswith("You lost.\nX took square 5.\n")


def test_forfeit_shows_no_winner() -> None:
    """Three responses without a legal move end the game, at -1 for that player alone; both see how it stands."""
    env: Any = gem.make("pz:connect_four-v3")
    env.reset(seed=0)
    env.step({"player_0": "\\boxed{5}"})
    env.step({"player_1": "\\boxed{6}"})
    for _ in range(3):
        _, rewards, _, _, infos = env.step({"player_0": "left"})
    assert rewards == {"player_0": -1.0, "player_1": 0.0}
    assert infos["player_0"]["final_obs"].startswith("You forfeit for want of a legal action; the episode is over.\n")
    assert "draw" not in infos["player_0"]["final_obs"]
    assert infos["player_1"]["correct"] is False
    assert infos["player_1"]["final_obs"].startswith(
        "player_0 forfeits for want of a legal action; the episode is over.\nYou chose column 6.\n"
    )
    assert infos["player_1"]["final_obs"].endswith(". . . . . X O")


@pytest.mark.parametrize("name", ["pz:rps-v2", "pz:tictactoe-v3", "pz:connect_four-v3"])
def test_record_names_the_seats_and_siblings_go_on_alone(name: str) -> None:
    """Seats are the agents' names; a sibling in the same state plays the same, and then its own game."""
    env: Any = gem.make(name)
    assert gem.spec(name).seats == tuple(env.possible_agents)
    observations, _ = env.reset(seed=4)
    for _ in range(3):
        observations, *_ = env.step({agent: env.sample_random_action(agent) for agent in observations})
    sibling = env.fork()
    responses = {agent: sibling.sample_random_action(agent) for agent in observations}
    assert responses == {agent: env.sample_random_action(agent) for agent in observations}
    assert sibling.step(responses) == env.step(responses)
    sibling.reset(seed=5)
    assert len(env.moves) == 4
    env.close()
