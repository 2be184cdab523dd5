"""Wrappers that disturb an agent: what each changes, what it leaves alone, and that a seed fixes it."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
from perturbed import Dice, Echo, Notebook, SlowNotebook, register

import gem_core as gem
from gem_core.env import AnyEnv, Guard
from gem_core.errors import ArgumentError
from gem_core.testing import check_tool, check_wrapper
from gem_core.tools import ToolEnv
from gem_eval.robustness.changed_tool import ChangedTool
from gem_eval.robustness.cut_outputs import CutOutputs
from gem_eval.robustness.distractors import make_distractors
from gem_eval.robustness.renamed_parameters import RenamedParameters
from gem_eval.robustness.tool_faults import Tool429, ToolTimeout
from gem_eval.robustness.wording import Paraphrase, Typos, change_prose

CALL = "<note>a long line of text</note>"


def with_tools(*tools: gem.Tool, **options: Any) -> ToolEnv:
    return ToolEnv(Guard(Dice()), list(tools) or [Notebook()], **{"max_tool_uses": None, **options})


def json_call(**arguments: Any) -> str:
    return f"<tool_call>{json.dumps({'name': 'note', 'arguments': arguments})}</tool_call>"


def played(env: AnyEnv, seed: int, actions: list[str]) -> list[Any]:
    return [env.reset(seed=seed)[0], *(env.step(action)[0] for action in actions)]


register()


PERTURBATIONS: dict[str, Callable[[AnyEnv], AnyEnv]] = {
    "tool_429": lambda env: Tool429(ToolEnv(env, [Notebook()]), rate=0.5),
    "tool_timeout": lambda env: ToolTimeout(ToolEnv(env, [Notebook()]), rate=0.5),
    "cut_outputs": lambda env: CutOutputs(ToolEnv(env, [Notebook()]), rate=0.5),
    "cut_outputs without tools": lambda env: CutOutputs(env, rate=0.5),
    "renamed_parameters": lambda env: RenamedParameters(ToolEnv(env, [Notebook()])),
    "paraphrase": lambda env: Paraphrase(env, rate=0.5),
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


def test_a_cut_output_keeps_the_calls_left_and_the_board() -> None:
    """Half of what a tool or a task returned is there, with a mark; first and last observation are whole."""
    env = CutOutputs(with_tools(max_tool_uses=4), rate=1.0)
    env.reset(seed=1)
    observation = env.step("<note>0123456789</note>")[0]
    assert observation.startswith("Output of note:\n01234\n[The output is cut off here.]\nTool calls left: 3.")
    cut, plain = CutOutputs(Guard(Dice()), rate=1.0), Guard(Dice())
    assert cut.reset(seed=1)[0] == plain.reset(seed=1)[0]
    observation, _, _, _, info = cut.step("x")
    whole = plain.step("x")[0]
    assert "[The output is cut off here.]" in observation
    assert observation == info["feedback"] + info["suffix"]
    assert observation.rpartition("\n")[2] == whole.rpartition("\n")[2]
    assert cut.step("right")[0] == plain.step("right")[0]


def test_native_results_are_cut_as_the_observation_is() -> None:
    """What a task answers under the ids of native calls is cut too."""

    class Answering(Echo):
        def step(self, action: str) -> Any:
            return "result " * 9, 0.0, False, False, {"messages": [{"role": "tool", "content": "result " * 9}]}

    env = CutOutputs(Guard(Answering()), rate=1.0)
    env.reset(seed=1)
    observation, _, _, _, info = env.step("x")
    assert info["messages"] == [{"role": "tool", "content": observation}]


def test_renamed_parameters_are_mapped_back() -> None:
    """Schema, explanation and errors have the new names; calls by them reach the tool."""
    env = RenamedParameters(with_tools(tool := Notebook()))
    observation, info = env.reset(seed=1)
    function = info["tools"][0]["function"]
    assert list(function["parameters"]["properties"]) == ["content", "times_value"]
    assert function["parameters"]["required"] == ["content"]
    assert "times_value" in env.step(json_call(content="a", times_value="many"))[0]
    assert "<note>content</note>" in observation
    assert env.step(json_call(content="a", times_value=2))[0].startswith("Output of note:\na\na\n")
    assert env.step("<note>b</note>")[0].startswith("Output of note:\na\na\nb\n")
    assert "there is no parameter 'text'; its parameters are content, times_value" in env.step(json_call(text="a"))[0]
    assert "text" in tool.parameters_schema()["properties"]


def test_a_new_name_never_hides_another_parameter() -> None:
    """A tool that has both 'text' and 'content' keeps two parameters."""

    class Both(Notebook):
        def parameters_schema(self) -> dict[str, Any]:
            return {"type": "object", "properties": {"text": {"type": "string"}, "content": {"type": "string"}}}

        def validate(self, arguments: Any) -> Any:
            return dict(arguments)

        def call(self, arguments: Any, session: Any) -> gem.ToolResult:
            return gem.ToolResult(json.dumps(arguments))

    env = RenamedParameters(with_tools(Both()))
    names = env.reset(seed=1)[1]["tools"][0]["function"]["parameters"]["properties"]
    assert not {"text", "content"} & set(names)
    said = env.step(json_call(**dict(zip(names, ("first", "second"), strict=True))))[0]
    assert '{"text": "first", "content": "second"}' in said


def test_distractors_and_changed_tools_keep_the_promises_of_tools() -> None:
    """One takes its arguments and bears hostile ones, and answers nothing of use."""
    tools = make_distractors(8)
    check_tool(tools[1], {"text": "Hello", "language": "Dutch"})
    check_tool(ChangedTool(Notebook()), {"text": "x"})
    assert len({tool.name for tool in tools}) == 8
    env = with_tools(Notebook(), *tools)
    assert [tool["function"]["name"] for tool in env.reset(seed=1)[1]["tools"]][:3] == ["note", "weather", "translate"]
    assert "No forecast is available." in env.step("<weather>Paris</weather>")[0]


def test_they_are_found_by_name_and_name_what_they_lack() -> None:
    """``make`` takes them by name; without tools the error says where to name some."""
    env = gem.make("perturbed:Dice-v0", wrappers="distractor_tools,tool_429,paraphrase,typos")
    assert [name for name, _ in env.spec.wrappers] == ["tools", "tool_429", "paraphrase", "typos"]
    for wrappers in ("tool_429", [("typos", {"rate": 2})]):
        with pytest.raises(ArgumentError):
            gem.make("perturbed:Dice-v0", wrappers=wrappers)
    gem.make("perturbed:Echo-v0", wrappers="typos,concat").reset(seed=1)
    with pytest.raises(ArgumentError):  # outside a view it would change the history
        gem.make("perturbed:Echo-v0", wrappers="concat,typos").reset(seed=1)


TASK = """You are not shown the code. Write your guess inside \\boxed{do not}, for example `do not`, at most 3 times.
The word "cannot" is not <answer>do not</answer>; see https://example.com/do not x and $do not$.
    do not indent
