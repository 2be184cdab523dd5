"""The policy: a small decoder-only transformer with a value head.

Every batch has one layout: prompts end at the same column (padding is before them) and responses begin at the next
(padding is after them). So the last layer, whose cost is half of it in a model of two, is computed at the columns alone
from which a token is drawn, in generation as in learning.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from gem_train.learner.vocabulary import ANSWER, PAD


@dataclass(frozen=True)
class ModelOptions:
    """Sizes of the policy.

    Args:
        vocabulary: Number of tokens.
        layers: Number of blocks.
        width: Width of the residual stream.
        heads: Number of heads of attention.
        context: The most tokens of a prompt and its response together.
    """

    vocabulary: int
    layers: int = 2
    width: int = 64
    heads: int = 4
    context: int = 512


Cache = list[tuple[Tensor, Tensor]]
"""Keys and values of each layer: (rows, heads, columns, width / heads)."""


class Block(nn.Module):
    """Attention and a feed-forward layer, each normalized first."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.attention_norm, self.feed_norm = nn.LayerNorm(width), nn.LayerNorm(width)
        self.query, self.key_value = nn.Linear(width, width, bias=False), nn.Linear(width, 2 * width, bias=False)
        self.out = nn.Linear(width, width, bias=False)
        self.feed = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))

    def forward(self, x: Tensor, mask: Tensor, first: int, cached: tuple[Tensor, Tensor] | None) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """Return the stream at the columns from ``first`` on, and the keys and values of all columns.

        Args:
            x: Stream at new columns, (rows, columns, width).
            mask: Which columns a column attends to, (rows, 1, columns from first on, all columns).
            first: First column that is needed.
            cached: Keys and values of the columns before.
        """
        normed = self.attention_norm(x)
        key, value = (self._split(part) for part in self.key_value(normed).chunk(2, dim=-1))
        if cached is not None:
            key, value = torch.cat([cached[0], key], dim=2), torch.cat([cached[1], value], dim=2)
        query = self._split(self.query(normed[:, first:]))
        attended = F.scaled_dot_product_attention(query, key, value, attn_mask=mask)
        x = x[:, first:] + self.out(attended.transpose(1, 2).flatten(2))
        return x + self.feed(self.feed_norm(x)), (key, value)

    def _split(self, x: Tensor) -> Tensor:
        return x.unflatten(2, (self.heads, -1)).transpose(1, 2)


class Policy(nn.Module):
    """A language model that also estimates the return of a turn.

    Args:
        options: Its sizes.
    """

    def __init__(self, options: ModelOptions) -> None:
        super().__init__()
        self.options = options
        self.embedding = nn.Embedding(options.vocabulary, options.width)
        self.positions = nn.Embedding(2 * options.context, options.width)
        self.blocks = nn.ModuleList(Block(options.width, options.heads) for _ in range(options.layers))
        self.norm = nn.LayerNorm(options.width)
        self.unembedding = nn.Linear(options.width, options.vocabulary, bias=False)
        self.value = nn.Linear(options.width, 1)
        for parameter in self.parameters():
            if parameter.dim() == 2:
                nn.init.normal_(parameter, std=0.02 if parameter is not self.embedding.weight else 0.1)
        nn.init.zeros_(self.value.weight)

    def forward(self, tokens: Tensor, prompt: Tensor, first: int) -> Tensor:
        """Return the stream at the columns from ``first`` on, (rows, columns, width).

        Args:
            tokens: (rows, columns), in the layout of this module.
            prompt: Whether a column before the responses holds a token, (rows, prompt columns).
            first: First column that is needed.
        """
        return self.extend(tokens, prompt, first, None)[0]

    def extend(self, tokens: Tensor, prompt: Tensor, first: int, cache: Cache | None) -> tuple[Tensor, Cache]:
        """Return the stream at new columns from ``first`` on, and the cache with all columns.

        Args:
            tokens: The new columns, (rows, columns).
            prompt: Whether a column before the responses holds a token, (rows, prompt columns).
            first: First new column that is needed.
            cache: Of the columns before; None at the start.
        """
        before = 0 if cache is None else cache[0][0].shape[2]
        rows, new = tokens.shape
        columns = torch.arange(before + new, device=tokens.device)
        present = F.pad(prompt, (0, before + new - prompt.shape[1]), value=True)
        # Places are counted from the one where the response begins, which is in the same column for all rows.
        places = columns[before:] - prompt.shape[1] + self.options.context
        x = self.embedding(tokens) + self.positions(places)
        # A column of padding attends to itself alone, so that no row of the softmax is empty.
        mask = (columns <= columns[before:, None]) & (present[:, None] | (columns == columns[before:, None]))
        made: Cache = []
        for index, block in enumerate(self.blocks):
            needed = first if index == len(self.blocks) - 1 else 0
            cached = None if cache is None else cache[index]
            x, entry = block(x, mask[:, None, needed:], needed, cached)
            made.append(entry)
        return x, made

    def logits(self, stream: Tensor) -> Tensor:
        """Return the logits of the next token, (…, vocabulary); padding and the mark of a response are never drawn."""
        logits = self.unembedding(self.norm(stream))
        logits[..., [PAD, ANSWER]] = -torch.inf
        return logits

    def values(self, stream: Tensor) -> Tensor:
        """Return the estimated return, (…)."""
        return self.value(self.norm(stream)).squeeze(-1)


def pad_prompts(prompts: list[list[int]]) -> tuple[Tensor, Tensor]:
    """Return prompts with padding before them, and whether a column holds a token: both (rows, columns)."""
    longest = max(map(len, prompts))
    tokens = torch.tensor([[PAD] * (longest - len(prompt)) + prompt for prompt in prompts])
    lengths = torch.tensor([len(prompt) for prompt in prompts])
    return tokens, torch.arange(longest) >= longest - lengths[:, None]
