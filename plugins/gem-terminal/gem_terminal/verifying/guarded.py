"""Putting back what a verifier stands on, where the agent changed, shadowed or removed it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from posixpath import basename, dirname
from typing import TYPE_CHECKING

from gem_terminal.verifying import protected

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Change, Machine

Untouched = Callable[[], frozenset[str]]
"""Returns the names that an untouched machine has in the folders of programs, libraries and packages; asked for only
when the agent added something with the name of a tool."""

_LISTING = """
for folder in {folders} /usr/lib/*-linux-* /lib/*-linux-* /usr/lib/python3*/*-packages \\
  /usr/local/lib/python3*/*-packages; do
  ls -1A "$folder" 2>/dev/null
done
exit 0
"""
_MOST_SHOWN = 50
_MOST_BYTES = 1_000_000


@dataclass(frozen=True)
class PutBack:
    """What was put back in a machine.

    Args:
        changed: What had been changed; None where the backend cannot tell.
        paths: The paths that were put back.
    """

    changed: Mapping[str, Change] | None = None
    paths: list[str] = field(default_factory=list)

    @property
    def shown(self) -> list[str] | None:
        """The paths, cut after 50; None where the backend cannot tell."""
        if self.changed is None:
            return None
        more = len(self.paths) - _MOST_SHOWN
        return self.paths if more <= 0 else [*self.paths[:_MOST_SHOWN], f"and {more} more"]


def put_back_tools(place: Machine, untouched: Untouched) -> PutBack:
    """Make the tools of a verifier what they were in the machine's image, before any of its programs runs.

    Costs one question to the backend where nothing of the list was changed.

    Args:
        place: Where the verifier will run.
        untouched: What an untouched machine has.

    Raises:
        MachineError: It failed; a verdict of this machine would mean nothing.
    """
    changed = place.changed()
    wanted = _wanted(place, changed, untouched) if changed else set()
    return PutBack(changed, place.put_back(sorted(wanted)) if wanted else [])


def put_back_rest(place: Machine, done: PutBack, *, folder: str = "") -> PutBack:
    """Put back what it takes a running machine to find.

    Args:
        place: Where the verifier will run.
        done: What :func:`put_back_tools` did.
        folder: Working directory of the verifier; empty where it is unknown.

    Raises:
        MachineError: It failed; a verdict of this machine would mean nothing.
    """
    shadows = _shadows(place, done.changed or {}, folder)
    more = place.put_back(sorted(shadows)) if shadows else []
    if "/etc/ld.so.cache" in done.paths:
        # The agent may have installed a library, which programs of its own need: the image's own ldconfig looks again.
        place.run(["/sbin/ldconfig"], user="root", timeout_s=60.0)
    return PutBack(done.changed, sorted([*done.paths, *more]))


def names_of(machine: Machine) -> frozenset[str]:
    """Return the names that a machine has in the folders of programs, libraries and packages."""
    folders = " ".join((*protected.BIN_FOLDERS, *protected.LIBRARY_FOLDERS))
    listing = machine.run(["/bin/sh", "-c", _LISTING.format(folders=folders)], timeout_s=60.0, most_output=5_000_000)
    names = frozenset(listing.output.decode("utf-8", "replace").split("\n"))
    return names | {protected.package_name(name) for name in names}


def _wanted(place: Machine, changed: Mapping[str, Change], untouched: Untouched) -> set[str]:
    wanted: set[str] = set()
    for path, how in changed.items():
        if protected.is_setting(path) or (protected.is_folder(path) and how != "added"):
            wanted.add(path)
        elif protected.is_tool(path) or protected.is_library(path):
            if how != "added" or basename(path) in untouched():
                wanted.add(path)
        elif (root := protected.standard_library(path)) and changed.get(root) != "added":
            wanted.add(path)
        elif protected.is_start_file(path):
            if how != "removed" and protected.runs_code(path, _content(place, path)):
                wanted.add(path)
        elif _in_runner(path, how, changed, untouched):
            wanted.add(path)
    return _topmost(wanted, changed)


def _shadows(place: Machine, changed: Mapping[str, Change], folder: str) -> set[str]:
    """Return what was added to the working directory, where ``python -m pytest`` would take it for pytest."""
    added = [path for path, how in changed.items() if how == "added" and protected.may_shadow_runner(path)]
    if added and not folder:
        folder = place.run(["/bin/pwd"], timeout_s=60.0).output.decode("utf-8", "replace").strip()
    return {path for path in added if dirname(path) == folder}


def _in_runner(path: str, how: Change, changed: Mapping[str, Change], untouched: Untouched) -> bool:
    package, name = protected.runner_package(path)
    if not package:
        return False
    if how == "added" and changed.get(package) == "added":  # the agent's own package, unless the image has one as well
        return name in untouched()
    return True


def _content(place: Machine, path: str) -> bytes:
    """Return the content of a file; of what is no regular file, or too large, what counts as code."""
    return place.get(path, most_bytes=_MOST_BYTES).get("", b"import pytest11\nimport \n")


def _topmost(wanted: set[str], changed: Mapping[str, Change]) -> set[str]:
    """Leave out what lies in a folder that was added and is wanted itself."""

    def covered(path: str) -> bool:
        above = dirname(path)
        while above != "/":
            if above in wanted and changed.get(above) == "added":
                return True
            above = dirname(above)
        return False

    return {path for path in wanted if not covered(path)}


class Inventories:
    """What untouched machines have, by the version of their task; asked once for each. For several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._names: dict[str, frozenset[str]] = {}

    def get(self, key: str, look: Untouched) -> frozenset[str]:
        """Return the names that belong to ``key``, looked up when they are not known yet."""
        with self._lock:
            known = self._names.get(key)
        if known is None:
            known = look()  # twice at the worst, when two threads ask at once: not worth holding a lock for seconds
            with self._lock:
                self._names[key] = known
        return known
