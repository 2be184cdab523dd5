"""``Documented``: a command whose docstring is all of its help."""

from __future__ import annotations

import inspect
from typing import Any

import click


class Documented(click.Command):
    """A command whose docstring goes on, from the line ``Examples:``, below its options, line by line as it stands."""

    def __init__(self, name: str | None, **settings: Any) -> None:
        text, heading, rest = inspect.cleandoc(settings.pop("help", None) or "").partition("Examples:\n")
        below = "\n\n".join(f"\b\n{paragraph}" for paragraph in f"{heading}{rest}".split("\n\n"))
        super().__init__(name, help=text, epilog=below, **settings)
