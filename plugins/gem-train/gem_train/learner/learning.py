"""``Learner``: the policy, what it plays and how it learns, one update at a time."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from gem_core.env import stable_hash
from gem_train.estimators import policy_gradient_loss, ppo_loss, role_baselines, truncated_importance_weights
from gem_train.learner.model import Policy
from gem_train.learner.options import TrainOptions
from gem_train.learner.policy_loss import Floats, Rows, Scored, score, turn_advantages
from gem_train.learner.vocabulary import Vocabulary
from gem_train.tokens import TokenBatch


class Learner:
    """A policy that learns from what it plays.

    Args:
        options: Of the run.
        vocabulary: What it reads and writes with.
    """

    def __init__(self, options: TrainOptions, vocabulary: Vocabulary) -> None:
        self.options, self.vocabulary = options, vocabulary
        with torch.random.fork_rng():
            torch.manual_seed(stable_hash(options.seed, "weights"))
            self.policy = Policy(vocabulary.texts, options)
        self.optimizer = torch.optim.AdamW(
            self.policy.parameters(), lr=options.learning_rate, betas=(0.9, 0.95), weight_decay=0.0
        )
        self.updates = 0
        self.baselines: dict[str, float] = {}
        """The moving mean of each seat's returns, with ``role_baselines``."""

    def state(self) -> dict[str, Any]:
        """Return a copy of everything that a run goes on from: plain values and tensors."""
        return copy.deepcopy(
            {
                "options": self.options.to_dict(),
                "words": self.vocabulary.words,
                "policy": self.policy.state_dict(),
                "optimizer": self.optimizer.state_dict(),
                "updates": self.updates,
                "baselines": self.baselines,
            }
        )

    @classmethod
    def restored(cls, state: Mapping[str, Any]) -> Self:
        """Return the learner whose state this was."""
        learner = cls(TrainOptions.from_dict(state["options"]), Vocabulary(state["words"]))
        learner.policy.load_state_dict(state["policy"])
        learner.optimizer.load_state_dict(state["optimizer"])
        learner.updates, learner.baselines = state["updates"], dict(state["baselines"])
        return learner

    def learn(self, batch: TokenBatch, values: Floats, bootstrap: Floats) -> dict[str, float]:
        """Take the steps of one update, and return the means of its metrics.

        Args:
            batch: What was played.
            values: Of the critic when it was played, (E, T).
            bootstrap: Of the critic after the last turn, (E,).
        """
        options = self.options
        left = max(0.0, 1 - self.updates / options.updates)
        self.optimizer.param_groups[0]["lr"] = options.learning_rate * left
        baselines = self._role_baselines(batch) if options.role_baselines else None
        rows = Rows.of(batch, *turn_advantages(batch, options, values, bootstrap, baselines))
        generator = torch.Generator().manual_seed(stable_hash(options.seed, "minibatches", self.updates))
        metrics: list[dict[str, float]] = []
        for _ in range(options.epochs):
            part = rows.usable
            if options.minibatches > 1:
                part = part[torch.randperm(len(part), generator=generator)]
            metrics.extend(self._step(rows, some) for some in part.chunk(options.minibatches) if len(some))
        self.updates += 1
        return {name: float(np.mean([step[name] for step in metrics])) for name in (metrics[0] if metrics else ())}

    def _role_baselines(self, batch: TokenBatch) -> Floats:
        """Return what to subtract from the returns of each episode, (E,), and move the means of the seats on."""
        names = [str(seat) for seat in batch.seats]
        known = list(dict.fromkeys([*self.baselines, *names]))
        means = np.array([self.baselines.get(name, 0.0) for name in known])
        roles = np.array([known.index(name) for name in names])
        counts = batch.learnable.any(axis=1)
        advantages, means = role_baselines(means, batch.episode_returns, roles, learnable=counts)
        self.baselines = dict(zip(known, means.tolist(), strict=True))
        subtracted: Floats = batch.episode_returns - advantages
        return subtracted

    def _step(self, rows: Rows, part: Tensor) -> dict[str, float]:
        """Take one step of the optimizer on some rows."""
        self.optimizer.zero_grad(set_to_none=True)
        totals: Counter[str] = Counter()
        tokens, turns = int(rows.learnable[part].sum()), int(rows.starts[part].sum())
        for different, copies, chunk in rows.chunks(part):
            width = int(rows.learnable[different].nonzero()[:, 1].max()) + 1
            scored = score(
                self.policy, rows.tokens[different, :width], rows.sampled[different, :width], self.options.temperature
            )
            loss, seen = self._loss(rows, chunk, width, Scored(*(each[copies] for each in scored)), tokens, turns)
            loss.backward()  # type: ignore[no-untyped-call]
            totals.update(seen)
        norm = torch.nn.utils.clip_grad_norm_(self.policy.parameters(), 1.0)
        self.optimizer.step()
        return {**totals, "gradient_norm": float(norm)}

    def _loss(
        self, rows: Rows, chunk: Tensor, width: int, scored: Scored, tokens: int, turns: int
    ) -> tuple[Tensor, dict[str, float]]:
        """Return a chunk's part of the loss of ``tokens`` tokens in ``turns`` turns, and of the metrics."""
        options, mask = self.options, rows.learnable[chunk, :width]
        old, advantages = rows.logprobs[chunk, :width], rows.advantages[chunk, :width]
        if options.algorithm in ("ppo", "grpo", "dr-grpo"):
            clip = options.clip
            loss, seen = ppo_loss(
                scored.logprobs, old, advantages, mask, clip_low=clip, clip_high=clip, denominator=tokens
            )
        else:
            weights = truncated_importance_weights(scored.logprobs, old, mask) if options.off_policy else None
            loss, seen = policy_gradient_loss(
                scored.logprobs, old, advantages, mask, weights=weights, denominator=tokens
            )
        entropy = scored.entropy.where(mask, 0.0).sum() / tokens
        total = loss - options.entropy * entropy
        if options.algorithm == "ppo":
            errors = (scored.values - rows.targets[chunk, :width]).where(rows.starts[chunk, :width], 0.0) ** 2
            total = total + options.value_weight * errors.sum() / (2 * turns)
        share = float(mask.sum()) / tokens
        return total, {
            "loss": float(loss.detach()),
            "entropy": float(entropy.detach()),
            "kl": float(seen.approximate_kl) * share,
            "clip_fraction": float(seen.clip_fraction) * share,
        }
