"""``gem export``: a run as a table, as a file of episodes, or as a log of inspect_ai."""
