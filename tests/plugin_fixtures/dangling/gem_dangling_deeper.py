"""Needs a module that fails."""

from gem_dangling_raises import MathEnv

__all__ = ["MathEnv"]
