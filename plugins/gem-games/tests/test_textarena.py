"""TextArena's games, one contract for all: valid random moves, what a seat may see, generators of their own."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import random
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gem_core as gem
from gem_core import make
from gem_core.errors import MissingRequirementError
from gem_core.testing import check_env
from gem_games.textarena.env import TextArenaEnv
from gem_games.textarena.games import GAMES
from gem_games.textarena.listing import CLOSED, EXTRA, textarena_specs
from gem_games.textarena.moves import NO_MOVE, SAMPLERS
from gem_games.textarena.table import TALK

EVERY = bool(os.environ.get("GEM_EVERY_TEXTARENA_GAME"))
"""Whether to try all ids with all promises, which takes some minutes."""
RUNNABLE = [spec for spec in textarena_specs() if spec.requires == (EXTRA,) and not spec.seats]
FIRST = list({spec.id.partition("-")[0]: spec for spec in reversed(RUNNABLE)}.values())[::-1]
"""One game of each family."""
OPEN = {spec.id.partition("-")[0]: spec.id for spec in textarena_specs() if spec.requires == (EXTRA,) and spec.seats}
OWN = "<think>Hidden thoughts.</think>I reason SELFISHLY for long here."
OTHER = "<think>Hidden thoughts.</think>I reason OTHERWISE for long here."
HEARD = {*TALK, "SettlersOfCatan", "TwoDollar"}
"""Families in which what is said is part of the game."""
HOSTILE = [
    "",
    "[" * 1_000_000,
    "[1 " * 300_000,
    "9" * 1_000_000,
    "[" + "9" * 3_000 + "]",
    "\ud800[\udfff]",
    "\x00[\x00]",
]
HOSTILE += ["[\u0661]", "[9**9**9**9]", "[-1 -1]", "[1 1 99999999999999]", "[Offer: 99999999999999 Wood -> 1 Wheat]"]
NOT_KNOWN = {"Crosswords", "Minesweeper", "Sudoku"}
"""Games that take what is wrong for invalid, which a player cannot know."""
COMES_TO_NOTHING = {"IndianPoker", "SpellingBee", "WordChains"}
"""Games that can come to where nothing is valid within twenty turns."""
TRIED_ELSEWHERE = {
    "process-determinism": "tried for all games in one other process",
    "hostile-actions": "test_hostile_actions_are_answered tries some",
}


def family(spec: Any) -> str:
    return str(spec.kwargs["game"]).partition("-")[0]


def test_the_table_matches_the_installed_library():
    from textarena.envs.registration import ENV_REGISTRY

    assert list(GAMES) == [name for name in ENV_REGISTRY if not name.endswith(("-raw", "-train"))]
    assert {family(spec) for spec in RUNNABLE} <= set(SAMPLERS)


@pytest.mark.parametrize("game", ["KuhnPoker-v0", "Secretary-v0", "IteratedStagHunt-v0-randomized", "SpellingBee-v0"])
def test_global_random_state_is_neither_used_nor_changed(game):
    """The games draw from ``random``, from a function of it that they keep, or from ``numpy.random``."""
    env = TextArenaEnv(game, players=GAMES[game])
    before = random.getstate(), repr(np.random.get_state())
    dealt = env.reset(seed=1)
    move = env.sample_random_action()
    result = env.step(move)
    assert (random.getstate(), repr(np.random.get_state())) == before
    random.random()
    np.random.random()
    assert env.reset(seed=1) == dealt
    assert env.step(move) == result


@pytest.mark.parametrize(
    ("env_id", "family"), [("ta:UsedCar-v0-balanced", "UsedCar"), ("ta:Sokoban-v0", "Sokoban"), ("ta:Tak-v0", "Tak")]
)
def test_a_closed_game_says_why(env_id: str, family: str) -> None:
    with pytest.raises(MissingRequirementError, match=CLOSED[family]):
        make(env_id)


def test_without_the_extra_make_says_what_to_install(monkeypatch):
    """The ids stay listed; each says the command that brings TextArena."""
    version, find = importlib.metadata.version, importlib.util.find_spec

    def without_textarena(name):
        if name == "textarena":
            raise importlib.metadata.PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(importlib.metadata, "version", without_textarena)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "textarena" else find(name))
    with pytest.raises(MissingRequirementError, match=r"gem-games\[textarena\]"):
        make("ta:TicTacToe-v0")


def test_our_own_games_need_nothing_of_the_extra():
    """Each can be made and played where neither TextArena nor what it brings can be imported."""
    code = """
