"""What every game for one promises, for each id under ``game:``; the rest stands in a file of its own for each game."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gem_core as gem
from gem_core.errors import ResetNeededError
from gem_core.testing import check_env

pytestmark = pytest.mark.thorough

IDS = [env_id for env_id in gem.list_envs("game") if not gem.spec(env_id).seats]
FORMAT_ERROR = {env_id: -0.2 if "WikiGame" in env_id else -0.1 for env_id in IDS}
LONGEST_FEEDBACK = 1_000  # characters
HOSTILE = [
    "",
    "\\boxed{}",
    "\\boxed{   }",
    "\\boxed{\x00}",
    "\\boxed{\x1b[2J}",
    "\\boxed{\ud800}",
    "\\boxed{" * 5_000,
    "\\boxed{{{{1}}}}",
    "\\boxed{\\boxed{1}}",
    "\\boxed{\u0661}",
    "\\boxed{\uff11 \uff12}",
    "\\boxed{\u0430}",
    "\\boxed{0 0 \u0130}",
    "\\boxed{0 0 \u00df}",
    "\\boxed{reveal \u0661 \u0662}",
    f"\\boxed{{reveal {'7' * 5_000} 1}}",
    f"\\boxed{{reveal{' ' * 5_000_000}1 1}}",
    f"\\boxed{{{'a' * 5_000_000} 1 1}}",
    f"\\boxed{{{'7' * 5_000}}}",
    f"\\boxed{{-{'7' * 5_000}}}",
    f"\\boxed{{{'9 ' * 4}}}",
    f"\\boxed{{{'9' * 5_000} 0 a}}",
    f"\\boxed{{{'1 ' * 2_500_000}}}",
    f"\\boxed{{A{' ' * 5_000_000}C}}",
    f"\\boxed{{up{' ' * 5_000_000}up}}",
    "\\boxed{<LINKS 0>}",
    "\\boxed{<LINKS 999999999999999999>}",
    f"\\boxed{{<LINKS{' ' * 1_000_000}2>}}",
    "x" * 5_000_000,
    "\\boxed{" + "x_" * 2_500_000 + "}",
]
ANSWERS = st.text("ABCabc 0123\\boxed{},-", max_size=12) | st.sampled_from(
    ["up", "Left", "reveal 0 0", "flag 1 1", "reveal 1 1", "1 1 1", "2 3 4", "0 0 0 4", "1 2 3 4", "<PREV_PAGE>"]
)


def played(env: Any, seed: int) -> list[Any]:
    """Play an episode by random actions and return all that it gave."""
    records: list[Any] = [env.reset(seed=seed)]
    while len(records) == 1 or not records[-1][2]:
        records.append(env.step(env.sample_random_action()))
    return records


@pytest.mark.parametrize("env_id", IDS)
def test_keeps_the_contract(env_id: str) -> None:
    check_env(env_id)


@pytest.mark.parametrize("env_id", IDS)
def test_random_episodes(env_id: str) -> None:
    """No sampled action is lost; observations are feedback and suffix; infos are fresh, plain JSON."""
    env = gem.make(env_id)
    for seed in range(40):
        records = played(env, seed)
        for number, record in enumerate(records):
            observation, info = record[0], record[-1]
            assert observation == info["feedback"] + info["suffix"]
            assert info == json.loads(json.dumps(info))
            if number:
                assert info["parsed_action"] is not None
                assert "The turn is lost." not in observation
                assert type(record[1]) is float
                assert ("correct" in info) is record[2]
                assert f"Turns left: {env.unwrapped.max_turns - number}." in info["suffix"] or record[2]
            info.clear()
        assert sum(record[1] for record in records[1:]) <= 1 + 1e-9


@pytest.mark.parametrize("env_id", IDS)
def test_sampling_before_the_beginning_and_after_the_end(env_id: str) -> None:
    env = gem.make(env_id)
    with pytest.raises(ResetNeededError, match="call reset"):
        env.sample_random_action()
    for seed in range(20):
        played(env, seed)
        assert re.fullmatch(r"\\boxed\{.+\}", env.sample_random_action())


@pytest.mark.parametrize("env_id", IDS)
def test_same_seed_same_episode(env_id: str) -> None:
    """Alone, after other episodes, and beside another instance; another seed gives another episode."""
    env, other = gem.make(env_id), gem.make(env_id)
    first = [played(env, seed) for seed in range(12)]
    assert [played(other, seed) for seed in reversed(range(12))] == first[::-1]
    assert len({json.dumps(records) for records in first}) == 12


@pytest.mark.parametrize("format_error_ends", [True, False])
@pytest.mark.parametrize("env_id", IDS)
def test_hostile_responses_are_answered_briefly(env_id: str, format_error_ends: bool) -> None:
    """By nothing or a format error, which may end the game; what is said stays printable. ``check_env`` times it."""
    env = gem.make(env_id, format_error_ends=format_error_ends)
    for response in HOSTILE:
        _, info = env.reset(seed=0)
        observation, reward, terminated, truncated, _ = env.step(response)
        assert len(observation) < len(info["suffix"]) + LONGEST_FEEDBACK
        assert observation.encode()
        assert "\x1b" not in observation
        assert reward in (0.0, FORMAT_ERROR[env_id])
        assert not truncated
        assert not terminated or (format_error_ends and reward == FORMAT_ERROR[env_id])


@pytest.mark.parametrize("env_id", IDS)
def test_render_draws_only_when_asked_to(env_id: str) -> None:
    env = gem.make(env_id, render_mode="ansi")
    assert env.render() == "The game has not begun."
    env.reset(seed=0)
    env.step(env.sample_random_action())
    assert re.search(r"^turn 1 of \d+ · ", re.sub(r"\x1b\[\d+m", "", str(env.render())), re.MULTILINE)
    plain = gem.make(env_id)
    plain.reset(seed=0)
    assert plain.render() is None


@given(st.sampled_from(IDS), st.integers(0, 100), st.lists(ANSWERS, max_size=30), st.booleans())
def test_rewards_stay_within_bounds(env_id: str, seed: int, answers: list[str], format_error_ends: bool) -> None:
    """Whatever is said, a game pays no less a turn than for a format error, and at most 1 in all."""
    env = gem.make(env_id, format_error_ends=format_error_ends)
    env.reset(seed=seed)
    total = 0.0
    for answer in answers:
        _, reward, terminated, truncated, _ = env.step(f"\\boxed{{{answer}}}")
        assert not truncated
        assert FORMAT_ERROR[env_id] <= reward <= 1
        total += reward
        if terminated:
            break
    assert total <= 1 + 1e-9


@pytest.mark.parametrize("format_error_ends", [True, False])
@pytest.mark.parametrize("env_id", IDS)
def test_prompt_says_what_an_unreadable_response_does(env_id: str, format_error_ends: bool) -> None:
    env = gem.make(env_id, format_error_ends=format_error_ends)
    prompt, _ = env.reset(seed=0)
    does = "ends the game" if format_error_ends else "costs a turn"
    assert prompt.count(
        f"Only the last box that can be read counts. A response without one {does}; an answer that breaks a rule costs "
        f"a turn. You have {env.unwrapped.max_turns} turns.\n"
    ) == 1  # fmt: skip
    for response in ("I give up.", "\\boxed{}", "\\boxed{ } \\boxed{"):
        env.reset(seed=0)
        assert env.step(response)[1:3] == (FORMAT_ERROR[env_id], format_error_ends)


@pytest.mark.parametrize("env_id", IDS)
def test_last_box_that_can_be_read_is_played(env_id: str) -> None:
    """Whatever boxes stand behind it: empty ones, unfinished ones, and what no game takes for an answer."""
    env = gem.make(env_id)
    env.reset(seed=0)
    action = env.sample_random_action()
    result = env.step(action)
    for behind in ("\\boxed{}", "\\boxed{ \n}", "\\boxed{", "\\boxed{} \\boxed{}"):
        env.reset(seed=0)
        assert env.step(f"No: \\boxed{{0}}. {action} I answer inside {behind}") == result


@pytest.mark.parametrize(
    ("env_id", "answer", "behind"),
    [
        ("game:GuessTheNumber-v0", "25", "\\boxed{your guess}"),
        ("game:GuessTheNumber-v0", "25", "\\boxed{\\text{final}}"),
        ("game:Mastermind-v0-easy", "1 2", "\\boxed{1, 2}"),
        ("game:TowerofHanoi-v0-easy", "A C", "\\boxed{done}"),
        ("game:Wordle-v0-hard", "house", "\\boxed{\\text{house}}"),
        ("game:Hangman-v0-easy", "e", "\\boxed{your guess}"),
        ("game:Crosswords-v0-easy", "0 3 E", "\\boxed{row col letter}"),
        ("game:WordSearch-v0-easy", "2 0 2 5", "\\boxed{2 0}"),
        ("game:Minesweeper-v0-easy", "reveal 0 1", "\\boxed{reveal}"),
        ("game:FifteenPuzzle-v0-hard", "up", "\\boxed{direction}"),
        ("game:Sudoku-v0-easy", "1 2 3", "\\boxed{1 2}"),
        ("game:Game2048-v0-easy", "left", "\\boxed{2048}"),
        ("game:Sokoban-v0-easy", "up", "\\boxed{push up}"),
    ],
)
def test_box_without_the_form_of_an_answer_is_passed_over(env_id: str, answer: str, behind: str) -> None:
    """As in gem-llm, which plays the last box that has the form of a move."""
    env = gem.make(env_id)
    env.reset(seed=0)
    result = env.step(f"\\boxed{{{answer}}}")
    env.reset(seed=0)
    assert env.step(f"\\boxed{{{answer}}}. I put it as {behind}.") == result
    assert "cannot be read" not in result[0]
