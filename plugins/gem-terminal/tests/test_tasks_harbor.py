"""Tasks in the format of Harbor are read field by field."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from task_writing import HARBOR, read_task, write

from gem_terminal.tasks.task import Collect, Container, Environment, Healthcheck, Solution, Step, Task, Verifier

if TYPE_CHECKING:
    import pytest

FULL = """
schema_version = "1.4"
source = "somewhere"
artifacts = ["/app/kept"]

[task]
name = "org/five"
version = "2"
keywords = ["five"]

[metadata]
difficulty = "easy"
category = "files"
tags = ["a", 1]
made = 2025-01-31

[agent]
timeout_sec = 120
user = 1000

[verifier]
timeout_sec = 90.5
user = "root"
network_mode = "public"
[verifier.env]
LEVEL = "2"
KEY = "${KEY:-none}"

[environment]
build_timeout_sec = 300
cpus = 2
memory_mb = 512
storage_mb = 1024
gpus = 0
workdir = "/work"
network_mode = "allowlist"
allowed_hosts = ["example.com", "*.example.org"]
skills_dir = "/skills"
[environment.env]
NAME = "${NAME}"
[[environment.mcp_servers]]
name = "x"
url = "x"
[environment.healthcheck]
command = "test -f /ready"
interval_sec = 1.5
timeout_sec = 3
start_period_sec = 2
retries = 4

[solution.env]
HOW = "well"
"""


def test_every_field_arrives(tmp_path: Path) -> None:
    """Image, limits, network, healthcheck, verifier, solution and what the task says of itself."""
    folder = write(
        tmp_path / "five", HARBOR, {"task.toml": FULL, "solution/solve.sh": "true\n", "tests/test.sh": "#!/bin/sh -e\n"}
    )
    task = read_task(folder, variables={"NAME": "ada"})
    assert task.environment == Environment(
        main=Container(
            context=folder / "environment",
            env={"NAME": "ada"},
            workdir="/work",
            healthcheck=Healthcheck(("bash", "-c", "test -f /ready"), 1.5, 3.0, 2.0, 4),
            cpus=2.0,
            memory_mb=512,
            storage_mb=1024,
        ),
        network="allowlist",
        allowed_hosts=("example.com", "*.example.org"),
        build_timeout_s=300.0,
    )
    assert task.steps == (
        Step(
            name="",
            instruction="Write 5 to /app/five.txt.",
            agent_timeout_s=120.0,
            agent_user="1000",
            verifier=Verifier(
                files={"/tests": folder / "tests"},
                command=("/bin/sh", "-e", "/tests/test.sh"),
                timeout_s=90.5,
                result="reward_file",
                env={"LEVEL": "2", "KEY": "none"},
                user="root",
                network="public",
                artifacts=("/logs/artifacts", "/app/kept"),
            ),
            solution=Solution(
                files={"/solution": folder / "solution"}, command=("bash", "/solution/solve.sh"), env={"HOW": "well"}
            ),
        ),
    )
    assert (task.name, task.format, task.reward_of_steps) == ("five", "harbor", "mean")
    assert (task.difficulty, task.category, task.tags) == ("easy", "files", ("a", "1"))
    assert task.notes == (
        "task.toml: 'environment.skills_dir' is not known and has no effect.",
        "task.toml: 'environment.mcp_servers' is not known and has no effect.",
    )


def test_defaults_are_the_formats(tmp_path: Path) -> None:
    """600 s for the verifier and for building, no limit for the agent; nothing said of the network."""
    task = read_task(write(tmp_path / "t", HARBOR))
    (step,) = task.steps
    assert (step.agent_timeout_s, step.verifier.timeout_s) == (None, 600.0)
    assert task.environment == Environment(main=Container(context=tmp_path / "t/environment"))
    assert step.verifier.command == ("/bin/bash", "/tests/test.sh")


def toml(tmp_path: Path, text: str, **files: str | None) -> Task:
    """Read the smallest task with another ``task.toml``, and more files."""
    return read_task(write(tmp_path / "t", HARBOR, {"task.toml": text}, files))


def test_keys_of_older_versions_are_read(tmp_path: Path) -> None:
    """``version``, ``memory = "2G"``, ``storage``, ``allow_internet``."""
    old = 'version = "1.0"\n[environment]\nmemory = "2G"\nstorage = "512M"\nallow_internet = false\n'
    environment = toml(tmp_path, old).environment
    assert (environment.main.memory_mb, environment.main.storage_mb, environment.network) == (2048, 512, "none")
    assert toml(tmp_path, "[environment]\nallow_internet = true\n").environment.network == "public"


def test_the_newer_key_wins(tmp_path: Path) -> None:
    """Over ``allow_internet``, as in Harbor, and over ``memory``."""
    both = '[environment]\nallow_internet = true\nnetwork_mode = "no-network"\nmemory = "1G"\nmemory_mb = 5\n'
    environment = toml(tmp_path, both).environment
    assert (environment.network, environment.main.memory_mb) == ("none", 5)


def test_the_agents_network_comes_before_the_environments(tmp_path: Path) -> None:
    """And the verifier then has the environment's."""
    text = '[environment]\nnetwork_mode = "public"\n[agent]\nnetwork_mode = "no-network"\n'
    task = toml(tmp_path, text)
    assert (task.environment.network, task.steps[0].verifier.network) == ("none", "public")