import sys
sys.modules.update(dict.fromkeys(["textarena", "nltk", "openai", "websockets"]))
import gem_core as gem
for env_id in gem.list_envs("game:*"):
    env = gem.make(env_id)
    env.reset(seed=1)
    seats = gem.spec(env_id).seats
    env.step({agent: env.sample_random_action(agent) for agent in env.acting} if seats else env.sample_random_action())
assert gem.list_envs("ta:*")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.stderr == ""


@pytest.mark.thorough
@pytest.mark.parametrize("spec", RUNNABLE if EVERY else FIRST, ids=lambda spec: spec.id)
def test_the_contract_is_kept(spec: Any) -> None:
    skip = {"valid-sample": "what is wrong is invalid"} if family(spec) in NOT_KNOWN else {}
    if EVERY:
        check_env(spec.id, skip=skip)
    else:
        check_env(spec.id, episodes=1, max_turns=3, skip={**TRIED_ELSEWHERE, **skip})


@pytest.mark.thorough
@pytest.mark.parametrize("env_id", OPEN.values())
def test_the_contract_is_kept_with_all_seats_open(env_id: str) -> None:
    check_env(env_id, episodes=1, max_turns=3, skip={"process-determinism": TRIED_ELSEWHERE["process-determinism"]})


@pytest.mark.parametrize("spec", RUNNABLE if EVERY else FIRST[::15], ids=lambda spec: spec.id)
def test_hostile_actions_are_answered(spec: Any) -> None:
    """Megabytes, broken Unicode and numbers beyond all bounds give a reward and an observation, and no error."""
    env = TextArenaEnv(**spec.kwargs)
    for action in HOSTILE:
        env.reset(seed=1)
        observation, reward, _, truncated, info = env.step(action)
        assert isinstance(observation, str)
        assert len(observation) < 50_000
        assert isinstance(reward, float)
        assert "error" not in info
        assert not truncated


def test_the_guide_names_the_closed_games() -> None:
    """And says how many run."""
    guide = (Path(__file__).parents[3] / "docs" / "textarena.md").read_text(encoding="utf-8")
    table = guide.partition("These games stay closed")[2].partition("## ")[0]
    closed = {family(spec) for spec in textarena_specs() if spec.requires != (EXTRA,)}
    assert set(CLOSED) <= closed
    named = {name.strip() for row in table.splitlines()[4:] for name in row.split("|")[1:2] for name in name.split(",")}
    assert named == closed
    assert f"{len(RUNNABLE)} of the {len(GAMES)} run offline" in guide


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


def _play(env, seed, turns=20):
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
    assert "error" not in _play(env, seed=11)
    if family(spec) in NOT_KNOWN:
        return
    if family(spec) in COMES_TO_NOTHING:
        assert len(refused) == env.table.actions.count(NO_MOVE)
    else:
        assert refused == []


@pytest.mark.parametrize("game", ["Sudoku-v0-easy", "Crosswords-v0", "Minesweeper-v0"])
def test_the_random_player_does_not_know_the_solution(game, refused):
    assert not any(_play(TextArenaEnv(game), seed=seed, turns=100)["correct"] for seed in range(5))
    assert refused or game == "Minesweeper-v0"


def test_where_nothing_is_valid_the_game_ends(refused):
    """The words of WordChains grow by a letter each, until there is none; whose turn it is then has lost."""
    env = TextArenaEnv("WordChains-v0", players=2)
    info = _play(env, seed=4, turns=40)
    assert env.table.done
    assert env.table.actions[-1] == NO_MOVE
    assert info["textarena"]["turn_count"] > 3


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
