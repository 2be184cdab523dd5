"""Tasks in the first format of Terminal-Bench are read field by field."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from task_writing import TERMINAL_BENCH, read_task, write

from gem_terminal.tasks.task import Container, Environment, Solution, Step, Verifier

COMPOSE = """
services:
  client:
    build:
      dockerfile: Dockerfile
    image: ${T_BENCH_TASK_DOCKER_CLIENT_IMAGE_NAME}
    container_name: ${T_BENCH_TASK_DOCKER_CLIENT_CONTAINER_NAME}
    command: [ "sh", "-c", "sleep infinity" ]
    environment:
      - TEST_DIR=${T_BENCH_TEST_DIR}
    volumes:
      - ${T_BENCH_TASK_LOGS_PATH}:${T_BENCH_CONTAINER_LOGS_PATH}
      - ${T_BENCH_TASK_AGENT_LOGS_PATH}:${T_BENCH_CONTAINER_AGENT_LOGS_PATH}
"""
"""What the file says in most tasks of the format."""

FULL = """
# A comment at the top.
instruction: |-
  Write 5 to /app/five.txt.
author_name: Ada
author_email: unknown
difficulty: hard
category: file-operations
tags: [files, 7]
parser_name: swebench
max_agent_timeout_sec: 900
max_test_timeout_sec: 180.5
run_tests_in_same_shell: true
expert_time_estimate_min:
made: 2025-01-31
"""


def test_every_field_arrives(tmp_path: Path) -> None:
    """Instruction, limits, parser, tests, solution and what the task says of itself."""
    folder = write(
        tmp_path / "five",
        TERMINAL_BENCH,
        {
            "task.yaml": FULL,
            "docker-compose.yaml": COMPOSE,
            "solution.sh": "echo -n 5 > /app/five.txt\n",
            "test_weights.json": '{"test_five": 2, "test_other": 0.5, "wrong": "Hello", "below": -1}',
        },
    )
    task = read_task(folder)
    assert task.steps == (
        Step(
            name="",
            instruction="Write 5 to /app/five.txt.",
            agent_timeout_s=900.0,
            verifier=Verifier(
                files={"/tests": folder / "tests", "/tests/run-tests.sh": folder / "run-tests.sh"},
                command=("bash", "/tests/run-tests.sh"),
                timeout_s=180.5,
                result="output",
                parser="swebench",
                env={"TEST_DIR": "/tests"},
                same_shell=True,
                weights={"test_five": 2.0, "test_other": 0.5},
            ),
            solution=Solution(
                files={"/oracle/solution.sh": folder / "solution.sh"}, command=("bash", "/oracle/solution.sh")
            ),
        ),
    )
    assert list(task.steps[0].verifier.files) == ["/tests", "/tests/run-tests.sh"], "a folder replaces all in it"
    assert task.environment == Environment(main=Container(context=folder, env={"TEST_DIR": "/tests"}))
    assert (task.name, task.folder, task.format) == ("five", folder, "terminal-bench")
    assert (task.difficulty, task.category, task.tags) == ("hard", "file-operations", ("files", "7"))
    assert task.notes == (
        "task.yaml: 'made' is not known and has no effect.",
        "test_weights.json: the weight of 'wrong' is 'Hello' and has no effect.",
        "test_weights.json: the weight of 'below' is -1 and has no effect.",
    )


def test_defaults_are_the_formats(tmp_path: Path) -> None:
    """360 s for the agent, 60 s for the tests, pytest; a task without a Compose file is built from its Dockerfile."""
    yaml = "instruction: Go.\nmax_agent_timeout_sec:\ntags:\nparser_name:\n"  # an empty field has its default
    task = read_task(write(tmp_path / "t", TERMINAL_BENCH, {"task.yaml": yaml}))
    (step,) = task.steps
    assert (step.agent_timeout_s, step.verifier.timeout_s, step.verifier.parser) == (360.0, 60.0, "pytest")
    assert not step.verifier.same_shell
    assert step.solution is None
    assert task.environment.main == Container(context=tmp_path / "t", env={"TEST_DIR": "/tests"})
    assert (task.environment.network, task.notes, task.tags) == (None, (), ())


def test_the_oldest_form_of_instructions_is_read(tmp_path: Path) -> None:
    """The description named ``base`` of several."""
    yaml = "descriptions:\n- {key: hard, description: Think.}\n- {key: base, description: Do.}\n"
    task = read_task(write(tmp_path / "t", TERMINAL_BENCH, {"task.yaml": yaml}))
    assert task.steps[0].instruction == "Do."


def test_typed_solutions_keep_their_limits(tmp_path: Path) -> None:
    """``solution.yaml`` has lines with the seconds each may take; ``solution.sh`` comes before it."""
    typed = "- command: cd /app\n  max_timeout_sec: 5\n- command: make\n  min_timeout_sec: 200\n  block: true\n"
    folder = write(tmp_path / "t", TERMINAL_BENCH, {"solution.yaml": typed})
    assert read_task(folder).steps[0].solution == Solution(typed=(("cd /app", 5.0), ("make", 200.0)))


def test_keys_without_enter_are_noted(tmp_path: Path) -> None:
    """They cannot be told by lines, so the task has no solution."""
    typed = "- command: vim x\n- command: Escape\n  append_enter: false\n"
    task = read_task(write(tmp_path / "t", TERMINAL_BENCH, {"solution.yaml": typed}))
    assert task.steps[0].solution is None
    assert task.notes == ("solution.yaml: types keys without Enter ('append_enter'), and is passed over.",)


@pytest.mark.parametrize("line", ["COPY . /app", "  add --chown=1 ./ /app", "COPY * /app/"])
def test_an_image_with_the_tests_in_it_is_noted(tmp_path: Path, line: str) -> None:
    """The context of a build is the whole folder."""
    task = read_task(write(tmp_path / "t", TERMINAL_BENCH, {"Dockerfile": f"FROM x\n{line}\n"}))
    assert task.notes == ("Dockerfile: copies the whole folder: the agent can see its tests and its solution.",)


def test_windows_line_ends_and_a_byte_order_mark_are_read(tmp_path: Path) -> None:
    """The instruction has none of them; a script that has them is noted."""
    files = {
        "task.yaml": b"\xef\xbb\xbfinstruction: |-\r\n  One.\r\n  Two.\r\n",
        "run-tests.sh": b"#!/bin/bash\r\ntrue\r\n",
    }
    task = read_task(write(tmp_path / "t", TERMINAL_BENCH, files))
    assert task.steps[0].instruction == "One.\nTwo."
    assert task.notes == ("run-tests.sh: has the line ends of Windows, which a shell stumbles over.",)


def test_a_single_service_is_the_agents_whatever_its_name(tmp_path: Path) -> None:
    """With a note: the format calls it ``client``."""
    files = {"docker-compose.yaml": "services: {agent: {build: ., user: worker}}\n"}
    task = read_task(write(tmp_path / "t", TERMINAL_BENCH, files))
    assert (task.environment.main.user, task.environment.services) == ("worker", {})
    assert task.notes == (
        "docker-compose.yaml: the service 'agent': is taken for the one that the agent works in, as it is the only "
        "one.",
    )


@pytest.mark.parametrize("without", ["", "sys.modules['yaml._yaml'] = None; "], ids=["libyaml", "python"])
def test_yaml_is_read_with_and_without_libyaml(tmp_path: Path, without: str) -> None:
    """PyYAML may have been built without it; limits hold either way."""
    good = write(tmp_path / "good", TERMINAL_BENCH, {"docker-compose.yaml": COMPOSE})
    bad = write(tmp_path / "bad", TERMINAL_BENCH, {"task.yaml": "a: " + "[" * 100})
    code = f"""import sys; {without}
from gem_terminal.errors import TaskError
from gem_terminal.tasks.folders import find_tasks
from gem_terminal.tasks.parsing import Loader
print(Loader.__base__.__name__, find_tasks([{str(good)!r}]).tasks[0].environment.main.env["TEST_DIR"])
try:
    find_tasks([{str(bad)!r}])
except TaskError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, timeout=60)
    name = "SafeLoader" if without else "CSafeLoader"
    assert (done.stdout, done.stderr) == (
        f"{name} /tests\n{bad}/task.yaml: is nested too deeply; expected 40 levels at most.\n",
        "",
    )
