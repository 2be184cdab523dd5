"""``Env.np_random`` starts when it is first asked for."""

from __future__ import annotations

from typing import Any

from gem_core.env.base import Env
from gem_core.env.seeding import start_generator


class Dice(Env):
    """Shows one throw, or none."""

    def __init__(self, throws: int = 1) -> None:
        super().__init__()
        self.throws = throws

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[str, dict[str, Any]]:
        super().reset(seed=seed)
        return " ".join(str(int(self.np_random.integers(6))) for _ in range(self.throws)), {}


def test_generator_starts_from_the_seed_of_the_latest_reset() -> None:
    """Starting late changes nothing of what is drawn, however many resets went before."""
    env = Dice(throws=0)
    env.reset(seed=3)
    env.reset(seed=4)
    assert env.np_random.random() == start_generator(None, 4).random()
    first = env.np_random
    env.reset(seed=4)
    assert env.np_random is first, "the generator object is reused"
    assert env.np_random.random() == start_generator(None, 4).random()


def test_gymnasiums_private_attribute_sees_the_started_generator() -> None:
    """Gymnasium's checker reads ``_np_random``; it is None before the first reset, as there."""
    env = Dice(throws=0)
    assert env._np_random is None
    env.reset(seed=6)
    assert env._np_random is env.np_random
    assert env.np_random_seed == 6


def test_a_generator_that_was_set_is_kept_until_the_next_reset() -> None:
    env = Dice(throws=0)
    mine = start_generator(None, 7)
    env.np_random = mine
    assert env.np_random is mine
    assert env.np_random_seed == -1
