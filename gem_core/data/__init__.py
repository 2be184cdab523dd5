"""Environments that ask the rows of a data set, and where rows come from."""
