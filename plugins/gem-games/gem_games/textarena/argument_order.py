"""Puts right what games of textarena 0.7.4 hand to their state in the wrong order.

Countdown, Cryptarithm, Slitherlink and ThreeCardMonte give the reward of an invalid move as its reason and the reason
as the reward; the first three also mix up who said what when they note an action. CharacterConclave does not say
what kind of message it notes.
"""

from __future__ import annotations

from enum import Enum
from typing import Any

GAME = -1


def put_right(states: Any) -> None:
    """Let the state classes of TextArena read both orders; once is enough.

    Args:
        states: The module ``textarena.state``.
    """
    single = states.SinglePlayerState
    if hasattr(single.set_invalid_move, "reads_both"):
        return
    note_invalid, observe = single.set_invalid_move, states.ta.State.add_observation

    def set_invalid_move(self: Any, reason: Any, reward: Any = -1.0) -> Any:
        if isinstance(reward, str):
            reason, reward = reward, reason
        return note_invalid(self, reason=reason, reward=reward)

    def add_observation(
        self: Any, message: Any, observation_type: Any = None, from_id: Any = GAME, to_id: int = -1
    ) -> None:
        if observation_type is None:
            kinds = states.ta.ObservationType
            observation_type = kinds.GAME_MESSAGE if from_id == GAME else kinds.PLAYER_ACTION
        elif isinstance(from_id, Enum):
            message, observation_type, from_id = observation_type, from_id, message
        observe(self, message=message, observation_type=observation_type, from_id=from_id, to_id=to_id)

    set_invalid_move.reads_both = True  # type: ignore[attr-defined]  # functions take attributes
    single.set_invalid_move = set_invalid_move
    states.ta.State.add_observation = add_observation
