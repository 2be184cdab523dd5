"""How ``gem play`` shows an episode: laid out for a person, or exactly as a model gets it."""

from __future__ import annotations

import textwrap
from typing import Any

import click

from gem_core.agents.answer_form import AnswerForm
from gem_core.cli.play_session import PlaySession
from gem_core.env.base import Env
from gem_core.env.observations import split_observation
from gem_core.errors import SamplingNotSupported
from gem_core.records.episode import Episode, Transition
from gem_core.records.plain_json import ImageFolder
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
        session: What is played.
        terminal: Where it is shown.
        exact: Show observations to the letter, as a model gets them.
        raw: Whether answers are sent as they are typed.
        images: Folder into which images are written; None only tells their size.
    """

    def __init__(
        self, session: PlaySession, terminal: Terminal, *, exact: bool, raw: bool, images: ImageFolder | None = None
    ) -> None:
        self._session = session
        self._terminal = terminal
        self._exact = exact
        self._raw = raw
        self._images = images

    # An episode.

    def opening(self, summary: str = "") -> None:
        """Show what the present episode begins with."""
        session, show = self._session, self._terminal.show
        episode = session.episode
        show()
        show(f"{episode.id} · episode {session.number}", bold=True)
        if summary and session.number == 1:
            show(summary, dim=True)
        form = AnswerForm() if self._raw else session.form()
        as_it_is = "An answer is sent as you type it."
        show(f"{f'An answer is sent as {in_one_line(str(form))}.' if form else as_it_is} Type ? for help.", dim=True)
        self.situation()

    def situation(self) -> None:
        """Show the present observation."""
        observation, info = self._session.observation, self._session.info
        if self._exact:
            self._rule(f"turn {self._session.episode.turns + 1}")
            self._terminal.show_exactly(self._text(observation))
            self._rule()
        else:
            self._laid_out(observation, info)

    def turn(self, turn: Transition) -> None:
        """Show what a turn brought."""
        episode = self._session.episode
        colour = "green" if turn.reward > 0 else "red" if turn.reward < 0 else None
        self._terminal.show(
            f"turn {episode.turns} · {in_one_line(turn.action)} · "
            + _styled(f"reward {_number(turn.reward)}", colour)
            + f" · return {_number(episode.episode_return)}",
            **({} if self._exact else {"bold": True}),
        )
        if not self._session.over:
            self.situation()
        elif not self._exact:
            self._laid_out(episode.final_observation, episode.final_info)
        else:
            self._rule("after the last turn")
            self._terminal.show_exactly(self._text(episode.final_observation))
            self._rule()

    def ending(self) -> None:
        """Say how the episode ended, and how to play it again."""
        show, session = self._terminal.show, self._session
        show(ending_of(session.episode), bold=True, fg=_colour_of(session.episode))
        if session.taken_back:
            show(f"Turns taken back, which are in no record: {session.taken_back}.", dim=True)
        if self._terminal.interactive and session.can_undo:
            show("!undo takes the last turn back.", dim=True)

    def farewell(self, episodes: list[Episode], path: str | None, options: str = "") -> None:
        """Say what was played, what was left unfinished, and where the rest was written."""
        show, session = self._terminal.show, self._session
        if not session.over:
            turns = session.episode.turns
            left = f"after {turns} turn{'s' if turns != 1 else ''}, return {_number(session.episode.episode_return)}"
            show(f"Left unfinished {left}{'; it is not recorded' if path else ''}.", fg="yellow")
        if len(episodes) > 1:
            verdicts = [episode.success for episode in episodes if episode.success is not None]
            solved = f", {sum(verdicts)} won" if verdicts else ""
            mean = sum(episode.episode_return for episode in episodes) / len(episodes)
            show(f"{len(episodes)} episodes{solved}, mean return {_number(mean)}.")
        if path:
            counted = f"{len(episodes)} episode{'s' if len(episodes) != 1 else ''} written to {path}"
            show(f"{counted if episodes else 'No episode was finished, and no file written'}.")
        show(f"The same again: gem play {session.env_id} --seed {session.seed}{options}", dim=True)

    def help(self) -> None:
        """Show the keys, the rules and an example of an action."""
        show, session = self._terminal.show, self._session
        show(KEYS.rstrip("\n"))
        if session.tools:
            show(f"  Tools: {', '.join(session.tools)}. A call is sent as you type it.")
        show(f"  {self._example()}")
        rules, _ = split_observation(session.episode.observation, session.episode.info)
        show()
        self._running(self._text(rules))

    def _example(self) -> str:
        # An answer drawn from a data set may be the right one.
        form, task = self._session.form(), self._session.env.unwrapped
        if form and isinstance(task, Env) and task.num_tasks is not None:
            return f"The form of an answer: {in_one_line(str(form))}"
        try:
            return f"A valid action, for example: {in_one_line(self._session.random_action())}"
        except SamplingNotSupported:
            return f"The form of an answer: {in_one_line(str(form)) if form else 'any text'}"

    # Observations.

    def _text(self, observation: Observation) -> str:
        images = self._images
        save_image = None if images is None else lambda image: images.path / images.write(image)
        return observation_text(observation, save_image)

    def _laid_out(self, observation: Observation, info: Info) -> None:
        feedback, suffix = split_observation(observation, info)
        # The drawing shows to a person what the suffix tells a model.
        board = self._board() if suffix else ""
        show = self._terminal.show
        if feedback and feedback != TERMINAL_STATE:
            show()
            self._running(self._text(feedback).strip("\n"))
        if board:
            show()
            self._terminal.show_drawing(textwrap.indent(board.strip("\n"), "  "))
        elif suffix:
            show()
            self._running(self._text(suffix).strip("\n"))
        show()

    def _board(self) -> str:
        env = self._session.env
        if env.render_mode != "ansi":
            return ""
        drawn: Any = env.render()
        return drawn if isinstance(drawn, str) else drawn.getvalue() if hasattr(drawn, "getvalue") else ""

    def _running(self, text: str, **style: Any) -> None:
        """Show text, its long lines broken between words."""
        columns = self._terminal.columns
        for line in text.split("\n"):
            fits = columns is None or len(line) <= columns or line[:1].isspace()
            for piece in [line] if fits else textwrap.wrap(line, columns or 0, break_on_hyphens=False):
                self._terminal.show_plainly(piece, **style)

    def _rule(self, title: str = "") -> None:
        self._terminal.show(f"──── {title} ".ljust(40, "─") if title else "─" * 40, dim=True)


def ending_of(episode: Episode) -> str:
    """Return one line on how an episode ended."""
    turns = f"{episode.turns} turn{'s' if episode.turns != 1 else ''}"
    if episode.error is not None:
        cause = printable(str(episode.error.get("message", episode.error)))
        return f"Ended after {turns} by an error that was not yours: {cause}"
    verdict = {True: "Won", False: "Lost", None: "Over"}[episode.success]
    if episode.transitions and not episode.transitions[-1].terminated:
        verdict = "Won, cut off" if episode.success else "Cut off"
    return f"{verdict} after {turns}. Return {_number(episode.episode_return)}."


def _colour_of(episode: Episode) -> str:
    return "yellow" if episode.success is None else "green" if episode.success else "red"


def _styled(text: str, colour: str | None) -> str:
    return click.style(text, fg=colour, bold=True) if colour else text


def _number(value: float) -> str:
    return f"{value:.4g}"


def in_one_line(text: str) -> str:
    """Return an action so that it fits into a line of a report."""
    line = printable(text.replace("\n", "⏎"))
    return line if len(line) <= _LONGEST_ACTION else f"{line[:_LONGEST_ACTION]}…"
