"""``PlaySession``: a person at a terminal plays episodes, and may take turns back.

It is an agent of ``rollout``. A turn is taken back by playing the episode again from its start without it, which works
in every deterministic environment and leaves no trace in the record.
"""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

from gem_core.agents.human import AnswerForm
from gem_core.cli.layout import counted
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import ArgumentError, EnvFaultError
from gem_core.records.conversation import split_observation
from gem_core.records.episode import Episode, Transition
from gem_core.records.files import EpisodeWriter
from gem_core.records.plain_json import ImageFolder
from gem_core.records.plans import EpisodeQueue, EpisodeStart
from gem_core.rollouts.agent import Context
from gem_core.rollouts.drivers import default_plan, rollout
from gem_core.terminal import BLOCK, Terminal, observation_text, printable
from gem_core.types import TERMINAL_STATE, Info, Observation
from gem_core.vector.vector_env import VectorEnv

_LONGEST_ACTION = 60

_KEYS = f"""\
  ?          this help
  !undo      take the last turn back
  !random    play a random valid action
  !quit      end, as Ctrl-D does
  {BLOCK} on a line of its own begins and ends an answer of several lines, in which nothing is a command."""


class _PlayAgain(Exception):
    """Raised to play the present episode again from its start."""


@dataclass(eq=False)
class PlaySession:
    """Plays one episode after another, the same ones that a run of this seed has.

    Args:
        env: What is played, made by ``make``.
        seed: Seed of the run; None draws one, found as ``seed``.
        repeatable: Whether a seed and the actions repeat an episode, so that turns can be taken back.
        exact: Show observations to the letter, as a model gets them.
        summary: Of the environment.
        writer: Where finished episodes are recorded, with images beside them; None for nowhere.
        seat: The person's seat in a game of several agents.
    """

    env: AnyEnv
    seed: int | None
    repeatable: bool
    exact: bool = False
    summary: str = ""
    writer: EpisodeWriter | None = None
    seat: str | None = None
    reads = "observation"

    def __post_init__(self) -> None:
        self._vector = VectorEnv.from_env(self.env, seed=self.seed, on_error="raise", keep_open=True)
        self._starts = EpisodeQueue(default_plan(self._vector, sys.maxsize), self._vector.seed)
        self._terminal = Terminal()
        self._images = None if self.writer is None else ImageFolder.beside(self.writer.path)
        self._repeated: Sequence[Transition] = ()
        self._show: Callable[[], None] = self._show_opening
        self._context: Context | None = None
        """Of the turn that waits for an answer; None outside an episode."""
        self.seed = self._vector.seed
        self.finished: list[Episode] = []

    # Episodes.

    def play(self, episodes: int | None) -> None:
        """Play so many episodes; without a number, as long as the person wants, or one without a person.

        Raises:
            EOFError: There was nothing more to read.
        """
        asks = episodes is None and self._terminal.interactive
        while asks or len(self.finished) < (episodes or 1):
            episode = self._play_one(cast("EpisodeStart", self._starts.draw(0)))
            self._show_ending(episode)
            self.finished.append(episode)
            if self.writer is not None:
                self.writer.write(episode)
            if asks and self._terminal.line("Play another? [Y/n] ").strip().casefold().startswith(("n", "q", "!q")):
                return

    def farewell(self, again: str) -> None:
        """Say where the episodes were written, and how to play the same again."""
        if self._context is not None:
            self._terminal.show(f"Left unfinished after {counted(self._context.turn, 'turn')}.", "yellow")
        if self.writer is not None and self.finished:
            self._terminal.show(f"{counted(len(self.finished), 'episode')} written to {self.writer.path}.")
        self._terminal.show(f"The same again: {again}", "dim")

    def _play_one(self, start: EpisodeStart) -> Episode:
        self._repeated, self._show = (), self._show_opening
        while True:
            try:
                (episode,) = rollout(self._vector, self, plan=[replace(start.item, seed=start.seed)], seed=self.seed)
            except _PlayAgain:
                continue
            except EnvFaultError as error:
                raise (error.__cause__ or error) from None
            last = episode.transitions[-1]
            if not self.repeatable or not _was_not_played(last):
                break
            self._repeated, self._show = episode.transitions[:-1], lambda: None
            # The reason is not shown: the last observation of a task may reveal its solution.
            self._terminal.show(
                f"{in_one_line(last.action)} was not played: it cannot be read, or breaks the rules. That would end "
                "the episode, so it does not count: answer again, or type ? for help.",
                "yellow",
            )
        episode.key = start.key
        if self.seat is not None:
            episode.seat, episode.agent = self.seat, "human"
        return episode

    # Turns.

    def __call__(self, observation: Observation, context: Context) -> str:
        """Return what the person answers, or the earlier answer while the episode is played again."""
        self._observation, self._context = observation, context
        if context.turn < len(self._repeated):
            return self._repeated[context.turn].action
        self._show()
        self._show = self._show_turn
        commands = {"help": self._show_help, "undo": self._undo, "random": context.sample_random_action}
        return self._form(context).around(self._terminal.ask(f"turn {context.turn + 1}> ", commands))

    def _undo(self) -> None:
        turns = cast("Context", self._context).transitions
        if not turns:
            raise ArgumentError("there is no turn to take back")
        if not self.repeatable:
            raise ArgumentError(
                "turns of this environment cannot be taken back: a seed and the actions do not repeat it"
            )
        self._terminal.show(f"Taken back: {in_one_line(turns[-1].action)}", "dim")
        self._repeated, self._show = turns[:-1], self._show_situation
        raise _PlayAgain

    def _form(self, context: Context) -> AnswerForm:
        return AnswerForm.of_task(self._observation, context)

    # What is shown.

    def _show_opening(self) -> None:
        show, context = self._terminal.show, cast("Context", self._context)
        show(f"\n{context.env_id} · episode {len(self.finished) + 1}", "bold")
        if self.summary and not self.finished:
            show(self.summary, "dim")
        show(f"An answer is sent as {in_one_line(str(self._form(context)))}. Type ? for help.", "dim")
        if context.system:
            show()
            self._terminal.show(self._text(context.system))
        self._show_situation()

    def _show_situation(self) -> None:
        context = cast("Context", self._context)
        self._show_observation(self._observation, context.info, f"turn {context.turn + 1}")

    def _show_turn(self) -> None:
        self._show_result(cast("Context", self._context).transitions)
        self._show_situation()

    def _show_ending(self, episode: Episode) -> None:
        self._context = None
        self._show_result(episode.transitions)
        self._show_observation(episode.final_observation, episode.final_info, "after the last turn")
        verdict = {True: "Won", False: "Lost", None: "Over"}[episode.success]
        if episode.seat is not None and episode.success is False and episode.episode_return >= 0:
            verdict = "Not won"  # it may be a draw
        if not episode.transitions[-1].terminated:
            verdict = "Won, cut off" if episode.success else "Cut off"
        colour = {True: "green", False: "red", None: "yellow"}[episode.success]
        text = f"{verdict} after {counted(episode.turns, 'turn')}. Return {episode.episode_return:.4g}."
        self._terminal.show(text, f"bold {colour}")

    def _show_help(self) -> None:
        """Show the keys, the form of an answer, and the first observation, which has the rules."""
        context = cast("Context", self._context)
        self._terminal.show(_KEYS)
        if context.tools:
            names = ", ".join(tool["function"]["name"] for tool in context.tools)
            self._terminal.show(f"  Tools: {names}. A call is sent as you type it.")
        self._terminal.show(f"  The form of an answer: {in_one_line(str(self._form(context)))}\n")
        first = context.transitions[0].observation if context.transitions else self._observation
        self._terminal.show(self._text(first))

    def _show_result(self, transitions: Sequence[Transition]) -> None:
        turn = transitions[-1]
        total = sum(each.reward for each in transitions)
        result = f"reward {turn.reward:.4g} · return {total:.4g}"
        colour = "green" if turn.reward > 0 else "red" if turn.reward < 0 else ""
        self._terminal.show(f"turn {len(transitions)} · {in_one_line(turn.action)} · {result}", f"bold {colour}")

    def _show_observation(self, observation: Observation, info: Info, title: str) -> None:
        show = self._terminal.show
        if self.exact:
            show(f"──── {title} ".ljust(40, "─"), "dim")
            self._terminal.show_exactly(self._text(observation))
            show("─" * 40, "dim")
            return
        feedback, suffix = split_observation(observation, info)
        if feedback and feedback != TERMINAL_STATE:
            show()
            self._terminal.show(self._text(feedback).strip("\n"))
        # The board shows a person what the suffix tells a model.
        board = self.env.render() if suffix and self.env.render_mode == "ansi" else None
        if isinstance(board, str) and board:
            show()
            self._terminal.show_drawing(textwrap.indent(board.strip("\n"), "  "))
        elif suffix:
            show()
            self._terminal.show(self._text(suffix).strip("\n"))
        show()

    def _text(self, observation: Observation) -> str:
        images = self._images
        return observation_text(
            observation, None if images is None else lambda image: images.path / images.write(image)
        )


def in_one_line(text: str) -> str:
    """Return an action so that it fits into a line of a report."""
    line = printable(text.replace("\n", "⏎"))
    return line if len(line) <= _LONGEST_ACTION else f"{line[:_LONGEST_ACTION]}…"


def _was_not_played(turn: Transition) -> bool:
    """Tell whether the environment reports that it could not parse or play a response."""
    return turn.info.get("parsed_action", "") is None and not turn.info.get("correct")
