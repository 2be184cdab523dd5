"""Updates of the learner: what they do to the policy, and what they leave out."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from learner_envs import always_right, learner_of_both_arms, tiny, tiny_learner

import gem_core as gem
from gem_train.estimators import discounted_returns
from gem_train.learner.environments import TrainingPlan, training_envs
from gem_train.learner.imitation import imitate, record_episodes
from gem_train.learner.learning import Learner
from gem_train.learner.options import ALGORITHMS, TrainOptions
from gem_train.learner.playing import Played, Player, token_batch
from gem_train.learner.policy_loss import score
from gem_train.learner.training import Training
from gem_train.learner.vocabulary import Vocabulary
from gem_train.tokens import TokenBatch


def batch_of(played: list[Played], **options: bool) -> TokenBatch:
    return token_batch(played, groups=list(range(len(played))), **options)


def gradient_of(learner: Learner, batch: TokenBatch) -> torch.Tensor:
    """Return the gradient of an update, which is left where the optimizer found it."""
    learner = Learner.restored(learner.state())
    learner.learn(batch, np.zeros_like(batch.rewards), np.zeros(len(batch.rewards)))
    return torch.cat([each.grad.flatten() for each in learner.policy.parameters() if each.grad is not None])


def gradient_by_rows(learner: Learner, batch: TokenBatch) -> torch.Tensor:
    """Return the gradient of REINFORCE, row by row and by the formula."""
    returns = batch.to_tokens(discounted_returns(batch.rewards, batch.mask, gamma=learner.options.gamma))
    policy = Learner.restored(learner.state()).policy
    for row, tokens in enumerate(batch.tokens):
        mask = torch.from_numpy(batch.loss_mask[row])
        logprobs = score(policy, torch.from_numpy(tokens)[None], torch.from_numpy(batch.token_mask[row])[None]).logprobs
        loss = -(logprobs[0] * torch.from_numpy(returns[row]).float() * mask).sum() / int(batch.loss_mask.sum())
        loss.backward()
    parameters = [each for each in policy.parameters() if each.grad is not None]
    torch.nn.utils.clip_grad_norm_(parameters, 1.0)
    return torch.cat([each.grad.flatten() for each in parameters])


def test_equal_rows_are_computed_once_with_the_gradient_of_all():
    """Sixteen episodes of one turn with two answers are few different rows."""
    learner = learner_of_both_arms(algorithm="reinforce", memory=0)
    with Training(learner) as training:
        batch = batch_of(training.evaluate() + training.evaluate())
    assert len({row.tobytes() for row in batch.tokens}) < len(batch.tokens)
    # The value head has no gradient in one, and none that is not 0 in the other.
    expected, found = gradient_by_rows(learner, batch), gradient_of(learner, batch)
    assert expected.abs().sum() > 0
    torch.testing.assert_close(found[: len(expected)], expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("algorithm", ["reinforce", "rebn"])
def test_episodes_with_an_error_count_for_nothing(algorithm: str):
    """Neither in the loss nor in the statistics of the batch."""
    learner = learner_of_both_arms(algorithm=algorithm)
    with Training(learner) as training:
        played = training.evaluate()
    expected = gradient_of(learner, batch_of(played[2:]))
    for seat in played[:2]:
        seat.error = True
    torch.testing.assert_close(gradient_of(learner, batch_of(played)), expected, rtol=1e-4, atol=1e-6)


def test_responses_that_were_cut_off_are_not_learnt_from_where_asked():
    """If none is left, the policy stays as it is."""
    learner = learner_of_both_arms(max_tokens=1)
    with Training(learner) as training:
        played = [seat for seat in training.evaluate() if seat.turns[0].cut_off]
    assert played
    assert batch_of(played).loss_mask.any()
    batch = batch_of(played, learn_cut_off=False)
    before = learner.state()["policy"]
    assert learner.learn(batch, np.zeros_like(batch.rewards), np.zeros(len(played))) == {}
    assert all(torch.equal(value, before[name]) for name, value in learner.policy.state_dict().items())


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_every_algorithm_finds_the_better_arm(algorithm: str):
    """After a few updates it is pulled more often, by all of them."""
    learner = learner_of_both_arms(algorithm=algorithm, updates=12, episodes=32, learning_rate=1e-2, eval_episodes=128)
    with Training(learner) as training:
        before = success_of(training)
        for _ in range(8):
            training.update()
        assert success_of(training) > max(before + 0.1, 0.6)


def success_of(training: Training) -> float:
    played = training.evaluate()
    return sum(seat.success for seat in played) / len(played)


def test_imitation_lowers_the_loss_and_is_heard():
    """What the player said is said by the policy."""
    options = tiny(imitate="learner_envs:always_right", imitate_steps=150)
    recorded = record_episodes(options, options.env, "learner_envs:always_right", 32)
    assert {turn.action for episode in recorded for turn in episode.transitions} == {always_right("")}
    learner = Learner(options, Vocabulary.build(["Say left or right.\npull", "left", "right"]))
    losses = list(imitate(learner, recorded))
    assert losses[-1] < losses[0] / 4
    with Training(learner) as training:
        assert success_of(training) > 0.7


def test_a_player_that_says_too_much_is_refused():
    """Nothing that it said could be learnt, and the message says which options to change."""
    with pytest.raises(gem.errors.ArgumentError, match=r"nothing that 'random' said fits in max_tokens \(1\)"):
        tiny_learner(max_tokens=1, vocabulary=1)


def test_overlap_plays_with_the_weights_of_one_update_ago():
    """From the second update on, with weights that say so; the first is played with those that there are."""
    learner = learner_of_both_arms(algorithm="reinforce", overlap=True, learning_rate=1e-2)
    policies, updates = [], []
    with Training(learner) as training:
        for _ in range(3):
            policies.append(copy.deepcopy(learner.policy))
            updates.append(training.update())
    assert abs(updates[0].metrics["kl"]) < 1e-9 < 1e-5 < updates[1].metrics["kl"]
    for sampler, update in zip([policies[0], policies[0], policies[1]], updates, strict=True):
        batch = batch_of(update.played)
        scored = score(sampler, torch.from_numpy(batch.tokens), torch.from_numpy(batch.token_mask))
        np.testing.assert_allclose(scored.logprobs.detach().numpy(), batch.logprobs, atol=1e-5)


def test_the_learning_rate_falls_to_0_in_a_straight_line():
    """From the given one, and the last update still moves something."""
    learner = learner_of_both_arms(updates=4, learning_rate=0.01)
    rates = []
    with Training(learner) as training:
        while learner.updates < 4:
            training.update()
            rates.append(learner.optimizer.param_groups[0]["lr"])
    assert rates == pytest.approx([0.01, 0.0075, 0.005, 0.0025])


def test_options_fill_in_what_their_algorithm_needs():
    """And keep what is given."""
    filled = [
        (o.group_size, o.epochs, o.minibatches) for o in (tiny(algorithm=name) for name in ("rebn", "ppo", "rloo"))
    ]
    assert filled == [(1, 1, 1), (1, 4, 4), (8, 1, 1)]
    assert tiny(algorithm="ppo", epochs=1).epochs == 1
    options = replace(tiny(), wrappers=("concat", ("concat", {"max_turns": 2})), env_kwargs={"turns": 2})
    assert type(options).from_dict(options.to_dict()) == options
    assert math.isclose(options.gamma, 0.9)


WRONG = {
    "algorithm is one of reinforce, rebn, ppo, grpo, dr-grpo, rloo, not 'a2c'": {"algorithm": "a2c"},
    "grpo compares episodes within groups: group_size must be 2 or more": {"algorithm": "grpo", "group_size": 1},
    "episodes (9) must be a multiple of group_size (8)": {"algorithm": "rloo", "episodes": 9},
    "gamma must be from 0 to 1, not 1.5": {"gamma": 1.5},
    "temperature must be above 0, not 0": {"temperature": 0},
    "max_tokens (96) must be below context (96)": {"max_tokens": 96},
    "width (15) must be a multiple of heads (2)": {"width": 15},
    "layers must be 1 or more, not 0": {"layers": 0},
    "role_baselines is for reinforce and rebn, in one environment": {"role_baselines": True, "algorithm": "ppo"},
}


@pytest.mark.parametrize(("message", "options"), WRONG.items(), ids=[next(iter(each)) for each in WRONG.values()])
def test_options_that_cannot_be_are_refused(message: str, options: dict[str, object]):
    """With what is accepted."""
    with pytest.raises(gem.errors.ArgumentError) as caught:
        tiny(**options)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    "options",
    [{}, {"memory": 1, "feedback": True}, {"wrappers": ("concat_with_action",)}],
    ids=["row", "memory", "view"],
)
def test_the_critic_reads_what_would_have_come_after_an_episode_that_was_cut_off(options: dict[str, Any]):
    """Its value there is that of the next turn, where the same episodes go on."""
    learner = tiny_learner("arms:Four-v0", algorithm="ppo", **options)
    torch.nn.init.normal_(learner.policy.value.weight)
    cut = Learner.restored(learner.state() | {"options": with_limit(learner.options).to_dict()})
    values = []
    for one in (learner, cut):
        player = Player(one.policy, one.vocabulary, one.options, 16)
        with training_envs(one.options, TrainingPlan(one.options)) as envs:
            played = player.play(envs, 1)
            values.append((played, player.bootstrap(played)))
    (whole, after_end), (halves, after_two) = values
    assert not after_end.any()
    assert [len(seat.turns) for seat in halves] == [2] * 16
    np.testing.assert_allclose(after_two, [seat.turns[2].said.value for seat in whole], atol=1e-5)


def with_limit(options: TrainOptions) -> TrainOptions:
    return replace(options, wrappers=(("turn_limit", {"max_turns": 2}), *options.wrappers))
