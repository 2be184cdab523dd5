"""How far two policies are apart on sampled tokens."""

from __future__ import annotations

import math
from typing import Literal

from gem_train.estimators._arrays import Array, at_least_single, check, constant, masked, namespace

KLKind = Literal["k1", "k2", "k3"]


def kl_penalty(logprobs: Array, reference_logprobs: Array, token_mask: Array, *, kind: KLKind = "k3") -> Array:
    r"""Estimate, on each sampled token, the divergence of the policy from a reference.

    With :math:`\log r = \log \pi_{ref} - \log \pi` on tokens sampled from :math:`\pi`: k1 is :math:`-\log r`
    (unbiased, may be negative), k2 :math:`\frac12 (\log r)^2` (biased, small variance), k3 :math:`r - 1 - \log r`
    (unbiased, never negative). As a loss, aggregate it with ``aggregate_tokens``; only the gradient of k2 is, on
    average, that of the divergence.

    Args:
        logprobs: float (rows, L), of the policy; gradients flow through these.
        reference_logprobs: float (rows, L), taken as constants.
        token_mask: bool (rows, L), True on sampled tokens.
        kind: The estimator.

    Returns:
        float (rows, L), 0 where the mask is False.

    Raises:
        ValueError: A shape or dtype does not fit, or kind is not known.

    Source: J. Schulman, "Approximating KL Divergence", http://joschu.net/blog/kl-approx.html; k3 in GRPO,
    arXiv:2402.03300, equation 4.
    """
    xp = namespace(logprobs, reference_logprobs, token_mask)
    check("logprobs", logprobs, (None, None), "float")
    check("reference_logprobs", reference_logprobs, logprobs.shape, "float")
    check("token_mask", token_mask, logprobs.shape, "bool")
    log_ratio = masked(xp, constant(reference_logprobs) - at_least_single(xp, logprobs), token_mask)
    if kind == "k1":
        return -log_ratio
    if kind == "k2":
        return log_ratio**2 / 2
    if kind == "k3":
        return xp.expm1(log_ratio) - log_ratio
    raise ValueError(f"kind is {kind!r}; expected 'k1', 'k2' or 'k3'")


def truncated_importance_weights(
    logprobs: Array, rollout_logprobs: Array, token_mask: Array, *, cap: float = 2.0
) -> Array:
    r"""Weigh tokens that another policy sampled: an older one, or an engine whose log-probabilities differ.

    :math:`w = \min(\pi(a) / \mu(a), c)` for each token, :math:`\mu` the policy that sampled it. Multiply the loss by
    it (``weights=`` of the losses): for learning one step off-policy, and where engine and learner compute the same
    weights differently.

    Args:
        logprobs: float (rows, L), of the learner, before its update.
        rollout_logprobs: float (rows, L), as the sampler reported them; where it reported none (NaN) the weight is 1.
        token_mask: bool (rows, L), True on sampled tokens.
        cap: :math:`c`, the largest weight; above 0.

    Returns:
        float (rows, L), constants (no gradient), 0 where the mask is False.

    Raises:
        ValueError: A shape or dtype does not fit, or cap is not above 0.

    Source: IMPALA, arXiv:1802.01561, section 4.1; for engines, F. Yao and others, "Your Efficient RL Framework
    Secretly Brings You Off-Policy RL Training", https://fengyao.notion.site/off-policy-rl (2025).
    """
    xp = namespace(logprobs, rollout_logprobs, token_mask)
    check("logprobs", logprobs, (None, None), "float")
    check("rollout_logprobs", rollout_logprobs, logprobs.shape, "float")
    check("token_mask", token_mask, logprobs.shape, "bool")
    if not cap > 0:
        raise ValueError(f"cap is {cap}; expected a number above 0")
    difference = constant(logprobs) - constant(rollout_logprobs)
    known = token_mask & ~xp.isnan(rollout_logprobs)
    weights = xp.exp(xp.clip(masked(xp, difference, known), max=math.log(cap)))
    return masked(xp, weights, token_mask)
