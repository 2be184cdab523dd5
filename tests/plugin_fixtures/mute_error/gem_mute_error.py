"""Fails with an error whose text fails."""


class MuteError(Exception):
    """Has no text."""

    def __str__(self):
        raise RuntimeError("mute")


raise MuteError
