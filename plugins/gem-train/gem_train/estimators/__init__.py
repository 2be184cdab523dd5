"""Returns, advantages and losses for agents that act in turns: pure functions, the same for NumPy and torch.

A function returns the kind of array that it was given (NumPy or torch, its dtype, its device). Shapes, throughout:

- ``E`` episodes, ``T`` turns of the longest of them; ``rewards``, ``values``, returns and advantages are float (E, T).
- ``mask``, bool (E, T): True where there is a turn. What stands elsewhere is ignored, NaN included; results are 0
  there.
- ``learnable``, bool (E, T) or (E,): what may be learnt from (see ``learnable_turns``); the rest is left out of means,
  deviations and baselines, and has the advantage 0.
- ``logprobs``, float (rows, L), and ``token_mask``, bool (rows, L): True on tokens that the model sampled.

All of them raise ``ValueError`` for a shape, a dtype or a factor that cannot be right. This package imports neither
torch nor gem_core.
"""

from __future__ import annotations

from gem_train.estimators.groups import gigpo_advantages, grpo_advantages, rloo_advantages
from gem_train.estimators.losses import PolicyMetrics, aggregate_tokens, policy_gradient_loss, ppo_loss, value_loss
from gem_train.estimators.normalization import normalize_advantages, return_batch_normalization
from gem_train.estimators.policies import entropy, kl_penalty, truncated_importance_weights
from gem_train.estimators.returns import discounted_returns, gae, learnable_turns
from gem_train.estimators.roles import role_baselines

__all__ = [
    "PolicyMetrics",
    "aggregate_tokens",
    "discounted_returns",
    "entropy",
    "gae",
    "gigpo_advantages",
    "grpo_advantages",
    "kl_penalty",
    "learnable_turns",
    "normalize_advantages",
    "policy_gradient_loss",
    "ppo_loss",
    "return_batch_normalization",
    "rloo_advantages",
    "role_baselines",
    "truncated_importance_weights",
    "value_loss",
]
