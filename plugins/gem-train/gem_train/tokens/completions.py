"""``completions``: rows as a prompt and what follows it, as TRL, verl and OpenRLHF take them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from gem_train.tokens.token_batch import TokenBatch


class Completion(NamedTuple):
    """A row, cut before its first sampled token.

    Args:
        prompt_ids: What the model was sent at first.
        completion_ids: The responses and, between them, what the environment wrote.
        completion_mask: 1 on tokens that a loss may use, 0 on all others; as long as ``completion_ids``.
        logprobs: Of the sampled tokens, NaN where they are not known; 0 on all others; as long as ``completion_ids``.
        episode: Index of the episode.
    """

    prompt_ids: list[int]
    completion_ids: list[int]
    completion_mask: list[int]
    logprobs: list[float]
    episode: int


def completions(batch: TokenBatch) -> list[Completion]:
    """Return each row as a prompt and its completion.

    TRL calls the parts ``prompt_ids``, ``completion_ids``, ``logprobs`` and ``env_mask``; verl ``prompt_ids``,
    ``response_ids``, ``response_logprobs`` and ``response_mask``.
    """
    found = batch.token_mask.any(axis=1)
    starts = np.where(found, (batch.token_mask.cumsum(axis=1) == 0).sum(axis=1), batch.lengths)
    loss_mask = batch.loss_mask.astype(np.int64)
    return [
        Completion(
            batch.tokens[row, :start].tolist(),
            batch.tokens[row, start:end].tolist(),
            loss_mask[row, start:end].tolist(),
            batch.logprobs[row, start:end].tolist(),
            int(batch.episode[row]),
        )
        for row, (start, end) in enumerate(zip(starts, batch.lengths, strict=True))
    ]
