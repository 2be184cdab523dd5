"""Learning from scratch on a CPU: a small transformer that reads and writes an environment's real text."""
