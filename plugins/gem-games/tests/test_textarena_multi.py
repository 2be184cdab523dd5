"""TextArena's games with all seats open: turns, rewards, what a seat sees, hostile text, state and blame."""

from __future__ import annotations

from typing import Any

import pytest

import gem_core as gem
from gem_core.errors import ArgumentError, EnvFaultError
from gem_core.testing import check_env
from gem_games.textarena import table
from gem_games.textarena.library import load
from gem_games.textarena.listing import EXTRA, textarena_specs
from gem_games.textarena.multi_agent import TextArenaMultiAgentEnv
from gem_games.textarena.table import TALK

SELF_PLAY = {
    "TicTacToe-v0": 2,
    "ConnectFour-v0": 2,
    "Breakthrough-v0-small": 2,
    "KuhnPoker-v0": 2,
    "Nim-v0": 2,
    "IteratedPrisonersDilemma-v0": 2,
    "SimpleNegotiation-v0": 2,
    "LiarsDice-v0": 3,
    "Snake-v0": 3,
    "SecretMafia-v0": 6,
    "Poker-v0": 3,
    "Taboo-v0": 4,
}
"""Boards, cards, dice, dilemmas, talk, teams and roles, with the number of players."""

OPEN = [spec for spec in textarena_specs() if spec.seats]
RUNNABLE = [spec for spec in OPEN if spec.requires == (EXTRA,)]
FIRST = list({spec.kwargs["game"].partition("-")[0]: spec for spec in reversed(RUNNABLE)}.values())[::-1]
HOSTILE = ["", "[", "[" * 100_000, "[1 " * 50_000, "\ud800[\udfff]", "\x00[\x00]", "[9**9**9]", "[1]" * 50_000, "[²]"]


def played(env: Any, seed: int, act: Any) -> dict[str, float]:
    """Play a game; return the sum of what ``step`` gave each agent."""
    observations, _ = env.reset(seed=seed)
    given = dict.fromkeys(env.possible_agents, 0.0)
    while env.agents:
        observations, rewards, _, _, infos = env.step({agent: act(agent) for agent in observations})
        assert not any("error" in info for info in infos.values()), infos
        for agent, reward in rewards.items():
            given[agent] += reward
    return given


@pytest.mark.parametrize("game", SELF_PLAY)
def test_self_play_accounts_for_every_reward(game: str, many: int) -> None:
    """What ``step`` gave is ``cumulative``, and what TextArena pays; no game fails or is cut off."""
    env = TextArenaMultiAgentEnv(game, players=SELF_PLAY[game])
    for seed in range(many):
        given = played(env, seed, env.sample_random_action)
        assert given == env.cumulative
        assert list(given.values()) == [env.table.rewards()[seat] for seat in range(env.table.players)]
        assert all(env.terminations.values())


def test_every_game_of_several_players_is_listed_with_its_seats() -> None:
    games = [spec.kwargs["game"] for spec in textarena_specs() if spec.kwargs["players"] > 1 and not spec.seats]
    assert [spec.kwargs["game"] for spec in OPEN] == games
    env = gem.make("ta:Taboo-v0-city-country-multi")
    assert gem.spec("ta:Taboo-v0-city-country-multi").seats == env.possible_agents
    assert gem.make("ta:Poker-v0-multi", players=4).possible_agents == ("player_0", "player_1", "player_2", "player_3")


@pytest.mark.thorough
def test_contract_is_kept() -> None:
    """In another process too; ``test_textarena_contract.py`` tries the other games."""
    check_env("ta:KuhnPoker-v0-multi")


def test_seats_act_in_the_order_of_the_game() -> None:
    """And the winner is told so; ``correct`` is of each seat."""
    env = TextArenaMultiAgentEnv("TicTacToe-v0")
    observations, infos = env.reset(seed=1)
    assert observations.keys() == infos.keys() == {"player_0"}
    assert "You are Player 0" in observations["player_0"]
    assert observations["player_0"] == infos["player_0"]["feedback"] + infos["player_0"]["suffix"]
    for agent, other, move in [("player_0", "player_1", "[4]"), ("player_1", "player_0", "[0]")]:
        observations, rewards, *_ = env.step({agent: move})
        assert observations.keys() == rewards.keys() == {other}
    assert "You are Player 0" not in observations["player_0"]
    env.step({"player_0": "[1]"})
    env.step({"player_1": "[2]"})
    observations, rewards, terminations, truncations, infos = env.step({"player_0": "[7]"})
    assert observations == {}
    assert rewards == {"player_0": 1.0, "player_1": -1.0}
    assert terminations == {"player_0": True, "player_1": True}
    assert not any(truncations.values())
    assert {agent: info["correct"] for agent, info in infos.items()} == {"player_0": True, "player_1": False}
    assert "placed their symbol (O) in cell 7" in infos["player_1"]["final_obs"]


