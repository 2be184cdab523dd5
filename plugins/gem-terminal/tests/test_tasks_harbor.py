"""Tasks in the format of Harbor are read field by field."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from task_writing import HARBOR, read_task, write

from gem_terminal.tasks.task import Collect, Container, Environment, Healthcheck, Solution, Step, Task, Verifier

if TYPE_CHECKING:
    from collections.abc import Mapping

FULL = """
schema_version = "1.4"
source = "somewhere"
artifacts = ["/app/kept"]
task = {name = "org/five", version = "2", keywords = ["five"]}
metadata = {difficulty = "easy", category = "files", tags = ["a", 1], made = 2025-01-31}
agent = {timeout_sec = 120, user = 1000}
solution.env = {HOW = "well"}
verifier = {timeout_sec = 90.5, user = "root", network_mode = "public", env = {LEVEL = "2", KEY = "${KEY:-none}"}}
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
env = {NAME = "${NAME}"}
healthcheck = {command = "test -f /ready", interval_sec = 1.5, timeout_sec = 3, start_period_sec = 2, retries = 4}
"""


def toml(tmp_path: Path, text: str, files: Mapping[str, str | None] = {}) -> Task:
    """Read the smallest task with another ``task.toml``, and more files."""
    return read_task(write(tmp_path / "t", HARBOR, {"task.toml": text}, files), variables={"NAME": "ada"})


def test_every_field_arrives(tmp_path: Path) -> None:
    """Image, limits, network, healthcheck, verifier, solution and what the task says of itself."""
    task = toml(tmp_path, FULL, {"solution/solve.sh": "true\n", "tests/test.sh": "#!/bin/sh -e\n"})
    folder = task.folder
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
    verifier = Verifier(
        files={"/tests": folder / "tests"},
        command=("/bin/sh", "-e", "/tests/test.sh"),
        timeout_s=90.5,
        result="reward_file",
        env={"LEVEL": "2", "KEY": "none"},
        user="root",
        network="public",
        artifacts=("/logs/artifacts", "/app/kept"),
    )
    solution = Solution({"/solution": folder / "solution"}, ("bash", "/solution/solve.sh"), env={"HOW": "well"})
    step = Step("", "Write 5 to /app/five.txt.", verifier, agent_timeout_s=120.0, agent_user="1000", solution=solution)
    assert task.steps == (step,)
    assert (task.name, task.format, task.reward_of_steps) == ("t", "harbor", "mean")
    assert (task.difficulty, task.category, task.tags) == ("easy", "files", ("a", "1"))
    assert [note.split("'")[1] for note in task.notes] == ["environment.skills_dir"]


def test_defaults_are_the_formats(tmp_path: Path) -> None:
    """600 s for the verifier, no limit for the agent, nothing said of the network; a script needs no permission."""
    task = toml(tmp_path, "", {"tests/test.sh": "echo 1 > /logs/verifier/reward.txt\n"})
    (step,) = task.steps
    assert (step.agent_timeout_s, step.verifier.timeout_s) == (None, 600.0)
    assert task.environment == Environment(main=Container(context=tmp_path / "t/environment"))
    assert step.verifier.command == ("bash", "/tests/test.sh")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('memory = "2G"\nstorage = "512M"\nallow_internet = false', (2048, 512, "none")),
        ("allow_internet = true", (None, None, "public")),
        ('allow_internet = true\nnetwork_mode = "no-network"\nmemory = "1G"\nmemory_mb = 5', (5, None, "none")),
        ('network_mode = "public"\n[agent]\nnetwork_mode = "no-network"', (None, None, "none")),
    ],
    ids=["older keys", "internet", "the newer key wins", "the agent's network comes before the environment's"],
)
def test_keys_of_the_environment(tmp_path: Path, text: str, expected: Any) -> None:
    environment = toml(tmp_path, f"[environment]\n{text}\n").environment
    assert (environment.main.memory_mb, environment.main.storage_mb, environment.network) == expected


def test_an_image_comes_before_a_dockerfile(tmp_path: Path) -> None:
    """Which is kept for where ``docker_image`` cannot be had, with a note."""
    task = toml(tmp_path, '[environment]\ndocker_image = "some/image:1"\n')
    assert task.environment.main == Container(image="some/image:1", context=task.folder / "environment")
    assert [note.partition(":")[0] for note in task.notes] == ["environment/Dockerfile"]


def test_the_environment_of_this_process_is_never_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may hold keys, and the agent sees its container's."""
    monkeypatch.setenv("API_KEY", "secret")
    compose = "services: {main: {build: ., environment: [API_KEY, 'OTHER=${API_KEY}']}}\n"
    text = '[environment.env]\nA = "${API_KEY:-none}"\n[verifier.env]\nB = "${API_KEY}"\n'
    task = toml(tmp_path, text, {"environment/docker-compose.yaml": compose})
    assert task.environment.main.env == {"OTHER": "", "A": "none"}
    assert "secret" not in repr(task)
    assert task.missing == {"API_KEY": "environment/docker-compose.yaml"}
    assert task.variables == {"API_KEY": "none"}


