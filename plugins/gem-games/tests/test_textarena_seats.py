"""Seats at a table of TextArena: turns, opponents, rewards, limits, judges, and whose fault a failure is."""

from __future__ import annotations

import re
from typing import Any

import pytest

import gem_core as gem
from gem_core.errors import ArgumentError, EnvFaultError, MissingRequirementError, UnknownAgentError
from gem_games.textarena import table
from gem_games.textarena.env import TextArenaEnv
from gem_games.textarena.library import load
from gem_games.textarena.listing import textarena_specs
from gem_games.textarena.moves import SAMPLERS
from gem_games.textarena.multi_agent import TextArenaMultiAgentEnv

SELF_PLAY = {
    "ConnectFour-v0": 2,
    "IteratedPrisonersDilemma-v0": 2,
    "SimpleNegotiation-v0": 2,
    "LiarsDice-v0": 3,
    "SecretMafia-v0": 6,
    "Poker-v0": 3,
    "Taboo-v0": 4,
}
"""Boards, cards, dice, dilemmas, talk, teams and roles, with the number of players."""
OPEN = [spec for spec in textarena_specs() if spec.seats]
HOSTILE = ["", "[" * 100_000, "[1 " * 50_000, "\ud800[\udfff]", "\x00[\x00]", "[9**9**9]", "[²]"]


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
        observations, rewards, terminations, _, infos = env.step({"player_1": action})
    assert (observations, rewards) == ({}, {"player_0": 1.0, "player_1": -1.0})
    assert terminations == {"player_0": True, "player_1": True}
    assert {agent: info["correct"] for agent, info in infos.items()} == {"player_0": True, "player_1": False}


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


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"opponents": {5: "random"}}, "5"),
        ({"opponents": ["random"] * 2}, "1"),
        ({"players": 3}, "players=3"),
        ({"game": "Golf-v0", "players": 3}, "two"),
        ({"game": "Sodoku"}, "'Sudoku-v0'"),
        ({"seat": 2}, "2"),
        ({"opponents": "bisec"}, "bisec"),
    ],
)
def test_a_table_that_cannot_be_is_refused(kwargs: dict[str, Any], message: str) -> None:
    with pytest.raises((ArgumentError, UnknownAgentError), match=message):
        TextArenaEnv(**{"game": "TicTacToe-v0", "players": 2, **kwargs})


def failing(observation: str) -> str:
    raise ConnectionError("no answer")


def test_an_opponent_that_fails_truncates_with_an_error() -> None:
    """Any action would have failed, so it is nobody's loss; at reset it raises."""
    with pytest.raises(EnvFaultError, match="'player_0'") as caught:
        TextArenaEnv("TicTacToe-v0", players=2, seat=1, opponents=failing).reset(seed=1)
    assert isinstance(caught.value.__cause__, ConnectionError)
    env = TextArenaEnv("TicTacToe-v0", players=2, opponents=failing)
    env.reset(seed=1)
    _, reward, terminated, truncated, info = env.step("[4]")
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["error"]["kind"] == "opponent"
    assert info["error"]["message"] == "the agent at 'player_1' failed: ConnectionError: no answer"
    assert "correct" not in info


def test_opponents_who_never_end_their_turn_at_reset_raise() -> None:
    """They make the same invalid move again and again, where that costs nothing."""
    env = TextArenaEnv("TicTacToe-v0", players=2, seat=1, opponents=lambda _: "[4]")
    env.table.act = lambda action: None
    with pytest.raises(EnvFaultError, match="the turn of 'player_1' did not come in 300 turns of the others"):
        env.reset(seed=1)


def test_opponents_who_end_each_game_before_the_agents_turn_fail_the_reset() -> None:
    """The opponent loses by two invalid moves; where it does so once, another game is dealt."""
    env = TextArenaEnv("TicTacToe-v0", players=2, seat=1, opponents=lambda _: "[nonsense]")
    with pytest.raises(EnvFaultError, match="10 games in a row were over before 'player_1' acted"):
        env.reset(seed=1)
    answers = iter(["[nonsense]", "[nonsense]", "[4]"])
    env = TextArenaEnv("TicTacToe-v0", players=2, seat=1, opponents=lambda _: next(answers))
    observation, _ = env.reset(seed=1)
    assert "Player 0 placed their symbol (O) in cell 4." in observation
    other = env.fork()
    assert other.table.actions == env.table.actions == ["[4]"]


def played_alone(env: Any, agent: Any, seed: int = 1) -> tuple[float, bool, bool, dict[str, Any], int]:
    """Play an episode; return the sum of rewards, the flags, the last info and the number of turns."""
    observation, _ = env.reset(seed=seed)
    total, turns = 0.0, 0
    while True:
        observation, reward, terminated, truncated, info = env.step(agent(env, observation))
        total, turns = total + reward, turns + 1
        if terminated or truncated:
            return total, terminated, truncated, info, turns


def sorting(env: Any, _: str) -> str:
    """In 2048: to the left or down while that changes the board."""
    ways = SAMPLERS["2048"](env.unwrapped.table.game, None)
    return next(way for way in ("[Left]", "[Down]", "[Right]", "[Up]") if way in ways)


