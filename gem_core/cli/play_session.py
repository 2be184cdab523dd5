"""``PlaySession``: an agent of ``rollout`` through which a person answers and may take turns back.

A turn is taken back by replaying the episode from its start without it, which works in every deterministic environment
and leaves no trace in the record.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import cast

from gem_core.cli.play_view import PlayView, in_one_line
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import ArgumentError, EnvFaultError
from gem_core.records.episode import Episode, Transition
from gem_core.records.files import EpisodeWriter
from gem_core.records.plans import EpisodeQueue, EpisodeStart
from gem_core.rollouts.agent import Context
from gem_core.rollouts.drivers import default_plan, rollout
from gem_core.terminal import EndOfInput, Terminal, Typed, whole_command
from gem_core.types import Observation
from gem_core.vector.vector_env import VectorEnv


class _PlayAgain(Exception):
    """Raised to replay the present episode."""


class _PlayNext(Exception):
    """Raised to leave the present episode for the next."""


class PlaySession:
    """Plays one episode after another, the same ones that a run of this seed has.

    Args:
        env: What is played, made by ``make``.
        view: Shows it.
        terminal: Where the person answers.
        seed: Seed of the run; None draws one, found as ``seed``.
        raw: Send answers as they are typed.
        repeatable: Whether a seed and the actions repeat an episode, so that turns can be taken back.
        writer: Where finished episodes are recorded; None for nowhere.
        seat: The person's seat, where several agents act.
        begun: What an episode started from, and its first turns: it is gone on with, each time that one begins.
    """

    reads = "observation"

    def __init__(
        self,
        env: AnyEnv,
        view: PlayView,
        terminal: Terminal,
        *,
        seed: int | None,
        raw: bool,
        repeatable: bool,
        writer: EpisodeWriter | None,
        seat: str | None = None,
        begun: tuple[EpisodeStart, Sequence[Transition]] | None = None,
    ) -> None:
        self._vector = VectorEnv.around(env, seed=seed, on_error="raise", keep_open=True)
        self._starts = EpisodeQueue(default_plan(self._vector, sys.maxsize), self._vector.seed)
        self._view = view
        self._terminal = terminal
        self._raw = raw
        self._repeatable = repeatable
        self._writer = writer
        self._seat = seat
        self._begun = begun
        self._again: list[Transition] = []
        self._taken_back = 0
        self._show: Callable[[], None] = view.opening
        self.seed = self._vector.seed
        self.finished: list[Episode] = []

    # Episodes.

    def play(self, episodes: int | None) -> None:
        """Play so many episodes; without a number, as long as the person wants, or one without a person.

        Raises:
            EndOfInput: There was nothing more to read.
        """
        asks = episodes is None and self._terminal.interactive
        for number in itertools.count(1):
            self._view.number = number
            start = cast("EpisodeStart", self._starts.draw(0)) if self._begun is None else self._begun[0]
            self._restart()
            try:
                goes_on = self._play_out(start, asks=asks)
            except _PlayNext:
                continue
            if not goes_on and (episodes is None or len(self.finished) >= episodes):
                return

    def _play_out(self, start: EpisodeStart, *, asks: bool) -> bool:
        """Play an episode to its end, and record it; return whether another is wanted, if that is asked."""
        while True:
            try:
                episode = self._run_episode(start)
            except _PlayAgain:
                continue
            last = episode.transitions[-1]
            if not self._raw and self._repeatable and _was_not_played(last):
                self._take_back(episode.transitions, lambda: None)
                # The reason is not shown: the last observation of a task may reveal its solution.
                self._terminal.show(
                    f"{in_one_line(last.action)} was not played: it cannot be read, or breaks the rules. That would "
                    "end the episode, so it does not count: answer again, or type ? for help.",
                    fg="yellow",
                )
                continue
            self._view.ending(episode, self._taken_back, can_undo=self._repeatable)
            another: bool | None = False
            try:
                if asks:
                    another = self._wants_another(episode)
            finally:
                if another is not None:
                    if self._writer is not None:
                        self._writer.write(episode)
                    self.finished.append(episode)
            if another is not None:
                return another

    def _wants_another(self, episode: Episode) -> bool | None:
        """Ask whether to go on; None where the last turn was taken back instead."""
        while True:
            another = self._terminal.confirm("Play another?", other="!undo")
            if another is not None:
                return another
            try:
                self._undo(episode.transitions)
            except ArgumentError as error:
                self._terminal.show(f"{error}.", fg="yellow")
            else:
                return None

    def _run_episode(self, start: EpisodeStart) -> Episode:
        plan = [replace(start.item, seed=start.seed)]
        try:
            (episode,) = rollout(self._vector, self, plan=plan, seed=self.seed)
        except EnvFaultError as error:
            raise (error.__cause__ or error) from None
        episode.key = start.key
        if self._seat is not None:
            episode.seat, episode.agent = self._seat, "human"
        return episode

    # Turns.

    def __call__(self, observation: Observation, context: Context) -> str:
        """Return what the person answers, or what was answered before where the episode is played again."""
        self._view.see(observation, context)
        if context.turn < len(self._again):
            before = self._again[context.turn]
            if observation == before.observation:
                return before.action
            self._terminal.show("Played again, this environment went another way; go on from here.", fg="yellow")
            self._again = []
        self._show()
        self._show = self._view.turn
        return self._terminal.ask_for_answer(f"turn {context.turn + 1}> ", lambda typed: self._answer(typed, context))

    def _answer(self, typed: Typed, context: Context) -> str | None:
        """Return the answer that was typed, or that a command gives."""
        if not typed.is_command:
            return typed.text if self._raw else self._view.form().around(typed.text, self._view.tools)
        match whole_command(typed.text, ("help", "undo", "random", "restart", "next", "quit")):
            case "help":
                self._view.help()
                return None
            case "random":
                return context.sample_random_action()
            case "undo":
                self._undo(context.transitions)
                raise _PlayAgain
            case "restart":
                self._restart()
                raise _PlayAgain
            case "next":
                raise _PlayNext
            case _:
                raise EndOfInput

    def _undo(self, transitions: list[Transition]) -> None:
        if not transitions:
            raise ArgumentError("there is no turn to take back")
        if not self._repeatable:
            raise ArgumentError(
                "turns of this environment cannot be taken back: a seed and the actions do not repeat its episodes"
            )
        self._terminal.show(f"Taken back: {in_one_line(transitions[-1].action)}", dim=True)
        self._take_back(transitions, self._view.situation)

    def _take_back(self, transitions: list[Transition], show: Callable[[], None]) -> None:
        self._again, self._show = transitions[:-1], show
        self._taken_back += 1

    def _restart(self) -> None:
        self._again, self._show = [] if self._begun is None else list(self._begun[1]), self._view.opening
        self._taken_back = 0


def _was_not_played(turn: Transition) -> bool:
    """Tell whether the environment reports that it could not parse or play a response."""
    return turn.info.get("parsed_action", "") is None and not turn.info.get("correct")
