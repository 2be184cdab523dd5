"""TextArena's games keep the contract of environments: one of each family by default, every id when asked for.

``GEM_EVERY_TEXTARENA_GAME=1`` tries all ids with all promises, which takes some minutes.
"""

from __future__ import annotations

import os
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gem_core.testing import check_env
from gem_games.textarena.env import TextArenaEnv
from gem_games.textarena.games import GAMES
from gem_games.textarena.listing import EXTRA, textarena_specs

pytestmark = pytest.mark.thorough

EVERY = bool(os.environ.get("GEM_EVERY_TEXTARENA_GAME"))
RUNNABLE = {spec.id: spec for spec in textarena_specs() if spec.requires == (EXTRA,) and not spec.seats}
FAMILIES = list({env_id.partition("-")[0]: env_id for env_id in reversed(RUNNABLE)}.values())[::-1]
OPEN = {spec.id.partition("-")[0]: spec.id for spec in textarena_specs() if spec.requires == (EXTRA,) and spec.seats}
TRIED_ELSEWHERE = {
    "process-determinism": "test_textarena.py tries it for all games in one other process",
    "hostile-actions": "test_hostile_actions_are_answered tries some",
}
HOSTILE = [
    "",
    "[" * 1_000_000,
    "[1 " * 300_000,
    " " * 1_000_000,
    "9" * 1_000_000,
    "[" + "9" * 3_000 + "]",
    "[1]" * 300_000,
    "\ud800[\udfff]",
    "\x00[\x00]",
    "[\u0661]",
    "[\u00b2]",
    "[9**9**9**9]",
    "[-1 -1]",
    "[1 1 99999999999999]",
    "[Offer: 99999999999999 Wood -> 1 Wheat]",
]


@pytest.mark.parametrize("env_id", list(RUNNABLE) if EVERY else FAMILIES)
def test_the_contract_is_kept(env_id: str) -> None:
    unknown = env_id[3:].partition("-")[0] in ("Crosswords", "Minesweeper", "Sudoku")
    skip = {"valid-sample": "TextArena takes what is wrong for an invalid move"} if unknown else {}
    if EVERY:
        check_env(env_id, skip=skip)
    else:
        check_env(env_id, episodes=1, max_turns=3, skip={**TRIED_ELSEWHERE, **skip})


@pytest.mark.parametrize("env_id", OPEN.values())
def test_the_contract_is_kept_with_all_seats_open(env_id: str) -> None:
    check_env(env_id, episodes=1, max_turns=3, skip={"process-determinism": TRIED_ELSEWHERE["process-determinism"]})


@pytest.mark.parametrize("env_id", list(RUNNABLE) if EVERY else FAMILIES[::6])
def test_hostile_actions_are_answered(env_id: str) -> None:
    """Megabytes, broken Unicode and numbers beyond all bounds give a reward and an observation, and no error."""
    env = TextArenaEnv(**RUNNABLE[env_id].kwargs)
    for action in HOSTILE:
        env.reset(seed=1)
        observation, reward, _, truncated, info = env.step(action)
        assert isinstance(observation, str)
        assert len(observation) < 50_000
        assert isinstance(reward, float)
        assert "error" not in info
        assert not truncated


def played(env: TextArenaEnv, seed: int, actions: list[str]) -> Any:
    """Begin an episode, and give a result for each action; a generator, so that others can play in between."""
    yield env.reset(seed=seed)[0]
    for action in actions:
        result = env.step(action)[:4]
        yield result
        if result[2] or result[3]:
            return


def test_games_do_not_disturb_each_other() -> None:
    """Two of each family are played turn about with all others, and with code that draws from the global generators."""
    alone, asked = {}, {}
    for env_id in FAMILIES:
        for seed in (3, 4):
            env = TextArenaEnv(**RUNNABLE[env_id].kwargs)
            log: list[Any] = [env.reset(seed=seed)[0]]
            actions: list[str] = []
            while len(actions) < 2 and not (len(log) > 1 and (log[-1][2] or log[-1][3])):
                actions.append(env.sample_random_action())
                log.append(env.step(actions[-1])[:4])
            alone[env_id, seed], asked[env_id, seed] = log, actions
    together: dict[Any, list[Any]] = {key: [] for key in asked}
    games = {
        key: played(TextArenaEnv(**RUNNABLE[key[0]].kwargs), key[1], actions)
        for key, actions in sorted(asked.items(), reverse=True)
    }
    expected, expected_numpy = random.Random(5), np.random.RandomState(5)
    ours, ours_numpy = random.getstate(), np.random.get_state()
    random.setstate(expected.getstate())
    np.random.set_state(expected_numpy.get_state())
    try:
        while games:
            for key in list(games):
                try:
                    together[key].append(next(games[key]))
                except StopIteration:
                    del games[key]
                assert random.random() == expected.random()
                assert np.random.random() == expected_numpy.random()
    finally:
        random.setstate(ours)
        np.random.set_state(ours_numpy)
    assert together == alone


def test_every_family_is_tried() -> None:
    """All that TextArena registers, but for the closed ones."""
    families = {name.partition("-")[0] for name in GAMES}
    assert families - {env_id[3:].partition("-")[0] for env_id in FAMILIES} == {
        spec.id[3:].partition("-")[0] for spec in textarena_specs() if spec.requires != (EXTRA,)
    }


def test_the_guide_names_the_closed_games() -> None:
    """And says how many run."""
    guide = (Path(__file__).parents[3] / "docs" / "textarena.md").read_text(encoding="utf-8")
    table = guide.partition("These games stay closed")[2].partition("## ")[0]
    closed = {spec.id[3:].partition("-")[0] for spec in textarena_specs() if spec.requires != (EXTRA,)}
    named = {name.strip() for row in table.splitlines()[4:] for name in row.split("|")[1:2] for name in name.split(",")}
    assert named == closed
    assert f"{len(RUNNABLE)} of the {len(GAMES)} run offline" in guide
