"""Make environments from records, with their guard and wrappers."""

from __future__ import annotations

from gem_core.making.environment import MadeSpec, make_from, wrap
from gem_core.making.layers import WrapperChoice, Wrappers, wrapper_targets

__all__ = ["MadeSpec", "WrapperChoice", "Wrappers", "make_from", "wrap", "wrapper_targets"]
