"""What an image is built from: the files of a context as an archive, its digest, and the Dockerfile with our label."""

from __future__ import annotations

import hashlib
import json
import os
import re
import tarfile
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING

from docker.utils.build import exclude_paths

from gem_terminal.backends.docker.labels import LABEL
from gem_terminal.errors import BuildError

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Container

DOCKERFILE = ".gem-terminal.Dockerfile"
"""Where the Dockerfile is in the archive, beside the files of the context."""

_ARGUMENT = re.compile(r"^\s*ARG\s+([A-Za-z_][A-Za-z0-9_]*)", re.IGNORECASE | re.MULTILINE)
_ESCAPE = re.compile(r"^\s*#\s*escape\s*=\s*`", re.IGNORECASE)
_HERE = re.compile(r"<<-?\s*[\"']?([A-Za-z_][A-Za-z0-9_]*)[\"']?")
_IN_MEMORY = 4_000_000


@dataclass(frozen=True)
class Context:
    """All that an image is made of.

    Args:
        folder: The files of the context.
        files: Their paths, below it, that ``.dockerignore`` leaves.
        dockerfile: The text of the Dockerfile.
        args: Arguments of the build that the Dockerfile declares.
        target: Stage to build; empty for the last.
        digest: Hash of all this.
    """

    folder: Path
    files: tuple[str, ...]
    dockerfile: str
    args: Mapping[str, str]
    target: str
    digest: str

    def archive(self) -> IO[bytes]:
        """Return the context as an archive, its Dockerfile labelled; the caller closes it."""
        archive = tempfile.SpooledTemporaryFile(_IN_MEMORY)  # noqa: SIM115 - it is handed over
        with tarfile.open(mode="w", fileobj=archive) as tar:
            for path in self.files:
                info = tar.gettarinfo(os.path.join(self.folder, path), path)
                if info is None:
                    continue  # a socket
                info.uid = info.gid = 0
                info.uname = info.gname = ""
                info.mtime = max(int(info.mtime), 0)
                if info.isfile():
                    with open(os.path.join(self.folder, path), "rb") as file:
                        tar.addfile(info, file)
                else:
                    tar.addfile(info)
            text = with_label(self.dockerfile).encode("utf-8", "surrogateescape")
            info = tarfile.TarInfo(DOCKERFILE)
            info.size = len(text)
            tar.addfile(info, BytesIO(text))
        archive.seek(0)
        return archive


def read_context(container: Container, build_args: Mapping[str, str]) -> Context:
    """Read what an image is built from.

    Args:
        container: Has a ``context``.
        build_args: Arguments that overrule the container's own, where the Dockerfile declares them.

    Raises:
        BuildError: The folder or its Dockerfile cannot be read.
    """
    folder = Path(container.context or ".")
    path = folder / container.dockerfile
    try:
        text = path.read_bytes().decode("utf-8", "surrogateescape")
        files = tuple(sorted(exclude_paths(str(folder), _ignored(folder, path), dockerfile=container.dockerfile)))
        declared = set(_ARGUMENT.findall(text))
        args = {name: value for name, value in build_args.items() if name in declared}
        args = {**container.build_args, **args}
        digest = _digest(folder, files, [text, args, container.target])
    except OSError as error:
        raise BuildError(f"the files of an image cannot be read: {error}. Look at {path}") from error
    return Context(folder, files, text, args, container.target, digest)


def _ignored(folder: Path, dockerfile: Path) -> list[str]:
    for name in (dockerfile.with_name(dockerfile.name + ".dockerignore"), folder / ".dockerignore"):
        if name.is_file():
            lines = name.read_text("utf-8", "surrogateescape").splitlines()
            return [line.strip() for line in lines if line.strip() and not line.startswith("#")]
    return []


def _digest(folder: Path, files: tuple[str, ...], more: list[object]) -> str:
    """Hash what decides about an image: names, kinds, permissions and contents, but no times."""
    whole = hashlib.sha256(json.dumps(more, sort_keys=True).encode("utf-8", "surrogatepass"))
    for path in files:
        full = os.path.join(folder, path)
        status = os.lstat(full)
        whole.update(f"\0{path}\0{status.st_mode:o}\0".encode("utf-8", "surrogateescape"))
        if os.path.islink(full):
            whole.update(os.readlink(full).encode("utf-8", "surrogateescape"))
        elif os.path.isfile(full):
            with open(full, "rb") as file:
                whole.update(hashlib.file_digest(file, "sha256").digest())
    return whole.hexdigest()


def with_label(dockerfile: str) -> str:
    """Return a Dockerfile with our label at the start of each stage.

    So the layers of a build that was broken off have it too, and can be told from those of others.

    Args:
        dockerfile: Its text.
    """
    escape = "`" if any(_ESCAPE.match(line) for line in dockerfile.splitlines()[:3]) else "\\"
    lines: list[str] = []
    waiting: list[str] = []
    continued = starts = False
    for line in dockerfile.splitlines():
        lines.append(line)
        words = line.strip()
        if waiting:
            if words == waiting[0]:
                waiting.pop(0)
            continue
        if not words or words.startswith("#"):
            continue  # also in the middle of an instruction, where it does not end it
        if not continued:
            starts = words.upper().startswith(("FROM ", "FROM\t"))
            if words.upper().startswith(("RUN", "COPY", "ADD")):
                waiting = _HERE.findall(words) if _means_here(words) else []
        continued = words.endswith(escape)
        if starts and not continued:
            lines.append(f"LABEL {LABEL}=layer")
            starts = False
    return "\n".join(lines) + "\n"


def _means_here(words: str) -> bool:
    """Whether ``<<`` begins a text that follows, and is not an operator as in ``$((1<<COUNT))``."""
    return "<<" in words and "((" not in words
