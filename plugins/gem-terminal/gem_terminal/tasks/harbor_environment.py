"""Environments of Harbor: an image, a Dockerfile or a Compose file, and what ``task.toml`` says of how it is run."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from gem_terminal.tasks.compose import VARIABLES, Composed, read_compose
from gem_terminal.tasks.compose_mounts import MARK
from gem_terminal.tasks.harbor_file import Check, EnvironmentSection, Phase
from gem_terminal.tasks.reading import TaskFolder, shell_check
from gem_terminal.tasks.task import Container, Environment, Healthcheck, Network

MAIN = "main"
COMPOSE = "docker-compose.yaml"

_FILE = "task.toml"
_NETWORKS: Mapping[str, Network] = {"public": "public", "no-network": "none", "allowlist": "allowlist"}
_VARIABLE = re.compile(r"\$\{([A-Za-z_][A-Za-z0-9_]*)(?::-(.*))?\}", re.DOTALL)
_COMPOSE_VARIABLES: Mapping[str, str] = {
    **VARIABLES,
    "CONTEXT_DIR": ".",
    "MAIN_IMAGE_NAME": "gem-terminal-task",
    "TEST_DIR": "/tests",
    "ENV_AGENT_LOGS_PATH": "/logs/agent",
    "ENV_ARTIFACTS_PATH": "/logs/artifacts",
    "ENV_VERIFIER_LOGS_PATH": "/logs/verifier",
    "HOST_AGENT_LOGS_PATH": f"{MARK}/agent",
    "HOST_ARTIFACTS_PATH": f"{MARK}/artifacts",
    "HOST_VERIFIER_LOGS_PATH": f"{MARK}/verifier",
}


def network_of(phase: Phase) -> tuple[Network | None, tuple[str, ...]]:
    """Return the network of a part, and the hosts that it may reach where they are listed."""
    if phase.network_mode is not None:
        return _NETWORKS[phase.network_mode], tuple(host.strip() for host in phase.allowed_hosts or [])
    if isinstance(phase, EnvironmentSection) and phase.allow_internet is not None:
        return ("public" if phase.allow_internet else "none"), ()
    return None, ()


class EnvironmentReader:
    """Reads the environments of a task.

    Args:
        folder: The task folder, which gets notes.
        values: Values for variables; no others are used.

    Attributes:
        missing: Variables that have no value and need one, in words.
    """

    def __init__(self, folder: TaskFolder, values: Mapping[str, str]) -> None:
        self.folder = folder
        self.values = values
        self.missing: list[str] = []

    def read(
        self,
        section: EnvironmentSection,
        files: str,
        field: str,
        *,
        network: Network | None = None,
        hosts: tuple[str, ...] = (),
    ) -> Environment:
        """Read an environment.

        Args:
            section: What ``task.toml`` says of it.
            files: The folder with its Dockerfile or Compose file, in the task's.
            field: Where the section stands, for messages.
            network: The network it has in place of the section's.
            hosts: The hosts that it may reach, with ``network``.

        Raises:
            TaskError: It cannot be read.
        """
        env = self.variables(section.env, f"{field}.env")
        composed = self._composed(section, files, env)
        if composed.main is None:
            self.folder.fail(
                f"{files}/Dockerfile",
                f"the file is missing, and so is '{field}.docker_image' in {_FILE}; expected one of them.",
            )
        own, own_hosts = network_of(section)
        for key in ("mcp_servers", "skills_dir"):
            if getattr(section, key):
                self.folder.note(f"{_FILE}: '{field}.{key}' has no effect: agents here have one terminal.")
        unsupported = [*composed.unsupported, *self._unsupported(section, field)]
        return Environment(
            main=self._main(section, composed.main, env),
            services=composed.services,
            network=network or own or composed.network,
            allowed_hosts=hosts if network else own_hosts,
            build_timeout_s=section.build_timeout_sec,
            unsupported=tuple(dict.fromkeys(unsupported)),
        )

    def healthcheck(self, check: Check | None) -> Healthcheck | None:
        """Return a healthcheck as containers have it."""
        if check is None:
            return None
        return shell_check(
            check.command,
            shell="bash",
            interval_s=check.interval_sec,
            timeout_s=check.timeout_sec,
            start_period_s=check.start_period_sec,
            retries=check.retries,
        )

    def variables(self, env: Mapping[str, str], field: str, *, needed: bool = True) -> dict[str, str]:
        """Return environment variables, those of the form ``${NAME}`` and ``${NAME:-default}`` with their values.

        A name without a value makes the task one that cannot be run, where ``needed``: the environment of this process
        may hold secrets, and is not asked.
        """
        values = {}
        for key, value in env.items():
            if not key or "=" in key or "\0" in key + value:
                self.folder.fail(_FILE, f"'{field}' has the name {key[:60]!r}; expected the name of a variable.")
            template = _VARIABLE.fullmatch(value)
            if template is None:
                values[key] = value
            elif template[1] in self.values:
                values[key] = self.values[template[1]]
            elif template[2] is not None:
                values[key] = template[2]
            elif needed:
                self.missing.append(f"{_FILE}: the variable {template[1]!r} ('{field}.{key}'); give it in variables=")
            else:
                self.folder.note(f"{_FILE}: '{field}.{key}' has no value and is not set.")
        return values

    def _composed(self, section: EnvironmentSection, files: str, env: Mapping[str, str]) -> Composed:
        own = None
        if section.docker_image is not None:
            own = Container(image=section.docker_image)
            if self.folder.has_file(f"{files}/Dockerfile"):
                own = replace(own, context=self.folder.path / files)
                image = f"the image that {_FILE} names ('docker_image')"
                self.folder.note(f"{files}/Dockerfile: is built only where {image} is not to be had.")
        elif self.folder.has_file(f"{files}/Dockerfile"):
            own = Container(context=self.folder.path / files)
        if not self.folder.has_file(f"{files}/{COMPOSE}"):
            return Composed(own, {}, None, ())
        limits = {"CPUS": f"{section.cpus or 1:g}", "MEMORY": f"{section.memory_mb or 2048}M"}
        variables = {**_COMPOSE_VARIABLES, **limits, **env, **self.values}
        composed = read_compose(self.folder, f"{files}/{COMPOSE}", main=MAIN, variables=variables, fallback=own)
        return composed if composed.main is not None else replace(composed, main=own)

    def _main(self, section: EnvironmentSection, main: Container, env: Mapping[str, str]) -> Container:
        return replace(
            main,
            env={**main.env, **env},
            workdir=section.workdir or main.workdir,
            healthcheck=self.healthcheck(section.healthcheck) or main.healthcheck,
            cpus=section.cpus or main.cpus,
            memory_mb=section.memory_mb or main.memory_mb,
            storage_mb=section.storage_mb or main.storage_mb,
        )

    def _unsupported(self, section: EnvironmentSection, field: str) -> list[str]:
        found = []
        if section.os.strip().lower() != "linux":
            found.append(f"{_FILE}: the operating system {section.os[:60]!r} ('{field}.os')")
        if section.gpus:
            found.append(f"{_FILE}: {section.gpus} graphics cards ('{field}.gpus')")
        if section.tpu:
            found.append(f"{_FILE}: a tensor processor ('{field}.tpu')")
        return found
