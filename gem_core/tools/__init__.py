"""Tools: what one is, how calls are read out of a response, and the wrapper that gives tools to a task."""
