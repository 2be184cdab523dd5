"""Scores of models on environments, from the rows of a run's index."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from gem_core.records import Range, shared_range
from gem_eval.grouping import grouped
from gem_eval.statistics import Estimate, mean, pass_at, pass_hat, row_means

if TYPE_CHECKING:
    from gem_core import Episode
    from gem_eval.records import Row

Metric = Literal["success", "return"]


@dataclass(frozen=True)
class Score:
    """The score of one model on one environment, or on all together, by one metric.

    All counts but ``rows`` and ``errors`` are of episodes without an error.

    Args:
        id: The environment; ``"all"`` for several, each of whose rows weighs the same.
        model: Name of the agent.
        metric: ``"success"``, the share of episodes that solved their task; or ``"return"``.
        mean: Mean of the means of rows; None where no episode has a value.
        stderr: Standard error of the mean, clustered by row; None where the sample does not tell.
        low: Lower end of the 95 % interval.
        high: Upper end of the 95 % interval.
        episodes: Number of episodes; the mean of successes is over those that are not unscored.
        rows: Number of rows with a value.
        pass_at: Of successes with several epochs, pass@k by k: for powers of two up to the number of epochs, and for
            that. Rows with fewer than k epochs that count are left out.
        errors: Number of episodes that failed by an error; no score counts them.
        truncated: Number of episodes that a limit cut off. Unless their task gave a verdict, they count as not solved.
        unscored: Number of episodes whose task did not tell whether it was solved.
        unreadable: Number of episodes whose last response could not be read.
        pass_hat: As ``pass_at``, pass^k.
        without_truncated: The estimate without truncated episodes; None where it is the same, or there are no others.
        without_unreadable: The estimate without unreadable episodes; None where it is the same, or there are no others.
        with_errors: The mean if errors counted as 0; None where there are no errors.
        with_unscored: The mean of successes if unscored episodes counted as 0; None where there are none.
        pass_left_out: Number of rows that pass@k and pass^k leave out, by k: with fewer than k episodes that count.
    """

    id: str
    model: str
    metric: Metric
    mean: float | None
    stderr: float | None
    low: float | None
    high: float | None
    episodes: int
    rows: int
    pass_at: dict[str, Estimate]
    errors: int
    truncated: int
    unscored: int
    unreadable: int
    pass_hat: dict[str, Estimate]
    without_truncated: Estimate | None
    without_unreadable: Estimate | None
    with_errors: float | None
    with_unscored: float | None
    pass_left_out: dict[str, int]

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain JSON; of ``pass_at`` and ``pass_hat`` the means."""
        found = dict(vars(self))
        for name in ("pass_at", "pass_hat"):
            found[name] = {k: estimate.mean for k, estimate in found[name].items()}
        for name in ("without_truncated", "without_unreadable"):
            found[name] = None if found[name] is None else found[name]._asdict()
        return found


def compute_scores(episodes: Iterable[Row]) -> list[Score]:
    """Compute the scores of a run.

    Episodes with an error count as nothing but errors. The others have ``success`` as ``Episode`` has it: None where
    the task did not tell, False for one that was cut off without a verdict. An environment has success rates unless its
    task never tells: then the only episodes with ``success`` are those that were cut off. A return that is not finite
    has no value.

    Args:
        episodes: The episodes, in any order.

    Returns:
        For each environment and model, in order of first appearance, the score by success, where there is one, and by
        return; then, for each model, those of all its environments together, where there are several. Of several
        agents, each seat is an environment of its own, and there is no sum, which would mix the two sides of a game.
    """
    played = list(episodes)
    tells = {env_id for env_id, own in grouped(played, lambda row: row.id).items() if tells_success(own)}
    scores = []
    for (env_id, model), own in grouped(played, lambda row: (row.id, row.model)).items():
        metrics: list[Metric] = ["success", "return"] if env_id in tells else ["return"]
        scores += [_score(env_id, model, metric, own) for metric in metrics]
    if any(row.seat is not None for row in played):
        return scores
    for model, own in grouped(played, lambda row: row.model).items():
        telling = [row for row in own if row.id in tells]
        together: list[tuple[Metric, list[Row]]] = [("success", telling), ("return", own)]
        scores += [_score("all", model, metric, rows) for metric, rows in together if len({row.id for row in rows}) > 1]
    return scores


