"""Registers while it is imported."""

import gem_core as gem

gem.register("uses:One-v0", "gem_fine_env:FineEnv")
