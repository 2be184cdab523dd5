"""What the tools say of this machine; loads quickly."""


def line():
    """Return a line."""
    return "two locks in force"


def facts():
    """Return facts."""
    return {"level": "high", "drawers": 2}
