"""The options of ``gem run`` that are passed on to the agent, by keyword and only when they are given."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from gem_core.cli.tool_options import AtLeast
from gem_core.errors import ArgumentError

Command = TypeVar("Command", bound=Callable[..., Any])

_SECONDS = click.FloatRange(min=0, min_open=True)

_OPTIONS = [
    click.option("--base-url", metavar="URL", help="Address of the model server, as in http://localhost:8000/v1."),
    click.option("--max-concurrency", type=AtLeast(min=1), help="Requests at once.  [default: 64]"),
    click.option("--temperature", metavar="NUMBER", type=click.FloatRange(min=0), help="Temperature of sampling."),
    click.option("--top-p", metavar="NUMBER", type=click.FloatRange(0, 1), help="Share of probability to sample from."),
    click.option("--max-tokens", type=AtLeast(min=1), help="Longest answer, in tokens."),
    click.option("--stop", multiple=True, metavar="TEXT", help="Text at which the model stops. Can be repeated."),
    click.option("--sampling-seed", type=int, help="Seed of sampling, the same for every request."),
    click.option("--system", metavar="TEXT|@FILE", help="System prompt, or the file that holds it."),
    click.option("--extra-body", metavar="JSON", help="More fields of the request, as in '{\"top_k\": 20}'."),
    click.option(
        "--request-timeout", type=_SECONDS, metavar="SECONDS", help="Limit, retries included.  [default: 1800]"
    ),
    click.option("--attempt-timeout", type=_SECONDS, metavar="SECONDS", help="Limit of one attempt.  [default: 600]"),
    click.option("--max-retries", type=AtLeast(min=0), help="Attempts after the first.  [default: 8]"),
    click.option("--stream", is_flag=True, help="Receive answers as a stream."),
    click.option("--token-ids", is_flag=True, help="Record token ids and log-probabilities, if the server has them."),
    click.option("--no-native-tools", is_flag=True, help="Read tool calls from the model's text only."),
]

_KEYWORDS = {
    "sampling_seed": "seed",
    "request_timeout": "timeout_s",
    "attempt_timeout": "attempt_timeout_s",
    "token_ids": "return_token_ids",
}
"""Keywords of agents that are not named as their option."""


def agent_options(command: Command) -> Command:
    """Add the options to a command, which gets them as keyword arguments; see ``given``."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def given(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options that the user gave, as keyword arguments of the agent.

    Raises:
        ArgumentError: A value that cannot be read.
    """
    arguments = {
        _KEYWORDS.get(name, name): value
        for name, value in options.items()
        if value is not None and value is not False and value != ()  # a temperature of 0 is given
    }
    if arguments.pop("no_native_tools", False):
        arguments["native_tools"] = False
    if "stop" in arguments:
        arguments["stop"] = list(arguments["stop"])
    if "system" in arguments:
        arguments["system"] = _text(arguments["system"])
    if "extra_body" in arguments:
        arguments["extra_body"] = _object(arguments["extra_body"])
    return arguments


def _text(value: str) -> str:
    if not value.startswith("@"):
        return value
    try:
        return Path(value[1:]).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ArgumentError(f"--system: cannot read {value[1:]!r}: {reason}") from error


def _object(value: str) -> dict[str, Any]:
    try:
        content = json.loads(value)
    except (ValueError, RecursionError) as error:
        raise ArgumentError(f"--extra-body is no valid JSON: {error}") from None
    if not isinstance(content, dict):
        raise ArgumentError(f"--extra-body must be a JSON object, not {value:.100}")
    return content
