"""``batches``: real episodes as transitions and trajectories, with the ids that were sampled."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from spelling import Spelling, SpellingAgent

import gem_core as gem
from gem_train import TokenBatch, batches

GUESS = "game:GuessTheNumber-v0-easy"


def played(agent: Any, *wrappers: Any, env: str = GUESS, episodes: int = 4) -> list[gem.Episode]:
    """Play a game; the last turns of some episodes have been lost, others won."""
    return list(gem.rollout(gem.make(env, wrappers=list(wrappers)), agent, episodes=episodes, seed=1))


def chat(**options: Any) -> tuple[str, dict[str, Any]]:
    return ("concat_chat", {"tokenizer": Spelling(), **options})


def sampled(episode: gem.Episode) -> list[int]:
    """The ids that were sampled in an episode, in order."""
    return list(chain.from_iterable(turn.action.token_ids or () for turn in episode.transitions))


def marked(batch: TokenBatch) -> Iterator[list[int]]:
    """The sampled tokens of each episode, in order, as the mask marks them."""
    for episode in range(len(batch.terminated)):
        yield batch.tokens[(batch.episode == episode)[:, None] & batch.token_mask].tolist()


def test_an_append_only_view_keeps_the_sampled_ids() -> None:
    """One row an episode: the whole conversation, in which exactly the sampled spellings are marked."""
    tokenizer = Spelling()
    episodes = played(SpellingAgent(), chat())
    assert any(episode.turns > 2 for episode in episodes)
    batch = batches(episodes, form="trajectories", tokenizer=tokenizer)
    assert batch.episode.tolist() == [0, 1, 2, 3]
    assert list(marked(batch)) == [sampled(episode) for episode in episodes]
    for row, episode in enumerate(episodes):
        text = tokenizer.decode(batch.tokens[row, : batch.lengths[row]])
        assert text == f"{episode.sent(episode.turns - 1)}{episode.transitions[-1].action}{tokenizer.eos_token}"
        assert tokenizer.encode(text, add_special_tokens=False) != batch.tokens[row, : batch.lengths[row]].tolist()
        reported = [logprob for turn in episode.transitions for logprob in turn.action.logprobs or ()]
        assert_array_equal(batch.logprobs[row][batch.token_mask[row]], np.array(reported, np.float32))
