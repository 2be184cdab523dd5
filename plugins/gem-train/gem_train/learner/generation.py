"""Sampling of responses, with cached keys and values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from gem_train.learner.model import Cache
from gem_train.learner.vocabulary import END, PAD


class Sampled(NamedTuple):
    """A response.

    Args:
        tokens: The sampled tokens, the end token included; one that reached the limit has none.
        logprobs: Natural logarithm of the probability of each.
        value: Estimated return of the turn.
    """

    tokens: list[int]
    logprobs: list[float]
    value: float


@torch.no_grad()
def sample(
    cache: Cache,
    rows: Sequence[int],
    pieces: Sequence[Sequence[int]],
    max_tokens: int,
    *,
    keep: bool,
    generator: torch.Generator | None = None,
    temperature: float = 1.0,
) -> list[Sampled]:
    """Sample a response in each of some rows.

    Args:
        cache: The model, and what it has read of each row.
        rows: Numbers of the rows.
        pieces: What each row goes on with, before the response; what was sampled last is a part of it.
        max_tokens: The most tokens of a response.
        keep: Whether the rows go on later. If not, they begin anew, and what is alike in them is computed once.
        generator: Where random numbers come from.
        temperature: Divides the logits; 0 takes the likeliest token.
    """
    everything = torch.tensor(list(rows))
    drawn = torch.full((len(everything), max_tokens), PAD)
    logprobs = torch.zeros(len(everything), max_tokens)
    if keep:
        working = cache.copy_of(everything, max(map(len, pieces)) + max_tokens)
        values = _sample_apart(working, pieces, drawn, logprobs, generator, temperature)
        cache.take_back(everything, working)
    else:
        cache.lengths[everything] = 0
        values = _sample_together(cache, pieces, drawn, logprobs, generator, temperature)
    lengths = (drawn != PAD).sum(dim=1).tolist()
    return [
        Sampled(said[:length], probabilities[:length], value)
        for said, probabilities, length, value in zip(
            drawn.tolist(), logprobs.tolist(), lengths, values.tolist(), strict=True
        )
    ]


def _sample_apart(
    working: Cache,
    pieces: Sequence[Sequence[int]],
    drawn: Tensor,
    logprobs: Tensor,
    generator: torch.Generator | None,
    temperature: float,
) -> Tensor:
    """Fill in what is sampled, each row by itself, and return the values of the turns."""
    stream = working.read(*_padded(pieces))
    values = working.policy.values(stream)
    running, everyone = torch.ones(len(drawn), dtype=torch.bool), torch.arange(len(drawn))
    for column in range(drawn.shape[1]):
        token, logprob = _draw(_logprobs(working, stream, temperature), everyone, temperature, generator)
        drawn[:, column], logprobs[:, column] = token.where(running, PAD), logprob.where(running, 0.0)
        running &= token != END
        if not running.any() or column + 1 == drawn.shape[1]:
            break
        stream = working.read(token[:, None], running.long())
    return values


def _sample_together(
    cache: Cache,
    pieces: Sequence[Sequence[int]],
    drawn: Tensor,
    logprobs: Tensor,
    generator: torch.Generator | None,
    temperature: float,
) -> Tensor:
    """Do the same where rows begin anew: while rows have the same tokens, they are one state of the model."""
    places: dict[tuple[int, ...], int] = {}
    state = torch.tensor([places.setdefault(tuple(piece), len(places)) for piece in pieces])
    tokens, counts = _padded(list(places))
    limit = drawn.shape[1]
    # What all rows begin with, such as the rules of a game, is read once.
    alike = int((tokens == tokens[0]).all(dim=0)[: int(counts.min()) - 1].long().cumprod(dim=0).sum())
    working = cache.copy_of(torch.zeros(1, dtype=torch.long), alike)
    if alike:
        working.read(tokens[:1, :alike], torch.tensor([alike]))
    working = working.copy_of(torch.zeros(len(places), dtype=torch.long), tokens.shape[1] - alike + limit)
    stream = working.read(tokens[:, alike:], counts - alike)
    values = working.policy.values(stream)[state]
    running = torch.arange(len(pieces))
    for column in range(limit):
        scores = _logprobs(working, stream, temperature)
        token, logprob = _draw(scores, state, temperature, generator)
        drawn[running, column], logprobs[running, column] = token, logprob
        goes_on = token != END
        if not goes_on.any() or column + 1 == limit:
            break
        running = running[goes_on]
        following, state = torch.unique(state[goes_on] * scores.shape[1] + token[goes_on], return_inverse=True)
        before = following // scores.shape[1]
        if not torch.equal(before, torch.arange(len(working.lengths))):
            working = working.copy_of(before, limit - column)
        stream = working.read((following % scores.shape[1])[:, None], torch.ones_like(following))
    return values


def _padded(pieces: Sequence[Sequence[int]]) -> tuple[Tensor, Tensor]:
    """Return pieces as (rows, columns) with padding on the right, and the number of tokens of each."""
    longest = max(map(len, pieces))
    tokens = torch.tensor([[*piece, *[PAD] * (longest - len(piece))] for piece in pieces])
    return tokens, torch.tensor([len(piece) for piece in pieces])


def _logprobs(cache: Cache, stream: Tensor, temperature: float) -> Tensor:
    return torch.log_softmax(cache.policy.logits(stream) / (temperature or 1.0), dim=-1)


def _draw(
    logprobs: Tensor, state: Tensor, temperature: float, generator: torch.Generator | None
) -> tuple[Tensor, Tensor]:
    """Draw a token for each row from the distribution of its state, by the inverse of the cumulative one."""
    if temperature:
        cumulative = logprobs.exp().cumsum(dim=-1)
        below = torch.rand(len(state), 1, generator=generator) * (1 - 1e-6) * cumulative[state, -1:]
        token = (cumulative[state] <= below).sum(dim=-1)
    else:
        token = logprobs.argmax(dim=-1)[state]
    return token, logprobs[state, token]