x = do not
```
do not
```
The end: cannot."""


def test_only_running_text_is_paraphrased() -> None:
    """Phrases are exchanged, and quotations, formulas, tags, code and fences stay to the letter."""
    env = Paraphrase(Guard(Echo()))
    env.reset(seed=1)
    expected = TASK
    for before, after in (
        ("You are not", "You aren't"),
        ("Write your", "Put your"),
        ("for example", "for instance"),
        ("at most", "no more than"),
        ('"cannot" is not', '"cannot" isn\'t'),
        ("end: cannot", "end: can't"),
    ):
        assert before in expected
        expected = expected.replace(before, after)
    assert expected in env.change(TASK)


def test_a_paraphrase_leaves_the_board_and_the_tools_alone() -> None:
    """Polite sentences stand around the task, before the explanation of the tools and the board."""
    plain, env = with_tools(), Paraphrase(with_tools())
    (before, info), (after, paraphrased) = plain.reset(seed=1), env.reset(seed=1)
    told = info["tool_instructions"]["text"]
    assert paraphrased["tool_instructions"]["text"] == told
    assert after.partition(told)[2] == before.partition(told)[2]
    assert "You can't see it, for instance 'seven'." in after
    assert after == paraphrased["feedback"] + paraphrased["suffix"]


def test_a_function_may_say_the_task_in_its_own_words() -> None:
    """It is given the task and a seed that is the episode's."""
    seen = []

    def shout(text: str, seed: int) -> str:
        seen.append(seed)
        return text.upper()

    env = Paraphrase(Guard(Echo()), function=shout)
    assert [env.reset(seed=each)[0] for each in (1, 1, 2)] == ["PLEASE SAY HELLO TO EVERYBODY IN THE ROOM."] * 3
    assert seen[0] == seen[1] != seen[2]


def test_typos_keep_the_first_and_last_letter_and_all_else() -> None:
    """Only words of small letters are changed, by exchanging two neighbours inside."""
    env = Typos(Guard(Echo()), rate=1.0)
    env.reset(seed=1)
    text = "Consider 12345 apples, Berlin and snake_case: 'letters' stay, trial too, as does \\boxed{answer}."
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
