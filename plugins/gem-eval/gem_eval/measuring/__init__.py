"""What an environment costs, and what a policy earns in it: ``gem bench-env``."""
