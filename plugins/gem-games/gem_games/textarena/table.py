"""``Table``: one game of TextArena with all its seats; whoever plays them, and through whichever interface."""

from __future__ import annotations

import copy
import importlib
import re
import sys
from collections.abc import Callable, Sequence
from types import NoneType
from typing import Any, NamedTuple

from gem_core.errors import ArgumentError
from gem_core.parsing import without_thinking
from gem_core.suggestions import did_you_mean
from gem_games.textarena.fence import Fence
from gem_games.textarena.games import GAMES
from gem_games.textarena.judging import JudgeError, judges_of
from gem_games.textarena.library import load

LONGEST_ACTION = 4_000
"""Characters; of a longer action the end is read, since some patterns of the library take quadratic time."""
_MOST_TURNS = 1_000
"""Of a seat, where neither the game nor the caller sets a higher limit."""

TALK = {
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
_NO_BOARDS = {"IteratedPrisonersDilemma", "IteratedStagHunt", "ThreePlayerIPD"}
"""Families that call a passing announcement a board."""
_FOR_TWO = {"Briscola", "Golf"}
"""Families whose end with more seats textarena 0.7.4 cannot tell."""
_MOVE = re.compile(r"\[[^\[\]]*\]")
_ASKED = re.compile(r"\s*Player (\d+), (?:do )?you\b.*", re.DOTALL)
_UPDATED_BOARD = " Your updated board:\n"  # Battleship
_SHORTEST_ECHO = 20  # characters
_PLAIN = str, int, float, bool, NoneType
_PROGRESS = "_get_percentage_completion", "_progress", "_calculate_progress"


class View(NamedTuple):
    """What a seat sees: what happened since it acted last, and below it the board as it stands, if there is one."""

    feedback: str
    suffix: str


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
        self._has_board = self._family not in _NO_BOARDS
        self._fence = Fence(0)
        with self._fence:
            self._game, self._brackets, self._clip = load(name, max_turns)
        kinds = importlib.import_module("textarena.core").ObservationType
        # Read once: Python 3.11 takes its time over a member of an enumeration.
        self._prompt, self._board, self._action = kinds.PROMPT, kinds.GAME_BOARD, kinds.PLAYER_ACTION
        self._description = kinds.GAME_ACTION_DESCRIPTION
        self.seed = 0
        self.actions: list[str] = []
        self.verdicts: list[str] = []
        """What the judge has answered."""
        self._known_verdicts: list[str] = []
        self.done = False
        self.invalid = False
        """Whether the last action was an invalid move."""
        self.turns: list[int] = []
        """How many actions each seat has taken."""
        self.refused = 0
        """How many invalid moves in a row the seat has made whose turn it still is."""
        self.most_turns = _MOST_TURNS
        """How many actions of a seat there are at most; in 2048 as many as the tile that is wanted."""
        self._boards: dict[int, str] = {}
        self._news: list[list[str]] = []

    def reset(self, seed: int, verdicts: Sequence[str] = ()) -> None:
        """Deal a game; the judge is asked for nothing that these verdicts answer."""
        self.seed, self.actions, self.done, self.invalid = seed, [], False, False
        self.turns, self.refused = [0] * self.players, 0
        self.verdicts, self._known_verdicts = [], list(verdicts)
        self._boards, self._news = {}, [[] for _ in range(self.players)]
        self._fence = Fence(seed)
        with self._fence:
            # Made anew, since some constructors draw too.
            self._game, self._brackets, self._clip = load(self.name, self._max_turns)
            for judge in judges_of(self._game):
                judge.ask = self._ask_judge
            self._game.reset(num_players=self.players, seed=seed % 2**32)
        limit, tile = self._game.state.max_turns, getattr(self._game, "target_tile", 0)
        self.most_turns = self._max_turns or max(_MOST_TURNS, limit or 0, tile)
        if limit is None:
            # DontSayIt-v0-unlimited compares it with the turn, in textarena 0.7.4.
            self._game.state.max_turns = sys.maxsize
        self._note_invalid_moves()
        self._spread()

    def _note_invalid_moves(self) -> None:
        """Let the game's state tell of each invalid move."""
        state = self._game.state
        handle = state.set_invalid_move

        def set_invalid_move(*args: Any, **kwargs: Any) -> Any:
            self.invalid = True
            return handle(*args, **kwargs)

        state.set_invalid_move = set_invalid_move

    def replay(self, seed: int, actions: Sequence[str], verdicts: Sequence[str]) -> None:
        """Bring the game to where these actions of all seats lead."""
        self.reset(seed, verdicts)
        for action in actions:
            self.act(action)

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy is made from: the game itself holds functions that no copy can have for its own."""
        made = (self.name, self.players, self._max_turns, self._judge)
        verdicts = [*self.verdicts, *self._known_verdicts]
        return {"made": made, "seed": self.seed, "actions": self.actions, "verdicts": verdicts, "news": self._news}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Make a copy by playing the game again."""
        Table.__init__(self, *state["made"])
        if state["news"]:
            self.replay(state["seed"], state["actions"], state["verdicts"])
            self._news = state["news"]

    def tell(self, seat: int, text: str) -> None:
        """Let a text be all that is new for a seat."""
        self._news[seat] = [text]

    @property
    def seat(self) -> int:
        """Whose turn it is."""
        return int(self._game.state.current_player_id)

    @property
    def game(self) -> Any:
        """TextArena's own game; read only."""
        return self._game

    def look(self, seat: int) -> View:
        """Return what a seat sees; what it knew when it acted last is not shown again, but for the board."""
        texts = self._news[seat]
        board = self._boards.get(seat, "")
        return View("\n".join(texts), f"\n{board}" if board and texts else board)

    def act(self, action: str) -> str:
        """Play a text for the seat whose turn it is; return what of it was played.

        Thinking blocks are no part of it. What TextArena raises comes through, and is not noted.
        """
        action = without_thinking(action)[-LONGEST_ACTION:]
        mover, talk, self.invalid = self.seat, self._is_talk(), False
        with self._fence:
            self.done = bool(self._game.step(action=self._formed(action))[0])
        self.actions.append(action)
        self.turns[mover] += 1
        self.refused = self.refused + 1 if self.invalid and self.seat == mover else 0
        self._news[mover] = []
        self._spread(mover, action, talk=talk)
        return action

    def _spread(self, mover: int = -1, action: str = "", *, talk: bool = False) -> None:
        """Let each seat know what the game has sent it, as far as it may."""
        state = self._game.state
        said = [part for part in map(str.strip, _MOVE.split(action)) if len(part) >= _SHORTEST_ECHO]
        for seat, messages in state.observations.items():
            state.observations[seat] = []
            for sender, message, kind in messages:
                text = str(message)
                if said and seat == mover:
                    for part in said:
                        text = text.replace(part, "…")
                if kind is self._action:
                    own = sender == seat or (seat == mover and sender < 0)
                    text = "" if own else text if talk else self._move(text, messages)
                elif kind is self._board and self._has_board:
                    self._boards[seat] = text
                    continue
                else:
                    text = self._without_board(seat, text)
                if text:
                    who = state.role_mapping.get(sender) or f"Player {sender}"
                    self._news[seat].append(text if kind is self._prompt else f"[{who}] {text}")

    def _move(self, action: str, messages: list[tuple[int, str, Any]]) -> str:
        """Return what another seat hears of an action where the game is not to talk: the move alone.

        Where the game describes the move, its description is enough. Of an action with several pairs of brackets only
        the game knows which is the move, and its board shows it.
        """
        if self.invalid or any(kind is self._description for *_, kind in messages):
            return ""
        moves = set(_MOVE.findall(action))
        return str(moves.pop()) if len(moves) == 1 else ""

    def _without_board(self, seat: int, text: str) -> str:
        """Return what a message says besides the board, and to no other seat."""
        text, updated, board = text.partition(_UPDATED_BOARD)
        if updated:
            self._boards[seat] = board
        if ", you" in text or ", do you" in text:
            text = _ASKED.sub(lambda asked: asked[0] if int(asked[1]) == seat else "", text)
        return text

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
        with fence:
            try:
                game = copy.deepcopy(self._game)
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
        with self._fence:
            return next((float(progress()) for progress in found if progress is not None), 0.0)

    def report(self, seat: int) -> dict[str, Any]:
        """Return what TextArena says about a seat, as plain data."""
        found = self._game.state.game_info.get(seat, {})
        return {str(key): value for key, value in found.items() if isinstance(value, _PLAIN)}


def open_table(
    game: str, players: int, max_turns: int | None = None, judge: Callable[[str], str] | None = None
) -> Table:
    """Return the table of a game, if the game can be played so.

    Raises:
        ArgumentError: There is no such game, or not for so many players or with such a limit.
    """
    if game not in GAMES:
        raise ArgumentError(f"textarena has no game {game!r}.{did_you_mean(str(game), GAMES)} Run 'gem list ta'")
    if type(players) is not int or not 1 <= players <= 15:
        raise ArgumentError(f"players must be a whole number from 1 to 15, not {players!r}")
    if max_turns is not None and (type(max_turns) is not int or max_turns < 1):
        raise ArgumentError(f"max_turns must be a positive whole number, not {max_turns!r}")
    if game.partition("-")[0] in _FOR_TWO and players > 2:
        raise ArgumentError(f"{game} is for two players: with more, textarena 0.7.4 raises when it ends")
    try:
        table = Table(game, players, max_turns, judge)
    except AssertionError as error:
        raise ArgumentError(f"max_turns={max_turns} is not for {game}: {error}") from error
    usual = max(GAMES[game], 1)
    if players != usual:
        try:
            table.reset(0)
        except Exception as error:
            raise ArgumentError(
                f"players={players} is not for {game}, which can be played by {usual}: {error}"
            ) from error
    return table
