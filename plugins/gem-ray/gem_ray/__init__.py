"""Vector environments on Ray: a plugin of GEM."""