def test_being_cut_off_pays_for_what_is_done() -> None:
    """To play on is never worse than to spoil the game, which TextArena pays by the progress."""
    cut = gem.make("ta:2048-v0", max_turns=150)
    reward, terminated, truncated, info, turns = played_alone(cut, sorting)
    assert (terminated, truncated, info["correct"], turns) == (False, True, False, 150)

    def spoils(env: Any, observation: str) -> str:
        return sorting(env, observation) if len(env.unwrapped.table.actions) < 100 else "nonsense"

    spoilt, terminated, *_ = played_alone(gem.make("ta:2048-v0"), spoils)
    assert terminated
    assert reward > spoilt > 0


def test_a_game_with_a_limit_takes_another_one() -> None:
    """Its prompt names it, and its own reward comes when it is reached: the higher score wins in PigDice."""
    env = gem.make("ta:GuessTheNumber-v0", max_turns=3)
    assert "within 3 turns" in env.reset(seed=1)[0]
    reward, *_, info, turns = played_alone(env, lambda env, _: f"[{1 + len(env.unwrapped.table.actions)}]")
    assert 0 < reward < 1
    assert (info["correct"], turns) == (False, 3)
    _, terminated, truncated, _, _ = played_alone(
        gem.make("ta:PigDice-v0-500", max_turns=40), lambda env, _: env.sample_random_action()
    )
    assert (terminated, truncated) == (True, False)


@pytest.mark.parametrize("max_turns", [0, "9", 7])
def test_a_limit_that_cannot_be_is_refused(max_turns: Any) -> None:
    """TruthAndDeception takes even ones alone."""
    with pytest.raises(ArgumentError, match=f"max_turns.*{max_turns}"):
        gem.make("ta:TruthAndDeception-v0", max_turns=max_turns)


def test_a_game_with_a_judge_wants_one() -> None:
    with pytest.raises(MissingRequirementError, match="judge="):
        gem.make("ta:Debate-v0")
    env = gem.make("ta:Debate-v0", judge=lambda question: "Affirmative")
    assert env.unwrapped.spec.make().unwrapped.game == "Debate-v0"


def test_a_judge_answers_as_the_game_master() -> None:
    """It is asked once for each question, also when the state is restored."""
    asked: list[str] = []

    def judge(question: str) -> str:
        asked.append(question)
        return "No"

    env = gem.make("ta:TwentyQuestions-v0", judge=judge)
    env.reset(seed=1)
    observation, *_ = env.step("Can it fly?")
    assert observation == "[GAME] No"
    assert "Q: Can it fly?\nOptions: 'Yes', 'No', 'I don't know'" in asked[0]
    other = env.fork()
    assert len(asked) == 1
    word = other.unwrapped.table.game.game_word
    assert other.step(f"[{word}]")[1:3] == (1.0, True)
    assert len(asked) == 1


def test_a_judge_that_fails_is_nobodys_fault() -> None:
    def judge(question: str) -> str:
        raise OSError("no answer")

    env = gem.make("ta:TwentyQuestions-v0", judge=judge)
    env.reset(seed=1)
    _, reward, terminated, truncated, info = env.step("Is it alive?")
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["error"] == {"kind": "judge", "message": "JudgeError: OSError: no answer"}
    with pytest.raises(EnvFaultError, match="Debate-v0: the judge: OSError: no answer"):
        gem.make("ta:Debate-v0", judge=judge).reset(seed=1)


def test_an_opponent_reaches_the_conversation_of_its_seat() -> None:
    """As the messages that it reads, or by its context."""

    class Model:
        reads, system = "messages", "Play well."

        def __init__(self) -> None:
            self.sent: list[Any] = []

        def __call__(self, observation: Any, context: Any) -> str:
            assert observation == context.messages
            assert context.turn == sum(message["role"] == "assistant" for message in observation)
            self.sent.append(observation)
            return f"<think>Hm.</think>{context.sample_random_action()}"

    model = Model()
    env = TextArenaEnv("TicTacToe-v0", players=2, opponents={1: model})
    for _ in range(2):  # the conversation of an earlier episode is forgotten
        observation, _ = env.reset(seed=1)
        for _ in range(2):
            env.step(env.sample_random_action())
    first, second = model.sent[-2:]
    assert [message["role"] for message in second] == ["system", "user", "assistant", "user"]
    assert second[:2] == first
    assert second[1]["content"] != observation
    assert re.fullmatch(r"<think>Hm.</think>\[\d\]", second[2]["content"])


@pytest.mark.parametrize(("vote", "reward"), [("Affirmative", 1.0), ("Negative", -1.0), ("Neither", 0.0)])
def test_a_judge_votes_as_the_jury(vote: str, reward: float) -> None:
    """Before the debate it has no opinion; after it the seat that it votes for has won."""
    votes = iter(["Hm.", vote])
    env = gem.make("ta:Debate-v0", judge=lambda question: next(votes))
    env.reset(seed=1)
    side = env.unwrapped.table.game.state.game_state["sides"][0]
    while True:
        _, got, terminated, _, _ = env.step("It is so.")
        if terminated:
            break
    assert got == (reward if side == "Affirmative" else -reward)
