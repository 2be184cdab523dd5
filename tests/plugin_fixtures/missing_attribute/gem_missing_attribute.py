"""Points to an attribute that is not there."""
