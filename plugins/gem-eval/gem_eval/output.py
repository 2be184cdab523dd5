"""What commands write for programs."""

from __future__ import annotations

import json
from typing import Any

import click

from gem_core.records import to_plain


def print_json(value: Any) -> None:
    """Write a value to standard output as JSON; numbers that are not finite become text."""
    click.echo(json.dumps(to_plain(value), indent=1))
