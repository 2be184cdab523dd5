"""Files into and out of a container, through the engine alone: no program of the agent's has a part in it.

The engine unpacks and packs within the container's own files, so that no link leads to the host.
"""

from __future__ import annotations

import contextlib
import io
import posixpath
import tarfile
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, TYPE_CHECKING, BinaryIO, cast

import docker
import docker.errors

if TYPE_CHECKING:
    from gem_terminal.backends.docker.engine import Client

_CHUNK = 65536
_IN_MEMORY = 4_000_000


@contextlib.contextmanager
def put_archive(files: Mapping[str, Path | bytes | None], mode: int | None) -> Iterator[IO[bytes]]:
    """Give an archive that, unpacked at the root, puts files where they belong.

    Args:
        files: Host files and folders, or contents, by absolute paths; None for an empty folder that is everyone's.
        mode: Permissions of files; None keeps those of the host's, readable by all.

    Raises:
        OSError: A file of the host cannot be read.
    """

    def as_roots(info: tarfile.TarInfo) -> tarfile.TarInfo | None:
        info.uid = info.gid = 0
        info.uname = info.gname = ""
        if info.isdir():
            info.mode = 0o755
        else:
            info.mode = (info.mode & 0o7777) | 0o444 if mode is None else mode
        return info if info.isdir() or info.isreg() or info.issym() or info.islnk() else None

    with _new_archive() as (archive, tar):
        for path, source in files.items():
            path = path.strip("/")
            if isinstance(source, bytes):
                _add(tar, path, 0o644 if mode is None else mode, source)
                continue
            if source is None or source.is_dir():
                _replace_folder(tar, path)
            if source is None:
                folder = tarfile.TarInfo(path)
                folder.type, folder.mode = tarfile.DIRTYPE, 0o777
                tar.addfile(folder)
                continue
            tar.add(source.resolve(), path, filter=as_roots)
        tar.close()
        archive.seek(0)
        yield archive


def _replace_folder(tar: tarfile.TarFile, path: str) -> None:
    """Make the engine replace a folder: it merges one into one that is there, but puts a file in place of it."""
    _add(tar, path, 0o600, b"")


def _add(tar: tarfile.TarFile, path: str, mode: int, data: bytes) -> None:
    info = tarfile.TarInfo(path)
    info.mode, info.size, info.mtime = mode, len(data), int(time.time())
    tar.addfile(info, io.BytesIO(data))


@contextlib.contextmanager
def _new_archive() -> Iterator[tuple[IO[bytes], tarfile.TarFile]]:
    with (
        tempfile.SpooledTemporaryFile(_IN_MEMORY) as archive,
        tarfile.open(mode="w", fileobj=archive, format=tarfile.PAX_FORMAT) as tar,
    ):
        yield cast("IO[bytes]", archive), tar


def get_files(client: Client, container: str, path: str, most_bytes: int) -> dict[str, bytes]:
    """Return the regular files at a path, at most ``most_bytes`` in all, from what the engine packs of it.

    What is packed is read up to a bound, so that neither a file of no end nor very many files keep this going.

    Raises:
        docker.errors.NotFound: There is nothing at the path, or no container.
    """
    found: dict[str, bytes] = {}
    left, bound = most_bytes, 4 * most_bytes + 16_000_000
    with _packed(client, container, path) as packed:
        try:
            with tarfile.open(mode="r|", fileobj=packed) as tar:
                for entry in tar:
                    if entry.offset_data + entry.size > bound:
                        break
                    if entry.isreg() and entry.size <= left and (file := tar.extractfile(entry)) is not None:
                        found[entry.name.strip("/").partition("/")[2]] = file.read()
                        left -= entry.size
        except (tarfile.TarError, EOFError, ValueError):
            # It ended early, as where files grew while they were packed. What came whole counts.
            pass
    return found


def save_archive(client: Client, container: str, path: str, file: BinaryIO, most_bytes: int) -> bool:
    """Write what the engine packs of a path into a file; False when it is more than so many bytes.

    Raises:
        docker.errors.NotFound: There is nothing at the path, or no container.
    """
    try:
        about = client.ask("HEAD", f"/containers/{container}/archive", params={"path": path}).headers
    except docker.errors.APIError as error:
        if error.status_code == 500:  # so the engine answers to a link that leads to itself
            raise docker.errors.NotFound("a link that leads to itself") from error
        raise
    # Where a link leads in the end, by which the engine does not go itself.
    target = docker.utils.decode_json_header(about["X-Docker-Container-Path-Stat"]).get("linkTarget")
    with _packed(client, container, posixpath.join(posixpath.dirname(path), target or path)) as packed:
        while most_bytes >= 0 and (data := packed.read(_CHUNK)):
            file.write(data)
            most_bytes -= len(data)
    return most_bytes >= 0


@contextlib.contextmanager
def load_archive(file: BinaryIO, path: str) -> Iterator[IO[bytes]]:
    """Give an archive that, unpacked at the root, puts what one of :func:`save_archive` holds at a path."""
    there, top = path.strip("/"), None
    with _new_archive() as (archive, tar), tarfile.open(mode="r|", fileobj=file) as source:
        for member in source:
            if top is None:
                top = member.name
                if member.isdir():
                    _replace_folder(tar, there)
            member.name = there + member.name.removeprefix(top)
            if member.islnk():
                member.linkname = there + member.linkname.removeprefix(top)
            member.pax_headers = {k: v for k, v in member.pax_headers.items() if k not in ("path", "linkpath")}
            tar.addfile(member, source.extractfile(member) if member.isreg() else None)
        tar.close()
        archive.seek(0)
        yield archive


@contextlib.contextmanager
def _packed(client: Client, container: str, path: str) -> Iterator[IO[bytes]]:
    plain = {"Accept-Encoding": "identity"}  # the engine would compress it, which takes longer than to send it
    address = f"/containers/{container}/archive"
    with contextlib.closing(client.ask("GET", address, params={"path": path}, headers=plain, stream=True)) as response:
        yield cast("IO[bytes]", response.raw)
