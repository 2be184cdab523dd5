"""Compare runs, paired by row."""
