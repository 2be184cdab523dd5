"""Normalization over the turns of a batch."""

from __future__ import annotations

from gem_train.estimators._arrays import Array, check, from_member, namespace


def return_batch_normalization(returns: Array, mask: Array, *, epsilon: float = 1e-8, correction: int = 0) -> Array:
    r"""Normalize returns over all turns of a batch (ReBN).

    :math:`A_{i,t} = (G_{i,t} - \mathrm{mean}(G)) / (\mathrm{std}(G) + \epsilon)`, mean and deviation over all turns
    of all episodes together. Where all returns are equal, advantages are 0.

    Args:
        returns: float (E, T), for instance of ``discounted_returns``.
        mask: bool (E, T), the turns that count: pass ``learnable`` where some must not.
        epsilon: Added to the deviation.
        correction: 0 divides the squares by the number of turns, as the paper's code does; 1 by one less, as
            ``torch.std`` does.

    Returns:
        float (E, T), 0 where the mask is False.

    Raises:
        ValueError: A shape or dtype does not fit.

    Source: GEM, arXiv:2510.01051.
    """
    check("returns", returns, (None, None), "float")
    return _normalized(returns, mask, epsilon, correction)


def normalize_advantages(advantages: Array, mask: Array, *, epsilon: float = 1e-8, correction: int = 0) -> Array:
    r"""Normalize advantages over all turns of a batch.

    :math:`\hat A = (A - \mathrm{mean}(A)) / (\mathrm{std}(A) + \epsilon)`: the formula of
    ``return_batch_normalization``, used after a critic or a baseline, as implementations of PPO do.

    Args:
        advantages: float (E, T).
        mask: bool (E, T), the turns that count.
        epsilon: Added to the deviation.
        correction: 0 divides the squares by the number of turns; 1 by one less, as ``torch.std`` does.

    Returns:
        float (E, T), 0 where the mask is False.

    Raises:
        ValueError: A shape or dtype does not fit.

    Source: arXiv:2006.05990 (What Matters in On-Policy Reinforcement Learning?).
    """
    check("advantages", advantages, (None, None), "float")
    return _normalized(advantages, mask, epsilon, correction)


def _normalized(values: Array, mask: Array, epsilon: float, correction: int) -> Array:
    xp = namespace(values, mask)
    check("mask", mask, values.shape, "bool")
    counted = values[mask]
    if not counted.shape[0]:
        return xp.zeros_like(values)
    # One of the values is subtracted first: exactly 0 is left where all are equal.
    counted = from_member(xp, counted, xp.broadcast_to(counted[0], counted.shape))
    counted = counted - xp.mean(counted)
    deviation = xp.sqrt(xp.sum(counted**2) / max(counted.shape[0] - correction, 1))
    normalized = xp.zeros_like(values)
    normalized[mask] = xp.astype(counted / (deviation + epsilon), values.dtype)
    return normalized
