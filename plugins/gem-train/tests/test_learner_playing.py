"""Episodes that the policy plays: seats, errors, groups, and the agent that plays as it does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from learner_envs import learner_of_both_arms, tiny_learner

import gem_core as gem
from gem_train import batches
from gem_train.learner.agent import CheckpointAgent
from gem_train.learner.learning import Learner
from gem_train.learner.playing import groups_of, token_batch
from gem_train.learner.policy_loss import score
from gem_train.learner.run import RunFolder
from gem_train.learner.training import Training


def test_episodes_that_cannot_begin_move_no_group():
    """They are counted; the others are compared with their like, and the next update begins with its own starts."""
    learner = tiny_learner("arms:Absent-v0", imitate="learner_envs:always_right", algorithm="grpo", group_size=4)
    later = Learner.restored(learner.state() | {"updates": 1})
    with Training(learner) as training:
        first, second = training.update(), training.update()
    with Training(later) as training:
        again = training.update()
    begun = [seat for seat in first.played if seat.turns]
    assert len(begun) == learner.options.episodes
    assert first.metrics["errors"] == len(first.played) - len(begun) > 0
    assert not any(seat.error for seat in begun)
    assert [seat.start for seat in again.played] == [seat.start for seat in second.played]
    groups = dict(zip(groups_of(first.played), [seat.start for seat in first.played], strict=True))
    assert len(groups) == len({seat.start for seat in first.played})


def test_each_seat_of_self_play_has_its_own_episode():
    """With its own rewards, which add up to 0 in a game of two, and its own turns."""
    learner = tiny_learner("game:KuhnPoker-v0", role_baselines=True, max_tokens=8, context=256, imitate_steps=60)
    with Training(learner) as training:
        update = training.update()
    assert [(seat.slot, seat.seat) for seat in update.played] == [
        (slot, seat) for slot in range(16) for seat in ("first", "second")
    ]
    for first, second in zip(update.played[::2], update.played[1::2], strict=True):
        assert first.episode_return == -second.episode_return != 0
        assert "first player" in first.turns[0].shown
        assert all("second player" in turn.shown for turn in second.turns[:1])
        assert first.terminated
        assert second.terminated
    assert update.metrics["errors"] == 0
    batch = token_batch(update.played, groups=[0] * 32)
    assert batch.seats == ["first", "second"] * 16
    assert np.array_equal(batch.episode_returns, [seat.episode_return for seat in update.played])
    means = {"first": 0.0, "second": 0.0}
    for seat in update.played:
        if seat.turns:
            means[str(seat.seat)] += 0.05 * (seat.episode_return - means[str(seat.seat)])
    assert learner.baselines == pytest.approx(means)


def test_an_environment_that_fails_leaves_its_episode_out():
    """It is counted, the others are learnt from, and its slot plays the next update."""
    learner = tiny_learner("arms:Failing-v0")
    with Training(learner) as training:
        updates = [training.update() for _ in range(3)]
    for update in updates:
        failed = [seat for seat in update.played if seat.error]
        assert 0 < len(failed) < 16 == len(update.played)
        assert update.metrics["errors"] == len(failed)
        batch = token_batch(update.played, groups=[0] * 16)
        assert batch.learnable.any(axis=1).tolist() == [not seat.error for seat in update.played]
    assert len({tuple(seat.error for seat in update.played) for update in updates}) > 1


READINGS: dict[str, tuple[dict[str, Any], int]] = {
    "conversation": ({}, 6),
    "one earlier turn, and feedback alone": ({"memory": 1, "feedback": True}, 18),
    "a view": ({"wrappers": ("concat_with_action",)}, 24),
}


@pytest.mark.parametrize(("options", "rows"), READINGS.values(), ids=READINGS)
def test_the_agent_reads_as_the_policy_did(options: dict[str, Any], rows: int, tmp_path: Path):
    """And its episodes make batches, with the probabilities of the policy; a row goes on where its prompt does."""
    learner = tiny_learner("arms:Four-v0", **options)
    RunFolder(tmp_path).save(learner.state())
    with gem.make_vec("arms:Four-v0", 2, wrappers=learner.options.wrappers, seed=1) as vec:
        episodes = list(gem.rollout(vec, f"train:{tmp_path}", episodes=6))
    for episode in episodes:
        one, two, three, _ = episode.transitions
        read = one.observation + one.action + two.observation + two.action + three.observation
        if "memory" in options:
            read = one.info["feedback"] + two.action + two.info["feedback"]
        elif "wrappers" in options:
            read = three.observation
        assert learner.vocabulary.decode(three.action.prompt_token_ids) == read
        assert {turn.action.finish_reason for turn in episode.transitions} <= {"stop", "length"}
    batch = batches(episodes, form="trajectories")
    assert len(batch.tokens) == rows
    scored = score(learner.policy, torch.from_numpy(batch.tokens), torch.from_numpy(batch.token_mask))
    np.testing.assert_allclose(scored.logprobs.detach().numpy(), batch.logprobs, atol=1e-5)


def test_the_agent_repeats_itself_by_its_seed(tmp_path: Path):
    """With temperature 0 it says the likeliest, and at temperature 1 other things with another seed."""
    RunFolder(tmp_path).save(learner_of_both_arms().state())

    def said(**options: Any) -> list[str]:
        agent = CheckpointAgent(str(tmp_path), **options)
        return [
            str(turn.action)
            for one in gem.rollout("arms:One-v0", agent, episodes=12, seed=3)
            for turn in one.transitions
        ]

    assert said() == said() != said(seed=1)
    assert len(set(said())) > len(set(said(temperature=0.0)))
