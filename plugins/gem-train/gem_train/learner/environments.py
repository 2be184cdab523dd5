"""The environments of a run: vector environments with a plan that any update can begin from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing
from itertools import count

import gem_core as gem
from gem_core.env import stable_hash
from gem_core.records import PlanItem
from gem_core.vector import VectorEnv
from gem_train.learner.options import TrainOptions


class TrainingPlan:
    """What the episodes of an update begin with: those of a group with the same seed.

    An episode that cannot begin takes one more start; ``begin`` leaves behind what an earlier update took or did not.

    Args:
        options: Of the run.
    """

    def __init__(self, options: TrainOptions) -> None:
        self._options = options
        self.begin(0)

    def begin(self, update: int) -> None:
        """Go to the first episode of an update."""
        self._update, self._places = update, count()

    def __iter__(self) -> Iterator[PlanItem]:
        options = self._options
        while True:
            group = next(self._places) // options.group_size
            seed = stable_hash(options.seed, "training", self._update, group)
            yield PlanItem(id=options.env[group % len(options.env)], seed=seed)


def training_envs(options: TrainOptions, plan: TrainingPlan) -> VectorEnv:
    """Return a slot for each episode of an update."""
    return _vector(options, options.env, options.episodes, plan)


def evaluation_envs(options: TrainOptions, env_id: str) -> VectorEnv:
    """Return a slot for each episode of an evaluation, whose starts are the same every time."""
    items = [PlanItem(seed=stable_hash(options.seed, "evaluation", place)) for place in range(options.eval_episodes)]
    return _vector(options, (env_id,), options.eval_episodes, items)


def _vector(options: TrainOptions, ids: tuple[str, ...], slots: int, plan: Iterable[PlanItem]) -> VectorEnv:
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
