"""Puts right how games of textarena 0.7.4 end: as it is, the first seven raise then.

- Tak names the winner under another keyword than its state takes;
- Checkers and FifteenPuzzle call what their state does not have, and so do Briscola and Golf with more than two seats;
- ScenarioPlanning misspells a keyword in a draw;
- Stratego keeps a bomb that was defused in its list of pieces, and later looks for it on the board;
- who is eliminated in PublicGoodsGame or MarketEntryGame is asked again and again, and if all are, the search for the
  next player never ends;
- Bandit compares the button that is chosen at the end with a table of all, and so takes none for the best.
"""

from __future__ import annotations

import re
from typing import Any

_WINNER = re.compile(r"Player (\d+) wins")


def put_right(states: Any, spaces: list[dict[str, Any]]) -> None:
    """Change the state classes, and the class of Stratego where it is loaded; once is enough, twice does no harm.

    Args:
        states: The module ``textarena.state``.
        spaces: The names in the modules of games that are loaded.
    """
    two = states.TwoPlayerState
    if not hasattr(states.SinglePlayerState, "set_winners"):
        win = two.set_winner

        def set_winner(self: Any, player_id: Any = None, reason: str = "", player_ids: Any = None) -> None:
            win(self, player_ids if player_id is None else player_id, reason)

        draw = two.set_draw

        def set_draw(self: Any, reason: str = "", reson: str = "") -> None:
            draw(self, reason or reson)

        two.set_winner = two.set_winners = set_winner
        two.set_draw = set_draw
        states.SinglePlayerState.set_winners = _solved
        states.FFAMultiPlayerState.set_outcome = _one_wins
        states.FFAMultiPlayerState.step = _passing_by_the_eliminated(states.FFAMultiPlayerState.step)
    for space in spaces:
        if "StrategoEnv" in space:
            space["StrategoEnv"]._check_winner = _stratego_winner
        if "BanditEnv" in space and not hasattr(space["BanditEnv"].reset, "tells_the_best"):
            space["BanditEnv"].reset = _telling_the_best(space["BanditEnv"].reset)


class _Means(dict[str, float]):
    """The mean of each button, which equals the name of the best."""

    __hash__ = None  # as that of any dict

    def __eq__(self, other: object) -> bool:
        return other == max(self, key=self.__getitem__) if isinstance(other, str) else super().__eq__(other)


def _telling_the_best(reset: Any) -> Any:
    """Return a ``reset`` of Bandit after which its comparison finds the best button."""

    def begin(self: Any, num_players: int, seed: int | None = None) -> Any:
        reset(self, num_players=num_players, seed=seed)
        self.state.game_state["ground_truth"] = _Means(self.state.game_state["ground_truth"])

    begin.tells_the_best = True  # type: ignore[attr-defined]  # functions take attributes
    return begin


def _passing_by_the_eliminated(step: Any) -> Any:
    """Return a ``step`` of a game for many that goes on to who is left, and ends where nobody is."""

    def go_on(self: Any, rotate_player: bool = True) -> Any:
        if self.current_player_id in self.elimination_order:
            self.made_invalid_move = False  # which would have the same player try once more
        if not self.done and len(set(self.elimination_order)) >= self.num_players:
            self.set_draw("All players are eliminated.")
        return step(self, rotate_player)

    return go_on


def _solved(self: Any, player_ids: Any, reason: str) -> None:
    self.set_outcome(reward=1, reason=reason)


def _one_wins(self: Any, reward: float, reason: str) -> None:
    """Note the winner that is named in the reason; the reward is that of the seat which moved last."""
    named = _WINNER.search(reason)
    self.set_winners([int(named.group(1))] if named else [], reason)


def _stratego_winner(self: Any) -> int | None:
    """Return who has won, if one has only bombs and the flag left on the board."""
    pieces = [piece for row in self.board for piece in row if isinstance(piece, dict)]
    movable = {piece["player"] for piece in pieces if piece["rank"] not in ("Bomb", "Flag")}
    return next((1 - player for player in range(2) if player not in movable), None)
