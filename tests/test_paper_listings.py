"""The two listings of the GEM paper (arXiv:2510.01051) run with only their import lines changed."""

from __future__ import annotations

import random
import string
from typing import Any

import pytest

import gem_core as gem
from gem_core import TERMINAL_STATE, Env, extract_last_boxed_answer, make, register


def test_interaction_loop_runs() -> None:
    """The interaction loop plays an episode of GuessTheNumber to its end."""
    pytest.importorskip("gem_games", reason="the loop plays a game of the plugin gem-games")
    env = gem.make("game:GuessTheNumber-v0")
    observation, info = env.reset()
    turns = 0
    while True:
        action = env.sample_random_action()  # type: ignore[attr-defined]
        next_observation, reward, terminated, truncated, info = env.step(action)
        observation = next_observation
        turns += 1
        if terminated or truncated:
            break
    assert 1 <= turns <= 10
    assert isinstance(observation, str)
    assert isinstance(reward, float)
    assert isinstance(info, dict)


class ReverseStringEnv(Env):
    """The paper's environment to the letter: it draws from global random and ends with both flags."""

    def __init__(self, str_len: int = 5):
        super().__init__()
        self.str_len = str_len

    def _get_instructions(self):
        return (
            "You are tasked to reverse a given string.\n"
            "You may provide your response in any manner. Only the content wrapped inside \\boxed{} will be considered "
            "as your final answer.\n"
            f"Please reverse the string: {self.gt_str}.\n"
        )

    def reset(self, seed=None):
        super().reset(seed)
        characters = string.ascii_letters + string.digits
        self.gt_str = "".join(random.choices(characters, k=self.str_len))
        return self._get_instructions(), {}

    def step(self, action):
        clean_action = extract_last_boxed_answer(action)
        if clean_action is None:  # noqa: SIM108 - the paper writes it so
            reward = 0
        else:
            reward = float(clean_action[::-1] == self.gt_str)
        return TERMINAL_STATE, reward, True, True, {}


@pytest.fixture
def env(own_registry: Any) -> Any:
    """The paper's environment, registered and made by id."""
    register("custom:ReverseString", ReverseStringEnv)
    return make("custom:ReverseString")


def test_reverse_string_is_solved(env: Any) -> None:
    """The hidden string is readable on the made environment, and its reverse is rewarded."""
    observation, _ = env.reset()
    assert env.gt_str in observation
    assert env.step(f"It is \\boxed{{{env.gt_str[::-1]}}}.")[1:4] == (1.0, True, True)
    longer: Any = make("custom:ReverseString", str_len=9)
    longer.reset()
    assert len(longer.gt_str) == 9


@pytest.mark.parametrize("action", ["", "\\boxed{}", "\\boxed{no}", "abc", "\\boxed{"])
def test_reverse_string_wrong_answer_gets_nothing(env: Any, action: str) -> None:
    """A wrong or missing answer ends the episode without a reward."""
    env.reset(seed=3)
    assert env.step(action)[:4] == (TERMINAL_STATE, 0.0, True, True)
