"""What episodes took: seconds, steps a second and tokens, from the rows of a record."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from gem_eval.records import Row


def times(rows: Iterable[Row]) -> list[dict[str, Any]]:
    """Return what the episodes of each task and model took, as plain JSON; episodes with an error are left out.

    ``seconds`` are those of an episode from the first question to its end, ``env_seconds`` those of them in which no
    model was asked. ``equal_rows`` is the share of rows, among those played more than once, whose returns are all
    equal: group-relative advantages (GRPO) are zero there.
    """
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row.error is None:
            groups.setdefault((row.id, row.model), []).append(row)
    return [{"id": env_id, "model": model, **_taken(own)} for (env_id, model), own in groups.items()]


def _taken(rows: Sequence[Row]) -> dict[str, Any]:
    timed = [row for row in rows if row.seconds is not None]
    in_env = [(row.seconds or 0) - (row.model_seconds or 0) for row in timed]
    steps = sum(row.turns for row in timed)
    returns: dict[str, list[float]] = {}
    for row in rows:
        returns.setdefault(row.row, []).append(row.episode_return)
    repeated = [each for each in returns.values() if len(each) > 1]
    return {
        "episodes": len(rows),
        "turns": _mean([row.turns for row in rows]),
        "seconds": _percentiles([row.seconds or 0 for row in timed]),
        "env_seconds": _percentiles(in_env),
        "steps_per_second": steps / sum(in_env) if steps and sum(in_env) > 0 else None,
        "tokens_in": _mean([row.tokens_in for row in rows if row.tokens_in is not None]),
        "tokens_out": _mean([row.tokens_out for row in rows if row.tokens_out is not None]),
        "equal_rows": _mean([len(set(each)) == 1 for each in repeated]),
    }


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


def _percentiles(values: Sequence[float]) -> dict[str, float] | None:
    return {f"p{share}": float(np.percentile(values, share)) for share in (50, 99)} if values else None
