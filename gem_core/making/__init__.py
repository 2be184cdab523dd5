"""From a record to a living environment."""
