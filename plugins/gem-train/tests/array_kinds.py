"""Arrays of each kind that the estimators take, for tests that run the same for all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch


@dataclass(frozen=True)
class Kind:
    """A library and a width of its floats."""

    library: str
    bits: int

    @property
    def dtype(self) -> Any:
        return getattr(torch if self.library == "torch" else np, f"float{self.bits}")

    @property
    def tolerance(self) -> float:
        """Wider than the 1e-8 that normalization adds to a deviation."""
        return {16: 2e-3, 32: 2e-5, 64: 1e-7}[self.bits]

    def floats(self, values: Any) -> Any:
        array = np.asarray(values, dtype=f"float{self.bits}")
        return torch.from_numpy(array.copy()) if self.library == "torch" else array

    def exact(self, values: Any, dtype: str) -> Any:
        array = np.asarray(values, dtype=dtype)
        return torch.from_numpy(array.copy()) if self.library == "torch" else array

    def bools(self, values: Any) -> Any:
        return self.exact(values, "bool")

    def ints(self, values: Any) -> Any:
        return self.exact(values, "int64")

    def close(self, result: Any, expected: Any) -> None:
        """Check values, and that the result is of this kind."""
        assert result.dtype == self.dtype
        assert isinstance(result, torch.Tensor) == (self.library == "torch")
        np.testing.assert_allclose(np.asarray(result), expected, rtol=self.tolerance, atol=self.tolerance)


KINDS = [Kind(library, bits) for library in ("numpy", "torch") for bits in (32, 64)]

each_kind = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: f"{kind.library}{kind.bits}")
"""Run a test for NumPy and torch, in float32 and float64."""

each_library = pytest.mark.parametrize("kind", [KINDS[1], KINDS[2]], ids=lambda kind: f"{kind.library}{kind.bits}")
"""Run a longer test for each library, in one width of floats."""
