"""Mathematics with verified answers: a plugin of GEM."""
