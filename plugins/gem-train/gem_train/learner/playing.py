"""Episodes played by the policy in a vector environment, all slots in one batch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import torch

from gem_core.errors import ArgumentError
from gem_core.records import Transition
from gem_core.types import Info, Observation
from gem_core.vector import VectorEnv
from gem_train.learner.generation import Sampled, sample
from gem_train.learner.model import Cache, Policy
from gem_train.learner.options import TrainOptions
from gem_train.learner.policy_loss import Floats
from gem_train.learner.vocabulary import ANSWER, END, Vocabulary
from gem_train.tokens import TokenBatch


@dataclass(slots=True)
class Turn:
    """One response.

    Args:
        shown: What it answers.
        shown_ids: Ids of that, and the mark of the response.
        read: Ids that the model read in this row before it answered.
        said: What the model sampled.
        text: Its text.
        new_row: Whether the model was shown nothing of what came before.
        reward: All that came until the seat acted again.
    """

    shown: Observation
    shown_ids: list[int]
    read: list[int]
    said: Sampled
    text: str
    new_row: bool
    reward: float = 0.0

    @property
    def cut_off(self) -> bool:
        """Whether it stopped at the most tokens of a response."""
        return self.said.tokens[-1] != END


@dataclass(slots=True)
class Played:
    """One episode of one seat.

    Args:
        slot: Number of the slot.
        start: Seed that it began with; episodes of a group have the same.
        seat: Name of the seat; None where an agent is alone.
        shown: What the seat is to answer next, or was shown last.
        view: Whether ``shown`` has the whole history, as a view shows it.
        turns: Its turns.
        first_reward: What came before it acted.
        terminated: Whether the task was over.
        success: Whether it was solved: 1.0, 0.0, or NaN for unknown.
        error: Whether the environment failed.
    """

    slot: int
    start: int | None
    seat: str | None
    shown: Observation
    view: bool = False
    turns: list[Turn] = field(default_factory=list)
    first_reward: float = 0.0
    terminated: bool = False
    success: float = float("nan")
    error: bool = False

    @property
    def episode_return(self) -> float:
        """Sum of the rewards, undiscounted."""
        return sum((turn.reward for turn in self.turns), self.first_reward)


class Slot:
    """The episode of one slot: of one seat, or of several.

    Args:
        number: Of the slot.
        observation: What ``reset`` returned.
        info: What ``reset`` returned with it.
        feedback: See ``TrainOptions``.
    """

    def __init__(self, number: int, observation: Any, info: Info, feedback: bool) -> None:
        self.number, self.start, self.feedback = number, info.get("seed"), feedback
        self.seats: dict[str | None, Played] = {}
        self.acting: list[Played] = []
        """Who is to answer."""
        self.failed = len(info.get("failed_resets", ()))
        """Episodes that did not begin; the one that did came after them."""
        if not info.get("idle"):
            self._show(observation, info)

    def action(self) -> Any:
        """Return what those who act have just said."""
        said = {seat.seat: seat.turns[-1].text for seat in self.acting}
        return said.get(None, said)

    def add(self, observation: Any, reward: Any, terminated: bool, truncated: bool, info: Info) -> None:
        """Take the result of a step."""
        if not isinstance(reward, dict):
            self._earn(None, observation, float(reward), bool(terminated), info, over=bool(terminated or truncated))
        for name, own in info.get("agents", {}).items():
            ended = bool(info["terminations"][name])
            seen = observation[name] if name in observation else own["final_obs"]
            self._earn(name, seen, float(reward[name]), ended, own, over=ended or bool(info["truncations"][name]))
        if info.get("error") is not None:
            for seat in self.seats.values():
                seat.error = seat.error or not seat.terminated
        self.acting = []
        if not (terminated or truncated):
            self._show(observation, info)

    def _show(self, observation: Any, info: Info) -> None:
        together = isinstance(observation, dict)
        for name, shown in (observation if together else {None: observation}).items():
            own = info["agents"][name] if together else info
            seat = self.seats.setdefault(name, Played(self.number, self.start, name, shown))
            seat.view = seat.view or own.get("view") is not None
            seat.shown = self._shown(seat, shown, own)
            self.acting.append(seat)

    def _shown(self, seat: Played, observation: Observation, info: Info) -> Observation:
        return info.get("feedback", observation) if self.feedback and seat.turns else observation

    def _earn(self, name: str | None, seen: Observation, reward: float, ended: bool, info: Info, *, over: bool) -> None:
        seat = self.seats.setdefault(name, Played(self.number, self.start, name, seen))
        if seat.turns:
            seat.turns[-1].reward += reward
        else:
            seat.first_reward += reward
        if over:
            seat.shown, seat.terminated, seat.error = (
                self._shown(seat, seen, info),
                ended,
                info.get("error") is not None,
            )
            correct = info.get("correct", None if ended else False)
            seat.success = float("nan") if correct is None or seat.error else float(correct)


class Player:
    """A policy as it plays: it reads what is new in each row, and remembers the rest.

    Args:
        policy: That plays.
        vocabulary: What it reads and writes with.
        options: Of the run.
        rows: The most seats that play at once.
    """

    def __init__(self, policy: Policy, vocabulary: Vocabulary, options: TrainOptions, rows: int) -> None:
        self.policy, self.vocabulary, self.options = policy, vocabulary, options
        self._generator = torch.Generator()
        self._cache = Cache(policy, rows)
        self._encode = lru_cache(50_000)(lambda text: encode(text, vocabulary))

    def play(self, vec: VectorEnv, seed: int) -> list[Played]:
        """Play one episode in every slot, and return what each seat lived through, in the order of the slots.

        All seats that are to act are answered at once. Episodes that could not begin come last, without turns.

        Args:
            vec: Made with ``autoreset="disabled"``, so that each call begins the next episodes of its plan.
            seed: Of what is sampled.
        """
        feedback = self.options.feedback
        slots = [Slot(number, *first, feedback) for number, first in enumerate(zip(*vec.reset(), strict=True))]
        self._generator.manual_seed(seed)
        self._cache.lengths.zero_()
        rows: dict[int, int] = {}
        while running := [slot for slot in slots if slot.acting]:
            asked = [seat for slot in running for seat in slot.acting]
            self._answer(asked, [rows.setdefault(id(seat), len(rows)) for seat in asked])
            results = vec.step({slot.number: slot.action() for slot in running})
            for slot, *result in zip(running, *results, strict=True):
                slot.add(*result)
        failed = [Played(slot.number, None, None, "", error=True) for slot in slots for _ in range(slot.failed)]
        return [seat for slot in slots for seat in slot.seats.values()] + failed

    def _answer(self, seats: list[Played], rows: list[int]) -> None:
        """Add a turn to each of some seats."""
        options, lengths = self.options, self._cache.lengths
        pieces, new = [], []
        for seat, row, length in zip(seats, rows, lengths[rows].tolist(), strict=True):
            # What was sampled last is not in the cache.
            read, new_row = self._next_piece(seat, length + 1)
            if new_row:
                lengths[row] = 0
            pieces.append(read if new_row else [seat.turns[-1].said.tokens[-1], *read])
            new.append((read, new_row))
        drawn = sample(
            self._cache,
            rows,
            pieces,
            options.max_tokens,
            keep=options.memory is None,
            generator=self._generator,
            temperature=options.temperature,
        )
        for seat, said, (read, new_row) in zip(seats, drawn, new, strict=True):
            shown_ids = self._encode(text_of(seat.shown))
            seat.turns.append(Turn(seat.shown, shown_ids, read, said, self.vocabulary.decode(said.tokens), new_row))

    def _prompt(self, seat: Played) -> list[int]:
        """Return all that the policy would read if the episode of a seat went on."""
        turns = seat.turns
        begin = max(place for place, turn in enumerate(turns) if turn.new_row)
        before = [token for turn in turns[begin:] for tokens in (turn.read, turn.said.tokens) for token in tokens]
        piece, new_row = self._next_piece(seat, len(before))
        return piece if new_row else [*before, *piece]

    def _next_piece(self, seat: Played, length: int) -> tuple[list[int], bool]:
        earlier = [(turn.shown_ids, turn.said.tokens) for turn in seat.turns[-(self.options.memory or 1) :]]
        return next_piece(self.options, self._encode(text_of(seat.shown)), earlier, length, view=seat.view)

    def bootstrap(self, played: Sequence[Played]) -> Floats:
        """Return the critic's value after the last turn of each episode that was cut off; 0 elsewhere."""
        values = np.zeros(len(played))
        cut_off = [index for index, seat in enumerate(played) if seat.turns and not seat.terminated and not seat.error]
        if self.options.algorithm == "ppo" and cut_off:
            pieces = [self._prompt(played[index]) for index in cut_off]
            self._cache.lengths.zero_()
            drawn = sample(self._cache, range(len(cut_off)), pieces, 1, keep=False, temperature=0.0)
            values[cut_off] = [said.value for said in drawn]
        return values


