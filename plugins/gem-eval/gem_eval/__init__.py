"""Commands for recorded episodes: a plugin of GEM."""
