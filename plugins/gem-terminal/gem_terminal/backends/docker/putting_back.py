"""What was changed in a container, and putting it back from its image, through the engine alone."""

from __future__ import annotations

import contextlib
import posixpath
import tarfile
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING, cast

from gem_terminal.backends.docker.files import Status, status

if TYPE_CHECKING:
    from gem_terminal.backends.docker.engine import Client
    from gem_terminal.backends.interface import Change

_KINDS: Mapping[int, Change] = {0: "changed", 1: "added", 2: "removed"}  # as the engine counts them
_IN_MEMORY = 16_000_000
_CHUNK = 65536
_PROGRAMS = ("/bin", "/usr/bin", "/sbin", "/usr/sbin")


@dataclass
class Restored:
    """What was put back.

    Args:
        paths: The paths that differed from the image.
        emptied: Those of them that the image has not: they are empty files now, for an ``rm`` to remove.
    """

    paths: list[str] = field(default_factory=list)
    emptied: list[str] = field(default_factory=list)


def changes(client: Client, container: str) -> dict[str, Change]:
    """Return the paths that differ from the container's image."""
    found = client.ask("GET", f"/containers/{container}/changes").json() or []
    return {entry["Path"]: _KINDS[entry["Kind"]] for entry in found}


def put_back(client: Client, container: str, untouched: str, paths: Sequence[str]) -> Restored:
    """Make paths of a container what they are in an untouched one; neither has to run.

    The engine has no word for removing a file, so that one that was added is made an empty one that nobody may run.

    Args:
        client: The client.
        container: Its name.
        untouched: Name of a container of the same image that never ran.
        paths: Absolute paths; those above others are done first.
    """
    done = Restored()
    whole: set[str] = set()
    with tempfile.SpooledTemporaryFile(_IN_MEMORY) as archive:
        with tarfile.open(mode="w", fileobj=archive, format=tarfile.PAX_FORMAT) as tar:
            for path in sorted(set(paths)):
                if any(above in whole for above in _above(path)):
                    continue
                then, now = status(client, untouched, path), status(client, container, path)
                if _are_same(then, now):
                    continue
                done.paths.append(path)
                if then is None:
                    tar.addfile(_empty(path))
                    done.emptied.append(path)
                    whole.add(path)
                else:
                    _copy(client, untouched, path, tar)
                    if then.kind == "folder":
                        whole.add(path)
        if done.paths:
            archive.seek(0)
            client.put_archive(container, "/", cast("IO[bytes]", archive))
    return done


def program(client: Client, untouched: str, name: str) -> str:
    """Return the path of a program of an image; its bare name where it is in none of the usual folders."""
    for folder in _PROGRAMS:
        if status(client, untouched, f"{folder}/{name}") is not None:
            return f"{folder}/{name}"
    return name


def _are_same(then: Status | None, now: Status | None) -> bool:
    """Whether nothing needs to be done: neither is there, or both are folders, or the same link."""
    if then is None or now is None:
        return then is now
    return then.kind == now.kind and (then.kind == "folder" or (then.kind == "link" and then.target == now.target))


def _above(path: str) -> Iterator[str]:
    while (path := posixpath.dirname(path)) not in ("/", ""):
        yield path


def _empty(path: str) -> tarfile.TarInfo:
    info = tarfile.TarInfo(path.lstrip("/"))
    info.mode = 0o600
    return info


def _copy(client: Client, untouched: str, path: str, tar: tarfile.TarFile) -> None:
    """Add what an untouched container has at a path, with owners, permissions and capabilities."""
    folder = posixpath.dirname(path).lstrip("/")
    response = client.ask("GET", f"/containers/{untouched}/archive", params={"path": path}, stream=True)
    with contextlib.closing(response), tempfile.SpooledTemporaryFile(_IN_MEMORY) as held:
        for chunk in response.iter_content(_CHUNK):
            held.write(chunk)
        held.seek(0)
        with tarfile.open(mode="r", fileobj=held) as source:
            for entry in source:
                content = source.extractfile(entry) if entry.isreg() else None
                entry.name = posixpath.join(folder, entry.name)
                entry.pax_headers = {
                    key: value for key, value in entry.pax_headers.items() if key not in ("path", "linkpath")
                }
                if entry.islnk():
                    entry.linkname = posixpath.join(folder, entry.linkname)
                tar.addfile(entry, content)


def in_batches(paths: Sequence[str], most: int = 500) -> Iterator[Sequence[str]]:
    """Give paths in pieces that fit on a command line."""
    for start in range(0, len(paths), most):
        yield paths[start : start + most]
