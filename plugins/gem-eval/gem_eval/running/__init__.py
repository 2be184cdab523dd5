"""An evaluation: which rows are played, by whom, within which limits, and what is recorded."""