def next_piece(
    options: TrainOptions,
    shown: list[int],
    earlier: Sequence[tuple[Sequence[int], Sequence[int]]],
    length: int,
    *,
    view: bool,
) -> tuple[list[int], bool]:
    """Return what the policy reads before it answers, and whether a new row begins with it.

    Args:
        options: Of the run.
        shown: Ids of what it is to answer, and the mark of the response.
        earlier: What it was shown and said in earlier turns, as many as ``memory``; at least the last, if there is one.
        length: Tokens of the row so far.
        view: Whether ``shown`` has the whole history.
    """
    too_long = length + len(shown) + options.max_tokens > options.context
    if earlier and not view and options.memory is None and not too_long:
        return shown, False
    remembered = earlier[-options.memory :] if options.memory and not view else ()
    read = [*(token for turn in remembered for tokens in turn for token in tokens), *shown]
    # A conversation that is too long goes on without its past, and a prompt without its beginning.
    return read[-(options.context - options.max_tokens) :], True


def groups_of(played: Sequence[Played]) -> list[int]:
    """Return the number of each episode's group: one start, and one seat.

    Seats are compared with the same seat in other episodes, not with their opponents.
    """
    numbers: dict[tuple[int | None, str | None], int] = {}
    return [numbers.setdefault((seat.start, seat.seat), len(numbers)) for seat in played]


