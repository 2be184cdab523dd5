"""Robustness: wrappers that disturb an agent, by seed, and how much its score falls by each."""
