"""Tasks in the first format of Terminal-Bench are read field by field."""

from __future__ import annotations

from pathlib import Path

import pytest
from task_writing import TERMINAL_BENCH, read_task, write

from gem_terminal.tasks.task import Container, Environment, Solution, Step, Verifier

COMPOSE = """
services:
  client:
    build: {dockerfile: Dockerfile}
    image: ${T_BENCH_TASK_DOCKER_CLIENT_IMAGE_NAME}
    container_name: ${T_BENCH_TASK_DOCKER_CLIENT_CONTAINER_NAME}
    command: [ "sh", "-c", "sleep infinity" ]
    environment: [ "TEST_DIR=${T_BENCH_TEST_DIR}" ]
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
    files = {
        "task.yaml": FULL,
        "docker-compose.yaml": COMPOSE,
        "solution.sh": "echo -n 5 > /app/five.txt\n",
        "test_weights.json": '{"test_five": 2, "test_other": 0.5, "wrong": "Hello", "below": -1}',
    }
    folder = write(tmp_path / "five", TERMINAL_BENCH, files)
    task = read_task(folder)
    verifier = Verifier(
        files={"/tests": folder / "tests", "/tests/run-tests.sh": folder / "run-tests.sh"},
        command=("bash", "/tests/run-tests.sh"),
        timeout_s=180.5,
        result="output",
        parser="swebench",
        env={"TEST_DIR": "/tests"},
        same_shell=True,
        weights={"test_five": 2.0, "test_other": 0.5},
    )
    solution = Solution({"/oracle/solution.sh": folder / "solution.sh"}, ("bash", "/oracle/solution.sh"))
    step = Step("", "Write 5 to /app/five.txt.", verifier, agent_timeout_s=900.0, solution=solution)
    assert task.steps == (step,)
    assert list(task.steps[0].verifier.files) == ["/tests", "/tests/run-tests.sh"], "a folder replaces all in it"
    assert task.environment == Environment(main=Container(context=folder, env={"TEST_DIR": "/tests"}))
    assert (task.name, task.folder, task.format) == ("five", folder, "terminal-bench")
    assert (task.difficulty, task.category, task.tags) == ("hard", "file-operations", ("files", "7"))
    assert [note.split("'")[1] for note in task.notes] == ["made", "wrong", "below"]


def test_defaults_are_the_formats(tmp_path: Path) -> None:
    """360 s for the agent, 60 s for the tests, pytest; a task without a Compose file is built from its Dockerfile."""
    yaml = "instruction: Go.\nmax_agent_timeout_sec:\ntags:\nparser_name:\n"  # an empty field has its default
    task = read_task(write(tmp_path / "t", TERMINAL_BENCH, {"task.yaml": yaml}))
    (step,) = task.steps
    assert (step.agent_timeout_s, step.verifier.timeout_s, step.verifier.parser) == (360.0, 60.0, "pytest")
    assert (step.verifier.same_shell, step.solution) == (False, None)
    assert task.environment.main == Container(context=tmp_path / "t", env={"TEST_DIR": "/tests"})
    assert (task.environment.network, task.notes, task.tags) == (None, (), ())


@pytest.mark.parametrize(
    ("yaml", "instruction"),
    [
        (b"descriptions:\n- {key: hard, description: Think.}\n- {key: base, description: Do.}\n", "Do."),
        (b"\xef\xbb\xbfinstruction: |-\r\n  One.\r\n  Two.\r\n", "One.\nTwo."),
    ],
    ids=["the oldest form", "line ends of Windows"],
)
def test_instructions_of_other_forms(tmp_path: Path, yaml: bytes, instruction: str) -> None:
    task = read_task(write(tmp_path / "t", TERMINAL_BENCH, {"task.yaml": yaml}))
    assert task.steps[0].instruction == instruction


def test_typed_solutions_keep_their_limits(tmp_path: Path) -> None:
    """``solution.yaml`` has lines with the seconds each may take; ``solution.sh`` comes before it."""
    typed = "- command: cd /app\n  max_timeout_sec: 5\n- command: make\n  min_timeout_sec: 200\n  block: true\n"
    folder = write(tmp_path / "t", TERMINAL_BENCH, {"solution.yaml": typed})
    assert read_task(folder).steps[0].solution == Solution(typed=(("cd /app", 5.0), ("make", 200.0)))


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("solution.yaml", "- command: vim x\n- command: Escape\n  append_enter: false\n"),
        ("Dockerfile", "FROM x\nCOPY . /app\n"),
        ("Dockerfile", "FROM x\n  add --chown=1 ./ /app\n"),
        ("run-tests.sh", "#!/bin/bash\r\ntrue\r\n"),
        ("docker-compose.yaml", "services: {agent: {build: ., user: worker}}\n"),
    ],
    ids=["keys without Enter", "the tests in the image", "added", "line ends of Windows", "another service's name"],
)
def test_what_is_passed_over_or_doubtful_is_noted(tmp_path: Path, file: str, text: str) -> None:
    """Keys cannot be told by lines, an agent can read what its image has; a single service is the agent's."""
    task = read_task(write(tmp_path / "t", TERMINAL_BENCH, {file: text}))
    assert [note.partition(":")[0] for note in task.notes] == [file]
    assert task.steps[0].solution is None
    assert task.environment.services == {}
