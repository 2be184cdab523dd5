"""``HumanAgent``: a person at the terminal."""

from __future__ import annotations

from gem_core.agents.answer_form import AnswerForm
from gem_core.errors import AgentError
from gem_core.rollouts.agent import Context
from gem_core.terminal import EndOfInput, Terminal, Typed, observation_text, resolve_abbreviation
from gem_core.types import Observation

_HELP = """\
  ?         this help                              !random   play a random valid action
  !quit     end the run, as Ctrl-D does            !!text    is no command but the answer '!text'
  \"\"\" begins and ends an answer of several lines.
  'gem play' also takes turns back, and draws the board."""


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
        self._previous: dict[str | None, Context] = {}
        """The last question to each seat."""
        self._has_read = False

    def __call__(self, observation: Observation, context: Context) -> str:
        """Return what the person answers.

        Raises:
            AgentError: The input ended.
        """
        self._show(observation, context)
        try:
            return self._terminal.ask_for_answer(
                f"turn {context.turn + 1}> ", lambda typed: self._answer(typed, observation, context)
            )
        except EndOfInput:
            raise self._ended(context) from None

    def _answer(self, typed: Typed, observation: Observation, context: Context) -> str | None:
        self._has_read = True
        if not typed.is_command:
            form = AnswerForm.of_task(observation, context)
            return form.around(typed.text, [tool["function"]["name"] for tool in context.tools])
        match resolve_abbreviation(typed.text, ("help", "random", "quit")):
            case "help":
                form = AnswerForm.of_task(observation, context)
                self._terminal.show(f"{_HELP}\n  The form of an answer: {form or 'any text'}")
                return None
            case "random":
                return context.sample_random_action()
            case _:
                raise EndOfInput

    def _show(self, observation: Observation, context: Context) -> None:
        previous = self._previous.get(context.seat)
        if previous is not None and previous.transitions:
            turn = previous.transitions[-1]
            total = sum(each.reward for each in previous.transitions)
            over = turn.terminated or turn.truncated
            if over and "feedback" in previous.info:
                self._terminal.show_exactly(observation_text(previous.info["feedback"]))
            ending = ", and the episode is over" if over else ""
            self._terminal.show(f"reward {turn.reward:.4g} · return {total:.4g}{ending}", bold=True)
        self._previous[context.seat] = context
        seat = "" if context.seat is None else f" · {context.seat}"
        title = f"{context.env_id} · episode {_number(context)}{seat} · turn {context.turn + 1}"
        self._terminal.show(f"──── {title} ────", dim=True)
        self._terminal.show_exactly(observation_text(observation))

    def _ended(self, context: Context) -> AgentError:
        where = f"episode {_number(context)} of {context.env_id} waited for the answer of turn {context.turn + 1}"
        if not self._has_read and not self._terminal.interactive:
            return AgentError(
                f"the agent 'human' reads standard input, which ended while {where}; run it in a terminal"
            )
        return AgentError(f"the input ended while {where}")


def _number(context: Context) -> str:
    """Return the number of an episode, from 1, and of its repeat if it has some."""
    item, _, repeat = context.episode.partition(".")
    return f"{int(item) + 1}{f'.{int(repeat) + 1}' if context.group is not None else ''}" if item.isdigit() else item
