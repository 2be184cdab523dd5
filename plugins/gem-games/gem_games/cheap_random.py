"""Random numbers that are cheap to start from a seed."""

from __future__ import annotations

from hashlib import blake2b


class CheapRandom:
    """Whole numbers drawn from a seed, for games that need only a few of them at reset.

    A start and one number take 1 µs; a NumPy generator takes 6, more than the rest of a small game's reset.

    The same seed gives the same numbers everywhere; they are independent of the stream ``np_random`` of that seed.
    It keeps no state that can be saved: draw what an episode needs in ``reset``, and use ``np_random`` afterwards.

    Args:
        seed: A whole number from 0 up, as in ``Env.np_random_seed``.
    """

    __slots__ = ("_block", "_pool", "_seed")

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._block = self._pool = 0

    def below(self, limit: int) -> int:
        """Draw a whole number from 0 to ``limit - 1``, uniform but for less than one part in 2**64.

        Args:
            limit: From 1 to 2**256.
        """
        # Each draw is a digit in base `limit` of one large random number, as long as that is large enough.
        pool = self._pool
        if not pool or pool < limit << 64:
            # 64 bytes of BLAKE2b have nothing in common with the 32 bytes that start np_random.
            text = b"%d/%d" % (self._seed, self._block) if self._block else b"%d" % self._seed
            pool = int.from_bytes(blake2b(text).digest(), "little")
            self._block += 1
        self._pool, number = divmod(pool, limit)
        return number
