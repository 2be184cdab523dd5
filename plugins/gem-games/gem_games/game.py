r"""``Game``: what all games share, so that each game's own file holds nothing but its rules.

Rewards are those of gem-llm: 1 for success unless the game says otherwise, 0 for a turn
that settles nothing and for an invalid move, -0.1 for a response that cannot be read.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gem_core.env import Env
from gem_core.errors import ArgumentError, ResetNeededError
from gem_core.parsing import extract_boxed_answers, extract_last_boxed_answer
from gem_core.types import ResetResult, StepResult
from gem_games.cheap_random import CheapRandom

FORMAT_ERROR_REWARD = -0.1

_NOT_BEGUN, _PLAYING, _WON, _LOST = "not begun", "playing", "won", "lost"
_OUTCOME_COLOURS = {_WON: "green", _LOST: "red"}
# Select Graphic Rendition, ECMA-48 section 8.3.117. The basic eight follow the reader's own palette.
_COLOURS = {"bold": 1, "dim": 2, "red": 31, "green": 32, "yellow": 33, "blue": 34, "magenta": 35, "cyan": 36}
_LONGEST_NUMBER = 100  # characters: beyond every range a game can have, and far below what int() refuses
_LONGEST_LIST = 1_000  # characters
_LONGEST_QUOTE = 40
_DIRECTIONS = frozenset({"up", "down", "left", "right"})


class Game(Env):
    r"""A game of turns, won or lost within ``max_turns``; the base of one's own, here and in other plugins.

    A game sets ``max_turns``, and defines ``_deal``, ``_rules``, ``_situation``, ``_read``, ``_play``,
    ``_random_answer`` and ``_drawing``. ``_play`` gets what ``_read`` makes of the last ``\boxed{}`` that it can read,
    and returns the verdict on it: ``_invalid``, ``_move`` or ``_win``. ``reset``, ``step``, sampling and rendering are
    made from these. An observation is ``info["feedback"]``, what happened, followed by ``info["suffix"]``, how things
    stand. For example::

        from gem_games.game import Game, painted, quote

        class ParityEnv(Game):
            def __init__(self, max_turns: int = 3, *, format_error_ends: bool = True) -> None:
                super().__init__(format_error_ends=format_error_ends)
                self.max_turns = max_turns
                self.number = 0

            def _deal(self, draws):  # all that is drawn at a reset
                self.number = 1 + draws.below(100)

            def _rules(self):
                return "A hidden number from 1 to 100 is even or odd: say which.\n"

            def _situation(self):
                return "\n" + self._turns_left("Answer \\boxed{even} or \\boxed{odd}.")

            unreadable = "is not a number or a word."

            def _read(self, answer):  # None is no answer, which ends the game
                return answer.lower() if answer.isalnum() else None

            def _play(self, answer):
                if answer not in ("even", "odd"):
                    return self._invalid(f"{quote(answer)} is neither even nor odd.")
                if answer == ("odd" if self.number % 2 else "even"):
                    return self._win(answer, "Right.")
                return self._move(answer, "Wrong.", 0.0, 0.0)  # reward, and reward in the last turn

            def _solution(self):
                return f" It was {self.number}."

            def _random_answer(self):
                return ("even", "odd")[int(self.action_random.integers(2))]

            def _drawing(self):  # for a person: what gem play shows
                return painted("?" if self.outcome == "playing" else str(self.number), "bold")

    Args:
        format_error_ends: Whether a response that cannot be read ends the game; otherwise it costs a turn.

    Source: the reward of each case is that of https://github.com/axon-rl/gem.
    """

    format_error_reward: float = FORMAT_ERROR_REWARD
    unreadable: str = "cannot be read."
    """Says, behind the content of a box, why ``_read`` made nothing of it."""
    max_turns: int
    """Turns after which the game is lost. The task announces it, so the last turn is ``terminated``."""
    turn: int = 0
    """Turns taken so far."""
    outcome: str = _NOT_BEGUN
    """``"not begun"``, ``"playing"``, ``"won"`` or ``"lost"``."""

    def __init__(self, *, format_error_ends: bool = True) -> None:
        super().__init__()
        check_flag("format_error_ends", format_error_ends)
        self.format_error_ends = format_error_ends

    @property
    def return_range(self) -> tuple[float, float]:  # type: ignore[override]  # depends on the arguments
        """From nothing but unreadable responses to a game that is won."""
        return self.format_error_reward * (1 if self.format_error_ends else self.max_turns), 1.0

    # What a game defines.

    def _deal(self, draws: CheapRandom) -> None:
        """Set the game up; the parameters that were left open are drawn here too."""
        raise NotImplementedError

    def _rules(self) -> str:
        """Say what the game is about and how to answer; ``_reading_rules`` follow."""
        raise NotImplementedError

    def _situation(self) -> str:
        """Show how things stand: a line break, all that a player must know who sees nothing else, ``_turns_left``."""
        raise NotImplementedError

    def _read(self, answer: str, /) -> Any:
        """Return the content of a box in the form that ``_play`` takes; None if it has not the form of an answer."""
        return answer or None

    def _play(self, answer: Any) -> StepResult:
        """Return the verdict on an answer; see the class."""
        raise NotImplementedError

    def _solution(self) -> str:
        """Say what would have won, as a whole sentence with a space before it; ``""`` where there is nothing to say."""
        return ""

    def _gold_answer(self) -> str | None:
        """Return an answer that wins, or is the next of those that do; None where none is known."""
        return None

    def _random_answer(self) -> str:
        """Draw an answer that the rules allow from ``action_random``, by nothing that only the game knows."""
        raise NotImplementedError

    # What is made from it.

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Begin a game; the feedback is its rules."""
        super().reset(seed)
        self.turn = 0
        self.outcome = _PLAYING
        self._deal(CheapRandom(self.np_random_seed))
        feedback, suffix = self._rules() + self._reading_rules(), self._situation()
        return feedback + suffix, {"feedback": feedback, "suffix": suffix}

    def _reading_rules(self) -> str:
        """Say what happens to a response that cannot be read, and to an answer that breaks a rule."""
        unreadable = "ends the game" if self.format_error_ends else "costs a turn"
        return (
            f"Only the last box that can be read counts. A response without one {unreadable}; an answer that breaks a "
            f"rule costs a turn. You have {self.max_turns} turns.\n"
        )

    def step(self, action: str) -> StepResult:
        r"""Play the content of the last ``\boxed{}`` that can be read."""
        self.turn += 1
        last = extract_last_boxed_answer(action)
        if last is None:
            return self._format_error("Your response has no complete \\boxed{}.")
        answer = self._read(last)
        if answer is None:
            earlier = map(self._read, reversed(extract_boxed_answers(action)))
            answer = next((read for read in earlier if read is not None), None)
        if answer is None:
            return self._format_error(f"{quote(last)} {self.unreadable}")
        return self._play(answer)

    def sample_random_action(self) -> str:
        """Return a valid answer in the present state."""
        if self.outcome == _NOT_BEGUN:
            raise ResetNeededError(f"{self.env_id or type(self).__name__}: call reset() before sample_random_action()")
        return f"\\boxed{{{self._random_answer()}}}"

    def gold_action(self) -> str | None:
        """Return an answer that wins, or is the next of those that do; None where the game knows none."""
        answer = self._gold_answer() if self.outcome == _PLAYING else None
        return None if answer is None else f"\\boxed{{{answer}}}"

    def render(self) -> str | None:
        """Draw the game as text with ANSI colours, if it was made with ``render_mode="ansi"``."""
        if self.render_mode != "ansi":
            return None
        if self.outcome == _NOT_BEGUN:
            return "The game has not begun."
        outcome = painted(self.outcome, _OUTCOME_COLOURS.get(self.outcome, "bold"))
        return f"{self._drawing()}\nturn {self.turn} of {self.max_turns} · {outcome}"

    def _drawing(self) -> str:
        """Draw the present state for a person, over several lines, ``painted`` where it helps."""
        raise NotImplementedError

    # The verdicts.

    def _format_error(self, feedback: str) -> StepResult:
        """The response cannot be read."""
        if self.format_error_ends:
            return self._end(_LOST, f"{feedback} That ends the game.{self._solution()}", self.format_error_reward, None)
        reward = self.format_error_reward
        return self._move(None, f"{feedback} The turn is lost.", reward, reward)

    def _invalid(self, feedback: str, at_limit: float = 0.0) -> StepResult:
        """The answer can be read and breaks a rule: nothing changes, and the turn is lost.

        Args:
            feedback: Which rule.
            at_limit: Reward if this was the last turn.
        """
        return self._move(None, f"{feedback} The turn is lost.", 0.0, at_limit)

    def _move(self, played: str | None, feedback: str, reward: float, at_limit: float) -> StepResult:
        """The answer was played, and the game goes on if there are turns left.

        Args:
            played: The answer in its plain form, for ``info["parsed_action"]``.
            feedback: What it did.
            reward: Reward for it.
            at_limit: Reward if this was the last turn.
        """
        if self.turn >= self.max_turns:
            feedback = f"{feedback} You have used all your turns.{self._solution()}"
            return self._end(_LOST, feedback, at_limit, played)
        suffix = self._situation()
        info = {"feedback": feedback, "suffix": suffix, "parsed_action": played}
        return feedback + suffix, reward, False, False, info

    def _win(self, played: str, feedback: str, reward: float = 1.0) -> StepResult:
        """The answer was played and wins the game."""
        return self._end(_WON, feedback, reward, played)

    def _end(self, outcome: str, feedback: str, reward: float, played: str | None) -> StepResult:
        self.outcome = outcome
        suffix = self._situation()
        info = {"feedback": feedback, "suffix": suffix, "parsed_action": played, "correct": outcome == _WON}
        return feedback + suffix, reward, True, False, info

    def _turns_left(self, how_to_answer: str) -> str:
        """Say how many turns are left and how to answer, as the last line of a situation."""
        if self.outcome != _PLAYING:
            return f"The game is over: you {self.outcome}."
        return f"Turns left: {self.max_turns - self.turn}. {how_to_answer}"