def token_batch(
    played: Sequence[Played], *, groups: Sequence[int], learn_cut_off: bool = True, failure_reward: float = 0.0
) -> TokenBatch:
    """Return a row for what the policy read and said in each episode; more where it began anew.

    Args:
        played: Episodes of seats.
        groups: Group of each.
        learn_cut_off: Whether turns that stopped at the most tokens are learnt from.
        failure_reward: Added to the last reward of an episode that was not solved.
    """
    turns = [(index, seat, turn) for index, seat in enumerate(played) for turn in seat.turns]
    return TokenBatch.from_turns(
        contexts=[turn.read for _, _, turn in turns],
        responses=[turn.said.tokens for _, _, turn in turns],
        logprobs=[turn.said.logprobs for _, _, turn in turns],
        episode=[index for index, _, _ in turns],
        row=np.cumsum([turn.new_row for _, _, turn in turns]) - 1 if turns else [],
        rewards=[
            turn.reward + failure_reward * (turn is seat.turns[-1] and seat.success == 0.0) for _, seat, turn in turns
        ],
        learnable=[not seat.error and (learn_cut_off or not turn.cut_off) for _, seat, turn in turns],
        terminated=[seat.terminated for seat in played],
        groups=groups,
        success=[seat.success for seat in played],
        first_rewards=[seat.first_reward for seat in played],
        seats=[seat.seat for seat in played],
    )


def values_of(played: Sequence[Played], batch: TokenBatch) -> Floats:
    """Return what the critic said of each turn, (E, T)."""
    values = np.zeros_like(batch.rewards)
    values[batch.mask] = [turn.said.value for seat in played for turn in seat.turns]
    return values


def encode(text: str, vocabulary: Vocabulary) -> list[int]:
    """Return the ids of a text, and the mark of the response after them."""
    return [*vocabulary.encode(text), ANSWER]


def text_of(observation: Observation) -> str:
    """Return the text of any observation: plain, content parts, or chat messages with their roles.

    Raises:
        ArgumentError: It holds an image.
    """
    if isinstance(observation, str):
        return observation
    text = ""
    for part in observation:
        if part.get("type") == "image":
            raise ArgumentError("gem train reads text, and the observation holds an image; choose another task")
        text += f"{part['role']}: {text_of(part.get('content') or '')}\n" if "role" in part else part.get("text", "")
    return text


def shown_and_said(transitions: Sequence[Transition], feedback: bool) -> Iterator[tuple[Observation, str]]:
    """Yield what the policy would have been shown in each turn of an episode, and what was said.

    Args:
        transitions: The turns.
        feedback: See ``TrainOptions``.
    """
    before: Info = {}
    for turn in transitions:
        yield before.get("feedback", turn.observation) if feedback else turn.observation, turn.action.text
        before = turn.info
