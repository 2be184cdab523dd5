"""What a seat at a game of TextArena sees: nothing of its own responses, and of another's the move alone."""

from __future__ import annotations

import re
from typing import Any

import pytest

import gem_core as gem
from gem_games.textarena.env import TextArenaEnv
from gem_games.textarena.listing import EXTRA, textarena_specs
from gem_games.textarena.table import TALK

OWN = "<think>Hidden thoughts.</think>I reason SELFISHLY for long here."
OTHER = "<think>Hidden thoughts.</think>I reason OTHERWISE for long here."
HEARD = {*TALK, "SettlersOfCatan", "TwoDollar"}
"""Families in which what is said is part of the game."""


def family(spec: Any) -> str:
    return str(spec.kwargs["game"]).partition("-")[0]


FIRST = list(
    {
        family(spec): spec for spec in reversed(list(textarena_specs())) if spec.requires == (EXTRA,) and not spec.seats
    }.values()
)[::-1]


def seen(env_id: str, players: int, turns: int) -> tuple[list[str], list[str]]:
    """Return what the agent and the other seats see in a game in which all give reasons for random moves."""
    asked: list[str] = []

    def other(observation: str, context: Any) -> str:
        asked.append(observation)
        return f"{OTHER} {context.sample_random_action()}"

    env = gem.make(env_id, opponents=other if players > 1 else "random")
    observations = [env.reset(seed=3)[0]]
    for _ in range(turns):
        observation, _, terminated, truncated, info = env.step(f"{OWN} {env.sample_random_action()}")
        assert "error" not in info
        observations.append(observation)
        if terminated or truncated:
            break
    return observations, asked


@pytest.mark.parametrize("spec", FIRST, ids=lambda spec: spec.id)
@pytest.mark.few(30)
def test_no_seat_sees_its_own_response_or_the_reasons_of_another(spec: Any) -> None:
    observations, asked = seen(spec.id, spec.kwargs["players"], turns=12)
    everything = "\n".join([*observations, *asked])
    assert "Hidden thoughts" not in everything
    assert not any("SELFISHLY" in observation for observation in observations)
    assert not any("OTHERWISE" in observation for observation in asked if spec.kwargs["players"] == 2)
    if family(spec) not in HEARD:
        assert "SELFISHLY" not in everything
        assert "OTHERWISE" not in everything


@pytest.mark.parametrize("game", ["DontSayIt-v0", "SimpleNegotiation-v0", "TruthAndDeception-v0"])
def test_where_the_game_is_to_talk_all_that_is_said_is_heard(game: str) -> None:
    """But for thoughts."""
    asked: list[str] = []
    env = TextArenaEnv(game, players=2, opponents=lambda observation: asked.append(observation) or "Really?")
    env.reset(seed=1)
    observation, *_ = env.step("<think>He must not know.</think>The weather is fine.")
    assert "The weather is fine." in asked[-1]
    assert "He must not know" not in asked[-1]
    assert "Really?" in observation


def test_the_move_of_another_seat_is_seen_by_its_brackets_or_the_games_description() -> None:
    env = TextArenaEnv("Alquerque-v0", players=2, opponents=lambda _: "I should move [e4 e3] now.")
    env.reset(seed=1)
    observation, *_ = env.step("I like this one: [b2 b3]")
    assert observation.startswith("[Player 1] [e4 e3]\nMove #2\n")
    env = TextArenaEnv("ConnectFour-v0", players=2, opponents=lambda _: "Not [col 1], but [col 2].")
    env.reset(seed=1)
    observation, *_ = env.step("[col 4]")
    assert "but" not in observation
    assert "[Player 1]" not in observation
    assert "[GAME] Player 1 dropped their disk (O) into column" in observation


def test_a_thought_is_no_move() -> None:
    env = TextArenaEnv("TicTacToe-v0", players=2, opponents=lambda _: "[8]")
    env.reset(seed=1)
    *_, info = env.step("<think>Not [0].</think>[4]")
    assert env.table.actions[0] == info["parsed_action"] == "[4]"


def test_only_the_board_as_it_stands_is_shown() -> None:
    """FifteenPuzzle tells two boards a turn, Battleship tells them among what happened."""
    env = TextArenaEnv("FifteenPuzzle-v0")
    env.reset(seed=1)
    for _ in range(3):
        *_, info = env.step(env.sample_random_action())
        assert info["suffix"].count("\n") >= 4
        assert info["feedback"].count("\n") < 2
    env = TextArenaEnv("Battleship-v0", players=2, opponents=lambda _: "[A0]")
    _, info = env.reset(seed=1)
    before = info["suffix"]
    observation, *_, info = env.step("[B1]")
    assert observation.count("Your Ships") == 1
    assert info["suffix"] != before


def test_announcements_are_no_board() -> None:
    """A call for decisions is not shown again in the round of talks that follows."""
    env = TextArenaEnv("IteratedPrisonersDilemma-v0", players=2, opponents=lambda _: "[defect]")
    env.reset(seed=1)
    shown = []
    while "Starting Round 2" not in (observation := env.step("[cooperate]")[0]):
        shown.append(observation)
    assert "Please reply with" in shown[-1]
    assert "Please reply with" not in observation


@pytest.mark.parametrize("game", ["LetterAuction-v0", "SpiteAndMalice-v0"])
def test_what_another_seat_is_asked_is_not_passed_on(game: str) -> None:
    observations, asked = seen(f"ta:{game}", 2, turns=12)
    assert not any("Player 1, do you" in text or "Player 1, you" in text for text in observations)
    assert not any("Player 0, do you" in text or "Player 0, you" in text for text in asked)


def test_an_opponent_reaches_the_conversation_of_its_seat() -> None:
    """As the messages that it reads, or by its context; a restored game gives the same."""

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
    env = TextArenaEnv("TicTacToe-v0", players=2, opponents=model)
    for _ in range(2):  # the conversation of an earlier episode is forgotten
        observation, _ = env.reset(seed=1)
        for _ in range(2):
            env.step(env.sample_random_action())
    first, second = model.sent[-2:]
    assert [message["role"] for message in second] == ["system", "user", "assistant", "user"]
    assert second[:2] == first
    assert second[1]["content"] != observation
    assert re.fullmatch(r"<think>Hm.</think>\[\d\]", second[2]["content"])
    other = env.fork()
    for each in (env, other):
        each.step(each.sample_random_action())
    assert model.sent[-2] == model.sent[-1]


def test_a_judge_that_reads_messages_is_sent_its_question() -> None:
    asked: list[Any] = []

    def judge(observation: Any) -> str:
        asked.append(observation)
        return "1"

    judge.reads = "messages"  # type: ignore[attr-defined]
    env = TextArenaEnv("Debate-v0", players=2, judge=judge)
    env.reset(seed=1)
    assert [[message["role"] for message in messages] for messages in asked] == [["user"]] * len(asked) != []
