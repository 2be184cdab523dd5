"""The estimators against plain loops over lists, written from the papers' sums, on batches that hypothesis makes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import pytest
from array_kinds import Kind, each_library
from hypothesis import given
from hypothesis import strategies as st

from gem_train.estimators import (
    aggregate_tokens,
    discounted_returns,
    gae,
    gigpo_advantages,
    grpo_advantages,
    kl_penalty,
    policy_gradient_loss,
    ppo_loss,
    return_batch_normalization,
    rloo_advantages,
    role_baselines,
    truncated_importance_weights,
    value_loss,
)

NAN = math.nan
EPSILON = 1e-8


@dataclass
class Turn:
    """What the estimators know of a turn."""

    reward: float
    value: float
    state: int
    learnable: bool


@dataclass
class Play:
    """An episode as a list of turns."""

    turns: list[Turn]
    group: int
    terminated: bool
    bootstrap: float
    learnable: bool

    @property
    def total(self) -> float:
        return sum(turn.reward for turn in self.turns)

    def discounted(self, start: int, gamma: float) -> float:
        return sum(gamma**steps * turn.reward for steps, turn in enumerate(self.turns[start:]))


@dataclass
class Token:
    """What the losses know of a token."""

    logprob: float
    old: float
    advantage: float
    weight: float
    sampled: bool


# Multiples of a half, as rewards often are: many are equal, and a deviation is either 0 or far from it.
numbers = st.integers(-8, 8).map(lambda number: number / 2)
fractions = st.sampled_from([0.0, 0.5, 0.9, 1.0])
scales = st.sampled_from(["std", "none"])
corrections = st.sampled_from([0, 1])
turns = st.builds(Turn, numbers, numbers, st.integers(0, 2), st.booleans())
plays = st.builds(Play, st.lists(turns, max_size=5), st.integers(-1, 2), st.booleans(), numbers, st.booleans())
batches = st.lists(plays, min_size=1, max_size=8)
logprobs = st.floats(-6, 0)
tokens = st.builds(Token, logprobs, logprobs, numbers, st.floats(0, 2), st.booleans())
token_rows = st.lists(st.lists(tokens, min_size=4, max_size=4), min_size=1, max_size=5)


def padded(rows: list[list[Any]], padding: Any) -> list[list[Any]]:
    """Return rows of one length."""
    longest = max(map(len, rows))
    return [row + [padding] * (longest - len(row)) for row in rows]


def of_turns(batch: list[Play], name: str, padding: Any) -> list[list[Any]]:
    """Return an attribute of all turns."""
    return padded([[getattr(turn, name) for turn in play.turns] for play in batch], padding)


def mask_of(batch: list[Play]) -> list[list[bool]]:
    return padded([[True] * len(play.turns) for play in batch], False)


def relative(value: float, others: list[float], scale: str, correction: int) -> float:
    """Compare a value with all of its group, itself included."""
    mean = sum(others) / len(others)
    if scale == "none":
        return value - mean
    squares = sum((other - mean) ** 2 for other in others)
    return (value - mean) / (math.sqrt(squares / max(len(others) - correction, 1)) + EPSILON)


@each_library
@given(batch=batches, gamma=fractions)
def test_discounted_returns_are_sums_of_discounted_rewards(kind: Kind, batch: list[Play], gamma: float):
    """Each return by its own sum; a critic's value follows the last turn of an episode that did not terminate."""
    rewards, mask = kind.floats(of_turns(batch, "reward", NAN)), kind.bools(mask_of(batch))
    expected = [[play.discounted(t, gamma) for t in range(len(play.turns))] for play in batch]
    kind.close(discounted_returns(rewards, mask, gamma=gamma), padded(expected, 0))
    ends = {
        "terminated": kind.bools([play.terminated for play in batch]),
        "bootstrap_values": kind.floats([NAN if play.terminated else play.bootstrap for play in batch]),
    }
    for play, row in zip(batch, expected, strict=True):
        for turn in range(len(row)):
            row[turn] += 0 if play.terminated else gamma ** (len(row) - turn) * play.bootstrap
    kind.close(discounted_returns(rewards, mask, gamma=gamma, **ends), padded(expected, 0))


@each_library
@given(batch=batches, gamma=fractions, lam=fractions)
def test_gae_is_a_sum_of_discounted_differences(kind: Kind, batch: list[Play], gamma: float, lam: float):
    """Each advantage by its own sum over the differences that follow."""
    expected, targets = [], []
    for play in batch:
        values = [turn.value for turn in play.turns] + [0 if play.terminated else play.bootstrap]
        deltas = [turn.reward + gamma * values[t + 1] - values[t] for t, turn in enumerate(play.turns)]
        row = [
            sum((gamma * lam) ** (later - t) * deltas[later] for later in range(t, len(deltas)))
            for t in range(len(deltas))
        ]
        expected.append(row)
        targets.append([advantage + value for advantage, value in zip(row, values[:-1], strict=True)])
    results = gae(
        kind.floats(of_turns(batch, "reward", NAN)),
        kind.floats(of_turns(batch, "value", NAN)),
        kind.bools(mask_of(batch)),
        kind.bools([play.terminated for play in batch]),
        kind.floats([NAN if play.terminated else play.bootstrap for play in batch]),
        gamma=gamma,
        lam=lam,
    )
    kind.close(results[0], padded(expected, 0))
    kind.close(results[1], padded(targets, 0))


