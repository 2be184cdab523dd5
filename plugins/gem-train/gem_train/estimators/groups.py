"""Advantages relative to a group: episodes that share a start, or turns that share a state."""

from __future__ import annotations

from typing import Any, Literal

from gem_train.estimators._arrays import Array, centered, check, masked, namespace
from gem_train.estimators.returns import discounted_returns

Scale = Literal["std", "none"]


def grpo_advantages(
    episode_returns: Array,
    groups: Array,
    *,
    scale: Scale = "std",
    learnable: Array | None = None,
    epsilon: float = 1e-8,
    correction: int = 0,
) -> Array:
    r"""Compare the return of each episode with those of its group.

    :math:`A_i = (R_i - \mathrm{mean}(R_g)) / (\mathrm{std}(R_g) + \epsilon)`, :math:`g` the group of episode
    :math:`i`; with ``scale="none"`` (Dr. GRPO) :math:`A_i = R_i - \mathrm{mean}(R_g)`. A group of one, or of equal
    returns, has the advantages 0. Every turn of an episode gets its episode's advantage.

    Args:
        episode_returns: float (E,), the sum of an episode's rewards.
        groups: int (E,), equal for episodes that share a start.
        scale: Whether to divide by the deviation of the group.
        learnable: bool (E,); episodes in which it is False (errors) are left out of the group and get 0. None: all.
        epsilon: Added to the deviation.
        correction: 0 divides the squares by the size of the group; 1 by one less, as ``torch.std`` does.

    Returns:
        float (E,).

    Raises:
        ValueError: A shape or dtype does not fit, or scale is not known.

    Source: GRPO, arXiv:2402.03300, section 4.1.2; Dr. GRPO, arXiv:2503.20783.
    """
    xp, index, included = _episode_groups(episode_returns, groups, learnable)
    return _relative(xp, episode_returns, index, included, scale, epsilon, correction)


def rloo_advantages(episode_returns: Array, groups: Array, *, learnable: Array | None = None) -> Array:
    r"""Compare the return of each episode with the mean of the others of its group (leave one out).

    :math:`A_i = R_i - \frac{1}{k - 1} \sum_{j \ne i} R_j`, :math:`k` the size of the group; 0 in a group of one,
    which has nothing to compare with.

    Args:
        episode_returns: float (E,), the sum of an episode's rewards.
        groups: int (E,), equal for episodes that share a start.
        learnable: bool (E,); episodes in which it is False (errors) are left out of the group and get 0. None: all.

    Returns:
        float (E,).

    Raises:
        ValueError: A shape or dtype does not fit.

    Source: arXiv:2402.14740.
    """
    xp, index, included = _episode_groups(episode_returns, groups, learnable)
    differences, _, sizes = centered(xp, episode_returns, index, included, 0)
    # R_i - (sum - R_i) / (k - 1) = (R_i - mean) k / (k - 1)
    return xp.astype(differences * sizes / xp.clip(sizes - 1, min=1), episode_returns.dtype)


def gigpo_advantages(
    rewards: Array,
    groups: Array,
    states: Array,
    mask: Array,
    *,
    gamma: float,
    step_weight: float = 1.0,
    scale: Scale = "std",
    learnable: Array | None = None,
    epsilon: float = 1e-8,
    correction: int = 0,
) -> Array:
    r"""Compare episodes with their group, and turns with those that were taken in the same state (GiGPO).

    :math:`A_{i,t} = A^E_i + \omega A^S_{i,t}`. :math:`A^E` is that of ``grpo_advantages`` for the undiscounted
    :math:`R_i = \sum_t r_{i,t}`. :math:`A^S` is the same formula for the discounted returns :math:`G_{i,t}` of all
    turns, of any episode of the group, that began in the same anchor state; 0 for a state met once.

    Args:
        rewards: float (E, T).
        groups: int (E,), equal for episodes that share a start.
        states: int (E, T), equal for equal states before the turn; states of different groups are never compared.
        mask: bool (E, T), True where there is a turn.
        gamma: Discount factor of the turns' returns, from 0 to 1.
        step_weight: :math:`\omega`.
        scale: "std" divides both parts by the deviation of their group; "none" does not.
        learnable: bool (E, T); other turns are left out of the states' groups, episodes without any such turn out of
            the episodes' groups; they get 0. None: the mask.
        epsilon: Added to the deviations.
        correction: 0 divides the squares by the size of the group; 1 by one less, as ``torch.std`` does.

    Returns:
        float (E, T), 0 where not learnable.

    Raises:
        ValueError: A shape or dtype does not fit, gamma is out of range, or scale is not known.

    Source: arXiv:2505.10978, equations 3 to 8.
    """
    namespace(rewards, groups, states, mask, learnable)
    returns = discounted_returns(rewards, mask, gamma=gamma)
    if learnable is None:
        learnable = mask
    check("learnable", learnable, rewards.shape, "bool")
    check("states", states, rewards.shape, "int")
    xp = namespace(rewards)
    learnable = learnable & mask
    # Sorted, so that equal rewards in another order have the same sum.
    totals = xp.sum(xp.sort(xp.astype(masked(xp, rewards, mask), xp.float64), axis=1), axis=1)
    xp, group, included = _episode_groups(totals, groups, xp.any(learnable, axis=1))
    of_episodes = _relative(xp, totals, group, included, scale, epsilon, correction)

    state = xp.unique_inverse(states).inverse_indices
    several = int(xp.max(state)) + 1 if states.shape[0] * states.shape[1] else 0
    pairs = xp.unique_inverse(xp.reshape(group[:, None] * several + state, (-1,))).inverse_indices
    flat, counted = xp.reshape(returns, (-1,)), xp.reshape(learnable, (-1,))
    of_turns = xp.reshape(_relative(xp, flat, pairs, counted, scale, epsilon, correction), rewards.shape)
    return masked(xp, xp.astype(of_episodes[:, None] + step_weight * of_turns, rewards.dtype), learnable)


def _episode_groups(episode_returns: Array, groups: Array, learnable: Array | None) -> tuple[Any, Array, Array]:
    """Check the arguments; return the namespace, the index of each episode's group, and who is included."""
    xp = namespace(episode_returns, groups, learnable)
    check("episode_returns", episode_returns, (None,), "float")
    check("groups", groups, episode_returns.shape, "int")
    if learnable is None:
        learnable = xp.ones_like(groups, dtype=xp.bool)
    check("learnable", learnable, episode_returns.shape, "bool")
    return xp, xp.unique_inverse(groups).inverse_indices, learnable


def _relative(
    xp: Any, values: Array, index: Array, included: Array, scale: Scale, epsilon: float, correction: int
) -> Array:
    """Subtract the mean of the group, and divide by its deviation if asked to."""
    if scale not in ("std", "none"):
        raise ValueError(f"scale is {scale!r}; expected 'std' or 'none'")
    differences, deviations, _ = centered(xp, values, index, included, correction)
    return xp.astype(differences / (deviations + epsilon) if scale == "std" else differences, values.dtype)
