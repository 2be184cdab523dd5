"""Following a recipe in a sandbox, which makes the template that machines start from."""

from __future__ import annotations

import codecs
import os
import posixpath
import tarfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from gem_terminal.backends.local import ignore, recipe
from gem_terminal.errors import BuildError, EngineError, MachineLostError, TaskError

if TYPE_CHECKING:
    from gem_terminal.backends.local.machine import LocalMachine

_LOG_BYTES = 8000
_ARCHIVE = "/tmp/.gem-archive"


class Log:
    """The log of a build: each line is passed on, and its end kept.

    Args:
        on_line: Called with each line.
    """

    def __init__(self, on_line: Callable[[str], None] | None) -> None:
        self._on_line = on_line
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._begun = ""
        self.end = ""

    def add(self, data: bytes) -> None:
        """Add output of a program."""
        *lines, self._begun = (self._begun + self._decoder.decode(data)).split("\n")
        for line in lines:
            self.line(line.rstrip("\r"))
        if len(self._begun) > _LOG_BYTES:
            self.flush()

    def flush(self) -> None:
        """Take what was begun for a line."""
        begun, self._begun = self._begun, ""
        if begun:
            self.line(begun)

    def line(self, line: str) -> None:
        """Add a line."""
        self.end = (self.end + line + "\n")[-_LOG_BYTES:]
        if self._on_line is not None:
            self._on_line(line)


class Builder:
    """Follows a recipe.

    Args:
        machine: The sandbox, with an empty root.
        name: The task, for messages.
        context: The build's folder; None where there is none.
        dockerfile: Path of the Dockerfile in it.
        deadline: When to give up, as ``time.monotonic`` counts.
        log: Where output goes.
    """

    def __init__(
        self, machine: LocalMachine, name: str, context: Path | None, dockerfile: str, deadline: float, log: Log
    ) -> None:
        self.machine, self.name, self.context, self.deadline, self.log = machine, name, context, deadline, log
        self.ignored = ignore.Ignored("") if context is None else ignore.read(context, dockerfile)

    def follow(self, steps: tuple[recipe.Run | recipe.Copy | recipe.Folder, ...]) -> None:
        """Do all steps.

        Raises:
            BuildError: One fails, or there is no time left.
            TaskError: One cannot be done in a sandbox.
        """
        for step in steps:
            try:
                self._do(step)
            except MachineLostError as error:
                raise self._failed(step.line, str(error)) from error
            except EngineError as error:
                raise TaskError(f"{self.name}: line {step.line} of its Dockerfile: {error}") from error
            except OSError as error:
                raise self._failed(step.line, f"a file of the build cannot be read: {error}") from error

    def _do(self, step: recipe.Run | recipe.Copy | recipe.Folder) -> None:
        if isinstance(step, recipe.Folder):
            self.machine.make_folder(step.path)
        elif isinstance(step, recipe.Copy):
            self._copy(step)
        else:
            self._run(step)

    def _run(self, step: recipe.Run) -> None:
        self.log.line(f"[line {step.line}] RUN {step.words[-1][:200].strip()}")
        left = self.deadline - time.monotonic()
        if left <= 0:
            raise self._failed(step.line, "the time for building is over (build_timeout_s)")
        code = self.machine.follow(step.words, self.log.add, env=step.env, workdir=step.workdir, timeout_s=left)
        self.log.flush()
        if code is None:
            raise self._failed(step.line, "it was stopped, since the time for building was over (build_timeout_s)")
        if code:
            raise self._failed(step.line, f"RUN ended with exit code {code}")

    def _copy(self, step: recipe.Copy) -> None:
        self.log.line(f"[line {step.line}] COPY {' '.join((*step.sources, *step.contents))} {step.target}"[:200])
        found = [path for source in step.sources for path in self._sources(source, step.line)]
        several = len(found) + len(step.contents) > 1
        inside = step.target.endswith("/") or several or self._is_folder(step.target)
        for name, data in step.contents.items():
            self.machine.put({self._target(step, name, inside=inside): data}, mode=step.mode)
        for path in found:
            if path.is_dir():
                self._merge(path, step.target.rstrip("/") or "/", step.mode)
            elif step.unpack and tarfile.is_tarfile(path):
                self._unpack(path, step)
            else:
                self.machine.put({self._target(step, path.name, inside=inside): path}, mode=step.mode)

    def _target(self, step: recipe.Copy, name: str, *, inside: bool) -> str:
        return posixpath.join(step.target, name) if inside else step.target

    def _sources(self, source: str, line: int) -> list[Path]:
        """Return the files that a source stands for, those left out by ``.dockerignore`` apart."""
        if self.context is None:
            raise self._failed(line, "there is no folder to copy from")
        if any(character in source for character in "*?["):
            parts = "/".join(part for part in source.split("/") if part not in ("", ".", ".."))
            try:
                candidates = sorted(self.context.glob(parts))
            except (ValueError, NotImplementedError, IndexError) as error:
                raise self._failed(line, f"{source!r} is no pattern: {error}") from error
        else:
            candidates = [recipe.context_file(self.context, source)]
        found = [path for path in candidates if path.exists() and self._is_ours(path)]
        if not found:
            raise self._failed(line, f"{source!r} is not in {self.context}, or left out by .dockerignore")
        return found

    def _is_ours(self, path: Path) -> bool:
        """Return whether a path is part of the build's folder."""
        if self.context is None:
            return False
        relative = path.relative_to(self.context).as_posix()
        if not path.is_symlink() and not path.resolve().is_relative_to(self.context.resolve()):
            return False
        return relative == "." or not self.ignored(relative) or (path.is_dir() and self.ignored.makes_exceptions)

    def _merge(self, folder: Path, target: str, mode: int | None) -> None:
        if mode is not None:
            self.log.line("--chmod is not applied to what is in a folder")
        self.machine.merge({target: folder}, self._is_ours)

    def _unpack(self, path: Path, step: recipe.Copy) -> None:
        target = step.target.rstrip("/") or "/"
        self.machine.make_folder(target)
        self.machine.put({_ARCHIVE: path})
        words = ("tar", "-xf", _ARCHIVE, "-C", target, "--no-same-owner")
        self._run(recipe.Run(words, {"PATH": recipe.PATH}, "/", step.line))
        self.machine.remove_files([_ARCHIVE])

    def _is_folder(self, path: str) -> bool:
        return self.machine.run(["/usr/bin/test", "-d", path], timeout_s=30).exit_code == 0

    def _failed(self, line: int, why: str) -> BuildError:
        end = self.log.end.strip()
        shown = f"; the log ends with:\n{end[-2000:]}" if end else ""
        return BuildError(f"the image of {self.name} was not built: line {line} of its Dockerfile: {why}{shown}", end)


def baseline_kb(machine: LocalMachine) -> int:
    """Return how much the files of a machine take, in kilobytes."""
    return int((machine.written_mb() or 0.0) * 1024)


def check_readable(context: Path) -> None:
    """Raise unless a build's folder is there.

    Raises:
        TaskError: It is not.
    """
    if not context.is_dir() or not os.access(context, os.R_OK):
        raise TaskError(f"{context}, which the task is built from, is not a folder that can be read")
