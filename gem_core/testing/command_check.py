"""``check_command``: calls a registered subcommand of ``gem`` as a newcomer would."""

from __future__ import annotations

from typing import cast

import click
from click.testing import CliRunner

from gem_core.cli import cli
from gem_core.testing.findings import Findings


def check_command(name: str) -> list[str]:
    """Try what a subcommand of ``gem`` promises: it is found, says what it does, and refuses what it does not know.

    Args:
        name: The name that it is registered by.

    Returns:
        The promises that were kept, in one sentence each.

    Raises:
        CheckError: Promises are broken; the message names each, with what was seen.
        RegistrationError: Two plugins offer it.
    """
    findings = Findings(f"command {name!r}")
    found = cli.get_command(click.Context(cli), name)
    if not findings.expect("It is registered.", found is not None, "no plugin offers it"):
        findings.result()
    command = cast("click.Command", found)
    helped = CliRunner().invoke(command, ["--help"])
    seen = f"exit code {helped.exit_code}, {helped.exception!r}"
    findings.expect("With --help it says how it is called, and exits with 0.", helped.exit_code == 0, seen)
    findings.expect("It has a help text.", bool(command.help or command.get_short_help_str()), "no docstring")
    wrong = CliRunner().invoke(command, ["--no-such-option-of-anybody"])
    seen = f"exit code {wrong.exit_code}, {wrong.exception!r}"
    findings.expect("An option that there is not is refused with exit code 2.", wrong.exit_code == 2, seen)
    return findings.result()