def whole_number(text: str) -> int | None:
    """Read a whole number in ASCII digits, with a sign or without; None if the text is anything else.

    Leading zeros mean nothing. Of a number of more than 100 digits only the first 100 are read: it is beyond every
    range of a game either way, and ``int`` refuses to read more than 4,300.
    """
    if text.isdigit() and text.isascii() and len(text) <= _LONGEST_NUMBER:
        return int(text)
    digits = text if text.isdigit() else text.removeprefix("-" if text.startswith("-") else "+")
    if not (digits.isdigit() and digits.isascii()):
        return None
    if len(digits) > _LONGEST_NUMBER:
        digits = digits.lstrip("0")[:_LONGEST_NUMBER] or "0"
    return -int(digits) if text[0] == "-" else int(digits)


def whole_numbers(text: str) -> list[int] | None:
    """Read whole numbers with white space between them; None if there are none, or if a piece is something else.

    A text of more than 1,000 characters is not read.
    """
    if len(text) > _LONGEST_LIST:
        return None
    pieces = text.split()
    digits = "".join(pieces)
    if digits.isdigit() and digits.isascii() and len(digits) <= _LONGEST_NUMBER:
        return list(map(int, pieces))
    numbers = [number for number in map(whole_number, pieces) if number is not None]
    return numbers if 0 < len(numbers) == len(pieces) else None


