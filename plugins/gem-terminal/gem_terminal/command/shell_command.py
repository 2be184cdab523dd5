"""``gem terminal shell``: a person in the machine of a task."""

from __future__ import annotations

import contextlib
import os
import secrets
import select
import sys
import termios
import tty
from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from gem_core.errors import UsageError
from gem_terminal.backends.interface import Limits
from gem_terminal.command.asking import backend_options, chosen_backend, network_option, one_task, variable_option
from gem_terminal.errors import MachineError, MachineLostError

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Machine, Terminal

_PART_S = 0.02
# The shell of the image, bash where there is one; its exit code is left where it can be fetched.
_SHELL = 'if command -v bash >/dev/null 2>&1; then bash -l; else sh -l; fi; echo $? >"$1"'


@click.command(
    "shell",
    epilog="""\b
Examples:
  gem terminal shell my-tasks/fix-the-server
  gem terminal shell fix-the-server --in my-tasks --user nobody
""",
)
@click.argument("task", type=click.Path())
@click.option("--in", "where", metavar="PATH|ID", help="Where the task is; without it, terminal:Sample or TASK itself.")
@click.option("--user", default="", help="Whom the shell runs as; without it, the agent's user.")
@variable_option
@network_option
@backend_options
@click.pass_context
def command(
    ctx: click.Context,
    task: str,
    where: str | None,
    user: str,
    variables: tuple[str, ...],
    network: str,
    backend: str,
    build_args: tuple[str, ...],
) -> None:
    """Start the machine of a task and work in it yourself; it is removed when the shell ends.

    TASK is the folder of a task, or its name. The exit code is the shell's.
    """
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise UsageError("gem terminal shell needs a terminal; for a program there is gem.make('terminal:Folder')")
    found, chosen = one_task(task, where, variables), chosen_backend(backend, build_args)
    chosen.check(found)
    first = found.steps[0]
    click.echo(f"{found.name}: {first.instruction.strip()}\n", err=True)
    with chosen.start(found, Limits(network=network)) as machine:
        ctx.exit(_worked_in(machine, user or first.agent_user, found.environment.main.workdir))


def _worked_in(machine: Machine, user: str, workdir: str) -> int:
    """Join the terminals until the shell ends; return its exit code."""
    size = os.get_terminal_size(sys.stdout.fileno())
    note = f"/tmp/.shell-{secrets.token_hex(8)}"
    terminal = machine.open_terminal(
        ["/bin/sh", "-c", _SHELL, "sh", note],
        user=user,
        workdir=workdir,
        env={"TERM": os.environ.get("TERM", "xterm")},
        columns=size.columns,
        lines=size.lines,
    )
    try:
        with _raw(sys.stdin.fileno()):
            _join(machine, terminal, size)
    finally:
        terminal.close()
    if (lost := machine.why_lost()) is not None:
        raise lost
    code = machine.get(note, most_bytes=100).get("", b"").strip()
    return int(code) if code.isdigit() else 1


def _join(machine: Machine, terminal: Terminal, size: os.terminal_size) -> None:
    """Pass on what is typed and shown, and a new size of the window, until one side ends."""
    while True:
        if select.select([sys.stdin], [], [], 0)[0]:
            typed = os.read(sys.stdin.fileno(), 65_536)
            if not typed:
                return
            terminal.write(typed)
        before, size = size, os.get_terminal_size(sys.stdout.fileno())
        if size != before:
            script = f"stty rows {size.lines} cols {size.columns} </proc/{terminal.pid}/fd/0"
            with contextlib.suppress(MachineError):  # what is drawn askew is no reason to stop
                machine.run(["/bin/sh", "-c", script], timeout_s=5.0)
        try:
            shown = terminal.read(_PART_S)
        except MachineLostError:
            return
        while shown:
            shown = shown[os.write(sys.stdout.fileno(), shown) :]


@contextlib.contextmanager
def _raw(descriptor: int) -> Iterator[None]:
    before = termios.tcgetattr(descriptor)
    tty.setraw(descriptor)
    try:
        yield
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