def test_invalid_move_is_tried_again_by_the_same_seat() -> None:
    """It is told why, and the other seat nothing; the second one in a row loses, as TextArena has it."""
    env = TextArenaMultiAgentEnv("TicTacToe-v0")
    env.reset(seed=1)
    observations, _, _, _, infos = env.step({"player_0": "I take the middle."})
    assert observations.keys() == {"player_0"}
    assert "attempted an invalid move" in observations["player_0"]
    assert "the middle" not in observations["player_0"]
    assert (infos["player_0"]["invalid_move"], infos["player_0"]["parsed_action"]) == (True, None)
    observations, *_ = env.step({"player_0": "The middle: [4]"})
    assert "invalid" not in observations["player_1"]
    for action in ("[4]", "[4]"):
        _, rewards, *_ = env.step({"player_1": action})
    assert rewards == {"player_0": 1.0, "player_1": -1.0}


def test_parsed_action_comes_with_the_next_observation() -> None:
    env = TextArenaMultiAgentEnv("TicTacToe-v0")
    env.reset(seed=1)
    env.step({"player_0": "<think>Hm.</think>[4]"})
    *_, infos = env.step({"player_1": "[0]"})
    assert (infos["player_0"]["parsed_action"], infos["player_0"]["invalid_move"]) == ("[4]", False)


@pytest.mark.parametrize("spec", FIRST, ids=lambda spec: spec.id)
@pytest.mark.few(12)
def test_no_seat_sees_the_thinking_of_any_or_its_own_response(spec: Any) -> None:
    """Nor the reasons of another, unless the game is to talk."""
    env = TextArenaMultiAgentEnv(**spec.kwargs)
    observations, _ = env.reset(seed=3)
    seen: dict[str, list[str]] = {agent: [] for agent in env.possible_agents}
    for _ in range(24):
        for agent, observation in observations.items():
            seen[agent].append(observation)
        if not env.agents:
            break
        (agent,) = observations
        said = f"<think>Hidden thoughts.</think>I am {agent} and reason at some length here."
        observations, *_ = env.step({agent: f"{said} {env.sample_random_action(agent)}"})
    heard = spec.kwargs["game"].partition("-")[0] in {*TALK, "SettlersOfCatan", "TwoDollar"}
    for agent, texts in seen.items():
        everything = "\n".join(texts)
        assert "Hidden thoughts" not in everything
        assert f"I am {agent} and reason" not in everything
        assert heard or "and reason at some length" not in everything


def test_what_is_said_is_heard_by_the_others_where_the_game_is_to_talk() -> None:
    env = TextArenaMultiAgentEnv("DontSayIt-v0")
    env.reset(seed=1)
    observations, *_ = env.step({"player_0": "<think>Now!</think>Fine weather."})
    assert "Fine weather." in observations["player_1"]
    assert "Now!" not in observations["player_1"]
    observations, *_ = env.step({"player_1": "Indeed."})
    assert observations == {"player_0": "[Player 1] Indeed."}


@pytest.mark.parametrize("game", ["TicTacToe-v0", "SimpleNegotiation-v0", "SecretMafia-v0", "LiarsDice-v0", "Chess-v0"])
def test_hostile_text_of_any_seat_is_answered(game: str) -> None:
    """Every seat says such a thing in its turn; the game goes on or is lost, and nothing is an error."""
    env = TextArenaMultiAgentEnv(game, players=SELF_PLAY.get(game, 2))
    for place, text in enumerate(HOSTILE):
        turns = iter(range(1_000))
        hostile = env.possible_agents[place % len(env.possible_agents)]

        def act(agent: str, text: str = text, turns: Any = turns, hostile: str = hostile) -> str:
            return text if agent == hostile or next(turns) > 20 else env.sample_random_action(agent)

        assert played(env, place, act) == env.cumulative
        assert len(env.observe(hostile)) < 50_000


