"""Terminal tasks in containers."""
