"""``Training``: a run in memory, from the warm start to the last evaluation; ``gem train`` keeps it in a folder."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from typing import NamedTuple, Self

from gem_core.env import stable_hash
from gem_train.learner.environments import TrainingPlan, evaluation_envs, seat_count, training_envs
from gem_train.learner.imitation import build_vocabulary, imitate, record_episodes
from gem_train.learner.learning import Learner
from gem_train.learner.options import TrainOptions
from gem_train.learner.playing import Played, Player, groups_of, token_batch, values_of
from gem_train.learner.policy_loss import Floats


class Update(NamedTuple):
    """One update: its metrics by name, and the episodes that it learnt from."""

    metrics: dict[str, float]
    played: list[Played]


def warm_start(options: TrainOptions, on_step: Callable[[int, float], None] = lambda step, loss: None) -> Learner:
    """Return a learner with a vocabulary built from the environments, that imitates a player where asked.

    Args:
        options: Of the run.
        on_step: Called with the number of each step of imitation and its loss.
    """
    recorded = (
        record_episodes(options, options.env, options.imitate, options.imitate_episodes) if options.imitate else []
    )
    learner = Learner(options, build_vocabulary(options, recorded))
    if recorded:
        for step, loss in enumerate(imitate(learner, recorded)):
            on_step(step, loss)
    return learner


class Training:
    """Plays and learns, one update at a time; to be closed, as by ``with``.

    Random numbers of each update come from a seed of its own, so that a run can be taken up at any update.

    Args:
        learner: What ``warm_start`` returned, or what was restored from a checkpoint.
    """

    def __init__(self, learner: Learner) -> None:
        self.learner, self.options = learner, learner.options
        options = self.options
        self._open = ExitStack()
        self._plan = TrainingPlan(options)
        self._envs = self._open.enter_context(training_envs(options, self._plan))
        policy = copy.deepcopy(learner.policy) if options.overlap else learner.policy
        seats = max(_seats(env_id, options) for env_id in options.env)
        self._player = Player(policy, learner.vocabulary, options, options.episodes * seats)
        self._thread = self._open.enter_context(ThreadPoolExecutor(1)) if options.overlap else None
        self._next: Future[tuple[list[Played], Floats]] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._open.close()

    def update(self) -> Update:
        """Play a batch of episodes and learn from it."""
        options, learner = self.options, self.learner
        played, bootstrap = self._play()
        groups = groups_of(played)
        batch = token_batch(
            played, groups=groups, learn_cut_off=options.learn_cut_off, failure_reward=options.failure_reward
        )
        metrics = describe(played) | learner.learn(batch, values_of(played, batch), bootstrap)
        return Update(metrics, played)

    def evaluate(self, env_id: str | None = None) -> list[Played]:
        """Play the evaluation's episodes of an environment, the same ones every time.

        Args:
            env_id: Of the environment; None for the first one that is learnt.
        """
        options, learner = self.options, self.learner
        env_id = env_id or options.env[0]
        player = Player(learner.policy, learner.vocabulary, options, options.eval_episodes * _seats(env_id, options))
        with evaluation_envs(options, env_id) as envs:
            return player.play(envs, stable_hash(options.seed, "evaluation", learner.updates))

    def _play(self) -> tuple[list[Played], Floats]:
        """Return a batch, and the critic's values after its last turns; ``overlap`` begins the next."""
        update = self.learner.updates
        if self._thread is None:
            return self._play_update(update)
        ready = self._play_update(update) if self._next is None else self._next.result()
        self._player.policy.load_state_dict(self.learner.policy.state_dict())
        if update + 1 < self.options.updates:
            self._next = self._thread.submit(self._play_update, update + 1)
        return ready

    def _play_update(self, update: int) -> tuple[list[Played], Floats]:
        self._plan.begin(update)
        played = self._player.play(self._envs, stable_hash(self.options.seed, "sampling", update))
        return played, self._player.bootstrap(played)


def describe(played: Sequence[Played]) -> dict[str, float]:
    """Return the means over episodes of return, success, turns and tokens of a response, errors left out."""
    counted = [seat for seat in played if not seat.error and seat.turns]
    known = [seat.success for seat in counted if not math.isnan(seat.success)]
    tokens = [len(turn.said.tokens) for seat in counted for turn in seat.turns]
    return {
        "return": _mean([seat.episode_return for seat in counted]),
        "success": _mean(known),
        "turns": _mean([len(seat.turns) for seat in counted]),
        "response_tokens": _mean(tokens),
        "errors": float(sum(seat.error for seat in played)),
    }


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else math.nan


def _seats(env_id: str, options: TrainOptions) -> int:
    return max(1, seat_count(env_id, options))