def test_compose_and_the_file_of_the_task_are_joined(tmp_path: Path) -> None:
    """``main`` is built from the Dockerfile where Compose does not say; ``task.toml`` has the last word."""
    main = 'main: {depends_on: [db], environment: {A: "1", B: "1"}, mem_limit: 100m, cpus: "0.5"}, '
    text = '[environment]\nmemory_mb = 300\n[environment.env]\nB = "2"\n'
    context, env = tmp_path / "t/environment", {"A": "1", "B": "2"}
    for said, expected in (
        (main, Container(context=context, env=env, cpus=0.5, memory_mb=300)),
        ("", Container(context=context, env={"B": "2"}, memory_mb=300)),
    ):
        compose = f"services: {{{said}db: {{image: 'db:1', environment: {{SIZE: '${{MEMORY}}'}}}}}}\n"
        environment = toml(tmp_path, text, {"environment/docker-compose.yaml": compose}).environment
        assert environment.main == expected
        assert environment.services == {"db": Container(image="db:1", env={"SIZE": "300M"})}


STEPS = """
multi_step_reward_strategy = "final"
agent.timeout_sec = 50
verifier = {timeout_sec = 40, env = {A = "task"}}
[[steps]]
name = "first"
min_reward = 0.5
healthcheck.command = "true"
verifier.env.A = "step"
[[steps]]
name = "second"
min_reward = {reward = 1}
agent = {timeout_sec = 10, user = "worker"}
verifier = {timeout_sec = 20, user = "root"}
"""


def test_steps_are_read_with_what_they_share(tmp_path: Path) -> None:
    """Each has its instruction, limits, tests over those of the task, solution, and files that it brings."""
    files = {
        "instruction.md": None,
        "tests/common/a.py": "a",
        "steps/first/instruction.md": "One.",
        "steps/first/tests/test.sh": "#!/usr/bin/env python3\n",
        "steps/first/tests/common/b.py": "b",
        "steps/first/solution/solve.sh": "true\n",
        "steps/first/workdir/setup.sh": "true\n",
        "steps/first/workdir/data/x.csv": "1\n",
        "steps/second/instruction.md": "Two.",
    }
    task = toml(tmp_path, STEPS, files)
    first, second = task.steps
    step, tests = task.folder / "steps/first", task.folder / "tests"
    assert (first.name, first.instruction, first.agent_timeout_s, first.min_reward) == ("first", "One.", 50.0, 0.5)
    assert first.healthcheck == Healthcheck(("bash", "-c", "true"), 5.0, 30.0, 0.0, 3)
    own = {f"/tests/{name}": step / "tests" / name for name in ("common/b.py", "test.sh")}
    assert first.verifier.files == {"/tests": tests, **own}
    assert first.verifier.command == ("/usr/bin/env", "python3", "/tests/test.sh")
    assert (first.verifier.env, first.verifier.timeout_s) == ({"A": "step"}, 40.0)
    assert first.files == {name: step / "workdir" / name for name in ("data/x.csv", "setup.sh")}
    assert first.setup == ("bash", "setup.sh")
    assert first.solution == Solution(files={"/solution": step / "solution"}, command=("bash", "/solution/solve.sh"))
    assert (second.instruction, second.agent_timeout_s, second.agent_user) == ("Two.", 10.0, "worker")
    assert (second.min_reward, second.verifier.timeout_s, second.verifier.user) == (1.0, 20.0, "root")
    assert (second.verifier.files, second.verifier.env) == ({"/tests": tests}, {"A": "task"})
    assert (second.files, second.setup) == ({}, ())
    assert (task.reward_of_steps, task.environment.unsupported) == ("final", ())


def test_a_verifier_of_its_own_has_its_image(tmp_path: Path) -> None:
    """Built from ``tests`` where a Dockerfile is there, which then has the tests in it; else the agent's image."""
    text = """
artifacts = ["out", {source = "/logs/agent", exclude = ["x"]}]
environment.workdir = "/app"
[verifier]
environment_mode = "separate"
environment = {memory_mb = 64, network_mode = "no-network"}
collect = [{command = "dump > /app/out", timeout_sec = 5, user = "root"}]
"""
    verifier = toml(tmp_path, text).steps[0].verifier
    main = Container(context=tmp_path / "t/environment", memory_mb=64)
    assert verifier.environment == Environment(main=main, network="none")
    assert verifier.files == {"/tests": tmp_path / "t/tests"}
    assert verifier.artifacts == ("/logs/artifacts", "/app/out", "/logs/agent")
    assert verifier.collect == (Collect(("bash", "-c", "dump > /app/out"), 5.0, "root"),)
    built = toml(tmp_path, text, {"tests/Dockerfile": "FROM x\nCOPY . /tests\n"}).steps[0].verifier
    assert built.environment is not None
    assert built.environment.main.context == tmp_path / "t/tests"
    assert (built.files, built.command) == ({}, ("bash", "/tests/test.sh"))


UNSUPPORTED = {
    "gpus": "environment.gpus = 2",
    "os": 'environment.os = "Windows"',
    "tpu": 'environment.tpu = {type = "v4", topology = "2x2"}',
    "artifacts": 'artifacts = [{source = "/x", service = "db"}]\nverifier.environment_mode = "separate"',
    "verifier.collect": 'verifier.collect = [{command = "x", service = "db"}]',
    "min_reward": '[[steps]]\nname = "a"\nmin_reward = {style = 1}',
    "steps.agent.network_mode": '[[steps]]\nname = "a"\nagent.network_mode = "public"\n[[steps]]\nname = "b"',
}


@pytest.mark.parametrize("name", UNSUPPORTED)
def test_what_no_backend_has_is_named(tmp_path: Path, name: str) -> None:
    """The task can be read and listed all the same."""
    files = {"steps/a/instruction.md": "A", "steps/b/instruction.md": "B"}
    (said,) = toml(tmp_path, UNSUPPORTED[name], files).environment.unsupported
    assert f"{name}'" in said
