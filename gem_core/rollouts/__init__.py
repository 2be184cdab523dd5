"""Episodes of an agent in an environment: what an agent is, the one loop, and going on after an interruption."""