def test_fork_goes_on() -> None:
    """In the middle of a game of talk, all seats see and get the same from there on."""
    env = gem.make("ta:SecretMafia-v0-multi")
    observations, _ = env.reset(seed=5)
    for _ in range(7):
        (agent,) = observations
        observations, *_ = env.step({agent: env.sample_random_action(agent)})
    other = env.fork()
    assert other.acting == env.acting
    assert all(other.observe(agent) == env.observe(agent) for agent in env.possible_agents)
    while env.agents:
        (agent,) = env.acting
        actions = {agent: env.sample_random_action(agent)}
        assert {agent: other.sample_random_action(agent)} == actions
        assert other.step(actions) == env.step(actions)


@pytest.mark.parametrize(("game", "kwargs"), [("DontSayIt-v0-unlimited", {}), ("TicTacToe-v0", {"max_turns": 3})])
def test_episode_is_cut_off_when_a_seat_has_had_its_turns(
    game: str, kwargs: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody gets anything, and nobody has won."""
    monkeypatch.setattr(table, "_MOST_TURNS", 3)
    env = TextArenaMultiAgentEnv(game, **kwargs)
    moves = iter(["[4]", "[0]", "[1]", "[7]", "[2]", "[6]"])
    assert played(env, 1, lambda agent: next(moves)) == {"player_0": 0.0, "player_1": 0.0}
    assert all(env.truncations.values())
    assert env.table.turns == [3, 3]


def test_seat_that_holds_up_the_game_loses() -> None:
    """By twenty invalid moves in a row, where TextArena asks it again for ever, though it is out."""
    env = TextArenaMultiAgentEnv("Poker-v0")
    given = played(env, 1, lambda agent: "nonsense" if agent == "player_0" else env.sample_random_action(agent))
    assert given == {"player_0": -1.0, "player_1": 1.0}
    assert env.table.turns[0] == 20
    assert env.observe("player_0").startswith("That was the 20th invalid move in a row: the game is lost.")


def test_judge_is_asked_and_its_failure_is_nobodys() -> None:
    votes = iter(["Hm.", "Affirmative"])
    env = gem.make("ta:Debate-v0-multi", judge=lambda question: next(votes))
    given = played(env, 1, lambda agent: "It is so.")
    sides = env.table.game.state.game_state["sides"]
    assert given == {f"player_{seat}": 1.0 if sides[seat] == "Affirmative" else -1.0 for seat in range(2)}
    with pytest.raises(EnvFaultError, match="the judge: ZeroDivisionError"):
        gem.make("ta:Debate-v0-multi", judge=lambda question: 1 / 0).reset(seed=1)


def test_jury_that_is_divided_gives_a_draw() -> None:
    """In textarena 0.7.4 ScenarioPlanning raises then."""
    env = TextArenaMultiAgentEnv("ScenarioPlanning-v0", judge=lambda question: "Neither.")
    assert played(env, 1, lambda agent: "Look for water.") == {"player_0": 0.0, "player_1": 0.0}


def test_response_that_makes_the_library_raise_loses(monkeypatch: pytest.MonkeyPatch) -> None:
    """To the other seat, which is not told of it as if it were its own."""
    env = TextArenaMultiAgentEnv("TicTacToe-v0")
    env.reset(seed=1)
    broken = type(load("TicTacToe-v0")[0])
    plain = broken.step

    def step(self: Any, action: str) -> Any:
        if "13" in action:
            raise OverflowError("too much")
        return plain(self, action)

    monkeypatch.setattr(broken, "step", step)
    env.step({"player_0": "[4]"})
    _, rewards, terminations, _, infos = env.step({"player_1": "[13]"})
    assert rewards == {"player_0": 1.0, "player_1": -1.0}
    assert all(terminations.values())
    assert infos["player_1"]["final_obs"].startswith("The game could not read your response (OverflowError)")
    assert "could not read" not in infos["player_0"]["final_obs"]


def test_library_that_raises_on_any_action_is_an_error_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    env = TextArenaMultiAgentEnv("TicTacToe-v0")
    env.reset(seed=1)
    monkeypatch.setattr(type(load("TicTacToe-v0")[0]), "step", lambda self, action: {}["board"])
    _, rewards, _, truncations, infos = env.step({"player_0": "[4]"})
    assert rewards == {"player_0": 0.0, "player_1": 0.0}
    assert all(truncations.values())
    error = {"kind": "textarena", "message": "KeyError: 'board'"}
    assert [info["error"] for info in infos.values()] == [error, error]


def test_action_is_sampled_for_the_seat_whose_turn_it_is() -> None:
    env = TextArenaMultiAgentEnv("TicTacToe-v0")
    env.reset(seed=1)
    with pytest.raises(ArgumentError, match="it is not the turn of 'player_1'"):
        env.sample_random_action("player_1")
