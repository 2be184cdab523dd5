"""Verifying: the tests of a task, run so that the agent has no say in them."""
