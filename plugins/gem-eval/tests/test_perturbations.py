"""Wrappers that disturb an agent: what each changes, what it leaves alone, and that a seed fixes it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from perturbed import Dice, Echo, Notebook, SlowNotebook, register

import gem_core as gem
from gem_core.env import AnyEnv, Guard
from gem_core.errors import ArgumentError
from gem_core.testing import check_wrapper
from gem_core.tools import ToolEnv
from gem_eval.robustness.tool_faults import Tool429, ToolTimeout
from gem_eval.robustness.wording import Polite, Typos, change_prose

CALL = "<note>a long line of text</note>"


def with_tools(*tools: gem.Tool, **options: Any) -> ToolEnv:
    return ToolEnv(Guard(Dice()), list(tools) or [Notebook()], **{"max_tool_uses": None, **options})


def played(env: AnyEnv, seed: int, actions: list[str]) -> list[Any]:
    return [env.reset(seed=seed)[0], *(env.step(action)[0] for action in actions)]


register()


PERTURBATIONS: dict[str, Callable[[AnyEnv], AnyEnv]] = {
    "tool_429": lambda env: Tool429(ToolEnv(env, [Notebook()]), rate=0.5),
    "tool_timeout": lambda env: ToolTimeout(ToolEnv(env, [Notebook()]), rate=0.5),
    "polite": lambda env: Polite(env, rate=0.5),
    "typos": lambda env: Typos(env, rate=0.5),
}


@pytest.mark.few(2)
@pytest.mark.parametrize("name", PERTURBATIONS)
def test_perturbations_keep_the_contract(name: str) -> None:
    """Each is a wrapper that saves its state, spawns and repeats itself by seed."""
    check_wrapper(PERTURBATIONS[name])


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_the_task_goes_on_as_without_them(name: str) -> None:
    """What the task draws next is the same: the number on the board after each step."""
    plain, disturbed = Guard(Dice()), PERTURBATIONS[name](Guard(Dice()))
    for seed in range(5):
        boards = [
            [
                observation.partition("Thrown:")[2].partition(".")[0]
                for observation in played(env, seed, ["x", "y", "z"])
            ]
            for env in (plain, disturbed)
        ]
        assert boards[0] == boards[1]


def test_a_seed_fixes_which_calls_fail_also_in_a_fork() -> None:
    """About as many as the rate says; a fork has a counter of draws of its own, which its tools read."""
    env = ToolTimeout(with_tools(), rate=0.25)
    first, again, other = (played(env, seed, [CALL] * 200) for seed in (1, 1, 2))
    assert first == again
    assert first[1:] != other[1:]
    assert 30 < sum("did not answer within 30 s" in text for text in first) < 70
    fork = env.fork()
    went_on = [env.step(CALL)[0] for _ in range(8)]
    assert [fork.step(CALL)[0] for _ in range(8)] == went_on


@pytest.mark.parametrize("tool", [Notebook, SlowNotebook])
def test_a_call_that_fails_is_not_executed(tool: type[gem.Tool]) -> None:
    """The agent reads the error, the use counts, and nothing was written."""
    env = Tool429(with_tools(tool(), max_tool_uses=3, tool_error_reward=-1.0), rate=1.0)
    env.reset(seed=1)
    observation, reward, _, _, info = env.step(CALL)
    assert "HTTP 429" in observation
    assert "Tool calls left: 2." in observation
    assert reward == 0.0
    assert (info["tool"]["failed"], info["tool"]["fault"]) == (True, "HTTP 429, injected")
    env = Tool429(with_tools(tool()), rate=0.0)
    env.reset(seed=1)
    assert env.step(CALL)[0].startswith("Output of note:\na long line of text\n")


def test_they_are_found_by_name_and_name_what_they_lack() -> None:
    """``make`` takes them by name; without tools the error says where to name some."""
    env = gem.make("perturbed:Dice-v0", wrappers=[Notebook(), "tool_429", "polite", "typos"])
    assert [name for name, _ in env.spec.wrappers] == ["tools", "tool_429", "polite", "typos"]
    for wrappers in ("tool_429", [("typos", {"rate": 2})]):
        with pytest.raises(ArgumentError):
            gem.make("perturbed:Dice-v0", wrappers=wrappers)
    gem.make("perturbed:Echo-v0", wrappers="typos,concat").reset(seed=1)
    with pytest.raises(ArgumentError):  # outside a view it would change the history
        gem.make("perturbed:Echo-v0", wrappers="concat,typos").reset(seed=1)


def test_polite_sentences_leave_the_board_and_the_tools_alone() -> None:
    """They stand around the task, before the explanation of the tools and the board."""
    plain, env = with_tools(), Polite(with_tools())
    (before, info), (after, changed) = plain.reset(seed=1), env.reset(seed=1)
    told = info["tool_instructions"]["text"]
    assert changed["tool_instructions"]["text"] == told
    assert after.partition(told)[2] == before.partition(told)[2]
    assert "You cannot see it, for example 'seven'." in after
    assert len(after) > len(before)
    assert after == changed["feedback"] + changed["suffix"]


def test_typos_keep_the_first_and_last_letter_and_all_else() -> None:
    """Only words of small letters in running text are changed, by exchanging two neighbours inside."""
    env = Typos(Guard(Echo()), rate=1.0)
    env.reset(seed=1)
    for kept in (
        "    indented lines",
        "x = apples",
        "```\napples\n```",
        "<answer>apples</answer> $apples$",
        "a/apples",
    ):
        assert env.change(kept) == kept
    text = "Consider 12345 apples, Berlin and snake_case: 'letters' stay, as does \\boxed{answer}."
    words = [(one, other) for one, other in zip(text.split(), env.change(text).split(), strict=True) if one != other]
    assert [one for one, _ in words] == []  # an underscore makes the line code
    text = text.replace("snake_case", "camelCase")
    words = [(one, other) for one, other in zip(text.split(), env.change(text).split(), strict=True) if one != other]
    assert [one for one, _ in words] == ["apples,"]
    assert all(sorted(one) == sorted(other) and one[0] == other[0] for one, other in words)


def test_a_long_line_takes_no_long_time() -> None:
    """A long run without a blank, of quotes or of tags is read once."""
    for piece in ("a", '"', "<a>", "a.", "\\a{", "'", "$ "):
        text = piece * (200_000 // len(piece))
        assert change_prose(text, lambda prose: prose) == text
