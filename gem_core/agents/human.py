r"""``HumanAgent``: a person at the terminal; ``AnswerForm``: why they may type just ``25`` for ``\boxed{25}``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Self

from gem_core.errors import AgentError, SamplingNotSupported
from gem_core.rollouts.agent import Context
from gem_core.terminal import BLOCK, Terminal, observation_text
from gem_core.types import Observation

_HELP = f"""\
  ?         this help
  !random   play a random valid action
  !quit     end the run, as Ctrl-D does
  {BLOCK} on a line of its own begins and ends an answer of several lines."""

_FORMS = [
    re.compile(pattern, re.DOTALL)
    for pattern in (
        r".*(```[^\n`]*\n).*(\n```)\s*",
        r".*(<([A-Za-z][\w-]*)>\\boxed\{).*(\}</\2>)\s*",
        r".*(<([A-Za-z][\w-]*)>).*(</\2>)\s*",
        r".*(\\boxed\{).*(\}).*",
    )
]
"""What stands before and behind the answer of an example: a fenced block, a box in a tag, a tag, a box."""

_IN_A_FORM = re.compile(r"\A\s*(?:<[A-Za-z]|```|~~~)|\\boxed|<answer>")


@dataclass(frozen=True)
class AnswerForm:
    r"""What stands around an answer, as ``\boxed{`` and ``}``; nothing where any text will do.

    Args:
        opening: What stands before the answer.
        closing: What stands after the answer.
    """

    opening: str = ""
    closing: str = ""

    @classmethod
    def of_task(cls, observation: Observation, context: Context) -> Self:
        """Return the form of a valid action in the present state; without one, the form that the task's words name."""
        try:
            return cls.of_example(context.sample_random_action())
        except SamplingNotSupported:
            told = observation_text(context.transitions[0].observation if context.transitions else observation)
            return cls.of_example("\\boxed{}" if "\\boxed{" in told else "<answer></answer>" * ("<answer>" in told))

    @classmethod
    def of_example(cls, example: str) -> Self:
        """Return the form of a valid action; none if it calls a tool."""
        found = (pattern.fullmatch(example) for pattern in _FORMS if "<tool_call>" not in example)
        form = next((match for match in found if match), None)
        return cls() if form is None else cls(form[1], form[form.re.groups])

    def __str__(self) -> str:
        return f"{self.opening}…{self.closing}" if self.opening else "any text"

    def around(self, answer: str) -> str:
        """Return an answer in this form; one with a tag, a fenced block or a box of its own is left alone."""
        if not self.opening or self.opening in answer or _IN_A_FORM.search(answer):
            return answer
        return f"{self.opening}{answer}{self.closing}"


class HumanAgent:
    """Shows each observation to the letter, on standard error, and reads the response from standard input.

    A plain answer is put into the form that the environment expects, as ``gem play`` does.
    """

    interactive = True
    """Whether it answers one episode at a time, and shares the terminal with no progress bar."""

    reads = "observation"
    """The observation alone, since the earlier turns are still in the terminal."""

    def __init__(self) -> None:
        self._terminal = Terminal(err=True)
        self._asked: dict[str | None, Context] = {}
        """The last question to each seat."""

    def __call__(self, observation: Observation, context: Context) -> str:
        """Return what the person answers.

        Raises:
            AgentError: The input ended.
        """
        item, _, repeat = context.episode.partition(".")
        number = str(int(item) + 1) if item.isdigit() else item
        episode = f"episode {number}.{int(repeat) + 1}" if context.group is not None else f"episode {number}"
        show = self._terminal.show
        before = self._asked.get(context.seat)
        if before is not None and before.transitions:
            last = before.transitions[-1]
            ending = ", and the episode is over" if last.terminated or last.truncated else ""
            total = sum(each.reward for each in before.transitions)
            show(f"reward {last.reward:.4g} · return {total:.4g}{ending}", "bold")
        self._asked[context.seat] = context
        seat = "" if context.seat is None else f" · {context.seat}"
        show(f"──── {context.env_id} · {episode}{seat} · turn {context.turn + 1} ────", "dim")
        self._terminal.show_exactly(observation_text(observation))

        def explain() -> None:
            show(f"{_HELP}\n  The form of an answer: {AnswerForm.of_task(observation, context)}")

        commands = {"help": explain, "random": context.sample_random_action}
        try:
            answer = self._terminal.ask(f"turn {context.turn + 1}> ", commands)
        except EOFError:
            raise AgentError(
                f"the agent 'human' reads standard input, which ended while {episode} of {context.env_id} waited for "
                f"the answer of turn {context.turn + 1}; run it in a terminal"
            ) from None
        return AnswerForm.of_task(observation, context).around(answer)
