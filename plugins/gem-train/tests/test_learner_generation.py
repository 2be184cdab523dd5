"""The policy: what is sampled with a cache has the probabilities that the loss computes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from learner_envs import tiny, tiny_learner

from gem_train.learner.generation import sample
from gem_train.learner.learning import Learner
from gem_train.learner.model import Cache
from gem_train.learner.playing import Played, token_batch
from gem_train.learner.policy_loss import score
from gem_train.learner.training import Training
from gem_train.learner.vocabulary import END
from gem_train.tokens import TokenBatch


def played_by(learner: Learner) -> list[Played]:
    with Training(learner) as training:
        return training.evaluate()


def batch_of(played: list[Played]) -> TokenBatch:
    return token_batch(played, groups=list(range(len(played))))


READINGS: dict[str, dict[str, Any]] = {
    "the conversation": {},
    "a conversation that begins anew": {"context": 24},
    "one earlier turn": {"memory": 1},
    "two earlier turns, feedback alone": {"memory": 2, "feedback": True},
    "no earlier turn": {"memory": 0},
    "a view": {"wrappers": ("concat_with_action",)},
    "a prompt without its beginning": {"context": 12},
    "another temperature": {"temperature": 0.5},
}


@pytest.mark.parametrize("options", READINGS.values(), ids=READINGS)
def test_sampled_logprobs_are_those_of_the_loss(options: dict[str, Any]):
    """For rows of different lengths and responses that were cut off, whatever the policy reads."""
    learner = tiny_learner("arms:Four-v0", imitate_steps=3, **options)
    played = played_by(learner)
    batch = batch_of(played)
    assert any(turn.cut_off for seat in played for turn in seat.turns)
    assert len(set(batch.lengths.tolist())) > 1 or learner.options.context == 12
    assert batch.lengths.max() <= learner.options.context
    scored = score(
        learner.policy,
        torch.from_numpy(batch.tokens),
        torch.from_numpy(batch.token_mask),
        learner.options.temperature,
    )
    np.testing.assert_allclose(scored.logprobs.detach().numpy(), batch.logprobs, atol=1e-5)


def test_what_is_read_is_what_was_shown_and_said():
    """In one row for each conversation; in a new one where the context is full; with memory, in one for each turn."""
    for options, rows in (({}, 8), ({"context": 24}, None), ({"memory": 2}, 32)):
        learner = tiny_learner("arms:Four-v0", imitate_steps=3, **options)
        played = played_by(learner)
        batch = batch_of(played)
        assert len(batch.tokens) == rows if rows else 8 < len(batch.tokens) < 32
        text = learner.vocabulary.decode(batch.tokens[0, : batch.lengths[0]].tolist())
        turns = played[0].turns
        assert text.startswith(turns[0].shown + turns[0].text)
        if rows == 8:
            assert text == "".join(turn.shown + turn.text for turn in turns)
        if rows == 32:
            last = learner.vocabulary.decode(batch.tokens[3, : batch.lengths[3]].tolist())
            assert last == "".join(turn.shown + turn.text for turn in turns[1:])


def test_rows_that_begin_anew_are_sampled_from_the_same_distribution():
    """The frequencies of many rows alike, which are one state of the model, are the probabilities of a token."""
    learner = Learner(tiny(vocabulary=1), tiny_learner(imitate_steps=3).vocabulary)
    prompt, count = learner.vocabulary.encode("Say left or right."), 4000
    cache = Cache(learner.policy, count)
    generator = torch.Generator().manual_seed(1)
    drawn = sample(cache, range(count), [prompt] * count, 1, keep=False, generator=generator)
    seen = np.bincount([said.tokens[0] for said in drawn], minlength=len(learner.vocabulary)) / count
    expected = np.zeros(len(learner.vocabulary))
    for said in drawn:
        expected[said.tokens[0]] = np.exp(said.logprobs[0])
    assert abs(seen - expected).max() < 0.03


def test_the_likeliest_response_has_temperature_0():
    """The same in every row and both ways of sampling, and its end token is the last."""
    learner = tiny_learner(imitate="learner_envs:always_right", imitate_steps=60)
    prompt = [*learner.vocabulary.encode("Say left or right."), 2]
    for keep in (True, False):
        for said in sample(Cache(learner.policy, 3), range(3), [prompt] * 3, 5, keep=keep, temperature=0.0):
            assert learner.vocabulary.decode(said.tokens) == "right"
            assert said.tokens[-1] == END
