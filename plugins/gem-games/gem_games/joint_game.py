r"""``JointGame``: what games of two seats share, so that each game's own file holds nothing but its rules."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from gem_core.env import MultiAgentEnv, Verdict
from gem_core.errors import ResetNeededError
from gem_core.parsing import extract_boxed_answers, without_thinking
from gem_core.types import Info
from gem_games.cheap_random import CheapRandom
from gem_games.game import painted, quote

TRIES = 3
"""Answers in a row that cannot be read or break a rule, with which a seat forfeits the game."""

_WON, _LOST, _DRAWN = "won", "lost", "drawn"
_COLOURS = {_WON: "green", _LOST: "red", _DRAWN: "yellow"}


class JointGame(MultiAgentEnv):
    r"""A game of two seats, whose moves are written inside ``\boxed{}``; the base of one's own.

    A game sets ``possible_agents`` and ``stake``, and defines ``_deal``, ``_rules``, ``_situation``, ``_read``,
    ``_fault``, ``_play``, ``_random_answer`` and ``_drawing``. Seats act one after the other unless it sets another
    ``agent_selector``.

    A seat's observation is ``info["feedback"]``, what happened since it acted last (at first the rules), followed by
    ``info["suffix"]``, how things stand for it. ``info["parsed_action"]`` is the move that was read of its last
    response, None if none was. Thinking blocks are left out before a response is read, and the other seat hears only
    what ``_play`` tells it.

    A response that cannot be read, or breaks a rule, does nothing: the seat alone is told, and answers again. With the
    third such response in a row it forfeits: over the whole game it gets ``-stake`` and the other ``stake``, as for
    the highest loss and win; where both forfeit at once, each gets 0.

    At the end ``info["correct"]`` is True for a seat whose rewards add up to more than 0, which has won, and False for
    others. A draw is no win: left out of the rate, it would hide that 99 of 100 games were drawn; the reward tells it
    from a loss.
    """

    metadata: dict[str, Any] = {"render_modes": ["ansi", "human"]}  # noqa: RUF012 - Gymnasium declares it without ClassVar

    stake: int = 1
    """What a seat that forfeits loses over the whole game, and the other wins: the most that can be lost."""
    forfeiting: str = "loses the game"
    """Says, behind "the third in a row", what the last of the wrong answers does."""
    nothing_read: str = "Your response has no complete \\boxed{}."
    """Says what a response lacks."""
    unreadable: str = "cannot be read."
    """Says, behind the content of a box, why ``_read`` made nothing of it."""

    def __init__(self) -> None:
        super().__init__()
        self.outcomes: dict[str, str] = {}
        """``"won"``, ``"lost"`` or ``"drawn"`` by seat, once the game is over."""
        self._heard: dict[str, str] = {}
        self._faults: dict[str, int] = {}
        self._moves: dict[str, str] = {}

    # What a game defines.

    def _deal(self, draws: CheapRandom) -> None:
        """Set the game up."""
        raise NotImplementedError

    def _rules(self, seat: str) -> str:
        """Say what the game is about and how to answer; what happens to unreadable answers follows."""
        raise NotImplementedError

    def _situation(self, seat: str) -> str:
        """Show how things stand for a seat: a line break, all that it must know, then how to answer or ``_ending``."""
        raise NotImplementedError

    def _read(self, answer: str) -> str | None:
        """Return the content of a box in the plain form that ``_play`` takes; None if it has not the form of a move."""
        raise NotImplementedError

    def _fault(self, seat: str, move: str) -> str:
        """Say which rule a move breaks; ``""`` if none."""
        return ""

    def _play(self, moves: dict[str, str]) -> tuple[dict[str, float], bool]:
        """Carry out the moves of those who act now, and ``_tell`` each seat of them.

        Returns:
            The rewards, 0 for a seat that is left out, and whether the game is over.
        """
        raise NotImplementedError

    def _random_answer(self, seat: str) -> str:
        """Draw an answer that the rules allow from ``action_random``, by nothing that the seat cannot know."""
        raise NotImplementedError

    def _drawing(self) -> str:
        """Draw the present state for people, ``painted`` where it helps; what is hidden from a seat only at the end."""
        raise NotImplementedError

    # What is made from it.

    def begin_episode(self, options: dict[str, Any] | None) -> dict[str, Info]:
        """Deal, and tell each seat the rules."""
        self._deal(CheapRandom(self.np_random_seed))
        self.outcomes, self._moves = {}, {}
        self._faults = dict.fromkeys(self.agents, 0)
        self._heard = {seat: self._rules(seat) + self._reading_rules() for seat in self.agents}
        return {seat: self._view(seat) for seat in self.agents}

    def _reading_rules(self) -> str:
        return (
            "Only the last box that can be read counts. An answer that cannot be read or breaks a rule does nothing, "
            f"and you answer again; the third in a row {self.forfeiting}.\n"
        )

    def observe(self, agent: str) -> str:
        """Return what the seat heard since it acted last, and how things stand for it."""
        return self._heard[agent] + self._situation(agent)

    def process_actions(self, actions: dict[str, str]) -> Verdict:
        """Read the responses, and play once all who act now have given a move."""
        parsed = {seat: self._take(seat, action) for seat, action in actions.items()}
        rewards, over = self._resolve(actions)
        if over:
            for seat in self.agents:
                total = self.cumulative[seat] + rewards.get(seat, 0.0)
                self.outcomes[seat] = _WON if total > 0 else _LOST if total < 0 else _DRAWN
        infos = {seat: self._view(seat) for seat in self.agents}
        for seat, move in parsed.items():
            infos[seat]["parsed_action"] = move
        for seat, outcome in self.outcomes.items():
            infos[seat]["correct"] = outcome == _WON
        return rewards, dict.fromkeys(self.agents, over), {}, infos

    def _view(self, seat: str) -> Info:
        return {"feedback": self._heard[seat], "suffix": self._situation(seat)}

    def _take(self, seat: str, action: str) -> str | None:
        """Keep the move of a response until all have given theirs; None if there is none, of which the seat is told."""
        self._heard[seat] = ""
        move, fault = self._understand(seat, without_thinking(action))
        if not fault:
            self._moves[seat], self._faults[seat] = move, 0
            return move
        self._faults[seat] += 1
        left = TRIES - self._faults[seat]
        self._tell(seat, f"{fault} Tries left: {left}.")
        return None

    def _understand(self, seat: str, text: str) -> tuple[str, str]:
        """Return the move in a response without its thinking, and what is wrong with it: ``""`` if nothing is."""
        boxes = extract_boxed_answers(text)
        if not boxes:
            return "", self.nothing_read
        move = next((move for move in map(self._read, reversed(boxes)) if move is not None), None)
        return ("", f"{quote(boxes[-1])} {self.unreadable}") if move is None else (move, self._fault(seat, move))

    def _resolve(self, seats: Iterable[str]) -> tuple[dict[str, float], bool]:
        """Play, or let those answer again whose answers were wrong, or end the game if it was their last try."""
        wrong = [seat for seat in seats if self._faults[seat]]
        if not wrong:
            moves, self._moves = self._moves, {}
            return self._play(moves)
        losers = [seat for seat in wrong if self._faults[seat] == TRIES]
        if not losers:
            self.agent_selector.override(*wrong)
            return {}, False
        for seat in self.agents:
            for loser in losers:
                who = "You" if seat == loser else f"The player {loser!r}"
                self._tell(seat, f"{who} gave no valid answer in {TRIES} tries.")
        signs = {seat: 0 if len(losers) > 1 else -1 if seat in losers else 1 for seat in self.agents}
        return {seat: sign * self.stake - self.cumulative[seat] for seat, sign in signs.items()}, True

    def _tell(self, seat: str, text: str) -> None:
        """Add a sentence to what a seat hears before it acts next."""
        heard = self._heard[seat]
        self._heard[seat] = f"{heard} {text}" if heard and not heard.endswith("\n") else heard + text

    def sample_random_action(self, agent: str) -> str:  # type: ignore[override]  # as in MultiAgentEnv
        """Return a valid answer in the present state.

        Raises:
            ResetNeededError: The episode is over or has not begun.
        """
        if not self.acting:
            raise ResetNeededError(f"{self.env_id or type(self).__name__}: call reset() before sample_random_action()")
        return f"\\boxed{{{self._random_answer(agent)}}}"

    def render(self) -> str | None:
        """Draw the game as text with ANSI colours, if it was made with a ``render_mode``."""
        if self.render_mode is None:
            return None
        if not self._heard:
            return "The game has not begun."
        return f"{self._drawing()}\n{self._status()}"

    def _status(self) -> str:
        if not self.outcomes:
            return painted(f"{' and '.join(self.acting)} to act", "bold")
        return " · ".join(painted(f"{seat} {outcome}", _COLOURS[outcome]) for seat, outcome in self.outcomes.items())

    def _ending(self, seat: str) -> str:
        """Say how the game ended for a seat, as the last line of a situation."""
        outcome = self.outcomes[seat]
        return "The game is over: it is a draw." if outcome == _DRAWN else f"The game is over: you {outcome}."