def test_an_image_comes_before_a_dockerfile(tmp_path: Path) -> None:
    """Which is kept for where ``docker_image`` cannot be had, with a note."""
    task = toml(tmp_path, '[environment]\ndocker_image = "some/image:1"\n')
    assert task.environment.main == Container(image="some/image:1", context=task.folder / "environment")
    why = "is built only where the image that task.toml names ('docker_image') is not to be had."
    assert task.notes == (f"environment/Dockerfile: {why}",)


def test_what_no_backend_has_is_said_in_words(tmp_path: Path) -> None:
    """The task can be read and listed all the same."""
    text = '[environment]\ngpus = 2\nos = "Windows"\ntpu = {type = "v4", topology = "2x2"}\n\n'
    assert toml(tmp_path, text).environment.unsupported == (
        "task.toml: the operating system 'Windows' ('environment.os')",
        "task.toml: 2 graphics cards ('environment.gpus')",
        "task.toml: a tensor processor ('environment.tpu')",
    )


def test_the_environment_of_this_process_is_never_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may hold keys, and the agent sees its container's."""
    monkeypatch.setenv("API_KEY", "secret")
    compose = "services: {main: {build: ., environment: [API_KEY, 'OTHER=${API_KEY}']}}\n"
    text = '[environment.env]\nA = "${API_KEY:-none}"\n[verifier.env]\nB = "${API_KEY}"\n'
    task = toml(tmp_path, text, **{"environment/docker-compose.yaml": compose})
    assert task.environment.main.env == {"OTHER": "", "A": "none"}
    assert "secret" not in repr(task)
    assert task.missing == {"API_KEY": "environment/docker-compose.yaml"}
    assert task.variables == {"API_KEY": "none"}


def test_compose_and_the_file_of_the_task_are_joined(tmp_path: Path) -> None:
    """``main`` is built from the Dockerfile where Compose does not say; ``task.toml`` has the last word."""
    compose = """
services:
  main:
    depends_on: [db]
    environment: {A: "1", B: "1"}
    mem_limit: 100m
    cpus: "0.5"
  db:
    image: db:1
    environment: {SIZE: "${MEMORY}", TESTS: "${TEST_DIR}"}
"""
    text = '[environment]\nmemory_mb = 300\n[environment.env]\nB = "2"\n'
    task = toml(tmp_path, text, **{"environment/docker-compose.yaml": compose})
    assert task.environment.main == Container(
        context=tmp_path / "t/environment", env={"A": "1", "B": "2"}, cpus=0.5, memory_mb=300
    )
    assert task.environment.services == {"db": Container(image="db:1", env={"SIZE": "300M", "TESTS": "/tests"})}


def test_compose_may_leave_main_out(tmp_path: Path) -> None:
    """It is then built from the Dockerfile, beside the services."""
    files = {"environment/docker-compose.yaml": "services: {db: {image: 'db:1'}}\n"}
    environment = toml(tmp_path, "", **files).environment
    assert environment.main.context == tmp_path / "t/environment"
    assert list(environment.services) == ["db"]


STEPS = """
multi_step_reward_strategy = "final"
[agent]
timeout_sec = 50
[verifier]
timeout_sec = 40
[verifier.env]
A = "task"
[[steps]]
name = "first"
min_reward = 0.5
[steps.healthcheck]
command = "true"
[steps.verifier.env]
A = "step"
[[steps]]
name = "second"
min_reward = {reward = 1}
[steps.agent]
timeout_sec = 10
user = "worker"
[steps.verifier]
timeout_sec = 20
user = "root"
"""


