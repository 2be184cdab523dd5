"""A task that cannot be read is an error that names file and field, what was found, and what was expected."""

from __future__ import annotations

from pathlib import Path

import pytest
from task_writing import HARBOR, TERMINAL_BENCH, read_task, write

from gem_terminal.errors import TaskError

HARBORS = [
    ("task.toml", "= 1", "no valid TOML"),
    ("instruction.md", None, "is missing"),
    ("instruction.md", "\n", "is empty"),
    ("tests/test.sh", None, "is missing"),
    ("environment/Dockerfile", None, "is missing"),
    ("task.toml", '[verifier]\ntimeout_sec = "soon"\n', "'verifier.timeout_sec' is 'soon'"),
    ("task.toml", '[environment]\nmemory = "much"\n', "'environment.memory' is 'much'"),
    ("task.toml", '[environment]\nallowed_hosts = ["x"]\n', "network_mode = 'allowlist'"),
    ("task.toml", '[[steps]]\nname = "../x"\n', "'steps.0.name' is '../x'"),
    ("task.toml", '[[steps]]\nname = "a"\n[[steps]]\nname = "A"\n', "'steps' has 'a' twice"),
    ("task.toml", 'artifacts = ["/a/../b"]\nverifier.environment_mode = "separate"\n', "'artifacts' has '/a/../b'"),
    ("task.toml", '[environment.env]\n"A=B" = "1"\n', "name of a variable"),
]
BENCHES = [
    ("task.yaml", "", "has None"),
    ("task.yaml", "difficulty: easy\n", "'instruction' is missing"),
    ("task.yaml", "instruction: ' '\n", "'instruction' is empty"),
    ("task.yaml", "instruction: x\nmax_agent_timeout_sec: soon\nmax_test_timeout_sec: 0\n", "wrong beside it: 1."),
    ("task.yaml", "instruction: x\nmax_test_timeout_sec: .inf\n", "'max_test_timeout_sec' is 'inf'"),
    ("task.yaml", "instruction: x\nparser_name: mine\n", "'parser_name' is 'mine'"),
    ("run-tests.sh", None, "is missing"),
    ("Dockerfile", None, "is missing"),
    ("test_weights.json", "[1]", "has [1]"),
    ("docker-compose.yaml", "services: {web: {image: x}, db: {image: y}}\n", "named 'client'"),
    ("docker-compose.yaml", "services: [", "no valid YAML"),
    ("docker-compose.yaml", "version: '3'", "'services' is missing"),
    ("docker-compose.yaml", "services: &a {client: *a}", "nested too deeply"),
    ("docker-compose.yaml", "services: {client: {}, other: {}}", "'services.other.build' is missing"),
    ("docker-compose.yaml", "services: {'a b': {build: .}}", "'services.a b.[key]' is 'a b'"),
    (
        "docker-compose.yaml",
        "services: {client: {build: .}, a: {image: a, depends_on: [b]}, b: {image: b, depends_on: [a]}}",
        "among a, b",
    ),
]
SERVICES = {
    "environment: 5": "'services.client.environment' is '5'",
    'command: "it\'s"': "'services.client.command' is",
    "mem_limit: lots": "'services.client.mem_limit' is 'lots'",
    "healthcheck: {test: x, interval: soon}": "healthcheck.interval' is 'soon'",
    "healthcheck: {test: [true]}": "'services.client.healthcheck.test' is ['true']",
    "env_file: ../../.env": "outside the task folder",
    "depends_on: [x]": "'services.client.depends_on' names 'x'",
    "volumes: ['a:b:c:d']": "'services.client.volumes.0' is 'a:b:c:d'",
    "volumes: ['a:b']": "an absolute path",
    "user: '$'": "'$$' for a dollar sign",
    "user: '${A'": "'${A' has no closing brace",
    "build: nowhere": "'services.client.build.context' is 'nowhere'",
    f"build: {'x' * 5000}": f"'services.client.build.context' is '{'x' * 100}'",
    "build: {dockerfile: Other}": "'services.client.build.dockerfile' is 'Other'",
    "build: ..": "outside the task folder",
    "build: 'https://x.org/y.git'": "a path inside the task folder",
}


def client(text: str, _: str) -> str:
    """Return a Compose file whose one service says this."""
    return f"services: {{client: {{{text if 'build:' in text else f'build: ., {text}'}}}}}"


@pytest.mark.parametrize(
    ("base", "file", "text", "problem"),
    [
        *((HARBOR, *row) for row in HARBORS),
        *((TERMINAL_BENCH, *row) for row in BENCHES),
        *((TERMINAL_BENCH, "docker-compose.yaml", client(*row), row[1]) for row in SERVICES.items()),
    ],
)
def test_an_error_names_file_and_field(tmp_path: Path, base: dict, file: str, text: str | None, problem: str) -> None:
    """With the folder; and what was expected."""
    if text in SERVICES:
        text = (
            f"services: {{client: {{build: ., {text}}}}}"
            if "build" not in text
            else f"services: {{client: {{{text}}}}}"
        )
    folder = write(tmp_path / "t", base, {file: text})
    with pytest.raises(TaskError) as raised:
        read_task(folder)
    assert str(raised.value).startswith(f"{folder}/{file}: ")
    assert problem in str(raised.value)


def test_a_file_of_variables_is_named_with_its_line(tmp_path: Path) -> None:
    """And not the Compose file that names it."""
    compose = "services: {client: {build: ., env_file: run-tests.sh}}"
    with pytest.raises(TaskError, match=r"run-tests\.sh: line 2 "):
        read_task(write(tmp_path, TERMINAL_BENCH, {"docker-compose.yaml": compose}))
