"""From a batch that was played to what a policy's loss needs: advantages, and log-probabilities with gradient."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gem_train.estimators import (
    discounted_returns,
    gae,
    grpo_advantages,
    normalize_advantages,
    return_batch_normalization,
    rloo_advantages,
)
from gem_train.learner.model import Policy
from gem_train.learner.options import TrainOptions
from gem_train.tokens import TokenBatch

Floats = NDArray[np.float64]

_CHUNK_TOKENS = 4096
"""Tokens that go through the model at once, for the sake of the processor's caches."""


def turn_advantages(
    batch: TokenBatch, options: TrainOptions, values: Floats, bootstrap: Floats, baselines: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return the advantages and the returns that a critic learns, both (E, T).

    Args:
        batch: What was played.
        options: The algorithm and its constants.
        values: Of the critic, (E, T).
        bootstrap: Of the critic after the last turn, (E,).
        baselines: Subtracted from the returns of each episode, (E,); None for nothing.
    """
    learnable = batch.learnable
    if options.algorithm == "ppo":
        advantages, targets = gae(
            batch.rewards, values, batch.mask, batch.terminated, bootstrap, gamma=options.gamma, lam=options.lam
        )
        return normalize_advantages(advantages, learnable), targets
    returns = discounted_returns(batch.rewards, batch.mask, gamma=options.gamma)
    if baselines is not None:
        returns = np.where(batch.mask, returns - baselines[:, None], 0.0)
    if options.algorithm == "reinforce":
        return np.where(learnable, returns, 0.0), returns
    if options.algorithm == "rebn":
        return return_batch_normalization(returns, learnable), returns
    counts = learnable.any(axis=1)
    if options.algorithm == "rloo":
        of_episode = rloo_advantages(batch.episode_returns, batch.groups, learnable=counts)
    else:
        of_episode = grpo_advantages(
            batch.episode_returns,
            batch.groups,
            scale="std" if options.algorithm == "grpo" else "none",
            learnable=counts,
        )
    return np.where(learnable, of_episode[:, None], 0.0), returns


class Scored(NamedTuple):
    """What the policy gives to rows; (rows, columns), 0 where nothing was sampled.

    Args:
        logprobs: Of the sampled tokens.
        entropy: Of the distribution that each was sampled from.
        values: Estimated return of the turn, where its first token was sampled.
    """

    logprobs: Tensor
    entropy: Tensor
    values: Tensor


def score(policy: Policy, tokens: Tensor, sampled: Tensor, temperature: float = 1.0) -> Scored:
    """Return the log-probabilities of the sampled tokens of some rows, with gradient.

    Args:
        policy: The model.
        tokens: (rows, columns), padded on the right.
        sampled: Whether a token was sampled, (rows, columns).
        temperature: That they were sampled with.
    """
    rows, columns = torch.nonzero(sampled, as_tuple=True)
    if not len(rows):
        nothing = torch.zeros(tokens.shape)
        return Scored(nothing, nothing, nothing)
    # What all rows begin with, such as the rules of a game, is computed once.
    alike = int((tokens == tokens[0]).all(dim=0).long().cumprod(dim=0).sum())
    stream = policy(tokens[:, :-1], min(alike, int(columns.min()) - 1), rows, columns - 1)
    logprobs = torch.log_softmax(policy.logits(stream) / temperature, dim=-1)
    entropy = -(logprobs.exp() * logprobs.clamp(min=-1e4)).sum(dim=-1)
    chosen = logprobs.gather(1, tokens[rows, columns, None]).squeeze(1)
    return Scored(*(_placed(values, rows, columns, tokens) for values in (chosen, entropy, policy.values(stream))))


def _placed(values: Tensor, rows: Tensor, columns: Tensor, tokens: Tensor) -> Tensor:
    return torch.zeros(tokens.shape).index_put((rows, columns), values)


@dataclass(eq=False)
class Rows:
    """The rows of a batch, as one loss needs them; all but ``usable`` are (rows, columns).

    Args:
        tokens: Padded on the right.
        sampled: Whether a token was sampled.
        learnable: Whether it is learnt from.
        starts: Whether it is the first of a turn that is learnt from.
        logprobs: When it was sampled.
        advantages: Of its turn.
        targets: Of the critic, for its turn.
        usable: Numbers of the rows that hold anything to learn from.
    """

    tokens: Tensor
    sampled: Tensor
    learnable: Tensor
    starts: Tensor
    logprobs: Tensor
    advantages: Tensor
    targets: Tensor
    usable: Tensor

    @classmethod
    def of(cls, batch: TokenBatch, advantages: Floats, targets: Floats) -> Rows:
        """Return the rows of a batch.

        Args:
            batch: What was played.
            advantages: (E, T).
            targets: Of the critic, (E, T).
        """
        learnable = batch.loss_mask
        before = np.concatenate([np.full((len(batch.turn), 1), -1), batch.turn[:, :-1]], axis=1)
        return cls(
            tokens=torch.from_numpy(batch.tokens),
            sampled=torch.from_numpy(batch.token_mask),
            learnable=torch.from_numpy(learnable),
            starts=torch.from_numpy(learnable & (batch.turn != before)),
            logprobs=torch.from_numpy(batch.logprobs),
            advantages=torch.from_numpy(batch.to_tokens(advantages)).float(),
            targets=torch.from_numpy(batch.to_tokens(targets)).float(),
            usable=torch.from_numpy(np.flatnonzero(learnable.any(axis=1))),
        )

    def chunks(self, part: Tensor) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """Yield some rows in chunks of like length, equal ones once: a policy that has settled repeats itself.

        Args:
            part: Numbers of the rows.

        Yields:
            Numbers of different rows; for each row of the chunk, which of them it equals; the numbers of these rows.
        """
        tokens = self.tokens[part]
        lengths = (self.learnable[part] * torch.arange(1, tokens.shape[1] + 1)).amax(dim=1)
        equal: dict[bytes, list[int]] = {}
        for row, line, length in zip(part.tolist(), tokens.numpy(), lengths.tolist(), strict=True):
            equal.setdefault(line[:length].tobytes(), []).append(row)
        groups = sorted(equal.items(), key=lambda item: len(item[0]))
        while groups:
            # The last row of a chunk, its longest, says how wide the chunk is.
            width = len(groups[min(len(groups), 256) - 1][0]) // tokens.element_size()
            chunk, groups = groups[: max(1, _CHUNK_TOKENS // width)], groups[max(1, _CHUNK_TOKENS // width) :]
            copies = [place for place, (_, rows) in enumerate(chunk) for _ in rows]
            yield (
                torch.tensor([rows[0] for _, rows in chunk]),
                torch.tensor(copies),
                torch.tensor([row for _, rows in chunk for row in rows]),
            )
