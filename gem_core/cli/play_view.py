"""``PlayView``: shows an episode in the terminal, laid out for a person or exactly as a model gets it."""

from __future__ import annotations

import textwrap
from typing import Any

import click

from gem_core.agents.answer_form import AnswerForm
from gem_core.cli.layout import counted
from gem_core.env.base import Env
from gem_core.env.observations import split_observation
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import SamplingNotSupported
from gem_core.records.episode import Episode, Transition
from gem_core.records.plain_json import ImageFolder
from gem_core.rollouts.agent import Context
from gem_core.terminal import BLOCK, Terminal, observation_text, printable
from gem_core.types import TERMINAL_STATE, Info, Observation

_LONGEST_ACTION = 60

KEYS = f"""\
  ?          this help
  !undo      take the last turn back
  !random    play a random valid action
  !restart   begin this episode again
  !next      leave it, begin the next
  !quit      end, as Ctrl-D does
  Commands may be cut short, as in !u. An answer that begins with ! is typed with two.
  A line that ends in a backslash goes on in the next; {BLOCK} begins and ends a block of lines.
"""


class PlayView:
    """Shows episodes.

    Args:
        env: What is played.
        terminal: Where it is shown.
        exact: Show observations to the letter, as a model gets them.
        raw: Whether answers are sent as they are typed.
        summary: Of the environment.
        images: Folder into which images are written; None only tells their size.
    """

    def __init__(
        self,
        env: AnyEnv,
        terminal: Terminal,
        *,
        exact: bool,
        raw: bool,
        summary: str = "",
        images: ImageFolder | None = None,
    ) -> None:
        self.number = 0
        """Number of the present episode, from 1."""
        self.began = False
        """Whether there is anything to show yet."""
        self.tools: list[str] = []
        """Names of the tools that may be called."""
        self._env = env
        self._terminal = terminal
        self._exact = exact
        self._raw = raw
        self._summary = summary
        self._images = images
        self._context: Context
        self._over = False

    # An episode.

    def see(self, observation: Observation, context: Context) -> None:
        """Remember the observation that is to be answered."""
        self.began, self._over = True, False
        self._observation, self._context = observation, context
        if context.turn == 0:
            self._rules, _ = split_observation(observation, context.info)
            self.tools = [tool["function"]["name"] for tool in context.tools]

    def form(self) -> AnswerForm:
        """Return the form that answers have in the present state."""
        return AnswerForm.of_task(self._observation, self._context)

    def opening(self) -> None:
        """Show the beginning of the present episode."""
        show = self._terminal.show
        show()
        show(f"{self._context.env_id} · episode {self.number}", bold=True)
        if self._summary and self.number == 1:
            show(self._summary, dim=True)
        form = AnswerForm() if self._raw else self.form()
        as_it_is = "An answer is sent as you type it."
        show(f"{f'An answer is sent as {in_one_line(str(form))}.' if form else as_it_is} Type ? for help.", dim=True)
        self._show_system()
        self.situation()

    def situation(self) -> None:
        """Show the present observation."""
        self._show_observation(self._observation, self._context.info, f"turn {self._context.turn + 1}")

    def turn(self) -> None:
        """Show the result of the last turn."""
        self._result(self._context.transitions)
        self.situation()

    def ending(self, episode: Episode, taken_back: int, *, can_undo: bool) -> None:
        """Show the last turn, and say how the episode ended.

        Args:
            episode: That is over.
            taken_back: Number of turns that were taken back.
            can_undo: Whether the last one can be.
        """
        self._over = True
        self._result(episode.transitions)
        self._show_observation(episode.final_observation, episode.final_info, "after the last turn")
        show = self._terminal.show
        colour = "yellow" if episode.success is None else "green" if episode.success else "red"
        show(ending_of(episode), bold=True, fg=colour)
        if taken_back:
            show(f"Turns taken back, which are in no record: {taken_back}.", dim=True)
        if self._terminal.interactive and can_undo:
            show("!undo takes the last turn back.", dim=True)

    def farewell(self, episodes: list[Episode], path: str | None, again: str) -> None:
        """Say what was played, what was left unfinished, where the rest was written, and how to play it again."""
        show = self._terminal.show
        if not self._over:
            left = f"after {counted(self._context.turn, 'turn')}, return {_number(_return(self._context.transitions))}"
            show(f"Left unfinished {left}{'; it is not recorded' if path else ''}.", fg="yellow")
        if len(episodes) > 1:
            verdicts = [episode.success for episode in episodes if episode.success is not None]
            solved = f", {sum(verdicts)} won" if verdicts else ""
            mean = sum(episode.episode_return for episode in episodes) / len(episodes)
            show(f"{len(episodes)} episodes{solved}, mean return {_number(mean)}.")
        if path and episodes:
            show(f"{counted(len(episodes), 'episode')} written to {path}.")
        elif path:
            show("No episode was finished, and no file written.")
        show(f"The same again: {again}", dim=True)

    def help(self) -> None:
        """Show the keys, the rules and an example of an action."""
        show = self._terminal.show
        show(KEYS.rstrip("\n"))
        if self.tools:
            show(f"  Tools: {', '.join(self.tools)}. A call is sent as you type it.")
        show(f"  {self._example()}")
        self._show_system()
        show()
        self._terminal.show_plainly(self._text(self._rules))

    def _example(self) -> str:
        # An answer drawn from a data set may be the right one.
        form, task = self.form(), self._env.unwrapped
        if form and isinstance(task, Env) and task.num_tasks is not None:
            return f"The form of an answer: {in_one_line(str(form))}"
        try:
            return f"A valid action, for example: {in_one_line(self._context.sample_random_action())}"
        except SamplingNotSupported:
            return f"The form of an answer: {in_one_line(str(form)) if form else 'any text'}"

    # Turns and observations.

    def _result(self, transitions: list[Transition]) -> None:
        turn = transitions[-1]
        colour = "green" if turn.reward > 0 else "red" if turn.reward < 0 else None
        reward = f"reward {_number(turn.reward)}"
        self._terminal.show(
            f"turn {len(transitions)} · {in_one_line(turn.action)} · "
            f"{click.style(reward, fg=colour, bold=True) if colour else reward} · "
            f"return {_number(_return(transitions))}",
            **({} if self._exact else {"bold": True}),
        )

    def _show_system(self) -> None:
        """Show what a model is told first, as the part that it plays."""
        if self._context.system:
            self._terminal.show()
            self._terminal.show_plainly(self._text(self._context.system))

    def _show_observation(self, observation: Observation, info: Info, title: str) -> None:
        if not self._exact:
            self._show_laid_out(observation, info)
            return
        self._terminal.show(f"──── {title} ".ljust(40, "─"), dim=True)
        self._terminal.show_exactly(self._text(observation))
        self._terminal.show("─" * 40, dim=True)

    def _text(self, observation: Observation) -> str:
        images = self._images
        save_image = None if images is None else lambda image: images.path / images.write(image)
        return observation_text(observation, save_image)

    def _show_laid_out(self, observation: Observation, info: Info) -> None:
        feedback, suffix = split_observation(observation, info)
        # The board shows a person what the suffix tells a model.
        board = self._board() if suffix else ""
        show = self._terminal.show
        if feedback and feedback != TERMINAL_STATE:
            show()
            self._terminal.show_plainly(self._text(feedback).strip("\n"))
        if board:
            show()
            self._terminal.show_drawing(textwrap.indent(board.strip("\n"), "  "))
        elif suffix:
            show()
            self._terminal.show_plainly(self._text(suffix).strip("\n"))
        show()

    def _board(self) -> str:
        env = self._env
        if env.render_mode != "ansi":
            return ""
        drawn: Any = env.render()
        return drawn if isinstance(drawn, str) else drawn.getvalue() if hasattr(drawn, "getvalue") else ""


def ending_of(episode: Episode) -> str:
    """Return one line on how an episode ended."""
    turns = counted(episode.turns, "turn")
    if episode.error is not None:
        cause = printable(str(episode.error.get("message", episode.error)))
        return f"Ended after {turns} by an error that was not yours: {cause}"
    verdict = {True: "Won", False: "Lost", None: "Over"}[episode.success]
    if episode.seat is not None and episode.success is False and episode.episode_return >= 0:
        verdict = "Not won"  # it may be a draw
    if episode.transitions and not episode.transitions[-1].terminated:
        verdict = "Won, cut off" if episode.success else "Cut off"
    return f"{verdict} after {turns}. Return {_number(episode.episode_return)}."


def _return(transitions: list[Transition]) -> float:
    return sum(turn.reward for turn in transitions)


def _number(value: float) -> str:
    return f"{value:.4g}"


def in_one_line(text: str) -> str:
    """Return an action so that it fits into a line of a report."""
    line = printable(text.replace("\n", "⏎"))
    return line if len(line) <= _LONGEST_ACTION else f"{line[:_LONGEST_ACTION]}…"
