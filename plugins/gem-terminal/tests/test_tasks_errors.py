"""A task that cannot be read is an error that names file and field, what was found, and what was expected."""

from __future__ import annotations

from pathlib import Path

import pytest
from task_writing import HARBOR, TERMINAL_BENCH, read_task, write

from gem_terminal.errors import TaskError

Files = dict[str, str | None]

SEPARATE = '\n[verifier]\nenvironment_mode = "separate"\n'
HARBORS: list[tuple[Files, str]] = [
    ({"task.toml": "= 1"}, "task.toml: is no valid TOML"),
    ({"instruction.md": None}, "instruction.md: the file is missing"),
    ({"instruction.md": "\n"}, "instruction.md: the file is empty"),
    ({"tests/test.sh": None}, "tests/test.sh: the file is missing"),
    ({"environment/Dockerfile": None}, "environment/Dockerfile: the file is missing"),
    ({"task.toml": '[verifier]\ntimeout_sec = "soon"\n'}, "task.toml: 'verifier.timeout_sec' is 'soon'"),
    ({"task.toml": '[environment]\nmemory = "much"\n'}, "task.toml: 'environment.memory' is 'much'"),
    ({"task.toml": '[environment]\nallowed_hosts = ["x"]\n'}, "expected network_mode = 'allowlist'"),
    ({"task.toml": '[[steps]]\nname = "../x"\n'}, "task.toml: 'steps.0.name' is '../x'"),
    ({"task.toml": '[[steps]]\nname = "a"\n[[steps]]\nname = "A"\n'}, "task.toml: 'steps' has 'a' twice"),
    ({"task.toml": f'artifacts = ["/a/../b"]{SEPARATE}'}, "task.toml: 'artifacts' has '/a/../b'"),
    ({"task.toml": '[environment.env]\n"A=B" = "1"\n'}, "expected the name of a variable"),
]
TERMINAL_BENCHES: list[tuple[Files, str]] = [
    ({"task.yaml": ""}, "task.yaml: has None"),
    ({"task.yaml": "difficulty: easy\n"}, "task.yaml: the field 'instruction' is missing"),
    ({"task.yaml": "instruction: ' '\n"}, "task.yaml: 'instruction' is empty"),
    ({"task.yaml": "instruction: 5\n"}, "task.yaml: 'instruction' is 5"),
    ({"task.yaml": "instruction: x\nmax_agent_timeout_sec: soon\nmax_test_timeout_sec: 0\n"}, "wrong beside it: 1."),
    ({"task.yaml": "instruction: x\nmax_test_timeout_sec: .inf\n"}, "task.yaml: 'max_test_timeout_sec' is 'inf'"),
    ({"task.yaml": "instruction: x\nparser_name: mine\n"}, "task.yaml: 'parser_name' is 'mine'"),
    ({"run-tests.sh": None}, "run-tests.sh: the file is missing"),
    ({"Dockerfile": None}, "Dockerfile: the file is missing"),
    ({"test_weights.json": "[1]"}, "test_weights.json: has [1]"),
    ({"docker-compose.yaml": "services: {web: {image: x}, db: {image: y}}\n"}, "expected one named 'client'"),
]
COMPOSES = {
    "services: [": "is no valid YAML",
    "version: '3'": "the field 'services' is missing",
    "services: {client: {build: ., environment: 5}}": "'services.client.environment' is '5'",
    'services: {client: {build: ., command: "it\'s"}}': "'services.client.command' is",
    "services: {client: {build: ., mem_limit: lots}}": "'services.client.mem_limit' is 'lots'",
    "services: {client: {build: ., healthcheck: {test: x, interval: soon}}}": "healthcheck.interval' is 'soon'",
    "services: {client: {build: ., healthcheck: {test: [true]}}}": "'services.client.healthcheck.test' is ['true']",
    "services: {client: {build: nowhere}}": "'services.client.build.context' is 'nowhere'",
    f"services: {{client: {{build: {'x' * 5000}}}}}": f"'services.client.build.context' is '{'x' * 100}'",
    "services: {client: {build: {dockerfile: Other}}}": "'services.client.build.dockerfile' is 'Other'",
    "services: {client: {build: ..}}": "which is outside the task folder",
    "services: {client: {build: /etc}}": "which is outside the task folder",
    "services: {client: {build: 'https://x.org/y.git'}}": "expected a path inside the task folder",
    "services: {client: {build: ., env_file: ../../.env}}": "which is outside the task folder",
    "services: {client: {build: ., depends_on: [x]}}": "'services.client.depends_on' names 'x'",
    "services: {client: {build: .}, a: {image: a, depends_on: [b]}, b: {image: b, depends_on: [a]}}": "among a, b",
    "services: {client: {}, other: {}}": "'services.other.build' is missing",
    "services: {client: {build: ., volumes: ['a:b:c:d']}}": "'services.client.volumes.0' is 'a:b:c:d'",
    "services: {client: {build: ., volumes: ['a:b']}}": "expected an absolute path",
    "services: {client: {build: ., user: '$'}}": "write '$$' for a dollar sign",
    "services: {client: {build: ., user: '${A'}}": "'${A' has no closing brace",
    "services: {'a b': {build: .}}": "'services.a b.[key]' is 'a b'",
    "services: &a {client: *a}": "is nested too deeply",
}


@pytest.mark.parametrize(
    ("base", "files", "problem"),
    [
        *((HARBOR, files, problem) for files, problem in HARBORS),
        *((TERMINAL_BENCH, files, problem) for files, problem in TERMINAL_BENCHES),
        *((TERMINAL_BENCH, {"docker-compose.yaml": text}, problem) for text, problem in COMPOSES.items()),
    ],
)
def test_an_error_names_file_and_field(tmp_path: Path, base: Files, files: Files, problem: str) -> None:
    """With the folder; and what was expected."""
    folder = write(tmp_path / "t", base, files)
    with pytest.raises(TaskError) as raised:
        read_task(folder)
    message = str(raised.value)
    assert message.startswith(f"{folder}/{next(iter(files))}: ")
    assert problem in message


def test_a_file_of_variables_is_named_with_its_line(tmp_path: Path) -> None:
    """And not the Compose file that names it."""
    compose = "services: {client: {build: ., env_file: run-tests.sh}}"
    with pytest.raises(TaskError, match=r"run-tests\.sh: line 2 is .*; expected NAME=value"):
        read_task(write(tmp_path, TERMINAL_BENCH, {"docker-compose.yaml": compose}))
