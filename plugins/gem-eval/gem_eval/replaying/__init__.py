"""Replay recorded episodes, and go on from any of their turns."""
