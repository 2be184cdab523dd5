"""A game of a third party, written from the documentation of ``Game`` alone."""

from __future__ import annotations

import importlib
import inspect
import sys
import textwrap
from pathlib import Path

import pytest

import gem_core as gem
from gem_games.game import Game


@pytest.fixture
def game(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> type[Game]:
    """The class that the docstring of ``Game`` shows, in a module of its own."""
    shown = inspect.cleandoc(Game.__doc__ or "").partition("For example::\n")[2].partition("\nArgs:")[0]
    (tmp_path / "gem_own_game.py").write_text(textwrap.dedent(shown), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "gem_own_game", raising=False)
    found: type[Game] = importlib.import_module("gem_own_game").ParityEnv
    return found


def test_the_documented_game_is_won_lost_and_drawn(game: type[Game]) -> None:
    """Its rules, its verdicts and its picture."""
    gem.register("own:Parity-v0", game)
    env = gem.make("own:Parity-v0", render_mode="ansi")
    observation, _ = env.reset(seed=1)
    assert observation == (
        "A hidden number from 1 to 100 is even or odd: say which.\nOnly the last box that can be read counts. "
        "A response without one ends the game; an answer that breaks a rule costs a turn. You have 3 turns.\n\n"
        "Turns left: 3. Answer \\boxed{even} or \\boxed{odd}."
    )
    assert "turn 0 of 3" in str(env.render())
    right = "odd" if env.unwrapped.number % 2 else "even"
    assert env.step("\\boxed{neither}")[0].startswith("'neither' is neither even nor odd. The turn is lost.")
    assert env.step(f"\\boxed{{{right}}}")[1:3] == (1.0, True)
    env.reset(seed=1)
    for _ in range(2):
        assert not env.step("\\boxed{neither}")[2]
    lost = env.step("\\boxed{neither}")
    assert (lost[1:3], lost[4]["correct"]) == ((0.0, True), False)
    assert f"It was {env.unwrapped.number}." in lost[0]
