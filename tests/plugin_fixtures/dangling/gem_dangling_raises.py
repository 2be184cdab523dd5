"""Fails while it is imported."""

import json

import gem_core as gem

SETTINGS = json.loads("not json")


class MathEnv(gem.Env):
    """An environment."""
