"""Reading the part of Compose that task formats use into containers; what reaches for the host is never granted."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn

from gem_terminal.errors import TaskError
from gem_terminal.tasks.compose_file import Attachment, Build, ComposeFile, Dependency, EnvFile, Service
from gem_terminal.tasks.compose_mounts import MARK, Mounts
from gem_terminal.tasks.compose_refusals import refusals, unknown
from gem_terminal.tasks.task import Container, Healthcheck, Network
from gem_terminal.tasks.variables import Substitution, read_variables

if TYPE_CHECKING:
    from gem_terminal.tasks.reading import TaskFolder

VARIABLES: Mapping[str, str] = {
    "COMPOSE_PROJECT_NAME": "gem-terminal-task",
    "T_BENCH_TASK_DOCKER_CLIENT_IMAGE_NAME": "gem-terminal-task",
    "T_BENCH_TASK_DOCKER_CLIENT_CONTAINER_NAME": "gem-terminal-task",
    "T_BENCH_TASK_DOCKER_NAME_PREFIX": "gem-terminal-task",
    "T_BENCH_TEST_DIR": "/tests",
    "T_BENCH_TASK_LOGS_PATH": f"{MARK}/logs",
    "T_BENCH_CONTAINER_LOGS_PATH": "/logs",
    "T_BENCH_TASK_AGENT_LOGS_PATH": f"{MARK}/agent-logs",
    "T_BENCH_CONTAINER_AGENT_LOGS_PATH": "/agent-logs",
}
"""What the harness of Terminal-Bench gives to a Compose file. Folders of the host are marks, and never mounted."""

_MOST_SERVICES = 50
_MOST_CHARACTERS = 20_000
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")


@dataclass(frozen=True)
class Composed:
    """What a Compose file says.

    Args:
        main: The agent's container; None where the file has none.
        services: All others, each after those it depends on.
        network: ``"none"`` or ``"public"`` where the file says so of the agent's container.
        unsupported: What it asks for and does not get.
    """

    main: Container | None
    services: Mapping[str, Container]
    network: Network | None
    unsupported: tuple[str, ...]


def read_compose(
    folder: TaskFolder,
    file: str,
    *,
    main: str,
    variables: Mapping[str, str],
    fallback: Container | None = None,
    alone: bool = False,
) -> Composed:
    """Read a Compose file.

    Args:
        folder: The task folder, which gets notes of what is passed over.
        file: The Compose file in it.
        main: Name of the service that the agent works in.
        variables: Values of variables; those of a file ``.env`` beside it give way to them.
        fallback: What the agent's service is made of where it names neither image nor build.
        alone: Whether a service that is the only one is the agent's whatever its name.

    Raises:
        TaskError: It cannot be read.
    """
    reader = _Reader(folder, file, main, variables, fallback)
    reader.alone = alone
    return reader.read()


class _Reader:
    def __init__(
        self, folder: TaskFolder, file: str, main: str, variables: Mapping[str, str], fallback: Container | None
    ) -> None:
        self.folder = folder
        self.file = file
        self.below = file.rpartition("/")[0]
        self.main = main
        self.fallback = fallback
        beside = f"{self.below}/.env".lstrip("/")
        values = read_variables(folder.text(beside), str(folder.path / beside)) if folder.has_file(beside) else {}
        self.variables = {**values, **variables}
        self.substitute = Substitution(
            self.variables, lambda name: folder.note(f"{file}: the variable '{name[:100]}' has no value and is empty.")
        )
        self.alone = False
        self.unsupported: list[str] = []

    def read(self) -> Composed:
        data = self.folder.yaml(self.file, strings=True)
        try:
            data = self._substituted(data)
        except TaskError as error:
            self.folder.fail(self.file, f"{error}.")
        if isinstance(data, dict) and data.get("include"):
            self.unsupported.append(f"{self.file}: to include another Compose file ('include')")
        compose = self.folder.checked(ComposeFile, data, self.file)
        if len(compose.services) > _MOST_SERVICES:
            self.folder.fail(
                self.file, f"'services' has {len(compose.services)}; expected {_MOST_SERVICES} services at most."
            )
        for name in compose.services:
            if not _NAME.fullmatch(name):
                self.folder.fail(self.file, f"'services' has {name[:60]!r}; expected a name of letters and digits.")
        if len(compose.services) == 1 and self.alone and self.main not in compose.services:
            self.main = next(iter(compose.services))
            self._note(self.main, "is taken for the one that the agent works in, as it is the only one.")
        services = self._started(compose)
        mounts = Mounts(self.folder, self.file, compose, services, self.unsupported)
        containers = {name: self._container(name, services[name], mounts.of[name]) for name in self._in_order(services)}
        network = self._network(services[self.main], compose) if self.main in services else None
        return Composed(containers.pop(self.main, None), containers, network, tuple(dict.fromkeys(self.unsupported)))

    def _substituted(self, value: Any) -> Any:
        # Keys stay as they are, as in Compose.
        if isinstance(value, str):
            return self.substitute(value)
        if isinstance(value, list):
            return [self._substituted(part) for part in value]
        if isinstance(value, dict):
            return {key: self._substituted(part) for key, part in value.items()}
        return value

    def _fail(self, name: str, field: str, problem: str) -> NoReturn:
        self.folder.fail(self.file, f"'services.{name}.{field}' {problem}")

    def _refuse(self, name: str, what: str) -> None:
        self.unsupported.append(f"{self.file}: the service '{name}' asks for {what}")

    def _note(self, name: str, what: str) -> None:
        self.folder.note(f"{self.file}: the service '{name}': {what}")

    def _started(self, compose: ComposeFile) -> dict[str, Service]:
        started = {}
        for name, service in compose.services.items():
            if service.profiles and name != self.main:
                self._note(name, "has a profile, and is not started.")
            else:
                started[name] = service
        return started

    def _in_order(self, services: Mapping[str, Service]) -> list[str]:
        """Return the names of the services, each after those it depends on, else as they stand in the file."""
        needs = {name: self._needs(name, service, services) for name, service in services.items()}
        order: list[str] = []
        while len(order) < len(services):
            ready = [name for name in services if name not in order and all(need in order for need in needs[name])]
            if not ready:
                left = sorted(set(services) - set(order))
                self.folder.fail(self.file, f"'depends_on' goes in a circle among {', '.join(left)[:200]}.")
            order.append(ready[0])
        return order

    def _needs(self, name: str, service: Service, services: Mapping[str, Service]) -> list[str]:
        listed = service.depends_on
        named = {one: Dependency() for one in listed} if isinstance(listed, list) else listed
        needs = []
        for need, how in named.items():
            how = how or Dependency()
            if need not in services:
                if how.required:
                    self._fail(name, "depends_on", f"names {need[:60]!r}; expected one of {', '.join(services)[:200]}.")
            elif need == self.main:
                self._note(name, f"depends on '{need}', and is started before it all the same.")
            else:
                needs.append(need)
            if how.condition == "service_completed_successfully":
                self._refuse(name, f"the end of '{need}' before its start ('service_completed_successfully')")
        return needs

    def _container(self, name: str, service: Service, volumes: Mapping[str, str]) -> Container:
        for what in refusals(service):
            self._refuse(name, what)
        for key in unknown(service):
            self._note(name, f"'{key[:100]}' has no effect.")
        limits = service.deploy.resources.limits
        made = self._source(name, service)
        return Container(
            context=made.context,
            dockerfile=made.dockerfile,
            image=made.image,
            build_args=made.build_args,
            target=made.target,
            entrypoint=self._words(name, "entrypoint", service.entrypoint),
            command=self._command(name, service),
            env={**self._env_files(name, service), **self._pairs(name, "environment", service.environment)},
            workdir=service.working_dir or "",
            user=service.user or "",
            healthcheck=self._healthcheck(name, service),
            cpus=limits.cpus or service.cpus or None,
            memory_mb=limits.memory or service.mem_limit or None,
            shm_mb=service.shm_size or None,
            volumes=volumes,
            hostname=self._hostname(name, service),
        )

    def _source(self, name: str, service: Service) -> Container:
        if service.build is None:
            if service.image:
                return Container(image=service.image)
            if name == self.main and self.fallback is not None:
                return self.fallback
            self._fail(name, "build", "is missing, and so is 'image'; expected one of them.")
        build = Build(context=service.build) if isinstance(service.build, str) else service.build
        field = f"{self.folder.path / self.file}: 'services.{name}.build"
        context = self.folder.inside(build.context, below=self.below, named=f"{field}.context'")
        below = str(context.relative_to(self.folder.path))
        if not self.folder.has_folder(below):
            self._fail(name, "build.context", f"is {build.context[:100]!r}; expected a folder that is there.")
        dockerfile = self.folder.inside(build.dockerfile or "Dockerfile", below=below, named=f"{field}.dockerfile'")
        if not dockerfile.is_relative_to(context) or not self.folder.has_file(
            str(dockerfile.relative_to(self.folder.path))
        ):
            self._fail(
                name, "build.dockerfile", f"is {build.dockerfile or 'Dockerfile'!r}; expected a file inside {context}."
            )
        return Container(
            context=context,
            dockerfile=str(dockerfile.relative_to(context)),
            build_args=self._pairs(name, "build.args", build.args),
            target=build.target or "",
        )

    def _command(self, name: str, service: Service) -> tuple[str, ...] | None:
        words = self._words(name, "command", service.command)
        # The agent's container must go on; a service with an empty command has none of the image's either.
        return words or None if name == self.main else words

    def _words(self, name: str, field: str, written: str | list[str] | None) -> tuple[str, ...] | None:
        if not isinstance(written, str):
            return None if written is None else tuple(written)
        if len(written) > _MOST_CHARACTERS:  # splitting takes time to the square of it
            self._fail(name, field, f"has {len(written):,} characters; expected {_MOST_CHARACTERS:,} at most.")
        try:
            return tuple(shlex.split(written))
        except ValueError as error:
            self._fail(name, field, f"is {written[:60]!r}: {error}; expected words as a shell reads them.")

    def _pairs(self, name: str, field: str, written: list[str] | dict[str, str | None]) -> dict[str, str]:
        if isinstance(written, list):
            parted = [one.partition("=") for one in written]
            written = {key: value if equals else None for key, equals, value in parted}
        pairs = {}
        for key, value in written.items():
            if not key or "=" in key or "\0" in key + (value or ""):
                self._fail(name, field, f"has the name {key[:60]!r}; expected NAME=value.")
            if value is not None:
                pairs[key] = value
            elif key in self.variables:
                pairs[key] = self.variables[key]
            elif field == "environment":
                self._note(name, f"'{key[:100]}' would come from the host's environment, and is not set.")
        return pairs

    def _env_files(self, name: str, service: Service) -> dict[str, str]:
        listed = [service.env_file] if isinstance(service.env_file, str) else service.env_file or []
        values: dict[str, str] = {}
        for entry in listed:
            one = EnvFile(path=entry) if isinstance(entry, str) else entry
            named = f"{self.folder.path / self.file}: 'services.{name}.env_file'"
            path = self.folder.inside(one.path, below=self.below, named=named).relative_to(self.folder.path)
            if not one.required and not self.folder.has_file(str(path)):
                continue
            read = read_variables(self.folder.text(str(path)), str(self.folder.path / path))
            try:
                values.update({key: self.substitute(value) for key, value in read.items()})
            except TaskError as error:
                self.folder.fail(str(path), f"{error}.")
        return values

    def _healthcheck(self, name: str, service: Service) -> Healthcheck | None:
        check = service.healthcheck
        if check is None or check.disable or check.test in (None, [], ["NONE"], "", "NONE"):
            return None
        if isinstance(check.test, str):
            command: tuple[str, ...] = ("sh", "-c", check.test)
        elif check.test and check.test[0] == "CMD-SHELL" and len(check.test) == 2:
            command = ("sh", "-c", check.test[1])
        elif check.test and check.test[0] == "CMD" and len(check.test) > 1:
            command = tuple(check.test[1:])
        else:
            self._fail(name, "healthcheck.test", "is a list; expected it to begin with CMD or CMD-SHELL.")
        return Healthcheck(command, check.interval, check.timeout or 30.0, check.start_period, check.retries)

    def _hostname(self, name: str, service: Service) -> str:
        """Return the one further name that a container can have on the network; more are refused."""
        names = [service.hostname] if service.hostname else []
        if isinstance(service.networks, dict):
            for attachment in service.networks.values():
                names += (attachment or Attachment()).aliases
        container = service.container_name or ""
        if not container.startswith(VARIABLES["T_BENCH_TASK_DOCKER_NAME_PREFIX"]) and container:
            names.append(container)
        names = [one for one in dict.fromkeys(names) if one != name]
        if len(names) > 1:
            self._refuse(name, f"more than one name on the network: {', '.join(names)[:200]}")
        return names[0] if names else service.hostname or ""

    def _network(self, service: Service, compose: ComposeFile) -> Network | None:
        """Return what the agent's container says of the network; as every backend has one network, notes the rest."""
        mode = (service.network_mode or "").strip()
        if mode == "none":
            return "none"
        if mode == "bridge":
            return "public"
        joined = [compose.networks.get(name) for name in service.networks]
        if joined and all(entry is not None and entry.internal for entry in joined):
            return "none"
        return None
