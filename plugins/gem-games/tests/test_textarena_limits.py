"""When a game of TextArena is cut off, what is paid then, and games that have a judge."""

from __future__ import annotations

from typing import Any

import pytest

import gem_core as gem
from gem_core.errors import ArgumentError, EnvFaultError, MissingRequirementError
from gem_games.textarena import table
from gem_games.textarena.env import TextArenaEnv
from gem_games.textarena.moves import SAMPLERS


def played(env: Any, agent: Any, seed: int = 1) -> tuple[float, bool, bool, dict[str, Any], int]:
    """Play an episode; return the sum of rewards, the flags, the last info and the number of turns."""
    observation, _ = env.reset(seed=seed)
    total, turns = 0.0, 0
    while True:
        observation, reward, terminated, truncated, info = env.step(agent(env, observation))
        total, turns = total + reward, turns + 1
        if terminated or truncated:
            return total, terminated, truncated, info, turns


def at_random(env: Any, _: str) -> str:
    return str(env.sample_random_action())


def sorting(env: Any, _: str) -> str:
    """In 2048: to the left or down while that changes the board."""
    ways = SAMPLERS["2048"](env.unwrapped.table.game, None)
    return next(way for way in ("[Left]", "[Down]", "[Right]", "[Up]") if way in ways)


def test_no_id_has_a_limit_of_ours() -> None:
    assert {gem.spec(env_id).max_turns for env_id in gem.list_envs("ta")} == {None}


def test_being_cut_off_pays_for_what_is_done() -> None:
    """To play on is never worse than to spoil the game, which TextArena pays by the progress."""
    cut = gem.make("ta:2048-v0", max_turns=150)
    reward, terminated, truncated, info, turns = played(cut, sorting)
    assert (terminated, truncated, info["correct"], turns) == (False, True, False, 150)

    def spoils(env: Any, observation: str) -> str:
        return sorting(env, observation) if len(env.unwrapped.table.actions) < 100 else "nonsense"

    spoilt, terminated, *_ = played(gem.make("ta:2048-v0"), spoils)
    assert terminated
    assert reward > spoilt > 0


def test_a_game_with_a_limit_takes_another_one() -> None:
    """Its prompt names it, and its own reward comes when it is reached: the higher score wins in PigDice."""
    env = gem.make("ta:GuessTheNumber-v0", max_turns=3)
    assert "within 3 turns" in env.reset(seed=1)[0]
    reward, *_, info, turns = played(env, lambda env, _: f"[{1 + len(env.unwrapped.table.actions)}]")
    assert 0 < reward < 1
    assert (info["correct"], turns) == (False, 3)
    _, terminated, truncated, _, _ = played(gem.make("ta:PigDice-v0-500", max_turns=40), at_random)
    assert (terminated, truncated) == (True, False)


@pytest.mark.parametrize("env_id", ["ta:PigDice-v0-500", "ta:PigDice-v0-long"])
def test_long_games_come_to_their_own_end(env_id: str) -> None:
    reward, terminated, truncated, _, _ = played(gem.make(env_id), at_random)
    assert (abs(reward), terminated, truncated) == (1.0, True, False)


def test_a_game_without_any_limit_is_cut_off_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "_MOST_TURNS", 12)
    env = gem.make("ta:DontSayIt-v0-unlimited")
    reward, terminated, truncated, info, turns = played(env, at_random)
    assert (reward, terminated, truncated, info["correct"], turns) == (0.0, False, True, False, 12)
    assert "error" not in info
    env.reset(seed=1)
    for _ in range(11):
        env.step("Hm.")
    other = env.fork()
    assert other.step("Hm.")[3]


@pytest.mark.parametrize(
    ("max_turns", "message"),
    [
        (0, "max_turns must be a positive whole number, not 0"),
        ("9", "max_turns must be a positive whole number, not '9'"),
        (
            7,
            "max_turns=7 is not for TruthAndDeception-v0: Please use an even number of max turns. Current max_turns: 7",
        ),
    ],
)
def test_a_limit_that_cannot_be_is_refused(max_turns: Any, message: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        gem.make("ta:TruthAndDeception-v0", max_turns=max_turns)
    assert str(caught.value) == message


def test_a_seat_that_is_out_before_its_turn_is_dealt_another_game() -> None:
    """In SecretMafia by night; the first observation is of a game in which the seat is to play."""
    env = gem.make("ta:SecretMafia-v0")
    for seed in range(8):
        env.reset(seed=seed)
        table = env.unwrapped.table
        assert not table.done
        assert table.seat == 0
        assert 0 in table.game.state.game_state["alive_players"]


def test_klondike_can_be_played() -> None:
    """In textarena 0.7.4 its module cannot be read; the score at the end is the number of cards."""
    reward, terminated, _, info, turns = played(gem.make("ta:Klondike-v0"), at_random)
    assert (terminated, info["correct"], turns) == (True, False, 200)
    assert 0 < reward < 52
    env = gem.make("ta:Klondike-v0")
    env.reset(seed=1)
    assert env.step("[forfeit]")[1:3] == (0.0, True)


# The judge.


def test_a_game_with_a_judge_wants_one() -> None:
    with pytest.raises(MissingRequirementError) as caught:
        gem.make("ta:Debate-v0")
    needed = "it needs an argument: make(…, judge=…), or --set judge=… of gem run"
    assert str(caught.value) == f"ta:Debate-v0 cannot run here: {needed}"
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


@pytest.mark.parametrize("env_id", ["ta:GuessWho-v0", "ta:TwentyQuestions-v0-hardcore"])
def test_random_players_ask_the_judge(env_id: str) -> None:
    reward, *_, info, turns = played(gem.make(env_id, judge=lambda question: "I don't know"), at_random)
    assert (reward, info["correct"]) == (0.0, False)
    assert turns >= 20


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


def test_a_judge_does_not_change_what_the_game_draws() -> None:
    import random

    def judge(question: str) -> str:
        random.random()
        return "Hm."

    dealt = []
    for each in (judge, lambda question: "Hm."):
        env = TextArenaEnv("Debate-v0", players=2, judge=each)
        dealt.append(env.reset(seed=5)[0])
    assert dealt[0] == dealt[1]
