"""The study of rewards: its task, the player that is imitated, and a tiny run."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import gem_core as gem
from gem_core.rollouts import Context
from gem_core.testing import check_env
from gem_train.players import tool_player

pytest.importorskip("torch")

from gem_train.studies import rewards

RESULT = "Output of python:\n{}\nTool calls left: 2. Call a tool again, or give your answer.\n"


def said(question: str, result: str | None = None) -> Counter[str]:
    """Return how often the player says what, in 1,000 episodes."""
    shown = question if result is None else RESULT.format(result)
    conversation = f"{question}\n<python>…</python>\n{shown}" if result else question
    turn = 0 if result is None else 1
    return Counter(
        tool_player(
            conversation,
            Context(f"{episode}.0", rewards.ENV_ID, None, turn, {"seed": 3}, [], [], read_observation=lambda: shown),
        )
        for episode in range(1000)
    )


def test_player_uses_the_tool_three_times_in_ten() -> None:
    """It does so for sums and for products; without it, it knows sums and no product."""
    sums, products = said("What is 5 + 7?"), said("What is 17 * 23?")
    assert sums["<python>5 + 7</python>"] == pytest.approx(300, abs=50)
    assert products["<python>17 * 23</python>"] == pytest.approx(300, abs=50)
    assert sums["\\boxed{12}"] == pytest.approx(700 * (0.9 + 0.1 / 7), abs=50)
    assert products["\\boxed{391}"] < 20
    assert set(sums) == {"<python>5 + 7</python>", *(f"\\boxed{{{answer}}}" for answer in range(9, 16))}


def test_player_answers_what_the_tool_said() -> None:
    """Four times in five; else it runs the same code again."""
    answers = said("What is 17 * 23?", "391")
    assert set(answers) == {"\\boxed{391}", "<python>17 * 23</python>"}
    assert answers["\\boxed{391}"] == pytest.approx(800, abs=50)


def test_task_keeps_the_contract() -> None:
    """It is a data set of sums and products, about as many of each."""
    assert check_env(rewards.ENV_ID).broken == {}
    questions = [row["question"] for row in gem.spec(rewards.ENV_ID).kwargs["rows"]]
    signs = Counter(question.split()[3] for question in questions)
    assert signs == {"+": 405, "*": 400}


def test_player_solves_products_with_the_tool() -> None:
    """The answer of the real tool is read, and what is answered is right."""
    pytest.importorskip("gem_tools")
    with gem.make_vec(rewards.ENV_ID, 8, wrappers=rewards.WRAPPERS, seed=0) as vec:
        episodes = list(gem.rollout(vec, tool_player, episodes=40))
    used = [episode for episode in episodes if len(episode.transitions) > 1]
    assert len(used) > 5
    assert {episode.success for episode in used} == {True}


@pytest.mark.thorough
def test_study_runs_from_imitation_to_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the smallest size, on one seed."""
    pytest.importorskip("gem_tools")
    options_of = rewards.options_of
    tiny: dict[str, Any] = {"updates": 1, "episodes": 4, "eval_episodes": 12, "width": 8, "heads": 2}
    tiny |= {"imitate_episodes": 12, "imitate_steps": 2}
    monkeypatch.setattr(rewards, "options_of", lambda *given: replace(options_of(*given), **tiny))
    rows = rewards.run(tmp_path, quick=True, seeds=1, workers=1, quiet=True)
    assert [(row["setting"], row["questions"]) for row in rows] == [
        (setting, kind)
        for setting in ("REINFORCE, 0 and 1", "REINFORCE, -1 and 1", "ReBN, 0 and 1")
        for kind in ("sums", "products")
    ]
    assert len(list(tmp_path.glob("start-*.pt"))) == 1, "settings share the warm start"
    assert {path.name for path in tmp_path.glob("*.png")} == {"success.png", "with_tool.png", "calls.png"}
    assert "Python tool" in (tmp_path / "index.html").read_text(encoding="utf-8")
