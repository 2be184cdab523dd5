"""Who plays the other seats, or judges: what an agent there is sent, and the conversation that it can reach."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from gem_core.background import run_sync
from gem_core.errors import ArgumentError
from gem_core.rollouts import Context, Reading, as_agent, load_agent


class Player:
    """An agent that answers within an environment, with what it was asked and has answered in this episode.

    Args:
        agent: An agent, or the name of one.
    """

    def __init__(self, agent: Any) -> None:
        self._agent = load_agent(agent) if isinstance(agent, str) else as_agent(agent)
        self._reading = Reading.of(self._agent)
        self._said: list[tuple[str, str]] = []

    def begin(self) -> None:
        """Forget what was said in an earlier episode."""
        self._said = []

    def note(self, question: str, answer: str) -> None:
        """Take a question and what was made of the answer into the conversation."""
        self._said.append((question, answer))

    def ask(self, question: str, *, episode: str, env_id: str, sample: Callable[[], str]) -> str:
        """Return the agent's answer; it is noted by whoever knows what of it counts."""
        context = Context(
            episode=episode,
            env_id=env_id,
            group=None,
            turn=len(self._said),
            info={},
            tools=[],
            transitions=[],
            system=self._reading.system,
            draw_action=sample,
            read_messages=lambda: self._messages(question),
        )
        answer = self._agent(context.messages if self._reading.reads == "messages" else question, context)
        return str(answer if isinstance(answer, str) else run_sync(answer))

    def _messages(self, question: str) -> list[dict[str, Any]]:
        system = self._reading.system
        messages = [] if system is None else [{"role": "system", "content": system}]
        for asked, answered in self._said:
            messages += [{"role": "user", "content": asked}, {"role": "assistant", "content": answered}]
        return [*messages, {"role": "user", "content": question}]


def opponent_of(given: Any, seat: int, others: list[int]) -> Player | None:
    """Return who plays a seat, or None for the random player.

    Args:
        given: What was given as ``opponents``.
        seat: Which seat.
        others: All seats that the agent does not hold.

    Raises:
        ArgumentError: It does not fit these seats.
    """
    if isinstance(given, Mapping):
        wrong = [key for key in given if key not in others]
        if wrong:
            raise ArgumentError(f"opponents names seat {wrong[0]!r}, and the other seats are {others}")
        given = given.get(seat, "random")
    elif isinstance(given, Sequence) and not isinstance(given, str):
        if len(given) != len(others):
            raise ArgumentError(f"opponents must be {len(others)}, one for each other seat, not {len(given)}")
        given = given[others.index(seat)]
    return None if given == "random" else Player(given)
