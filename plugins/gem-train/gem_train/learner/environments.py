"""The environments of a run: vector environments with a plan that any update can begin from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from itertools import count

import gem_core as gem
from gem_core.env import stable_hash
from gem_core.records import PlanItem
from gem_core.vector import VectorEnv
from gem_train.learner.options import TrainOptions


def training_envs(options: TrainOptions, first_update: int = 0) -> VectorEnv:
    """Return a slot for each episode of an update; each ``reset`` begins the episodes of the next one."""
    return _vector(options, options.env, options.episodes, _training_plan(options, first_update))


def evaluation_envs(options: TrainOptions, env_id: str) -> VectorEnv:
    """Return a slot for each episode of an evaluation, whose starts are the same every time."""
    items = [PlanItem(seed=stable_hash(options.seed, "evaluation", place)) for place in range(options.eval_episodes)]
    return _vector(options, (env_id,), options.eval_episodes, items)


def _training_plan(options: TrainOptions, first_update: int) -> Iterator[PlanItem]:
    for update in count(first_update):
        for place in range(options.episodes // options.group_size):
            yield PlanItem(
                id=options.env[place % len(options.env)],
                seed=stable_hash(options.seed, "training", update, place),
                repeat=options.group_size,
            )


def _vector(
    options: TrainOptions, ids: tuple[str, ...], slots: int, plan: Iterator[PlanItem] | list[PlanItem]
) -> VectorEnv:
    return gem.make_vec(
        ids[0] if len(ids) == 1 else [ids[slot // options.group_size % len(ids)] for slot in range(slots)],
        slots,
        autoreset="disabled",
        wrappers=options.wrappers,
        seed=options.seed,
        plan=plan,
        **options.env_kwargs,
    )


def seat_count(env_id: str, options: TrainOptions) -> int:
    """Return how many agents act in an environment at most; 0 where an agent is alone."""
    with closing(gem.make(env_id, wrappers=options.wrappers, **options.env_kwargs)) as env:
        return len(env.unwrapped.possible_agents) if isinstance(env.unwrapped, gem.MultiAgentEnv) else 0