def read_direction(text: str) -> str | None:
    """Read ``up``, ``down``, ``left`` or ``right``, in letters of any case; None if the text is anything else."""
    if text in _DIRECTIONS:
        return text
    lowered = text.lower()
    return lowered if lowered in _DIRECTIONS else None


def painted(text: str, colour: str) -> str:
    """Return text in a colour for a terminal; text without anything to see stays as it is."""
    return f"\x1b[{_COLOURS[colour]}m{text}\x1b[0m" if text.strip() else text


def quote(text: str) -> str:
    """Quote what an agent wrote, cut to a length that a feedback can repeat, with odd characters escaped."""
    return repr(text) if len(text) <= _LONGEST_QUOTE else f"{text[:_LONGEST_QUOTE]!r}…"


def check_whole(name: str, value: object, low: int, high: int) -> None:
    """Refuse a constructor's argument that is not None and not a whole number within bounds.

    Raises:
        ArgumentError: It says what was allowed.
    """
    if value is None or (type(value) is int and low <= value <= high):
        return
    raise ArgumentError(f"{name} must be a whole number from {low} to {high}, or None to draw it, not {value!r}")


def check_flag(name: str, value: object, *, or_drawn: bool = False) -> None:
    """Refuse a constructor's argument that is neither True nor False, nor None where that draws it.

    Raises:
        ArgumentError: It says what was allowed.
    """
    if isinstance(value, bool) or (or_drawn and value is None):
        return
    allowed = "True, False, or None to draw it" if or_drawn else "True or False"
    raise ArgumentError(f"{name} must be {allowed}, not {value!r}")


def sizes_to_draw(sizes: Sequence[tuple[Any, ...]], given: tuple[Any, ...]) -> list[Any]:
    """Return the different sizes that are left when what was given, and is not None, replaces its part of each."""
    replaced: dict[Any, None] = {}
    for size in sizes:
        replaced[tuple([drawn if own is None else own for own, drawn in zip(given, size, strict=True)])] = None
    return list(replaced)
