"""What runs inside a sandbox, apart from the agent's programs: sent there as compiled code, it imports Python alone."""
