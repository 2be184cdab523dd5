"""``TokenBatch``: rows of tokens, and the turns that they belong to."""

from __future__ import annotations

from collections.abc import Sequence, Sized
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gem_core.errors import ArgumentError

Ids = Sequence[int] | NDArray[Any]
"""Token ids of one piece of a row: a list, or an array of one dimension."""

Logprobs = Sequence[float] | NDArray[Any] | None
"""One log-probability for each sampled token; None where they are not known."""


@dataclass(eq=False)
class TokenBatch:
    """Rows of tokens, and the turns that they belong to.

    E episodes have at most T turns; the tokens are in rows of at most L, each of one turn or several of an episode.
    Arrays (E, T) have the turns first and padding after them.

    Args:
        tokens: int64, (rows, L); padded on the right.
        lengths: int64, (rows,); number of tokens of each row.
        token_mask: bool, (rows, L); True on tokens that the model sampled. A loss takes ``loss_mask`` instead.
        logprobs: float32, (rows, L); of the sampled tokens as the sampler reported them, NaN where it did not; 0 on all
            other tokens.
        episode: int64, (rows,); index of the row's episode.
        turn: int64, (rows, L); the turn in which a token was sampled; -1 on all other tokens.
        rewards: float64, (E, T); reward of each turn.
        mask: bool, (E, T); True where there is a turn.
        learnable: bool, (E, T); the turns that a loss may use.
        states: int64, (E, T); equal for turns before which things stood alike, -1 where there is no turn.
        terminated: bool, (E,); the task was over.
        truncated: bool, (E,); the episode was cut off from outside.
        groups: int64, (E,); equal for episodes that share a start.
        success: float64, (E,); 1 for solved, 0 for not solved, NaN for unknown.
        first_rewards: float64, (E,); reward that came before the first turn, for what others had done.
        seats: Name of the agent's seat in each episode; None where it was alone.
        too_long: Number of turns whose tokens do not fit in ``max_length``; they are not learnable.
    """

    tokens: NDArray[np.int64]
    lengths: NDArray[np.int64]
    token_mask: NDArray[np.bool_]
    logprobs: NDArray[np.float32]
    episode: NDArray[np.int64]
    turn: NDArray[np.int64]
    rewards: NDArray[np.float64]
    mask: NDArray[np.bool_]
    learnable: NDArray[np.bool_]
    states: NDArray[np.int64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    groups: NDArray[np.int64]
    success: NDArray[np.float64]
    first_rewards: NDArray[np.float64]
    seats: list[str | None]
    too_long: int = 0

    @property
    def loss_mask(self) -> NDArray[np.bool_]:
        """The sampled tokens of learnable turns: bool, (rows, L)."""
        return self.to_tokens(self.learnable)

    @property
    def episode_returns(self) -> NDArray[np.float64]:
        """Sum of each episode's rewards, undiscounted, with the reward before its first turn: float64, (E,)."""
        # Sorted, so that equal rewards in another order have the same sum.
        returns: NDArray[np.float64] = np.sort(np.column_stack([self.first_rewards, self.rewards])).sum(axis=1)
        return returns

    def to_tokens(self, per_turn: ArrayLike) -> NDArray[Any]:
        """Give each sampled token the value of its turn, as its advantage.

        Args:
            per_turn: (E, T).

        Returns:
            The values, (rows, L), in the same dtype; 0 on tokens that were not sampled.

        Raises:
            ArgumentError: The shape is another than that of ``rewards``.
        """
        given = np.asarray(per_turn)
        if given.shape != self.rewards.shape:
            raise ArgumentError(f"values by turn have the shape {self.rewards.shape} of rewards, not {given.shape}")
        at = np.nonzero(self.token_mask)
        return _filled(self.tokens.shape, 0, given.dtype, at, given[self.episode[at[0]], self.turn[at]])

    def to_last_tokens(self, per_turn: ArrayLike) -> NDArray[Any]:
        """Give the last sampled token of each turn the value of the turn, as its reward; see ``to_tokens``.

        The value of a turn without tokens, as that of an empty response, is left out.
        """
        after = np.full_like(self.turn, -1)
        after[:, :-1] = self.turn[:, 1:]
        values = self.to_tokens(per_turn)
        values[self.turn == after] = 0
        return values

    @classmethod
    def from_turns(
        cls,
        contexts: Sequence[Ids],
        responses: Sequence[Ids],
        logprobs: Sequence[Logprobs] | None = None,
        *,
        episode: ArrayLike,
        rewards: ArrayLike,
        terminated: ArrayLike,
        row: ArrayLike | None = None,
        learnable: ArrayLike | None = None,
        states: ArrayLike | None = None,
        truncated: ArrayLike | None = None,
        groups: ArrayLike | None = None,
        success: ArrayLike | None = None,
        first_rewards: ArrayLike | None = None,
        seats: Sequence[str | None] | None = None,
        pad_id: int = 0,
        max_length: int | None = None,
    ) -> TokenBatch:
        """Make a batch from lists of token ids, one for each of N turns.

        ::

            # two turns of episode 0 and one of episode 1, each in a row of its own
            TokenBatch.from_turns(
                contexts=[[1, 2], [1, 2, 7, 3], [1, 5]],
                responses=[[7], [8, 9], [7]],
                episode=[0, 0, 1],
                rewards=[0.0, 1.0, 0.5],
                terminated=[True, False],
            )

        Args:
            contexts: Ids that stand before each response: those that the model was sent or, where the turn goes on with
                the row of the one before it, those that the environment wrote since.
            responses: Ids that the model sampled in each turn.
            logprobs: Log-probabilities of the responses; None where they are not known.
            episode: Index of each turn's episode; the turns of one episode come in order.
            rewards: Reward of each turn.
            terminated: Whether the task was over, for each of E episodes, those without turns included.
            row: Index of each turn's row: 0, and the same or one more from turn to turn; by default a row for each.
            learnable: Whether a loss may use each turn; by default all.
            states: Number of the state before each turn; by default all different.
            truncated: Whether each episode was cut off from outside; by default all that have not terminated.
            groups: For each episode; by default all different.
            success: For each episode; by default unknown.
            first_rewards: For each episode; by default 0.
            seats: For each episode; by default None.
            pad_id: Stands in ``tokens`` after the end of a row.
            max_length: Cut longer rows off on the right; the turns whose tokens do not fit are not learnable.

        Raises:
            ArgumentError: The lengths of the arguments do not fit together.
        """
        count, total = len(responses), len(np.asarray(terminated))
        owner = _column("episode", episode, count, np.int64)
        in_row = _column("row", row, count, np.int64, default=np.arange(count))
        _check_rows(in_row, owner, total)
        _check_length("contexts", contexts, count)
        _check_length("logprobs", logprobs, count)
        _check_length("seats", seats, total)
        number = _number_in_episode(owner)
        by_token, too_long = _laid_out(contexts, responses, logprobs, in_row, number, pad_id, max_length)
        usable = _column("learnable", learnable, count, np.bool_, default=True)
        known = _column("states", states, count, np.int64, default=np.arange(count))
        place, shape = (owner, number), (total, int(number.max(initial=-1)) + 1)
        ended = _column("terminated", terminated, total, np.bool_)
        return cls(
            **by_token,
            episode=owner[np.diff(in_row, prepend=-1) == 1],
            rewards=_filled(shape, 0, np.float64, place, _column("rewards", rewards, count, np.float64)),
            mask=_filled(shape, False, np.bool_, place, True),
            learnable=_filled(shape, False, np.bool_, place, usable & ~too_long),
            states=_filled(shape, -1, np.int64, place, known),
            terminated=ended,
            truncated=_column("truncated", truncated, total, np.bool_, default=~ended),
            groups=_column("groups", groups, total, np.int64, default=np.arange(total)),
            success=_column("success", success, total, np.float64, default=np.nan),
            first_rewards=_column("first_rewards", first_rewards, total, np.float64, default=0),
            seats=[None] * total if seats is None else list(seats),
            too_long=int(too_long.sum()),
        )


def _laid_out(
    contexts: Sequence[Ids],
    responses: Sequence[Ids],
    logprobs: Sequence[Logprobs] | None,
    in_row: NDArray[np.int64],
    number: NDArray[np.int64],
    pad_id: int,
    max_length: int | None,
) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
    """Lay the tokens out in rows.

    Args:
        contexts: See ``from_turns``, as for ``responses``, ``logprobs``, ``pad_id`` and ``max_length``.
        responses: One for each turn.
        logprobs: One for each response.
        in_row: Row of each turn.
        number: Number of each turn in its episode.
        pad_id: For the end of a row.
        max_length: Longest row.

    Returns:
        The arrays of tokens by name, and which turns do not fit in their row.
    """
    sizes = np.array([len(context) + len(said) for context, said in zip(contexts, responses, strict=True)], np.int64)
    row_sizes = np.bincount(in_row, sizes).astype(np.int64)
    shape = len(row_sizes), int(row_sizes.max(initial=0))
    tokens, of_turn = np.full(shape, pad_id, np.int64), np.full(shape, -1, np.int64)
    by_token = np.zeros(shape, np.float32)
    ends = np.cumsum(sizes) - (np.cumsum(row_sizes) - row_sizes)[in_row]
    for turn, (row, end, context, said) in enumerate(zip(in_row, ends, contexts, responses, strict=True)):
        start = end - len(said)
        tokens[row, start - len(context) : start] = context
        tokens[row, start:end] = said
        of_turn[row, start:end] = number[turn]
        reported = None if logprobs is None else logprobs[turn]
        if reported is not None and len(reported) != len(said):
            raise ArgumentError(f"turn {turn} of the list has {len(said)} tokens and {len(reported)} logprobs")
        by_token[row, start:end] = np.nan if reported is None else reported
    lengths = row_sizes if max_length is None else np.minimum(row_sizes, max_length)
    kept = slice(max_length)
    arrays = {
        "tokens": tokens[:, kept],
        "lengths": lengths,
        "token_mask": of_turn[:, kept] >= 0,
        "logprobs": by_token[:, kept],
        "turn": of_turn[:, kept],
    }
    return arrays, ends > lengths[in_row]


def _column(name: str, values: ArrayLike | None, length: int, dtype: type[Any], *, default: Any = None) -> NDArray[Any]:
    column = np.asarray(np.broadcast_to(default, length) if values is None else values, dtype)
    if column.shape != (length,):
        raise ArgumentError(f"{name} has the shape {column.shape}, and ({length},) is needed")
    return column


def _check_length(name: str, values: Sized | None, length: int) -> None:
    if values is not None and len(values) != length:
        raise ArgumentError(f"{name} has the length {len(values)}, and {length} is needed")


def _check_rows(rows: NDArray[np.int64], episodes: NDArray[np.int64], count: int) -> None:
    step = np.diff(rows, prepend=-1)
    if (step[:1] != 1).any() or ((step != 0) & (step != 1)).any():
        raise ArgumentError("row begins with 0 and is, from turn to turn, the same or one more")
    if (episodes[1:] != episodes[:-1])[step[1:] == 0].any():
        raise ArgumentError("a row holds turns of one episode")
    if len(episodes) and not 0 <= episodes.min() <= episodes.max() < count:
        raise ArgumentError(f"episode is an index from 0 to {count - 1}, one less than the length of terminated")


def _number_in_episode(episodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return of each turn how many of the same episode come before it."""
    order = np.argsort(episodes, kind="stable")
    ordered = episodes[order]
    numbers = np.empty_like(episodes)
    numbers[order] = np.arange(len(order)) - np.searchsorted(ordered, ordered)
    return numbers


def _filled(shape: tuple[int, ...], fill: Any, dtype: Any, at: tuple[Any, ...], values: Any) -> NDArray[Any]:
    """Return an array that holds values at some places, and the fill everywhere else."""
    array: NDArray[Any] = np.full(shape, fill, dtype)
    array[at] = values
    return array
