"""Baselines for self-play: a moving mean of the returns of each role."""

from __future__ import annotations

from typing import NamedTuple

import array_api_compat

from gem_train.estimators._arrays import Array, check, check_fraction, namespace


class RoleAdvantages(NamedTuple):
    """Advantages, and the baselines to pass to the next call."""

    advantages: Array
    """float (E,)."""
    baselines: Array
    """float (roles,)."""


def role_baselines(
    baselines: Array, episode_returns: Array, roles: Array, *, decay: float = 0.95, learnable: Array | None = None
) -> RoleAdvantages:
    r"""Subtract from each return the moving mean of its role, and move the means on.

    For each row in order, :math:`p` its role: :math:`A = R - b_p`, then :math:`b_p \leftarrow \alpha b_p +
    (1 - \alpha) R`. In self-play the players' returns add up to a constant, so a mean over all of them hides that
    moving first is an advantage; one for each role does not. The baseline is taken before it sees the return, as the
    paper's code does, so that the gradient stays unbiased. Start with zeros.

    Args:
        baselines: float (roles,), the means so far. Where several games are learnt at once, a role is one seat of
            one game.
        episode_returns: float (E,), one row for each seat of each episode.
        roles: int (E,), the row's role, an index into ``baselines``.
        decay: :math:`\alpha`, from 0 (only the last return counts) to 1 (never moves).
        learnable: bool (E,); rows in which it is False (errors) get 0 and move nothing. None: all.

    Returns:
        Advantages (E,), and the baselines (roles,) to pass to the next call; what was given stays as it was.

    Raises:
        ValueError: A shape or dtype does not fit, a role has no baseline, or decay is out of range.

    Source: SPIRAL, arXiv:2506.24119, role-conditioned advantage estimation.
    """
    xp = namespace(baselines, episode_returns, roles, learnable)
    check("baselines", baselines, (None,), "float")
    check("episode_returns", episode_returns, (None,), "float")
    check("roles", roles, episode_returns.shape, "int")
    check_fraction("decay", decay)
    if learnable is None:
        learnable = xp.ones_like(roles, dtype=xp.bool)
    check("learnable", learnable, episode_returns.shape, "bool")
    count = baselines.shape[0]
    # Each row depends on the one before: plain numbers are faster than arrays here.
    means: list[float] = baselines.tolist()
    advantages = []
    for value, role, counts in zip(episode_returns.tolist(), roles.tolist(), learnable.tolist(), strict=True):
        if not 0 <= role < count:
            raise ValueError(f"roles has {role}; expected an index of the {count} baselines, 0 to {count - 1}")
        advantages.append(value - means[role] if counts else 0.0)
        if counts:
            means[role] = decay * means[role] + (1.0 - decay) * value
    return RoleAdvantages(
        xp.asarray(advantages, dtype=episode_returns.dtype, device=array_api_compat.device(episode_returns)),
        xp.asarray(means, dtype=baselines.dtype, device=array_api_compat.device(baselines)),
    )
