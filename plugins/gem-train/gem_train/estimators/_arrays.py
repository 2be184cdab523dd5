"""What the estimators share: checks of their arguments, masking, sums by group."""

from __future__ import annotations

from typing import Any, TypeAlias

import array_api_compat

Array: TypeAlias = Any
"""A NumPy array or a torch tensor."""

_KINDS = {"float": "real floating", "bool": "bool", "int": "integral"}


def namespace(*arrays: Array | None) -> Any:
    """Return the array API functions for arrays that are all NumPy's or all torch's."""
    return array_api_compat.array_namespace(*(array for array in arrays if array is not None))


def check(name: str, array: Array, shape: tuple[int | None, ...], kind: str) -> None:
    """Raise unless an array has a shape, None for any length, and a kind of dtype: "float", "bool" or "int"."""
    xp = namespace(array)
    fits = len(shape) == array.ndim and all(want in (None, have) for want, have in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = ", ".join("any" if length is None else str(length) for length in shape)
        raise ValueError(f"{name} has the shape {tuple(array.shape)}; expected ({wanted})")
    if not xp.isdtype(array.dtype, _KINDS[kind]):
        raise ValueError(f"{name} has the dtype {array.dtype}; expected {kind}")


def check_fraction(name: str, value: float) -> None:
    """Raise unless a number is between 0 and 1."""
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"{name} is {value}; expected a number from 0 to 1")


def masked(xp: Any, array: Array, mask: Array) -> Array:
    """Return the array with zeros where the mask is False; NaN and gradients there are dropped."""
    return xp.where(mask, array, xp.zeros_like(array))


def constant(array: Array) -> Array:
    """Return the array without its gradient."""
    return array.detach() if array_api_compat.is_torch_array(array) else array


def at_least_single(xp: Any, array: Array) -> Array:
    """Return the array, in float32 if its own floats are shorter: those cannot hold the ratios of two policies."""
    return xp.astype(array, xp.float32) if xp.finfo(array.dtype).bits < 32 else array


def from_member(xp: Any, values: Array, members: Array) -> Array:
    """Return in float64 how far values (N,) are from others (N,); exactly 0 where rounding alone sets them apart.

    Sums of equal numbers in another order differ by rounding, which a division by their deviation would blow up.
    """
    rounding = 8 * xp.finfo(values.dtype).eps
    values, members = xp.astype(values, xp.float64), xp.astype(members, xp.float64)
    differences = values - members
    return xp.where(xp.abs(differences) <= rounding * xp.abs(members), xp.zeros_like(differences), differences)


def group_sums(xp: Any, values: Array, index: Array, count: int) -> Array:
    """Sum float64 values (N,) by their group's index (N,) from 0 to ``count`` - 1; returns (``count``,).

    The one place with a branch for each library: the array API has no sum by group.
    """
    if array_api_compat.is_torch_array(values):
        return xp.zeros(count, dtype=values.dtype, device=values.device).index_add(0, index, values)
    return xp.bincount(index, weights=values, minlength=count)


def centered(xp: Any, values: Array, index: Array, included: Array, correction: int) -> tuple[Array, Array, Array]:
    """Subtract from values (N,) the mean of their group, over the included members alone.

    Returns:
        Differences to the mean (0 where not included), deviations and sizes of each value's group, each float64 (N,).
    """
    count = int(xp.max(index)) + 1 if index.shape[0] else 0
    # Some included member of each group, subtracted first: exactly 0 is left where all members are equal.
    member = xp.zeros(count, dtype=values.dtype, device=array_api_compat.device(values))
    member[index[included]] = values[included]
    differences = masked(xp, from_member(xp, values, member[index]), included)
    sizes = group_sums(xp, xp.astype(included, xp.float64), index, count)
    means = group_sums(xp, differences, index, count) / xp.clip(sizes, min=1)
    differences = masked(xp, differences - means[index], included)
    variances = group_sums(xp, differences**2, index, count) / xp.clip(sizes - correction, min=1)
    return differences, xp.sqrt(variances)[index], sizes[index]
