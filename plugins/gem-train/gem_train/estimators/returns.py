"""Discounted returns and generalized advantages over turns."""

from __future__ import annotations

import array_api_compat

from gem_train.estimators._arrays import Array, check, check_fraction, masked, namespace


def discounted_returns(
    rewards: Array,
    mask: Array,
    *,
    gamma: float,
    terminated: Array | None = None,
    bootstrap_values: Array | None = None,
) -> Array:
    r"""Compute the discounted return of each turn.

    :math:`G_t = r_t + \gamma G_{t+1}`, and after the last turn :math:`G = 0`, or, with a critic, its value of what
    would have come if the episode was cut off. The discount counts turns, not tokens.

    Args:
        rewards: float (E, T).
        mask: bool (E, T), True where there is a turn; positions in which it is False are skipped.
        gamma: Discount factor, from 0 to 1.
        terminated: bool (E,), the task was over: nothing follows. Given together with ``bootstrap_values``.
        bootstrap_values: float (E,), value after the last turn; ignored where ``terminated``.

    Returns:
        float (E, T), 0 where the mask is False.

    Raises:
        ValueError: A shape or dtype does not fit, or gamma is out of range.

    Source: GEM, arXiv:2510.01051.
    """
    xp = namespace(rewards, mask, terminated, bootstrap_values)
    check("rewards", rewards, (None, None), "float")
    check("mask", mask, rewards.shape, "bool")
    check_fraction("gamma", gamma)
    if (terminated is None) != (bootstrap_values is None):
        raise ValueError("terminated and bootstrap_values belong together; give both or neither")
    following = _after_the_end(rewards, terminated, bootstrap_values)
    returns = []
    for turn in reversed(range(rewards.shape[1])):
        following = xp.where(mask[:, turn], rewards[:, turn] + gamma * following, following)
        returns.append(following)
    return masked(xp, xp.stack(returns[::-1], axis=1), mask) if returns else xp.zeros_like(rewards)


def gae(
    rewards: Array,
    values: Array,
    mask: Array,
    terminated: Array,
    bootstrap_values: Array,
    *,
    gamma: float,
    lam: float,
) -> tuple[Array, Array]:
    r"""Compute generalized advantage estimates over turns, and the targets of the values.

    :math:`\delta_t = r_t + \gamma V_{t+1} - V_t`, :math:`A_t = \delta_t + \gamma \lambda A_{t+1}`; targets are
    :math:`A_t + V_t`. After the last turn :math:`A = 0`, and :math:`V` is 0 where the episode terminated, else its
    bootstrap value: a truncated episode would have gone on.

    Args:
        rewards: float (E, T).
        values: float (E, T), the critic's value of the state before each turn.
        mask: bool (E, T), True where there is a turn; positions in which it is False are skipped.
        terminated: bool (E,), the task was over: nothing follows.
        bootstrap_values: float (E,), value after the last turn; ignored where ``terminated``.
        gamma: Discount factor, from 0 to 1.
        lam: From 0 (one-step differences) to 1 (returns minus values).

    Returns:
        Advantages and value targets, each float (E, T), 0 where the mask is False.

    Raises:
        ValueError: A shape or dtype does not fit, or a factor is out of range.

    Source: arXiv:1506.02438, equation 16.
    """
    xp = namespace(rewards, values, mask, terminated, bootstrap_values)
    check("rewards", rewards, (None, None), "float")
    check("values", values, rewards.shape, "float")
    check("mask", mask, rewards.shape, "bool")
    check_fraction("gamma", gamma)
    check_fraction("lam", lam)
    next_value = _after_the_end(rewards, terminated, bootstrap_values)
    advantage = xp.zeros_like(next_value)
    advantages = []
    for turn in reversed(range(rewards.shape[1])):
        here, value = mask[:, turn], values[:, turn]
        delta = rewards[:, turn] + gamma * next_value - value
        advantage = xp.where(here, delta + gamma * lam * advantage, advantage)
        next_value = xp.where(here, value, next_value)
        advantages.append(advantage)
    if not advantages:
        return xp.zeros_like(rewards), xp.zeros_like(rewards)
    stacked = masked(xp, xp.stack(advantages[::-1], axis=1), mask)
    return stacked, masked(xp, stacked + values, mask)


def _after_the_end(rewards: Array, terminated: Array | None, bootstrap_values: Array | None) -> Array:
    """Return the value of what follows the last turn, float (E,)."""
    xp = namespace(rewards)
    nothing = xp.zeros(rewards.shape[:1], dtype=rewards.dtype, device=array_api_compat.device(rewards))
    if bootstrap_values is None:
        return nothing
    check("terminated", terminated, rewards.shape[:1], "bool")
    check("bootstrap_values", bootstrap_values, rewards.shape[:1], "float")
    return xp.where(terminated, nothing, bootstrap_values)
