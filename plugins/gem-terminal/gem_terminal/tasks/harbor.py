"""Tasks in the format of Harbor and Terminal-Bench 2: ``task.toml``, ``instruction.md``, ``environment/``, ``tests/``.

Source: the package ``harbor`` 0.25.0, schema version 1.4 and what it reads of older ones.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from gem_terminal.tasks.compose import MARK, NAMES, read_compose
from gem_terminal.tasks.reading import Env, Seconds, Section, Size, TaskFolder, Text, short_form
from gem_terminal.tasks.task import (
    Collect,
    Container,
    Environment,
    Healthcheck,
    Network,
    Solution,
    Step,
    Task,
    Verifier,
)

FILE = "task.toml"

_COMPOSE = "docker-compose.yaml"
_PUBLISHED = "/logs/artifacts"
_NETWORKS: Mapping[str, Network] = {"public": "public", "no-network": "none", "allowlist": "allowlist"}
_NAMES: Mapping[str, str] = {
    **NAMES,
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
"""What Harbor gives to a Compose file."""


def _check_host(host: str) -> str:
    if not host.strip() or len(host) > 255 or any(one in host for one in "\0 \t\n@?#"):
        raise ValueError(f"{host[:60]!r} is no host; expected a name, an address or a range of addresses")
    return host.strip()


def _check_folder(name: str) -> str:
    if not name.strip() or name in (".", "..") or len(name) > 200 or any(one in name for one in "/\\\0\n"):
        raise ValueError("expected the name of a folder in 'steps'")
    return name


_Positive = Annotated[int, Field(gt=0, le=2**40)]
_Delay = Annotated[float, Field(ge=0, le=1e6)]
_Word = Annotated[
    str, BeforeValidator(lambda value: "" if value is None or isinstance(value, (dict, list)) else str(value))
]
_Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Phase(Section):
    network_mode: Literal["public", "no-network", "allowlist"] | None = None
    allowed_hosts: list[Annotated[str, AfterValidator(_check_host)]] | None = None

    @model_validator(mode="after")
    def _hosts_need_mode(self) -> _Phase:
        if self.allowed_hosts and self.network_mode != "allowlist":
            raise ValueError("'allowed_hosts' is given; expected network_mode = 'allowlist' with it")
        return self

    def network(self) -> tuple[Network | None, tuple[str, ...]]:
        """Return the network, None where it is not said, and the hosts that may be reached where they are listed."""
        if self.network_mode is None:
            return None, ()
        return _NETWORKS[self.network_mode], tuple(self.allowed_hosts or ())


class _Check(Section):
    command: str
    interval_sec: _Delay = 5.0
    timeout_sec: Seconds = 30.0
    start_period_sec: _Delay = 0.0
    start_interval_sec: _Delay = 5.0
    retries: Annotated[int, Field(ge=1, le=100_000)] = 3

    def healthcheck(self) -> Healthcheck:
        """Return it as a task has it."""
        command = ("bash", "-c", self.command)
        return Healthcheck(command, self.interval_sec, self.timeout_sec, self.start_period_sec, self.retries)


class _Environment(_Phase):
    build_timeout_sec: Seconds = 600.0
    docker_image: Annotated[str, Field(min_length=1, max_length=1000)] | None = None
    os: str = "linux"
    cpus: Annotated[float, Field(gt=0, le=100_000, allow_inf_nan=False)] | None = None
    memory_mb: _Positive | None = None
    storage_mb: _Positive | None = None
    memory: Size | None = None  # older keys, as "2G"; the newer win
    storage: Size | None = None
    gpus: Annotated[int, Field(ge=0)] | None = None
    gpu_types: list[str] | None = None
    tpu: Any = None
    env: Env = {}
    healthcheck: _Check | None = None
    workdir: str | None = None
    allow_internet: bool | None = None

    def network(self) -> tuple[Network | None, tuple[str, ...]]:
        if self.network_mode is None and self.allow_internet is not None:
            return ("public" if self.allow_internet else "none"), ()
        return super().network()


class _Agent(_Phase):
    timeout_sec: Seconds | None = None
    user: Text = ""


class _Collect(Section):
    command: str
    service: str = "main"
    timeout_sec: Seconds = 60.0
    user: Text = ""


class _Verifier(_Phase):
    timeout_sec: Seconds = 600.0
    env: Env = {}
    user: Text = ""
    environment_mode: Literal["shared", "separate"] | None = None
    environment: _Environment | None = None
    collect: list[_Collect] = []

    @model_validator(mode="after")
    def _mode_fits(self) -> _Verifier:
        if self.environment_mode == "shared" and self.environment is not None:
            raise ValueError("'environment' is given with environment_mode = 'shared'; expected one of them")
        return self

    @property
    def separate(self) -> bool | None:
        """Whether it runs in an environment of its own; None where it does not say."""
        if self.environment_mode is None:
            return True if self.environment is not None else None
        return self.environment_mode == "separate"


class _Artifact(Section):
    source: str
    destination: str | None = None
    exclude: list[str] = []
    service: str = "main"


_Artifacts = list[Annotated[_Artifact, short_form("source")]]


class _Solution(Section):
    env: Env = {}


class _Step(Section):
    name: Annotated[str, AfterValidator(_check_folder)]
    agent: _Agent = _Agent()
    verifier: _Verifier = _Verifier()
    min_reward: Annotated[
        dict[str, _Finite] | None,
        BeforeValidator(lambda value: value if value is None or isinstance(value, dict) else {"reward": value}),
    ] = None
    healthcheck: _Check | None = None
    artifacts: _Artifacts = []


class _About(Section):
    difficulty: _Word = ""
    category: _Word = ""
    tags: Annotated[list[_Word], BeforeValidator(lambda value: value if isinstance(value, list) else [])] = []


class _TaskFile(Section):
    source: Any = None
    task: dict[str, Any] | None = None
    metadata: _About = _About()
    agent: _Agent = _Agent()
    verifier: _Verifier = _Verifier()
    environment: _Environment = _Environment()
    solution: _Solution = _Solution()
    multi_step_reward_strategy: Literal["mean", "final"] = "mean"
    artifacts: _Artifacts = []
    steps: Annotated[list[_Step], Field(max_length=100)] = []


_Inherits = TypeVar("_Inherits", bound=_Phase)


def read_harbor(folder: TaskFolder, name: str) -> Task:
    """Read a task folder with a ``task.toml``.

    Raises:
        TaskError: It cannot be read.
    """
    file = folder.checked(_TaskFile, folder.parsed(FILE, "TOML"), FILE, silent=r"(schema_)?version|metadata\..*")
    return _Reader(folder, file).read(name)


@dataclass
class _Reader:
    folder: TaskFolder
    file: _TaskFile

    def read(self, name: str) -> Task:
        folder, file = self.folder, self.file
        sections = file.steps or [_Step(name="single", agent=file.agent, verifier=file.verifier)]
        names = [section.name.casefold() for section in sections]
        if twice := [name for name in names if names.count(name) > 1]:
            folder.fail(FILE, f"'steps' has {twice[0]!r} twice; expected names that differ.")
        environment = self._environment(file.environment, "environment", "environment")
        phases = [section.agent if section.agent.network_mode else file.agent for section in sections]
        if len({phase.network() for phase in phases}) > 1:
            folder.refused.append(f"{FILE}: another network in each step ('steps.agent.network_mode')")
        network, hosts = phases[0].network()
        if network is not None:
            environment = replace(environment, network=network, allowed_hosts=hosts)
        steps = tuple(self._step(section, f"steps/{section.name}/" if file.steps else "") for section in sections)
        return Task(
            name=name,
            folder=folder.path,
            format="harbor",
            environment=environment,
            steps=steps,
            digest=folder.digest,
            difficulty=file.metadata.difficulty,
            category=file.metadata.category,
            tags=tuple(file.metadata.tags),
            reward_of_steps=file.multi_step_reward_strategy,
        )

    def _environment(self, section: _Environment, files: str, field: str) -> Environment:
        """Read an environment from its section, and the folder ``files`` with its Dockerfile or Compose file."""
        env = self._env(section.env, f"{field}.env")
        found = self._composed(section, files, field, env)
        for key, what, asked in (
            ("os", f"the operating system {section.os[:60]!r}", section.os.strip().lower() != "linux"),
            ("gpus", f"{section.gpus} graphics cards", section.gpus),
            ("tpu", "a tensor processor", section.tpu),
        ):
            if asked:
                self.folder.refused.append(f"{FILE}: {what} ('{field}.{key}')")
        network, hosts = section.network()
        main = replace(
            found.main,
            env={**found.main.env, **env},
            workdir=section.workdir or found.main.workdir,
            healthcheck=section.healthcheck.healthcheck() if section.healthcheck else found.main.healthcheck,
            cpus=section.cpus or found.main.cpus,
            memory_mb=section.memory_mb or section.memory or found.main.memory_mb,
            storage_mb=section.storage_mb or section.storage or found.main.storage_mb,
        )
        network = network or found.network
        return Environment(main, found.services, network, hosts, section.build_timeout_sec)

    def _composed(self, section: _Environment, files: str, field: str, env: Mapping[str, str]) -> Environment:
        image = section.docker_image
        built = self.folder.has_file(f"{files}/Dockerfile")
        own = Container(context=self.folder.path / files if built else None, image=image) if built or image else None
        if built and image:
            named = f"the image that {FILE} names ('docker_image')"
            self.folder.note(f"{files}/Dockerfile: is built only where {named} is not to be had.")
        if self.folder.has_file(f"{files}/{_COMPOSE}"):
            limits = {"CPUS": f"{section.cpus or 1:g}", "MEMORY": f"{section.memory_mb or section.memory or 2048}M"}
            known, file = {**_NAMES, **limits, **env}, f"{files}/{_COMPOSE}"
            return read_compose(self.folder, file, main="main", known=known, fallback=own, optional=True)
        if own is None:
            problem = f"the file is missing, and so is '{field}.docker_image' in {FILE}; expected one of them."
            self.folder.fail(f"{files}/Dockerfile", problem)
        return Environment(own)

    def _env(self, env: Mapping[str, str], field: str, *, needed: bool = True) -> dict[str, str]:
        values = {}
        for key, written in env.items():
            value = self.folder.variables.of_table(written, f"{FILE}, '{field}.{key}'", needed=needed)
            if value is not None:
                values[key] = value
            elif not needed:
                self.folder.note(f"{FILE}: '{field}.{key}' has no value and is not set.")
        return values

    def _step(self, section: _Step, below: str) -> Step:
        folder = self.folder
        instruction = folder.text(f"{below}instruction.md").strip()
        if not instruction:
            folder.fail(f"{below}instruction.md", "the file is empty; expected what the agent is asked to do.")
        agent = _inherited(section.agent, self.file.agent)
        brought = self._brought(f"{below}workdir") if below else {}
        least = section.min_reward or {}
        if set(least) - {"reward"}:
            self.folder.refused.append(f"{FILE}: 'min_reward' of the step {section.name!r} for several rewards")
        return Step(
            name=section.name if below else "",
            instruction=instruction,
            verifier=self._verifier(section, below),
            agent_timeout_s=agent.timeout_sec,
            agent_user=agent.user,
            min_reward=least.get("reward"),
            healthcheck=section.healthcheck.healthcheck() if section.healthcheck else None,
            solution=self._solution(below),
            files=brought,
            setup=("bash", "setup.sh") if "setup.sh" in brought else (),
        )

    def _brought(self, workdir: str) -> dict[str, Path]:
        """Return the files that a step brings, one by one: a folder would replace one that is there."""
        root = self.folder.path / workdir
        found = sorted(Path(at, name) for at, _, names in os.walk(root) for name in names)
        return {file.relative_to(root).as_posix(): file for file in found}

    def _verifier(self, section: _Step, below: str) -> Verifier:
        asked, general = section.verifier, self.file.verifier
        verifier = _inherited(asked, general)
        separate = asked.separate if asked.separate is not None else bool(general.separate)
        environment, has_tests = self._own_environment(asked, below) if separate else (None, False)
        command, files = (("bash", "/tests/test.sh"), {}) if has_tests else self._tests(below)
        network, hosts = verifier.network()
        if network is None and _inherited(section.agent, self.file.agent).network()[0] is not None:
            network, hosts = self.file.environment.network()
        for one in verifier.collect:
            if one.service != "main":
                words = f"a command in the service {one.service[:60]!r} before the verifier ('verifier.collect')"
                self.folder.refused.append(f"{FILE}: {words}")
        return Verifier(
            files=files,
            command=command,
            timeout_s=verifier.timeout_sec,
            result="reward_file",
            env=self._env({**general.env, **asked.env}, "verifier.env"),
            user=verifier.user,
            network=network,
            allowed_hosts=hosts,
            environment=environment,
            artifacts=self._artifacts(section, separate),
            weights=self.folder.weights(),
            collect=tuple(
                Collect(("bash", "-c", one.command), one.timeout_sec, one.user)
                for one in verifier.collect
                if one.service == "main"
            ),
        )

    def _tests(self, below: str) -> tuple[tuple[str, ...], dict[str, Path]]:
        """Return the command that judges, and what is put into ``/tests``: the task's files, and a step's over them."""
        folders = [one for one in dict.fromkeys(["tests", f"{below}tests"]) if self.folder.has_folder(one)]
        scripts = [f"{one}/test.sh" for one in folders if self.folder.has_file(f"{one}/test.sh")]
        if not scripts:
            self.folder.fail(f"{below}tests/test.sh", "the file is missing; expected the script that judges.")
        files = {"/tests": self.folder.path / folders[0]}
        for over in folders[1:]:
            files |= _overlay(self.folder.path / folders[0], self.folder.path / over, "/tests")
        return self.folder.command(scripts[-1], "/tests/test.sh"), files

    def _own_environment(self, asked: _Verifier, below: str) -> tuple[Environment, bool]:
        """Return the verifier's own environment, and whether its image has the tests in it."""
        general = self.file.verifier.environment
        section = asked.environment or general or self.file.environment
        image, tests = self.file.environment.docker_image, ""
        for own, folder in ((general, "tests"), (asked.environment, f"{below}tests")):
            named = own.docker_image if own is not None else None
            if named or any(self.folder.has_file(f"{folder}/{one}") for one in ("Dockerfile", _COMPOSE)):
                image, tests = named, folder
        section = section.model_copy(update={"docker_image": image})
        environment = self._environment(section, tests or "environment", "verifier.environment")
        return environment, bool(tests)

    def _artifacts(self, section: _Step, separate: bool) -> tuple[str, ...]:
        """Return the paths that are taken to where the tests run, if that is elsewhere."""
        entries = [*self.file.artifacts, *section.artifacts]
        sources = [_PUBLISHED] if entries or separate else []
        for one in entries:
            root = (self.file.environment.workdir or "").rstrip("/")
            source = one.source if one.source.startswith("/") else f"{root}/{one.source}" if root else ""
            if one.service != "main":
                if separate:
                    self.folder.refused.append(f"{FILE}: 'artifacts' of the service {one.service!r}")
            elif not source.strip("/") or ".." in source.split("/") or "\0" in source:
                if separate:
                    self.folder.fail(FILE, f"'artifacts' has {one.source[:100]!r}; expected an absolute path.")
                self.folder.note(f"{FILE}: 'artifacts' has {one.source[:100]!r}, no absolute path, which is not taken.")
            else:
                sources.append(source)
            if one.exclude or one.destination:
                self.folder.note(f"{FILE}: 'exclude' and 'destination' of artifacts have no effect.")
        return tuple(dict.fromkeys(sources))

    def _solution(self, below: str) -> Solution | None:
        for one in dict.fromkeys([f"{below}solution", "solution"]):
            if self.folder.has_file(f"{one}/solve.sh"):
                return Solution(
                    files={"/solution": self.folder.path / one},
                    command=self.folder.command(f"{one}/solve.sh", "/solution/solve.sh"),
                    env=self._env(self.file.solution.env, "solution.env", needed=False),
                )
        return None


def _inherited(section: _Inherits, general: _Inherits) -> _Inherits:
    """Return a step's section, with what it does not say taken from the task's."""
    said = {key: getattr(section, key) for key in section.model_fields_set}
    if "network_mode" in said:
        said.setdefault("allowed_hosts", None)  # hosts belong to the mode beside them
    return general.model_copy(update=said)


def _overlay(below: Path, over: Path, at: str) -> dict[str, Path]:
    """Return what is put over a folder that is there already: a folder of both is gone into, since one replaces all."""
    files: dict[str, Path] = {}
    for child in sorted(over.iterdir()):
        if child.is_dir() and (below / child.name).is_dir():
            files |= _overlay(below / child.name, child, f"{at}/{child.name}")
        else:
            files[f"{at}/{child.name}"] = child
    return files
