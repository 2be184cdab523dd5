"""Sampling of responses, with cached keys and values."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from gem_train.learner.model import Policy, pad_prompts
from gem_train.learner.vocabulary import END, PAD


@dataclass
class Sampled:
    """Responses to prompts.

    Args:
        tokens: The sampled tokens, (rows, columns); after the end of a response comes padding.
        logprobs: Natural logarithm of the probability of each, (rows, columns); 0 in the padding.
        lengths: Number of sampled tokens of each row, the end token included.
        values: Estimated return of each turn, (rows,).
    """

    tokens: Tensor
    logprobs: Tensor
    lengths: Tensor
    values: Tensor


@torch.no_grad()
def sample(policy: Policy, prompts: list[list[int]], max_tokens: int, *, generator: torch.Generator | None = None, temperature: float = 1.0) -> Sampled:
    """Sample a response to each prompt. Equal prompts are read once.

    Args:
        policy: The model.
        prompts: Ids of each prompt.
        max_tokens: The most tokens of a response; one that reaches it has no end token.
        generator: Where random numbers come from.
        temperature: Divides the logits; 0 takes the likeliest token.
    """
    places: dict[tuple[int, ...], int] = {}
    row_of = torch.tensor([places.setdefault(tuple(prompt), len(places)) for prompt in prompts])
    tokens, prompt = pad_prompts([list(unique) for unique in places])
    stream, cache = policy.extend(tokens, prompt, tokens.shape[1] - 1, None)
    stream, prompt = stream[row_of, -1], prompt[row_of]
    cache = [(key[row_of], value[row_of]) for key, value in cache]
    values = policy.values(stream)
    drawn, logprobs = [], []
    running = torch.ones(len(prompts), dtype=torch.bool)
    while True:
        token, logprob = _draw(policy.logits(stream), temperature, generator)
        drawn.append(torch.where(running, token, PAD))
        logprobs.append(torch.where(running, logprob, 0.0))
        running = running & (token != END)
        if len(drawn) == max_tokens or not running.any():
            break
        stream, cache = policy.extend(drawn[-1][:, None], prompt, 0, cache)
        stream = stream[:, -1]
    tokens = torch.stack(drawn, dim=1)
    return Sampled(tokens, torch.stack(logprobs, dim=1), (tokens != PAD).sum(dim=1), values)


def _draw(logits: Tensor, temperature: float, generator: torch.Generator | None) -> tuple[Tensor, Tensor]:
    logprobs = torch.log_softmax(logits / (temperature or 1.0), dim=-1)
    token = torch.multinomial(logprobs.exp(), 1, generator=generator).squeeze(1) if temperature else logprobs.argmax(-1)
    return token, logprobs.gather(1, token[:, None]).squeeze(1)