@each_library
@given(batch=batches, correction=corrections)
def test_return_batch_normalization_takes_all_learnable_turns(kind: Kind, batch: list[Play], correction: int):
    """One mean and one deviation for the batch."""
    every = [turn.value for play in batch for turn in play.turns if turn.learnable]
    expected = [
        [relative(turn.value, every, "std", correction) if turn.learnable else 0.0 for turn in play.turns]
        for play in batch
    ]
    returns, learnable = of_turns(batch, "value", NAN), of_turns(batch, "learnable", False)
    result = return_batch_normalization(kind.floats(returns), kind.bools(learnable), correction=correction)
    kind.close(result, padded(expected, 0))


@each_library
@given(batch=batches, scale=scales, correction=corrections)
def test_grpo_and_rloo_compare_within_the_group(kind: Kind, batch: list[Play], scale: str, correction: int):
    """Episodes that are not learnable are as if they were not there, and get 0."""
    expected_grpo, expected_rloo = [], []
    for play in batch:
        group = [other for other in batch if other.group == play.group and other.learnable]
        others = [other.total for other in group if other is not play]
        counts = play.learnable
        expected_grpo.append(
            relative(play.total, [other.total for other in group], scale, correction) if counts else 0.0
        )
        expected_rloo.append(play.total - sum(others) / len(others) if counts and others else 0.0)
    returns = kind.floats([play.total if play.learnable else NAN for play in batch])
    groups = kind.ints([play.group for play in batch])
    learnable = kind.bools([play.learnable for play in batch])
    options: dict[str, Any] = {"scale": scale, "correction": correction}
    kind.close(grpo_advantages(returns, groups, learnable=learnable, **options), expected_grpo)
    kind.close(rloo_advantages(returns, groups, learnable=learnable), expected_rloo)


@each_library
@given(batch=batches, gamma=fractions, weight=fractions, scale=scales, correction=corrections)
def test_gigpo_compares_episodes_and_turns(
    kind: Kind, batch: list[Play], gamma: float, weight: float, scale: str, correction: int
):
    """The episodes' part over the groups' episodes, the turns' part over all turns of a group in the same state."""
    expected = []
    for play in batch:
        group = [other for other in batch if other.group == play.group]
        totals = [other.total for other in group if any(turn.learnable for turn in other.turns)]
        row = []
        for t, turn in enumerate(play.turns):
            met = [
                other.discounted(s, gamma)
                for other in group
                for s, there in enumerate(other.turns)
                if there.state == turn.state and there.learnable
            ]
            row.append(
                relative(play.total, totals, scale, correction)
                + weight * relative(play.discounted(t, gamma), met, scale, correction)
                if turn.learnable
                else 0.0
            )
        expected.append(row)
    result = gigpo_advantages(
        kind.floats(of_turns(batch, "reward", NAN)),
        kind.ints([play.group for play in batch]),
        kind.ints(of_turns(batch, "state", 0)),
        kind.bools(mask_of(batch)),
        gamma=gamma,
        step_weight=weight,
        scale=scale,  # type: ignore[arg-type]
        learnable=kind.bools(of_turns(batch, "learnable", True)),  # the mask alone says where there is no turn
        correction=correction,
    )
    kind.close(result, padded(expected, 0))


@each_library
@given(batch=batches, decay=fractions)
def test_role_baselines_are_moving_means(kind: Kind, batch: list[Play], decay: float):
    """The mean of a role as a weighted sum of the returns before; two calls go on where one would."""
    expected, seen = [], dict[int, list[float]]()
    for play in batch:
        before = seen.setdefault(play.group + 1, [])
        baseline = sum((1 - decay) * decay**age * value for age, value in enumerate(reversed(before)))
        expected.append(play.total - baseline if play.learnable else 0.0)
        if play.learnable:
            before.append(play.total)
    state, results = kind.floats([0, 0, 0, 0]), []
    for part in (batch[:3], batch[3:]):
        advantages, state = role_baselines(
            state,
            kind.floats([play.total for play in part]),
            kind.ints([play.group + 1 for play in part]),
            decay=decay,
            learnable=kind.bools([play.learnable for play in part]),
        )
        results += advantages.tolist()
    assert results == pytest.approx(expected, rel=kind.tolerance, abs=kind.tolerance)


def sampled(rows: list[list[Token]], name: str) -> list[list[float]]:
    """Return an attribute of sampled tokens, NaN for others."""
    return [[getattr(token, name) if token.sampled else NAN for token in row] for row in rows]


