"""Text games with a reward for every turn: a plugin of GEM. Each game is a file here."""
