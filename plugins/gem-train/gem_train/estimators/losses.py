"""Losses over sampled tokens, or over turns; all are minimized."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

from gem_train.estimators._arrays import Array, at_least_single, check, constant, masked, namespace

Aggregate = Literal["token", "sequence", "constant"]

_MOST_LOG_RATIO = 20.0
"""Ratios stay finite in float32, so that the gradient of a clipped one is 0 and not NaN."""


class PolicyMetrics(NamedTuple):
    """What a policy loss saw, as means over the sampled tokens; scalars without gradient."""

    ratio: Array
    """pi / pi_old."""
    approximate_kl: Array
    """r - 1 - log r, r that ratio: how far the policy has moved from the old one."""
    clip_fraction: Array
    """The share of tokens whose gradient the clipping removes."""


def aggregate_tokens(
    per_token: Array,
    token_mask: Array,
    *,
    aggregate: Aggregate = "token",
    length: int | None = None,
    denominator: float | None = None,
) -> Array:
    r"""Make one number of a number for each token.

    :math:`x_{i,t}` stands for sampled token :math:`t` of row :math:`i`, :math:`n_i` for their number; :math:`N` rows
    have any.

    - "token": :math:`\sum_i \sum_t x_{i,t} / \sum_i n_i`: each token counts the same (DAPO).
    - "sequence": :math:`\frac1N \sum_i \frac1{n_i} \sum_t x_{i,t}`: each row counts the same (GRPO).
    - "constant": :math:`\frac1N \sum_i \frac1L \sum_t x_{i,t}`, :math:`L` the constant ``length``: longer rows count
      more, and no row is punished less for being long (Dr. GRPO).

    Args:
        per_token: float (rows, L).
        token_mask: bool (rows, L), True on sampled tokens. Without any, the result is 0, with gradient 0.
        aggregate: One of the three above.
        length: For "constant" alone, and needed there: for instance the most tokens that a response may have.
        denominator: Divide by this instead of the number of tokens ("token") or of rows ("sequence", "constant"): the
            number in the whole batch, where gradients are accumulated over parts of it.

    Returns:
        float scalar.

    Raises:
        ValueError: A shape or dtype does not fit, or an option is not known or missing.

    Source: GRPO, arXiv:2402.03300, equation 3; Dr. GRPO, arXiv:2503.20783; DAPO, arXiv:2503.14476, equation 12.
    """
    xp = namespace(per_token, token_mask)
    check("per_token", per_token, (None, None), "float")
    check("token_mask", token_mask, per_token.shape, "bool")
    if aggregate not in ("token", "sequence", "constant"):
        raise ValueError(f"aggregate is {aggregate!r}; expected 'token', 'sequence' or 'constant'")
    if (length is not None) != (aggregate == "constant"):
        raise ValueError("length belongs to aggregate='constant', and is needed there; expected the number of tokens")
    counts = xp.sum(xp.astype(token_mask, per_token.dtype), axis=1)
    sums = xp.sum(masked(xp, per_token, token_mask), axis=1)
    if aggregate == "token":
        parts = counts
    else:
        sums = sums / (length if aggregate == "constant" else xp.clip(counts, min=1))
        parts = xp.astype(counts > 0, per_token.dtype)
    return xp.sum(sums) / (xp.clip(xp.sum(parts), min=1) if denominator is None else denominator)


def policy_gradient_loss(
    logprobs: Array,
    old_logprobs: Array,
    advantages: Array,
    token_mask: Array,
    *,
    weights: Array | None = None,
    aggregate: Aggregate = "token",
    length: int | None = None,
    denominator: float | None = None,
) -> tuple[Array, PolicyMetrics]:
    r"""Compute the loss of REINFORCE: no ratio, no clipping.

    :math:`-w A \log \pi` on each token, then ``aggregate_tokens``.

    Args:
        logprobs: float (rows, L), of the policy; gradients flow through these alone.
        old_logprobs: float (rows, L), of the policy that sampled, for the metrics alone: NaN makes these NaN.
        advantages: float (rows, L).
        token_mask: bool (rows, L), True on sampled tokens that may be learnt from.
        weights: float (rows, L), of ``truncated_importance_weights``. None: 1.
        aggregate: See ``aggregate_tokens``, as for the two that follow.
        length: The constant length.
        denominator: What to divide by.

    Returns:
        The loss, a scalar, and the metrics (``clip_fraction`` is 0).

    Raises:
        ValueError: A shape or dtype does not fit, or an option is not known or missing.

    Source: R. J. Williams, 1992, https://doi.org/10.1007/BF00992696.
    """
    xp, log_ratio, advantages = _compared(logprobs, old_logprobs, advantages, token_mask)
    losses = -advantages * masked(xp, logprobs, token_mask)
    losses = _weighted(xp, losses, weights, token_mask)
    loss = aggregate_tokens(losses, token_mask, aggregate=aggregate, length=length, denominator=denominator)
    return loss, _metrics(xp, log_ratio, xp.zeros_like(token_mask), token_mask)


def ppo_loss(
    logprobs: Array,
    old_logprobs: Array,
    advantages: Array,
    token_mask: Array,
    *,
    clip_low: float = 0.2,
    clip_high: float = 0.2,
    weights: Array | None = None,
    aggregate: Aggregate = "token",
    length: int | None = None,
    denominator: float | None = None,
) -> tuple[Array, PolicyMetrics]:
    r"""Compute the clipped loss of PPO, which GRPO shares.

    :math:`-w \min(r A, \mathrm{clip}(r, 1 - c_{low}, 1 + c_{high}) A)` on each token, :math:`r = \pi / \pi_{old}`,
    then ``aggregate_tokens``.

    For one ratio a turn instead of one a token, sum the log-probabilities of a turn's tokens, and pass the sums
    (E, T), turns for tokens: a turn is then one action.

    Args:
        logprobs: float (rows, L), of the policy; gradients flow through these alone.
        old_logprobs: float (rows, L), of the policy before the update.
        advantages: float (rows, L).
        token_mask: bool (rows, L), True on sampled tokens that may be learnt from.
        clip_low: How far the ratio may fall below 1, from 0 to 1.
        clip_high: How far it may rise above 1; larger than ``clip_low`` is DAPO's clip-higher.
        weights: float (rows, L), of ``truncated_importance_weights``. None: 1.
        aggregate: See ``aggregate_tokens``, as for the two that follow.
        length: The constant length.
        denominator: What to divide by.

    Returns:
        The loss, a scalar, and the metrics.

    Raises:
        ValueError: A shape or dtype does not fit, or an option is not known, missing or out of range.

    Source: PPO, arXiv:1707.06347, equation 7; clip-higher, DAPO, arXiv:2503.14476.
    """
    if not (0 <= clip_low <= 1 and clip_high >= 0):
        raise ValueError(f"clip_low is {clip_low}, clip_high {clip_high}; expected 0 to 1, and 0 or more")
    xp, log_ratio, advantages = _compared(logprobs, old_logprobs, advantages, token_mask)
    ratio = xp.exp(xp.clip(log_ratio, min=-_MOST_LOG_RATIO, max=_MOST_LOG_RATIO))
    unclipped = -ratio * advantages
    clipped = -xp.clip(ratio, min=1 - clip_low, max=1 + clip_high) * advantages
    losses = xp.maximum(unclipped, clipped)
    losses = _weighted(xp, losses, weights, token_mask)
    loss = aggregate_tokens(losses, token_mask, aggregate=aggregate, length=length, denominator=denominator)
    return loss, _metrics(xp, log_ratio, clipped > unclipped, token_mask)


def value_loss(values: Array, targets: Array, mask: Array) -> Array:
    r"""Compute the squared error of a critic, as a mean over turns: :math:`\frac12 (V - G)^2`.

    Args:
        values: float (E, T); gradients flow through these alone.
        targets: float (E, T), for instance of ``gae``.
        mask: bool (E, T), the turns that count. Without any, the loss is 0, with gradient 0.

    Returns:
        float scalar.

    Raises:
        ValueError: A shape or dtype does not fit.

    Source: PPO, arXiv:1707.06347, equation 9.
    """
    xp = namespace(values, targets, mask)
    check("values", values, (None, None), "float")
    check("targets", targets, values.shape, "float")
    check("mask", mask, values.shape, "bool")
    return aggregate_tokens(masked(xp, values - constant(targets), mask) ** 2 / 2, mask)


def _compared(logprobs: Array, old_logprobs: Array, advantages: Array, token_mask: Array) -> tuple[Any, Array, Array]:
    """Check the arguments of a policy loss; return the namespace, log-ratios and advantages, 0 where not sampled."""
    xp = namespace(logprobs, old_logprobs, advantages, token_mask)
    check("logprobs", logprobs, (None, None), "float")
    check("old_logprobs", old_logprobs, logprobs.shape, "float")
    check("advantages", advantages, logprobs.shape, "float")
    check("token_mask", token_mask, logprobs.shape, "bool")
    log_ratio = masked(xp, at_least_single(xp, logprobs) - constant(old_logprobs), token_mask)
    return xp, log_ratio, masked(xp, at_least_single(xp, constant(advantages)), token_mask)


def _weighted(xp: Any, losses: Array, weights: Array | None, token_mask: Array) -> Array:
    if weights is None:
        return losses
    namespace(losses, weights)
    check("weights", weights, losses.shape, "float")
    return losses * masked(xp, constant(weights), token_mask)


def _metrics(xp: Any, log_ratio: Array, removed: Array, token_mask: Array) -> PolicyMetrics:
    log_ratio = xp.clip(constant(log_ratio), min=-_MOST_LOG_RATIO, max=_MOST_LOG_RATIO)
    removed = xp.astype(removed, log_ratio.dtype)
    return PolicyMetrics(
        ratio=aggregate_tokens(xp.exp(log_ratio), token_mask),
        approximate_kl=aggregate_tokens(xp.expm1(log_ratio) - log_ratio, token_mask),
        clip_fraction=aggregate_tokens(removed, token_mask),
    )