def tells_success(played: Sequence[Row] | Sequence[Episode]) -> bool:
    """Whether a task says if it was solved; one that never does fails only where it is cut off."""
    verdicts = [(episode.success, episode.cut_off) for episode in played if episode.error is None]
    if any(success is not None and (success or cut_off is None) for success, cut_off in verdicts):
        return True
    return bool(verdicts) and all(success is not None for success, _ in verdicts)


def _score(env_id: str, model: str, metric: Metric, played: Sequence[Row]) -> Score:
    counted = [episode for episode in played if episode.error is None]
    errors = [episode for episode in played if episode.error is not None]
    unscored = [episode for episode in counted if episode.success is None]
    rows = _rows(metric, counted)
    within = _range(metric, counted)
    estimate = _estimate(rows, within)
    counts = [(len(row), int(sum(row))) for row in rows]
    ks = _ks(max((count for count, _ in counts), default=0)) if metric == "success" else []
    asked = len({(episode.id, episode.row) for episode in played})

    def without(left_out: Callable[[Row], bool]) -> Estimate | None:
        kept = [episode for episode in counted if not left_out(episode)]
        other = _estimate(_rows(metric, kept), within) if len(kept) < len(counted) else None
        if other is None or estimate is None or math.isclose(other.mean, estimate.mean, abs_tol=1e-12):
            return None
        return other

    def with_zeros(failed: list[Row]) -> float | None:
        changed = _rows(metric, counted, failed) if failed else []
        return float(row_means(changed).mean()) if changed else None

    center, stderr, low, high = estimate or (None, None, None, None)
    return Score(
        env_id,
        model,
        metric,
        center,
        stderr,
        low,
        high,
        episodes=len(counted),
        rows=len(rows),
        pass_at={str(k): pass_at(counts, k) for k in ks},
        errors=len(errors),
        truncated=sum(episode.cut_off is not None for episode in counted),
        unscored=len(unscored),
        unreadable=sum(episode.unreadable for episode in counted),
        pass_hat={str(k): pass_hat(counts, k) for k in ks},
        without_truncated=without(lambda episode: episode.cut_off is not None),
        without_unreadable=without(lambda episode: episode.unreadable),
        with_errors=with_zeros(errors),
        with_unscored=with_zeros(unscored) if metric == "success" else None,
        pass_left_out={str(k): asked - sum(count >= k for count, _ in counts) for k in ks},
    )


def _rows(metric: Metric, counted: Iterable[Row], zeros: Iterable[Row] = ()) -> list[list[float]]:
    """Return the values by row, with 0 for some more episodes; episodes without a value are left out."""
    rows: dict[tuple[str, str], list[float]] = {}
    for episode in counted:
        value = episode.episode_return if metric == "return" else episode.success
        if value is not None and math.isfinite(value):
            rows.setdefault((episode.id, episode.row), []).append(float(value))
    for episode in zeros:
        rows.setdefault((episode.id, episode.row), []).append(0.0)
    return list(rows.values())


def _range(metric: Metric, counted: Sequence[Row]) -> Range | None:
    """Return the range of values: of returns that are 1 for success and else 0, that of successes."""
    if metric == "success" or all(row.success is not None and row.episode_return == row.success for row in counted):
        return (0.0, 1.0)
    returns = [row.episode_return for row in counted if math.isfinite(row.episode_return)] or [0.0]
    return shared_range([row.return_range for row in counted], min(returns), max(returns))


def _estimate(rows: list[list[float]], within: Range | None) -> Estimate | None:
    return mean(rows, within=within) if rows else None


def _ks(epochs: int) -> list[int]:
    """Return the k of pass@k: powers of two up to a number of epochs, and that; none for one epoch."""
    return sorted({epochs, *(2**power for power in range(epochs.bit_length()))}) if epochs > 1 else []