def test_steps_are_read_with_what_they_share(tmp_path: Path) -> None:
    """Each has its instruction, limits, tests over those of the task, solution, and files that it brings."""
    folder = write(
        tmp_path / "t",
        HARBOR,
        {
            "task.toml": STEPS,
            "instruction.md": None,
            "tests/common/a.py": "a",
            "steps/first/instruction.md": "One.",
            "steps/first/tests/test.sh": "#!/usr/bin/env python3\n",
            "steps/first/tests/common/b.py": "b",
            "steps/first/solution/solve.sh": "true\n",
            "steps/first/workdir/setup.sh": "true\n",
            "steps/first/workdir/data/x.csv": "1\n",
            "steps/second/instruction.md": "Two.",
        },
    )
    task = read_task(folder)
    first, second = task.steps
    step = folder / "steps/first"
    assert (first.name, first.instruction, first.agent_timeout_s, first.min_reward) == ("first", "One.", 50.0, 0.5)
    assert first.healthcheck == Healthcheck(("bash", "-c", "true"), 5.0, 30.0, 0.0, 3)
    assert first.verifier.files == {
        "/tests": folder / "tests",
        "/tests/common/b.py": step / "tests/common/b.py",
        "/tests/test.sh": step / "tests/test.sh",
    }
    assert first.verifier.command == ("/usr/bin/env", "python3", "/tests/test.sh")
    assert (first.verifier.env, first.verifier.timeout_s) == ({"A": "step"}, 40.0)
    assert first.files == {"data/x.csv": step / "workdir/data/x.csv", "setup.sh": step / "workdir/setup.sh"}
    assert first.setup == ("bash", "setup.sh")
    assert first.solution == Solution(files={"/solution": step / "solution"}, command=("bash", "/solution/solve.sh"))
    assert (second.instruction, second.agent_timeout_s, second.agent_user) == ("Two.", 10.0, "worker")
    assert (second.min_reward, second.verifier.timeout_s, second.verifier.user) == (1.0, 20.0, "root")
    assert second.verifier.files == {"/tests": folder / "tests"}
    assert (second.verifier.env, second.files, second.setup) == ({"A": "task"}, {}, ())
    assert task.reward_of_steps == "final"
    assert task.environment.unsupported == ()


def test_a_verifier_of_its_own_has_its_image(tmp_path: Path) -> None:
    """Built from ``tests`` where a Dockerfile is there, which then has the tests in it; else the agent's image."""
    text = """
artifacts = ["out", {source = "/logs/agent", exclude = ["x"]}]
[environment]
workdir = "/app"
[verifier]
environment_mode = "separate"
[verifier.environment]
memory_mb = 64
network_mode = "no-network"
[[verifier.collect]]
command = "dump > /app/out"
timeout_sec = 5
user = "root"
"""
    task = toml(tmp_path, text)
    verifier = task.steps[0].verifier
    assert verifier.environment == Environment(
        main=Container(context=tmp_path / "t/environment", memory_mb=64), network="none"
    )
    assert verifier.files == {"/tests": tmp_path / "t/tests"}
    assert verifier.artifacts == ("/logs/artifacts", "/app/out", "/logs/agent")
    assert verifier.collect == (Collect(("bash", "-c", "dump > /app/out"), 5.0, "root"),)
    built = toml(tmp_path, text, **{"tests/Dockerfile": "FROM x\nCOPY . /tests\n"}).steps[0].verifier
    assert built.environment is not None
    assert built.environment.main.context == tmp_path / "t/tests"
    assert (built.files, built.command) == ({}, ("bash", "/tests/test.sh"))


def test_other_services_and_rewards_of_a_step_are_refused(tmp_path: Path) -> None:
    """Commands and artifacts of other services, thresholds of other rewards, networks that differ by step."""
    text = """
artifacts = [{source = "/x", service = "db"}]
[[verifier.collect]]
command = "x"
service = "db"
[[steps]]
name = "a"
min_reward = {style = 1}
[steps.agent]
network_mode = "public"
[steps.verifier]
environment_mode = "separate"
[[steps]]
name = "b"
"""
    files = {"steps/a/instruction.md": "A", "steps/b/instruction.md": "B"}
    assert sorted(toml(tmp_path, text, **files).environment.unsupported) == [
        "task.toml: 'artifacts' of the service 'db'",
        "task.toml: 'min_reward' of the step 'a' for several rewards",
        "task.toml: a command in the service 'db' before the verifier ('verifier.collect')",
        "task.toml: another network in each step ('steps.agent.network_mode')",
    ]


def test_unknown_keys_are_noted_once(tmp_path: Path) -> None:
    """Newer versions of the format have more keys."""
    task = toml(tmp_path, "new = 1\n[verifier]\nrestart_environment = false\n")
    assert task.notes == (
        "task.toml: 'new' is not known and has no effect.",
        "task.toml: 'verifier.restart_environment' is not known and has no effect.",
    )


def test_a_script_without_permission_is_run_by_its_first_line(tmp_path: Path) -> None:
    """Folders that come out of an archive have lost it at times."""
    folder = write(tmp_path / "t", HARBOR, {"tests/test.sh": "echo 1 > /logs/verifier/reward.txt\n"})
    os.chmod(folder / "tests/test.sh", 0o600)
    assert read_task(folder).steps[0].verifier.command == ("bash", "/tests/test.sh")
