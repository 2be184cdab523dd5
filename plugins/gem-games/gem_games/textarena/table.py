"""``Table``: one game of TextArena with all its seats; whoever plays them, and through whichever interface."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from gem_core.records import without_thinking
from gem_games.textarena.fence import Fence
from gem_games.textarena.judging import JudgeError, judges_of
from gem_games.textarena.library import copied, load

LONGEST_ACTION = 4_000
"""Characters; of a longer action the end is read, since some patterns of the library take quadratic time."""


TALK = {
    "CharacterConclave",
    "Debate",
    "DontSayIt",
    "IteratedPrisonersDilemma",
    "IteratedStagHunt",
    "NewRecruit",
    "SecretMafia",
    "SimpleBlindAuction",
    "SimpleNegotiation",
    "Taboo",
    "ThreePlayerIPD",
    "TruthAndDeception",
}
"""Families in which the other seats hear all that a seat says, at least in some phases."""
_NO_BOARDS = {"IteratedPrisonersDilemma", "IteratedStagHunt", "PublicGoodsGame", "ThreePlayerIPD"}
"""Families that call a passing announcement a board."""
_MOVE = re.compile(r"\[[^\[\]]*\]")
_ASKED = re.compile(r"\s*Player (\d+), (?:do )?you\b.*", re.DOTALL)
_UPDATED_BOARD = " Your updated board:\n"  # Battleship
_SHORTEST_ECHO = 20  # characters
_PROGRESS = "_get_percentage_completion", "_progress", "_calculate_progress"


class View(NamedTuple):
    """What a seat sees: what happened since it was last asked, and the board as it stands, ``""`` if there is none."""

    feedback: str
    board: str


class Table:
    """A game of TextArena: ``act`` plays for the seat whose turn it is.

    Args:
        name: The game's id in TextArena.
        players: How many seats it has.
        max_turns: Handed to a game that takes it; None leaves it the limit that TextArena registers.
        judge: Answers a question in a game that has a judge.
    """

    def __init__(
        self, name: str, players: int, max_turns: int | None = None, judge: Callable[[str], str] | None = None
    ) -> None:
        self.name, self.players, self._max_turns, self._judge = name, players, max_turns, judge
        self._family = name.partition("-")[0]
        self._fence = Fence(0)
        with self._fence.inside():
            self._game, self._brackets, self._clip = load(name, max_turns)
        self.seed = 0
        self.actions: list[str] = []
        self.verdicts: list[str] = []
        """What the judge has answered."""
        self._known_verdicts: list[str] = []
        self.done = self.unlimited = False
        self._boards: dict[int, str] = {}

    def reset(self, seed: int, verdicts: Sequence[str] = ()) -> None:
        """Deal a game; the judge is asked for nothing that these verdicts answer."""
        self.seed, self.actions, self.done = seed, [], False
        self.verdicts, self._known_verdicts = [], list(verdicts)
        self._boards = {}
        self._fence = Fence(seed)
        with self._fence.inside():
            # Made anew, since some constructors draw too.
            self._game, self._brackets, self._clip = load(self.name, self._max_turns)
            for judge in judges_of(self._game):
                judge.ask = self._ask_judge
            self._game.reset(num_players=self.players, seed=seed % 2**32)
        self.unlimited = self._game.state.max_turns is None
        if self.unlimited:
            # DontSayIt-v0-unlimited compares it with the turn, in textarena 0.7.4.
            self._game.state.max_turns = sys.maxsize

    @property
    def seat(self) -> int:
        """Whose turn it is."""
        return int(self._game.state.current_player_id)

    @property
    def game(self) -> Any:
        """TextArena's own game; read only."""
        return self._game

    def look(self, seat: int) -> View:
        """Return what is new for a seat; what was seen once is not shown again, but for the board."""
        state = self._game.state
        messages, state.observations[seat] = state.observations.get(seat, []), []
        texts = []
        for sender, text, kind in messages:
            if kind.name == "GAME_BOARD" and self._family not in _NO_BOARDS:
                self._boards[seat] = text
                continue
            if kind.name != "PLAYER_ACTION":
                text, updated, board = text.partition(_UPDATED_BOARD)
                if updated:
                    self._boards[seat] = board
                # What another seat is asked.
                text = _ASKED.sub(lambda asked: asked[0] if int(asked[1]) == seat else "", text)
            if text:
                who = state.role_mapping.get(sender, f"Player {sender}")
                texts.append(text if kind.name == "PROMPT" else f"[{who}] {text}")
        return View("\n".join(texts), self._boards.get(seat, ""))

    def act(self, action: str) -> str:
        """Play a text for the seat whose turn it is; return what of it was played.

        Thinking blocks are no part of it. What TextArena raises comes through, and is not noted.
        """
        action = without_thinking(action)[-LONGEST_ACTION:]
        state, mover, talk = self._game.state, self.seat, self._is_talk()
        known = {seat: len(messages) for seat, messages in state.observations.items()}
        errors, formed = self.errors(), self._formed(action)
        with self._fence.inside():
            self.done = bool(self._game.step(action=formed)[0])
        self.actions.append(action)
        invalid = self.errors() > errors or bool(state.game_info.get(mover, {}).get("invalid_move"))
        said = [part for part in map(str.strip, _MOVE.split(action)) if len(part) >= _SHORTEST_ECHO]
        for seat, messages in state.observations.items():
            fresh = [(sender, str(text), kind) for sender, text, kind in messages[known[seat] :]]
            for part in said if seat == mover else ():
                fresh = [(sender, text.replace(part, "…"), kind) for sender, text, kind in fresh]
            messages[known[seat] :] = _heard(fresh, seat, mover, talk=talk, invalid=invalid)
        return action

    def _is_talk(self) -> bool:
        """Whether what is said now is meant for the ears of others; else only the move is."""
        state = self._game.state
        if self._family not in TALK or (self._family == "Taboo" and state.role_mapping[self.seat] == "Guesser"):
            return False
        phase = state.game_state.get("phase")
        name = str(getattr(phase, "value", phase or "conversation")).lower()
        return "discussion" in name or "conversation" in name

    def _ask_judge(self, question: str) -> str:
        if self._judge is None:
            raise JudgeError(f"{self.name} has no judge")
        verdict = self._known_verdicts.pop(0) if self._known_verdicts else self._judge(question)
        self.verdicts.append(verdict)
        return verdict

    def _formed(self, action: str) -> str:
        """Do what the game's own wrappers do to an action."""
        action = action[-self._clip :] if self._clip else action
        if self._brackets and not ("[" in action and "]" in action):
            action = f"[{action}]"
        return action

    def tries(self, action: str) -> bool:
        """Tell, on a copy of the game, whether TextArena takes an action as a valid one."""
        invalid: list[Any] = []

        def note(*args: Any, **kwargs: Any) -> bool:
            invalid.append((args, kwargs))
            return False

        fence = self._fence.copy()
        with fence.inside():
            try:
                game = copied(self._game)
                for judge in judges_of(game):
                    judge.ask = lambda question: ""
                game.state.set_invalid_move = note
                game.step(action=self._formed(action))
            except Exception:  # noqa: BLE001 - whatever the library raises, the action is not valid
                return False
        return not invalid

    def rewards(self) -> dict[int, float]:
        """Return each seat's reward of a finished game."""
        return {int(seat): float(reward) for seat, reward in (self._game.state.rewards or {}).items()}

    def progress(self) -> float:
        """Return the reward that TextArena gives for what is done of a game for one; 0 where it knows none."""
        found = (getattr(self._game, name, None) for name in _PROGRESS)
        with self._fence.inside():
            return next((float(progress()) for progress in found if progress is not None), 0.0)

    def report(self, seat: int) -> dict[str, Any]:
        """Return what TextArena says about a seat, as plain data."""
        found = self._game.state.game_info.get(seat, {})
        return {str(key): value for key, value in found.items() if isinstance(value, str | int | float | bool | None)}

    def errors(self) -> int:
        """Return the number of invalid moves in a row by the seat whose turn it is."""
        return int(getattr(self._game.state, "error_count", 0))


def _heard(
    messages: list[tuple[int, str, Any]], seat: int, mover: int, *, talk: bool, invalid: bool
) -> list[tuple[int, str, Any]]:
    """Return what a seat is told of an action: nothing of its own, and of another seat's the move alone.

    Where the game describes the move, its description is enough. Of an action with several pairs of brackets only the
    game knows which is the move, and its board shows it.
    """
    described = any(kind.name == "GAME_ACTION_DESCRIPTION" for _, _, kind in messages)
    heard = []
    for sender, text, kind in messages:
        if kind.name == "PLAYER_ACTION":
            if sender == seat or (seat == mover and sender < 0):
                continue
            if not talk:
                moves = set(_MOVE.findall(text))
                if invalid or described or len(moves) != 1:
                    continue
                text = moves.pop()
        heard.append((sender, text, kind))
    return heard
