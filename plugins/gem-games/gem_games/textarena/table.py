"""``Table``: one game of TextArena with all its seats; whoever plays them, and through whichever interface."""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

from gem_games.textarena.fence import Fence
from gem_games.textarena.library import copied, load

LONGEST_ACTION = 4_000
"""Characters; of a longer action the end is read, since some patterns of the library take quadratic time."""


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
            if kind.name == "GAME_BOARD":
                self._boards[seat] = text
                if not any(later[2].name == "GAME_BOARD" for later in messages[place + 1 :]):
                    continue
            who = state.role_mapping.get(sender, f"Player {sender}")
            texts.append(text if kind.name == "PROMPT" else f"[{who}] {text}")
        return View("\n".join(texts), self._boards.get(seat, ""))

    def act(self, action: str) -> None:
        """Play a text for the seat whose turn it is. What TextArena raises comes through, and is not noted."""
        action = action[-LONGEST_ACTION:]
        with self._fence.inside():
            self.done = bool(self._game.step(action=self._formed(action))[0])
        self.actions.append(action)

    def _formed(self, action: str) -> str:
        """Do what the game's own wrappers do to an action."""
        action = action[: self._clip]
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
                game.state.set_invalid_move = note
                game.step(action=self._formed(action))
            except Exception:  # noqa: BLE001 - whatever the library raises, the action is not valid
                return False
        return not invalid

    def rewards(self) -> dict[int, float]:
        """Return each seat's reward of a finished game."""
        return {int(seat): float(reward) for seat, reward in (self._game.state.rewards or {}).items()}

    def report(self, seat: int) -> dict[str, Any]:
        """Return what TextArena says about a seat, as plain data."""
        found = self._game.state.game_info.get(seat, {})
        return {str(key): value for key, value in found.items() if isinstance(value, str | int | float | bool | None)}

    def errors(self) -> int:
        """Return the number of invalid moves in a row by the seat whose turn it is."""
        return int(getattr(self._game.state, "error_count", 0))
