"""Volumes and networks of a Compose file: what containers share with each other, and never with the host."""

from __future__ import annotations

import posixpath
import re
from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING

from gem_terminal.tasks.compose_file import ComposeFile, Mount, Service

if TYPE_CHECKING:
    from gem_terminal.tasks.reading import TaskFolder

_VOLUME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")
MARK = "/.gem-terminal"
"""Where the harness's own folders of the host would be; mounts of them become volumes, or nothing."""


class Mounts:
    """The volumes of each service.

    Args:
        folder: The task folder, which gets notes.
        file: The Compose file.
        compose: What it says.
        services: The services that are started.
        unsupported: Gets what is refused.

    Attributes:
        of: Paths in the container by the names of volumes, by the names of services.
    """

    def __init__(
        self,
        folder: TaskFolder,
        file: str,
        compose: ComposeFile,
        services: Mapping[str, Service],
        unsupported: list[str],
    ) -> None:
        self._folder = folder
        self._file = file
        self._unsupported = unsupported
        self._check_networks(compose, services)
        self.of: dict[str, dict[str, str]] = {name: self._volumes(name, one) for name, one in services.items()}
        for name, entry in compose.volumes.items():
            used = any(name in volumes for volumes in self.of.values())
            if (
                entry is not None
                and used
                and (entry.external or entry.driver_opts or entry.driver not in (None, "local"))
            ):
                unsupported.append(f"{file}: the volume '{name}' is one of the host's ('external', 'driver_opts')")
        self._drop_unshared_logs()

    def _check_networks(self, compose: ComposeFile, services: Mapping[str, Service]) -> None:
        for name, entry in compose.networks.items():
            if entry is not None and entry.external:
                self._unsupported.append(f"{self._file}: the network '{name}' is one of the host's ('external')")
        for name, service in services.items():
            mode = (service.network_mode or "").strip()
            if mode not in ("", "none", "bridge", "default"):
                self._refuse(name, f"the network {mode[:60]!r} ('network_mode')")
        if len({tuple(sorted(service.networks)) for service in services.values()}) > 1:
            self._folder.note(f"{self._file}: its networks are made one, in which all services see each other.")

    def _refuse(self, name: str, what: str) -> None:
        self._unsupported.append(f"{self._file}: the service '{name}' asks for {what}")

    def _volumes(self, name: str, service: Service) -> dict[str, str]:
        volumes: dict[str, str] = {}
        for written in service.volumes:
            mount = self._long_form(name, written) if isinstance(written, str) else written
            self._add(name, mount, volumes)
        temporary = [service.tmpfs] if isinstance(service.tmpfs, str) else service.tmpfs or []
        for one in temporary:
            self._note(name, f"the temporary file system {one.partition(':')[0][:100]!r} is an ordinary folder.")
        return volumes

    def _long_form(self, name: str, written: str) -> Mount:
        parts = written.split(":")
        if len(parts) == 1:
            return Mount(target=parts[0])
        if len(parts) > 3 or not parts[0]:
            self._folder.fail(
                self._file,
                f"'services.{name}.volumes' has {written[:100]!r}; expected 'name:/path' or 'name:/path:ro'.",
            )
        options = parts[2].split(",") if len(parts) == 3 else []
        kind = "bind" if parts[0][0] in "./~\\" else "volume"
        return Mount(type=kind, source=parts[0], target=parts[1], read_only="ro" in options)

    def _add(self, name: str, mount: Mount, volumes: dict[str, str]) -> None:
        target, source = mount.target.rstrip("/"), mount.source or ""
        if not target.startswith("/") or ".." in target.split("/") or "\0" in target:
            self._folder.fail(
                self._file, f"'services.{name}.volumes' has the path {mount.target[:100]!r}; expected an absolute one."
            )
        if posixpath.normpath(source).startswith(MARK + "/"):
            source = posixpath.normpath(source)  # the mark tells it from the task's own volumes
        elif mount.type == "tmpfs" or (mount.type == "volume" and not source):
            return self._note(name, f"the volume without a name at {target[:100]!r} is an ordinary folder.")
        elif mount.type != "volume":
            return self._refuse(name, f"{source[:100]!r} of the host at {target[:100]!r} ('volumes'); COPY it instead")
        elif not _VOLUME.fullmatch(source):
            self._folder.fail(
                self._file, f"'services.{name}.volumes' has the name {source[:100]!r}; expected letters and digits."
            )
        if mount.read_only:
            self._note(name, f"the volume at {target[:100]!r} can be written to.")
        if source in volumes:
            return self._refuse(name, f"the volume {source[:100]!r} at two paths")
        volumes[source] = target
        return None

    def _note(self, name: str, what: str) -> None:
        self._folder.note(f"{self._file}: the service '{name}': {what}")

    def _drop_unshared_logs(self) -> None:
        """Leave out the harness's folders of logs that no two services share; give the others' volumes plain names."""
        count = Counter(source for volumes in self.of.values() for source in volumes)
        for name, volumes in self.of.items():
            self.of[name] = {
                source.removeprefix(MARK + "/").replace("/", "-") if source.startswith(MARK) else source: target
                for source, target in volumes.items()
                if not source.startswith(MARK) or count[source] > 1
            }