def aggregated(rows: list[list[float | None]], aggregate: str, length: int) -> float:
    """Aggregate values, None where nothing was sampled."""
    present = [[value for value in row if value is not None] for row in rows]
    present = [row for row in present if row]
    if not present:
        return 0.0
    if aggregate == "token":
        return sum(map(sum, present)) / sum(map(len, present))
    return sum(sum(row) / (len(row) if aggregate == "sequence" else length) for row in present) / len(present)


def clipped_loss(token: Token, low: float, high: float) -> float:
    ratio = math.exp(token.logprob - token.old)
    nearest = min(max(ratio, 1 - low), 1 + high)
    return -token.weight * min(ratio * token.advantage, nearest * token.advantage)


@each_library
@given(
    rows=token_rows,
    aggregate=st.sampled_from(["token", "sequence", "constant"]),
    low=fractions,
    high=st.sampled_from([0.2, 0.5]),
)
def test_policy_losses(kind: Kind, rows: list[list[Token]], aggregate: Any, low: float, high: float):
    """PPO and REINFORCE token by token, each in the three ways of aggregation."""
    arrays = [kind.floats(sampled(rows, name)) for name in ("logprob", "old", "advantage")]
    mask = kind.bools([[token.sampled for token in row] for row in rows])
    options: dict[str, Any] = {"aggregate": aggregate, "length": 7 if aggregate == "constant" else None}
    options["weights"] = kind.floats(sampled(rows, "weight"))

    def total(loss_of: Any) -> float:
        return aggregated([[loss_of(token) if token.sampled else None for token in row] for row in rows], aggregate, 7)

    loss, metrics = ppo_loss(*arrays, mask, clip_low=low, clip_high=high, **options)
    kind.close(loss, total(lambda token: clipped_loss(token, low, high)))
    counted = [token for row in rows for token in row if token.sampled]
    ratios = [math.exp(token.logprob - token.old) for token in counted]
    kind.close(metrics.ratio, sum(ratios) / max(len(ratios), 1))
    kind.close(metrics.approximate_kl, sum(ratio - 1 - math.log(ratio) for ratio in ratios) / max(len(ratios), 1))
    loss, _ = policy_gradient_loss(*arrays, mask, **options)
    kind.close(loss, total(lambda token: -token.weight * token.advantage * token.logprob))


@each_library
@given(rows=token_rows)
def test_measures_of_two_policies(kind: Kind, rows: list[list[Token]]):
    """The three estimators of the divergence, and the truncated weights, token by token."""
    arrays = kind.floats(sampled(rows, "logprob")), kind.floats(sampled(rows, "old"))
    mask = kind.bools([[token.sampled for token in row] for row in rows])

    def each(value_of: Any) -> list[list[float]]:
        return [[value_of(token.logprob, token.old) if token.sampled else 0.0 for token in row] for row in rows]

    kind.close(kl_penalty(*arrays, mask, kind="k1"), each(lambda new, old: new - old))
    kind.close(kl_penalty(*arrays, mask, kind="k2"), each(lambda new, old: (new - old) ** 2 / 2))
    kind.close(kl_penalty(*arrays, mask, kind="k3"), each(lambda new, old: math.exp(old - new) - 1 - (old - new)))
    weights = truncated_importance_weights(*arrays, mask, cap=1.5)
    kind.close(weights, each(lambda new, old: min(math.exp(new - old), 1.5)))


@each_library
@given(batch=batches)
def test_value_loss_is_half_the_mean_square(kind: Kind, batch: list[Play]):
    """Over learnable turns."""
    values, targets = kind.floats(of_turns(batch, "value", NAN)), kind.floats(of_turns(batch, "reward", NAN))
    counted = [turn for play in batch for turn in play.turns if turn.learnable]
    squares = sum((turn.value - turn.reward) ** 2 / 2 for turn in counted)
    kind.close(
        value_loss(values, targets, kind.bools(of_turns(batch, "learnable", False))), squares / max(len(counted), 1)
    )


@each_library
@given(rows=token_rows)
def test_parts_of_a_batch_add_up_to_the_whole(kind: Kind, rows: list[list[Token]]):
    """With the denominator of the whole batch, losses of its rows one by one sum to its loss."""
    values = kind.floats(sampled(rows, "advantage"))
    mask = kind.bools([[token.sampled for token in row] for row in rows])
    counts = {
        "token": sum(token.sampled for row in rows for token in row),
        "sequence": sum(any(token.sampled for token in row) for row in rows),
    }
    for aggregate, count in counts.items():
        if not count:
            continue
        options: dict[str, Any] = {"aggregate": aggregate, "denominator": count}
        parts = [float(aggregate_tokens(values[i : i + 1], mask[i : i + 1], **options)) for i in range(len(rows))]
        whole = float(aggregate_tokens(values, mask, aggregate=aggregate))  # type: ignore[arg-type]
        assert sum(parts) == pytest.approx(whole, rel=kind.tolerance, abs=kind.tolerance)
