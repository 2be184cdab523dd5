"""TextArena: the table of ids, the fence, and that episodes are the same in another process."""

from __future__ import annotations

import copy
import importlib.metadata
import json
import os
import pickle
import random
import subprocess
import sys

import numpy as np
import pytest

from gem_core import make
from gem_core.errors import ArgumentError, MissingRequirementError
from gem_games.textarena.env import TextArenaEnv
from gem_games.textarena.games import GAMES
from gem_games.textarena.listing import EXTRA, textarena_specs

RUNNABLE = [spec for spec in textarena_specs() if spec.requires == (EXTRA,) and not spec.seats]
_EPISODES = """
import json, sys
from gem_games.textarena.env import TextArenaEnv
logs = {}
for kwargs, actions in json.load(sys.stdin):
    env = TextArenaEnv(**kwargs)
    logs[kwargs["game"]] = [env.reset(seed=7)[0], *(list(env.step(action)[:4]) for action in actions)]
print(json.dumps(logs))
"""


def test_the_table_matches_the_installed_library():
    from textarena.envs.registration import ENV_REGISTRY

    assert list(GAMES) == [name for name in ENV_REGISTRY if not name.endswith(("-raw", "-train"))]


@pytest.mark.thorough
def test_each_runnable_game_is_the_same_in_another_process():
    """With another hash seed the same actions give the same observations and rewards; nothing is an error."""
    logs, asked = {}, []
    for spec in RUNNABLE:
        env = TextArenaEnv(**spec.kwargs)
        observation, info = env.reset(seed=7)
        log, actions = [observation], []
        while len(actions) < 2:
            actions.append(env.sample_random_action())
            *result, info = env.step(actions[-1])
            log.append(result)
            assert "error" not in info, (spec.id, info)
            if result[2] or result[3]:
                break
        logs[spec.kwargs["game"]] = log
        asked.append((dict(spec.kwargs), actions))
    done = subprocess.run(
        [sys.executable, "-c", _EPISODES],
        input=json.dumps(asked),
        env={**os.environ, "PYTHONHASHSEED": "12345"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(done.stdout) == json.loads(json.dumps(logs))


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


def test_a_state_goes_on_in_another_instance():
    one = TextArenaEnv("ConnectFour-v0", players=2)
    one.reset(seed=3)
    one.step(one.sample_random_action())
    other = one.fork()
    move = one.sample_random_action()
    assert other.step(move)[:4] == one.step(move)[:4]


def test_a_callable_plays_the_other_seat():
    """The opponent is asked with what its own seat sees."""
    asked = []

    def opponent(observation):
        asked.append(observation)
        return "[4]"

    env = TextArenaEnv("TicTacToe-v0", players=2, seat=1, opponents=opponent)
    env.reset(seed=1)
    assert len(asked) == 1
    assert asked[0]


@pytest.mark.parametrize("action", ["", "[", "]" * 100_000, "\ud800", "\x00", "[" * 50_000, "[999999999999 -1]"])
@pytest.mark.parametrize("game", ["TicTacToe-v0", "Wordle-v0", "Chess-v0"])
def test_any_text_is_answered(game, action):
    env = TextArenaEnv(game, players=GAMES[game])
    env.reset(seed=1)
    observation, reward, _, _, info = env.step(action)
    assert isinstance(observation, str)
    assert isinstance(reward, float)
    assert "error" not in info


def test_a_closed_game_says_why():
    with pytest.raises(MissingRequirementError) as caught:
        make("ta:UsedCar-v0-balanced")
    assert str(caught.value) == (
        "ta:UsedCar-v0-balanced cannot run here: textarena 0.7.4 registers it without its module"
    )


def test_without_the_extra_make_says_what_to_install(monkeypatch):
    """The ids stay listed; each says the command that brings TextArena."""
    version = importlib.metadata.version

    def without_textarena(name):
        if name == "textarena":
            raise importlib.metadata.PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(importlib.metadata, "version", without_textarena)
    with pytest.raises(MissingRequirementError) as caught:
        make("ta:TicTacToe-v0")
    assert str(caught.value) == (
        "ta:TicTacToe-v0 cannot run here: it needs an extra of gem-games: 'pip install \"gem-games[textarena]\"'"
    )


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


def test_a_seat_that_is_not_there_is_refused():
    with pytest.raises(ArgumentError) as caught:
        TextArenaEnv("TicTacToe-v0", players=2, seat=2)
    assert str(caught.value) == "seat must be a whole number from 0 to 1, not 2"


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"])
@pytest.mark.parametrize(
    ("env_id", "kwargs"), [("ta:TicTacToe-v0", {}), ("ta:TwentyQuestions-v0", {"judge": "random"})]
)
def test_a_copy_plays_a_game_of_its_own(env_id, kwargs, copied):
    """It goes on as the original would have, and leaves that as it is."""
    env = make(env_id, **kwargs)
    env.reset(seed=3)
    env.step(env.sample_random_action())
    other = copied(env)
    refused = other.step("neither a move nor a question" if kwargs else "[9 9]")
    assert env.unwrapped.table.refused == env.unwrapped.table.invalid == 0
    assert env.step("neither a move nor a question" if kwargs else "[9 9]")[:4] == refused[:4]
