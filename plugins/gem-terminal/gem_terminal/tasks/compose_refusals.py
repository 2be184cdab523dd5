"""What a Compose file asks for and a task never gets, and what is passed over with a note."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from gem_terminal.tasks.compose_file import Build, Service

REFUSED = {
    "cap_add": "further capabilities",
    "cgroup": "a control group of the host's",
    "cgroup_parent": "a control group of the host's",
    "configs": "configs of the host's",
    "credential_spec": "credentials of the host's",
    "device_cgroup_rules": "devices of the host's",
    "devices": "devices of the host's",
    "extends": "to extend another service",
    "extra_hosts": "names for addresses of the host's network",
    "gpus": "graphics cards",
    "ipc": "memory shared with another container or the host",
    "isolation": "another kind of isolation",
    "models": "models of the host's",
    "pid": "the processes of another container or the host",
    "post_start": "commands after its start",
    "privileged": "privileged mode",
    "provider": "a provider outside the task",
    "runtime": "another runtime",
    "secrets": "secrets of the host's",
    "security_opt": "weaker protection",
    "sysctls": "settings of the kernel",
    "use_api_socket": "the container engine",
    "userns_mode": "the users of the host",
    "uts": "the host's name",
    "volumes_from": "the volumes of another container",
}
"""Keys of a service that ask for what lies outside its container, in words for an error."""

_REFUSED_IN_BUILD = {
    "additional_contexts": "contexts beside its own",
    "dockerfile_inline": "a Dockerfile inside the Compose file",
    "entitlements": "privileges",
    "privileged": "privileges",
    "secrets": "secrets of the host's",
    "ssh": "keys of the host's",
}
_HARMLESS = {"private", "shareable", "none", "false", "default", "no-new-privileges", "no-new-privileges:true"}
# What an engine grants every container that says nothing.
_GRANTED = {
    "AUDIT_WRITE",
    "CHOWN",
    "DAC_OVERRIDE",
    "FOWNER",
    "FSETID",
    "KILL",
    "MKNOD",
    "NET_BIND_SERVICE",
    "NET_RAW",
    "SETFCAP",
    "SETGID",
    "SETPCAP",
    "SETUID",
    "SYS_CHROOT",
}
_SILENT = {
    "annotations",
    "attach",
    "build_args",
    "cap_drop",
    "develop",
    "expose",
    "init",
    "labels",
    "logging",
    "mac_address",
    "oom_score_adj",
    "platform",
    "pull_policy",
    "restart",
    "stdin_open",
    "stop_grace_period",
    "stop_signal",
    "tty",
}
_SILENT_IN_BUILD = {"cache_from", "cache_to", "labels", "no_cache", "platforms", "pull", "shm_size", "tags"}


def refusals(service: Service) -> Iterator[str]:
    """Yield what a service asks for and does not get, in words that follow its name."""
    for key, words in REFUSED.items():
        value = (service.model_extra or {}).get(key)
        if key == "cap_add" and isinstance(value, list):
            value = [one for one in value if str(one).upper().removeprefix("CAP_") not in _GRANTED]
        if not _asks_for_nothing(value):
            yield f"{words} ('{key}')"
    if isinstance(service.build, Build):
        for key, words in _REFUSED_IN_BUILD.items():
            if not _asks_for_nothing((service.build.model_extra or {}).get(key)):
                yield f"{words} ('build.{key}')"
    if _reserves_devices(service.deploy.resources.reservations):
        yield "devices of the host's ('deploy.resources.reservations.devices')"
    if max(service.scale or 1, service.deploy.replicas or 1) > 1:
        yield "to run more than once ('deploy.replicas', 'scale')"


def unknown(service: Service) -> Iterator[str]:
    """Yield the keys of a service that are passed over, and that may matter."""
    for key in service.model_extra or {}:
        if key not in REFUSED and key not in _SILENT and not key.startswith("x-"):
            yield key
    if isinstance(service.build, Build):
        for key in service.build.model_extra or {}:
            if key not in _REFUSED_IN_BUILD and key not in _SILENT_IN_BUILD:
                yield f"build.{key}"
    if service.deploy.resources.limits.pids is not None:
        yield "deploy.resources.limits.pids"


def _asks_for_nothing(value: Any) -> bool:
    if isinstance(value, list):
        return all(str(part).strip().lower() in _HARMLESS for part in value)
    return not value or str(value).strip().lower() in _HARMLESS


def _reserves_devices(reservations: Any) -> bool:
    return isinstance(reservations, dict) and bool(reservations.get("devices"))
