"""What this distribution offers; it imports no task and no engine."""
