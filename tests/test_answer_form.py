"""The form of answers, found out from an example, and what is left alone."""

from __future__ import annotations

import pytest

from gem_core.agents.answer_form import AnswerForm


@pytest.mark.parametrize(
    ("example", "typed", "sent"),
    [
        (r"\boxed{3}", "25", r"\boxed{25}"),
        (r"I guess \boxed{1 2}.", "3 4", r"\boxed{3 4}"),
        ("<answer>yes</answer>", "no", "<answer>no</answer>"),
        ("<think>hm</think><answer>yes</answer>\n", "no", "<answer>no</answer>"),
        (r"<answer>\boxed{1}</answer>", "2", r"<answer>\boxed{2}</answer>"),
        ("```python\nprint(1)\n```", "print(2)", "```python\nprint(2)\n```"),
        ("so:\n```\nls\n```", "pwd", "```\npwd\n```"),
        ("[A]", "[B]", "[B]"),
        ("go</north>", "go", "go"),
        ("", "anything", "anything"),
    ],
)
def test_an_answer_is_put_into_the_form_of_the_example(example: str, typed: str, sent: str) -> None:
    """A box, a tag, a box in a tag, a fenced block, or nothing."""
    assert AnswerForm.of_example(example).around(typed) == sent


@pytest.mark.parametrize(
    ("example", "typed"),
    [
        (r"\boxed{3}", r"it is \boxed{4}"),
        (r"\boxed{3}", r"\boxed{4"),
        (r"\boxed{3}", "<answer>4</answer>"),
        ("<answer>3</answer>", r"\boxed{4}"),
        ("<move>3</move>", "<move>4"),
        ("```python\n1\n```", "```python\n2\n```"),
        ("```python\n1\n```", "~~~\n2\n~~~"),
        ('<tool_call>{"name": "search"}</tool_call>', "Hello."),  # an example that calls a tool shows no form
    ],
)
def test_what_is_in_a_form_already_is_left_alone(example: str, typed: str) -> None:
    """Also where the form is begun and not complete: the environment has to see the mistake."""
    assert AnswerForm.of_example(example).around(typed) == typed


@pytest.mark.parametrize(
    "call", ['<tool_call>{"name": "search"}</tool_call>', "<search>gem</search>", "```python\n1\n```"]
)
def test_a_tool_call_is_left_alone(call: str) -> None:
    """Where there are tools."""
    form = AnswerForm.of_example(r"\boxed{3}")
    assert form.around(call, ["search", "python"]) == call
    assert form.around(call) == f"\\boxed{{{call}}}"


def test_the_form_is_read_from_the_words_of_a_task() -> None:
    """For an environment that cannot give an example."""
    assert str(AnswerForm.of_instructions(r"Answer inside \boxed{}.")) == r"\boxed{…}"
    assert str(AnswerForm.of_instructions("Write <answer>…</answer>.")) == "<answer>…</answer>"
    assert not AnswerForm.of_instructions("Say something.")


@pytest.mark.parametrize("typed", ["<finish/>", ' <keys wait="3">q</keys>'])
def test_an_action_in_another_tag_is_left_alone(typed: str) -> None:
    """A task may have several, as a terminal's."""
    assert AnswerForm("<bash>", "</bash>").around(typed) == typed
    assert AnswerForm("<bash>", "</bash>").around("echo <b>") == "<bash>echo <b></bash>"
