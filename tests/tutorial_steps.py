"""Reads a tutorial as a list of steps, follows it in a folder, and compares what it shows with what came out."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

_BLOCK = re.compile(r'^(`{3,})(\w+)(?: title="([^"]+)")?\n(.*?)^\1$', re.MULTILINE | re.DOTALL)
_END_OF_STEP = "\x1e"
LONGEST_S = 1_800
"""Far more than a tutorial takes, on a machine with nothing else to do."""


class Step(NamedTuple):
    """A fenced block of a tutorial.

    Args:
        language: Of the block; ``text`` is what the step before shows.
        title: Name of the file that the block is; of a ``console`` block, where one would type it instead.
        code: What stands in the block.
    """

    language: str
    title: str
    code: str


def steps_of(page: str) -> list[Step]:
    """Return the blocks of a page in their order."""
    return [Step(match[2], match[3] or "", match[4]) for match in _BLOCK.finditer(page)]


def follow(steps: list[Step], folder: Path, variables: Mapping[str, str]) -> list[str]:
    """Type all commands into one shell and save all files, in the order of the page; stop where one fails.

    Args:
        steps: Of ``steps_of``.
        folder: An empty folder, where the reader begins.
        variables: Of the environment.

    Returns:
        The output of each step, standard error included; empty for blocks that are not typed.
    """
    kept = folder.with_name(f"{folder.name}-blocks")
    kept.mkdir()
    script = "\n".join(_lines_of_shell(steps, kept))
    with subprocess.Popen(
        ["bash", "-e", "-c", script],
        cwd=folder,
        env=variables,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as shell:
        try:
            printed, _ = shell.communicate(timeout=LONGEST_S)
        except BaseException:
            os.killpg(shell.pid, signal.SIGKILL)  # a command of it would go on without the shell
            raise
    outputs = printed.split(_END_OF_STEP)[:-1]
    if shell.returncode:
        raise AssertionError(f"this step failed:\n{steps[len(outputs)].code}\n{printed}")
    return outputs


def _lines_of_shell(steps: list[Step], kept: Path) -> Iterator[str]:
    for number, step in enumerate(steps):
        block = kept / str(number)
        block.write_text(step.code, encoding="utf-8")
        if step.title and step.language != "console":
            yield f"mkdir -p {shlex.quote(str(Path(step.title).parent))}"
            yield f"cp {shlex.quote(str(block))} {shlex.quote(step.title)}"
        elif step.language == "console" and not step.title:
            yield step.code
        yield r"printf '\x1e'"


def shown_outputs(steps: list[Step], outputs: list[str]) -> list[tuple[str, str]]:
    """Return what a page shows after its steps, each beside what came out."""
    return [
        (step.code, output)
        for (step, output) in zip(steps[1:], outputs[:-1], strict=True)
        if step.language == "text" and not step.title
    ]


def agrees(shown: str, output: str) -> bool:
    """Tell whether an output is the one that is shown.

    ``…`` stands for anything within a line, and alone on a line for any number of lines.
    """
    pattern = "".join(
        r"(?:.*\n)*" if line.strip() == "…" else rf"{re.escape(line.rstrip()).replace('…', '.*')} *\n"
        for line in shown.splitlines()
    )
    return re.fullmatch(pattern, output.rstrip() + "\n") is not None
