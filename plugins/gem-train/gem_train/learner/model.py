"""The policy: a small decoder-only transformer with a value head."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from gem_train.learner.options import TrainOptions
from gem_train.learner.vocabulary import ANSWER, PAD

KeysValues = tuple[Tensor, Tensor]
"""Keys and values of a layer: (rows, heads, columns, width of a head)."""


class Block(nn.Module):
    """Attention and a feed-forward layer, each normalized first."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.attention_norm, self.feed_norm = nn.LayerNorm(width), nn.LayerNorm(width)
        self.project, self.out = nn.Linear(width, 3 * width, bias=False), nn.Linear(width, width, bias=False)
        self.widen, self.narrow = nn.Linear(width, 4 * width), nn.Linear(4 * width, width)

    def qkv(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return queries, keys and values, each (rows, heads, columns, width of a head)."""
        parts = self.project(self.attention_norm(x)).unflatten(2, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        return parts[0], parts[1], parts[2]

    def finish(self, x: Tensor, attended: Tensor) -> Tensor:
        """Return the stream after this block: (…, width), from what attention read."""
        x = x + self.out(attended)
        finished: Tensor = x + self.narrow(F.gelu(self.widen(self.feed_norm(x))))
        return finished


class Policy(nn.Module):
    """A language model that also estimates the return of a turn.

    Args:
        texts: Text of each token, in the order of their ids.
        options: Of the run, with the sizes.
    """

    def __init__(self, texts: Sequence[str], options: TrainOptions) -> None:
        super().__init__()
        width = options.width
        self.options = options
        self.embedding, self.positions = nn.Embedding(len(texts), width), nn.Embedding(options.context, width)
        self.stack = nn.ModuleList(Block(width, options.heads) for _ in range(options.layers))
        self.norm = nn.LayerNorm(width)
        self.unembedding, self.value = nn.Linear(width, len(texts), bias=False), nn.Linear(width, 1)
        self._initialize(texts)

    @property
    def blocks(self) -> list[Block]:
        """Its layers, first to last."""
        return cast("list[Block]", list(self.stack))

    def forward(self, tokens: Tensor, prefix: int, rows: Tensor, columns: Tensor) -> Tensor:
        """Return the stream at some places, (places, width).

        Args:
            tokens: (rows, columns), padded on the right.
            prefix: Number of columns that are the same in all rows, and are computed once.
            rows: Row of each place.
            columns: Column of each place, ``prefix`` or above.
        """
        length = tokens.shape[1]
        shared = self.embedding(tokens[:1, :prefix]) + self.positions.weight[:prefix]
        x = self.embedding(tokens[:, prefix:]) + self.positions.weight[prefix:length]
        mask = torch.ones(length - prefix, length, dtype=torch.bool, device=tokens.device).tril(prefix)
        *earlier, last = self.blocks
        for block in (*earlier, last):
            query, key, value = block.qkv(x)
            if prefix:
                first_query, first_key, first_value = block.qkv(shared)
                attended = F.scaled_dot_product_attention(first_query, first_key, first_value, is_causal=True)
                shared = block.finish(shared, attended.transpose(1, 2).flatten(2))
                key = torch.cat([first_key.expand(len(key), -1, -1, -1), key], dim=2)
                value = torch.cat([first_value.expand(len(value), -1, -1, -1), value], dim=2)
            attended = F.scaled_dot_product_attention(query, key, value, attn_mask=mask)
            attended = attended.transpose(1, 2).flatten(2)
            if block is last:  # nothing reads the other places any more
                x, attended = x[rows, columns - prefix], attended[rows, columns - prefix]
            x = block.finish(x, attended)
        stream: Tensor = x
        return stream

    def logits(self, stream: Tensor) -> Tensor:
        """Return the logits of the next token, (…, vocabulary); padding and the mark of a response are never drawn."""
        logits: Tensor = self.unembedding(self.norm(stream))
        logits[..., [PAD, ANSWER]] = -torch.inf
        return logits

    def values(self, stream: Tensor) -> Tensor:
        """Return the estimated return, (…)."""
        values: Tensor = self.value(self.norm(stream)).squeeze(-1)
        return values

    @torch.no_grad()
    def _initialize(self, texts: Sequence[str]) -> None:
        for parameter in self.parameters():
            if parameter.dim() == 2:
                nn.init.normal_(parameter, std=0.5 * parameter.shape[1] ** -0.5)
        nn.init.normal_(self.embedding.weight, std=0.5)
        nn.init.normal_(self.positions.weight, std=0.05)
        nn.init.zeros_(self.value.weight)
        # A number begins with waves of its value, as a position does: so what is learnt of 24 holds nearly for 25.
        for index, text in enumerate(texts):
            if text.isascii() and text.isdigit() and len(text) < 7:
                waves = _waves(int(text), self.options.width)
                self.embedding.weight[index], self.unembedding.weight[index] = 0.5 * waves, 0.3 * waves


class Cache:
    """Keys and values of what was read so far, row by row, and how much of each row that is.

    Args:
        policy: That reads.
        rows: Number of rows.
    """

    def __init__(self, policy: Policy, rows: int) -> None:
        options = policy.options
        shape = (rows, options.heads, options.context, options.width // options.heads)
        self.policy = policy
        self.layers = [(torch.zeros(shape), torch.zeros(shape)) for _ in range(options.layers)]
        self.lengths = torch.zeros(rows, dtype=torch.long)

    @torch.no_grad()
    def read(self, tokens: Tensor, counts: Tensor) -> Tensor:
        """Read the next tokens of all rows, and return the stream after the last of each, (rows, width).

        Args:
            tokens: (rows, columns), padded on the right.
            counts: Number of tokens of each row; of a row without any, the stream means nothing.
        """
        places = self.lengths[:, None] + torch.arange(tokens.shape[1])
        places.clamp_(max=self.layers[0][0].shape[2] - 1)  # of padding
        end, rows = int(places.max()) + 1, torch.arange(len(tokens))
        mask = (torch.arange(end) <= places[..., None])[:, None]
        x = self.policy.embedding(tokens) + self.policy.positions(places)
        for block, (keys, values) in zip(self.policy.blocks, self.layers, strict=True):
            query, key, value = block.qkv(x)
            keys[rows[:, None], :, places], values[rows[:, None], :, places] = (
                key.transpose(1, 2),
                value.transpose(1, 2),
            )
            attended = F.scaled_dot_product_attention(query, keys[:, :, :end], values[:, :, :end], attn_mask=mask)
            x = block.finish(x, attended.transpose(1, 2).flatten(2))
        self.lengths += counts
        after: Tensor = x[rows, (counts - 1).clamp(min=0)]
        return after

    def copy_of(self, rows: Tensor, columns: int) -> Cache:
        """Return some rows, with room for more columns than they have.

        Args:
            rows: Numbers of the rows; a row may be there several times.
            columns: To be read after the longest of them.
        """
        copy = object.__new__(Cache)
        copy.policy, copy.lengths = self.policy, self.lengths[rows]
        longest = int(copy.lengths.max())
        width = min(longest + columns, self.policy.options.context)
        shape = (len(rows), self.policy.options.heads, width, self.layers[0][0].shape[3])
        copy.layers = [(torch.zeros(shape), torch.zeros(shape)) for _ in self.layers]
        for (keys, values), (new_keys, new_values) in zip(self.layers, copy.layers, strict=True):
            new_keys[:, :, :longest], new_values[:, :, :longest] = keys[rows, :, :longest], values[rows, :, :longest]
        return copy

    def take_back(self, rows: Tensor, copy: Cache) -> None:
        """Put the rows of a copy back."""
        width = int(copy.lengths.max())
        for (keys, values), (new_keys, new_values) in zip(self.layers, copy.layers, strict=True):
            keys[rows, :, :width], values[rows, :, :width] = new_keys[:, :, :width], new_values[:, :, :width]
        self.lengths[rows] = copy.lengths


def _waves(number: int, width: int) -> Tensor:
    frequencies = torch.exp(torch.linspace(math.log(2 * math.pi / 256), math.log(math.pi / 2), width // 2))
    return torch.cat([torch.sin(number * frequencies), torch.cos(number * frequencies)])
