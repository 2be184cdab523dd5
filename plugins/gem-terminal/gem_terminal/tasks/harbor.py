"""Tasks in the format of Harbor and Terminal-Bench 2: ``task.toml``, ``instruction.md``, ``environment/``, ``tests/``.

Source: the package ``harbor`` 0.25.0, schema version 1.4 and what it reads of older ones.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gem_terminal.tasks.harbor_environment import EnvironmentReader, network_of
from gem_terminal.tasks.harbor_file import Agent, Artifact, StepSection, TaskFile, VerifierSection
from gem_terminal.tasks.reading import TaskFolder, command_of, plain, read_weights
from gem_terminal.tasks.task import Collect, Environment, Network, Solution, Step, Task, Verifier

FILE = "task.toml"

_PUBLISHED = "/logs/artifacts"


def read_harbor(folder: TaskFolder, name: str, variables: Mapping[str, str]) -> Task:
    """Read a task folder.

    Args:
        folder: The folder, with a ``task.toml``.
        name: The name of the task.
        variables: Values for variables such as ``${API_KEY}``; the environment of this process is never read.

    Raises:
        TaskError: It cannot be read.
    """
    return _Reader(folder, folder.checked(TaskFile, folder.toml(FILE), FILE), variables).read(name)


class _Reader:
    def __init__(self, folder: TaskFolder, file: TaskFile, variables: Mapping[str, str]) -> None:
        self.folder = folder
        self.file = file
        self.environments = EnvironmentReader(folder, variables)
        self.unsupported: list[str] = []

    def read(self, name: str) -> Task:
        folder, file = self.folder, self.file
        sections = file.steps or [StepSection(name="single", agent=file.agent, verifier=file.verifier)]
        self._check_names(sections)
        agent_network, agent_hosts = self._agent_network(sections)
        environment = self.environments.read(
            file.environment, "environment", "environment", network=agent_network, hosts=agent_hosts
        )
        steps = tuple(self._step(section, several=bool(file.steps)) for section in sections)
        if folder.has_file("trajectory.json"):
            folder.note("trajectory.json: earlier context of an agent has no effect.")
        tags = file.metadata.get("tags")
        return Task(
            name=name,
            folder=folder.path,
            format="harbor",
            environment=_with_unsupported(environment, [*self.unsupported, *self.environments.missing]),
            steps=steps,
            digest=folder.digest,
            difficulty=_text(file.metadata.get("difficulty")),
            category=_text(file.metadata.get("category")),
            tags=tuple(_text(tag) for tag in tags) if isinstance(tags, list) else (),
            reward_of_steps=file.multi_step_reward_strategy or "mean",
            metadata=self._metadata(),
            notes=tuple(folder.notes),
        )

    def _metadata(self) -> dict[str, Any]:
        told = dict(self.file.metadata)
        if self.file.task is not None:
            told["task"] = {key: one for key, one in self.file.task.model_dump().items() if one is not None}
        if self.file.source is not None:
            told["source"] = self.file.source
        metadata: dict[str, Any] = plain(told)
        return metadata

    def _check_names(self, sections: list[StepSection]) -> None:
        names = [section.name.casefold() for section in sections]
        if len(names) > 100:
            self.folder.fail(FILE, f"'steps' has {len(names)}; expected 100 at most.")
        for name in names:
            if names.count(name) > 1:
                self.folder.fail(FILE, f"'steps' has {name!r} twice; expected names that differ.")

    def _agent_network(self, sections: list[StepSection]) -> tuple[Network | None, tuple[str, ...]]:
        """Return the network that the agent has, where it is said apart from the environment's."""
        phases = [section.agent if section.agent.network_mode else self.file.agent for section in sections]
        found = {network_of(phase) for phase in phases}
        if len(found) > 1:
            self.unsupported.append(f"{FILE}: another network in each step ('steps.agent.network_mode')")
        return network_of(phases[0])

    def _step(self, section: StepSection, *, several: bool) -> Step:
        folder = self.folder
        below = f"steps/{section.name}/" if several else ""
        instruction = folder.text(f"{below}instruction.md").strip()
        if not instruction:
            folder.fail(f"{below}instruction.md", "the file is empty; expected what the agent is asked to do.")
        if several and folder.has_file(f"{below}trajectory.json"):
            folder.note(f"{below}trajectory.json: earlier context of an agent has no effect.")
        agent = _inherited(section.agent, self.file.agent)
        brought = self._brought(f"{below}workdir") if several else {}
        return Step(
            name=section.name if several else "",
            instruction=instruction,
            verifier=self._verifier(section, below),
            agent_timeout_s=agent.timeout_sec,
            agent_user=agent.user or "",
            min_reward=self._min_reward(section),
            healthcheck=self.environments.healthcheck(section.healthcheck),
            solution=self._solution(below),
            files=brought,
            setup=("bash", "setup.sh") if "setup.sh" in brought else (),
        )

    def _brought(self, workdir: str) -> dict[str, Path]:
        """Return the files that a step brings, one by one: a folder would replace one that is there."""
        if not self.folder.has_folder(workdir):
            return {}
        root = self.folder.path / workdir
        found = sorted(Path(at, name) for at, _, names in os.walk(root) for name in names)
        return {file.relative_to(root).as_posix(): file for file in found}

    def _min_reward(self, section: StepSection) -> float | None:
        least = section.min_reward
        if not isinstance(least, dict):
            return least
        if set(least) - {"reward"}:
            self.unsupported.append(f"{FILE}: 'min_reward' of the step {section.name!r} for several rewards")
        return least.get("reward")

    def _verifier(self, section: StepSection, below: str) -> Verifier:
        asked, general = section.verifier, self.file.verifier
        verifier = _inherited(asked, general)
        separate = asked.separate if asked.separate is not None else bool(general.separate)
        environment, bundled = self._own_environment(asked, below) if separate else (None, False)
        script, files = self._tests(below) if not bundled else ("", {})
        network, hosts = network_of(verifier)
        if network is None and network_of(_inherited(section.agent, self.file.agent))[0] is not None:
            network, hosts = network_of(self.file.environment)
        return Verifier(
            files=files,
            command=command_of(self.folder, script, "/tests/test.sh") if script else ("bash", "/tests/test.sh"),
            timeout_s=verifier.timeout_sec,
            result="reward_file",
            env=self.environments.variables({**general.env, **asked.env}, "verifier.env"),
            user=verifier.user or "",
            network=network,
            allowed_hosts=hosts,
            environment=environment,
            artifacts=self._artifacts(section, separate),
            weights=read_weights(self.folder),
            collect=self._collect(verifier),
        )

    def _collect(self, verifier: VerifierSection) -> tuple[Collect, ...]:
        for one in verifier.collect:
            if one.service != "main":
                self.unsupported.append(
                    f"{FILE}: a command in the service {one.service[:60]!r} before the verifier ('verifier.collect')"
                )
        return tuple(
            Collect(("bash", "-c", one.command), one.timeout_sec, one.user or "")
            for one in verifier.collect
            if one.service == "main"
        )

    def _tests(self, below: str) -> tuple[str, dict[str, Path]]:
        """Return the script that judges, and what is put into ``/tests``: the task's files, and a step's over them."""
        folders = [one for one in dict.fromkeys(["tests", f"{below}tests"]) if self.folder.has_folder(one)]
        scripts = [f"{one}/test.sh" for one in folders if self.folder.has_file(f"{one}/test.sh")]
        if not scripts:
            self.folder.fail(f"{below}tests/test.sh", "the file is missing; expected the script that judges.")
        files = {"/tests": self.folder.path / folders[0]}
        for over in folders[1:]:
            files |= _overlay(self.folder.path / folders[0], self.folder.path / over, "/tests")
        return scripts[-1], files

    def _own_environment(self, asked: VerifierSection, below: str) -> tuple[Environment, bool]:
        """Return the verifier's own environment, and whether its image has the tests in it."""
        general = self.file.verifier.environment
        section = asked.environment or general or self.file.environment
        for own, tests in ((asked.environment, f"{below}tests"), (general, "tests")):
            image = own.docker_image if own is not None else None
            built = any(self.folder.has_file(f"{tests}/{one}") for one in ("Dockerfile", "docker-compose.yaml"))
            if image or built:
                section = section.model_copy(update={"docker_image": image})
                return self._separate(section, tests), True
        section = section.model_copy(update={"docker_image": self.file.environment.docker_image})
        return self._separate(section, "environment"), False

    def _separate(self, section: Any, files: str) -> Environment:
        environment = self.environments.read(section, files, "verifier.environment")
        self.unsupported.extend(environment.unsupported)
        return environment

    def _artifacts(self, section: StepSection, separate: bool) -> tuple[str, ...]:
        entries = [*self.file.artifacts, *section.artifacts]
        if not separate:
            if entries:
                self.folder.note(f"{FILE}: 'artifacts' are not kept; the verifier sees them where they are.")
            return ()
        sources = [_PUBLISHED]
        for entry in entries:
            one = Artifact(source=entry) if isinstance(entry, str) else entry
            source = one.source
            if not source.startswith("/") and self.file.environment.workdir:
                source = f"{self.file.environment.workdir.rstrip('/')}/{source}"
            if not source.startswith("/") or ".." in source.split("/") or "\0" in source:
                self.folder.fail(FILE, f"'artifacts' has {one.source[:100]!r}; expected an absolute path.")
            if one.service not in (None, "main"):
                self.unsupported.append(f"{FILE}: 'artifacts' of the service {one.service!r}")
            if one.exclude or one.destination:
                self.folder.note(f"{FILE}: 'exclude' and 'destination' of artifacts have no effect.")
            sources.append(source)
        return tuple(dict.fromkeys(sources))

    def _solution(self, below: str) -> Solution | None:
        for one in dict.fromkeys([f"{below}solution", "solution"]):
            if not self.folder.has_file(f"{one}/solve.sh"):
                continue
            return Solution(
                files={"/solution": self.folder.path / one},
                command=command_of(self.folder, f"{one}/solve.sh", "/solution/solve.sh"),
                env=self.environments.variables(self.file.solution.env, "solution.env", needed=False),
            )
        return None


def _inherited(section: Any, general: Any) -> Any:
    """Return a step's section, with what it does not say taken from the task's."""
    said = {key: getattr(section, key) for key in section.model_fields_set}
    if section.__class__ in (Agent, VerifierSection) and "network_mode" in said:
        said.setdefault("allowed_hosts", None)  # hosts belong to the mode beside them
    return general.model_copy(update=said)


def _with_unsupported(environment: Environment, more: list[str]) -> Environment:
    return replace(environment, unsupported=tuple(dict.fromkeys([*environment.unsupported, *more])))


def _overlay(below: Path, over: Path, at: str) -> dict[str, Path]:
    """Return what is put over a folder that is there already: a folder of both is gone into, since one replaces all."""
    files: dict[str, Path] = {}
    for child in sorted(over.iterdir()):
        if child.is_dir() and (below / child.name).is_dir():
            files |= _overlay(below / child.name, child, f"{at}/{child.name}")
        else:
            files[f"{at}/{child.name}"] = child
    return files


def _text(value: Any) -> str:
    return "" if value is None or isinstance(value, (dict, list)) else str(value)
