"""Grade the episodes of a run again."""
