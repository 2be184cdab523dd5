"""``gem audit``: what is checked of an environment before money is spent on it."""
