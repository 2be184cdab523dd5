"""Seeds: one stable hash, and generators that start from a seed."""

from __future__ import annotations

import operator
import secrets
from hashlib import blake2b
from typing import Any, SupportsIndex

import numpy as np
from numpy.random.bit_generator import ISeedSequence

from gem_core.errors import ArgumentError

SEED_LIMIT = 1 << 53
"""Seeds that the library makes lie below this, so that they are exact in JSON readers that use doubles."""

SEED_MAXIMUM = 1 << 128
"""Seeds that callers give must lie below this."""

# One round of a full-period linear congruential generator (Hull and Dobell, 1962): the seeds of the later episodes of
# a stream. Its weak low bits do no harm, because every seed goes through a cryptographic hash before it is used.
_NEXT_MULTIPLIER = 0x5851F42D4C957F2D % SEED_LIMIT
_NEXT_INCREMENT = 0x14057B7EF767814F % SEED_LIMIT


def stable_hash(*parts: SupportsIndex | str | None) -> int:
    """Hash whole numbers and strings to a seed, the same in every process and on every machine.

    Subclasses of ``str`` and ``int``, and whole numbers of NumPy, count as what they equal.

    Returns:
        A whole number from 0 to 2**53 - 1.
    """
    encoded = b""
    for part in parts:
        # Each part says its kind and where it ends, so that no two lists of parts give the same bytes.
        if part is None:
            encoded += b"n"
        elif isinstance(part, str):
            text = part.encode("utf-8", "surrogatepass")
            encoded += b"s%d:%b" % (len(text), text)
        else:
            encoded += b"i%d," % operator.index(part)
    return int.from_bytes(blake2b(encoded, digest_size=8).digest(), "little") % SEED_LIMIT


def next_seed(seed: int) -> int:
    """Return the seed of the episode that follows the one that started from ``seed`` in the same stream."""
    return (seed * _NEXT_MULTIPLIER + _NEXT_INCREMENT) % SEED_LIMIT


def fresh_seed() -> int:
    """Return a seed from the operating system's entropy."""
    return secrets.randbelow(SEED_LIMIT)


def checked_seed(seed: SupportsIndex) -> int:
    """Return a seed as a plain int.

    Raises:
        ArgumentError: It is not a whole number from 0 to 2**128 - 1.
    """
    try:
        number = operator.index(seed)
    except TypeError:
        raise ArgumentError(f"seed must be a whole number from 0 up, not {seed!r}") from None
    if number >= SEED_MAXIMUM:
        raise ArgumentError("seed must be below 2**128, and the one given is larger")
    if number < 0 or isinstance(seed, bool):
        raise ArgumentError(f"seed must be a whole number from 0 up, not {seed!r:.100}")
    return number


class _Unseeded(ISeedSequence):
    """Starts a bit generator whose state is set right after; NumPy's own hash takes ten times as long."""

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> Any:
        """Return zeros."""
        return np.zeros(n_words, dtype)


_UNSEEDED = _Unseeded()


def generator_at(seed: int) -> np.random.Generator:
    """Return a generator at the start of the stream ``seed``.

    The stream is PCG64 started from the BLAKE2b hash of the seed; it is not ``numpy.random.default_rng(seed)``.
    """
    generator = np.random.Generator(np.random.PCG64(_UNSEEDED))  # type: ignore[arg-type]  # NumPy takes it; its stubs do not
    value = int.from_bytes(blake2b(b"%d" % seed, digest_size=32).digest(), "little")
    generator.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": value >> 128, "inc": (value & ((1 << 128) - 1)) | 1},
        "has_uint32": 0,
        "uinteger": 0,
    }
    return generator
