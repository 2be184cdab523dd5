"""``Table``: one game of TextArena with all its seats; whoever plays them, and through whichever interface."""

from __future__ import annotations

import copy
import sys
from typing import Any, NamedTuple

from gem_games.textarena.fence import Fence
from gem_games.textarena.library import load

_LONGEST_ACTION = 20_000  # characters: some patterns of the library take quadratic time


class View(NamedTuple):
    """What a seat sees: what happened since it was last asked, and the board as it stands, ``""`` if there is none."""

    feedback: str
    board: str


class Table:
    """A game of TextArena: ``act`` plays for the seat whose turn it is.

    Args:
        name: The game's id in TextArena.
        players: How many seats it has.
    """

    def __init__(self, name: str, players: int) -> None:
        self.name, self.players = name, players
        self._fence = Fence(0)
        with self._fence.inside():
            self._game, self._brackets, self._clip = load(name)
        self.seed = 0
        self.actions: list[str] = []
        self.done = False
        self._boards: dict[int, str] = {}

    def reset(self, seed: int) -> None:
        """Deal a game."""
        self.seed, self.actions, self.done = seed, [], False
        self._boards = {}
        self._fence = Fence(seed)
        with self._fence.inside():
            # Made anew, since some constructors draw too.
            self._game, self._brackets, self._clip = load(self.name)
            self._game.reset(num_players=self.players, seed=seed % 2**32)
        if self._game.state.max_turns is None:
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
        for place, (sender, text, kind) in enumerate(messages):
            text = str(text)
            if _kind(kind) == "GAME_BOARD":
                self._boards[seat] = text
                if not any(_kind(later[2]) == "GAME_BOARD" for later in messages[place + 1 :]):
                    continue
            who = state.role_mapping.get(sender, f"Player {sender}")
            texts.append(text if _kind(kind) == "PROMPT" else f"[{who}] {text}")
        return View("\n".join(texts), self._boards.get(seat, ""))

    def act(self, action: str) -> None:
        """Play a text for the seat whose turn it is. What TextArena raises comes through."""
        self.actions.append(action)
        with self._fence.inside():
            self.done = bool(self._game.step(action=self._formed(action))[0])

    def _formed(self, action: str) -> str:
        """Do what the game's own wrappers do to an action."""
        action = action[: self._clip or _LONGEST_ACTION]
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
                # Word lists are never changed, and copying them takes a second: the copy shares them.
                shared = {id(part): part for part in vars(self._game).values() if _is_long(part)}
                game = copy.deepcopy(self._game, shared)
                game.state.set_invalid_move = note
                game.step(action=self._formed(action))
            except Exception:  # noqa: BLE001 - whatever the library raises, the action is not valid
                return False
        return not invalid

    def rewards(self) -> dict[int, float]:
        """Return each seat's reward of a finished game.

        Some games of textarena 0.7.4 give the reason of an invalid move in the reward's place: that is -1, as usual.
        """
        rewards = (self._game.state.rewards or {}).items()
        return {int(seat): float(reward) if isinstance(reward, int | float) else -1.0 for seat, reward in rewards}

    def report(self, seat: int) -> dict[str, Any]:
        """Return what TextArena says about a seat, as plain data."""
        found = self._game.state.game_info.get(seat, {})
        return {str(key): value for key, value in found.items() if isinstance(value, str | int | float | bool | None)}

    def errors(self) -> int:
        """Return the number of invalid moves in a row by the seat whose turn it is."""
        return int(getattr(self._game.state, "error_count", 0))


def _kind(kind: Any) -> str:
    """Return the name of a kind of message; three games of textarena 0.7.4 give a text instead of one."""
    return str(getattr(kind, "name", kind))


def _is_long(part: Any) -> bool:
    return isinstance(part, list | set | frozenset) and len(part) > 1_000
