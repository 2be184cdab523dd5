"""Points to a module that is not there."""
