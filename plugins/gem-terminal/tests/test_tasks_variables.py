"""Variables that tasks take from their host: only those that are given, and an error for those that are missing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from task_writing import HARBOR, TERMINAL_BENCH, write

from gem_core.errors import ArgumentError
from gem_terminal.selecting import read_tasks, select_tasks

TOML = '[environment.env]\nKEY = "${API_KEY}"\nMODEL = "${MODEL:-small}"\n[verifier.env]\nKEY = "${API_KEY}"\n'
COMPOSE = "services: {client: {build: ., environment: ['KEY=$API_KEY', 'MODEL=${MODEL:-small}']}}\n"


@pytest.fixture(params=[(HARBOR, "task.toml", TOML), (TERMINAL_BENCH, "docker-compose.yaml", COMPOSE)], ids=str)
def folder(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A task that asks for a key, and for a model that has a default, in each format; this process has the key."""
    monkeypatch.setenv("API_KEY", "from the host")
    base, file, text = request.param
    return write(tmp_path / "t", base, {file: text})


@pytest.mark.parametrize(
    ("given", "key", "model"),
    [
        ({"API_KEY": "k"}, "k", "small"),
        ({"API_KEY": "k", "MODEL": 5}, "k", "5"),
        (["API_KEY=a=b", "MODEL="], "a=b", ""),
        ("API_KEY", "from the host", "small"),
    ],
)
def test_a_task_gets_what_is_given(folder: Path, given: Any, key: str, model: str) -> None:
    """By name and value, or by the name alone for the value in the environment of this process."""
    (task,) = select_tasks(folder, variables=given)
    # An empty value counts as none with ``:-`` in Compose files, as it does there.
    expected = model or ("small" if task.format == "terminal-bench" else "")
    assert (task.environment.main.env["KEY"], task.environment.main.env["MODEL"]) == (key, expected)
    assert (task.variables, task.environment.unsupported) == ({"API_KEY": None, "MODEL": "small"}, ())


def test_a_missing_variable_is_an_error_that_names_the_ways_to_give_it(folder: Path) -> None:
    """Of the tasks that are chosen alone; the value that this process has gets nowhere."""
    with pytest.raises(ArgumentError) as raised:
        select_tasks(folder)
    ways = ("variables={'API_KEY': '…'}", "variables=['API_KEY']", "--variable API_KEY=…", "--set 'variables=")
    assert [words for words in ways if words not in str(raised.value)] == []
    (task,) = read_tasks(folder).tasks
    assert "'API_KEY'" in task.environment.unsupported[0]
    assert "from the host" not in repr(task)
    for name, asks, count in (("other", "", "the task 't'"), ("more", TOML, "2 of 3 tasks")):
        write(folder.parent / name, HARBOR, {"task.toml": asks})
        assert [task.name for task in select_tasks(folder.parent, "other")] == ["other"]
        with pytest.raises(ArgumentError, match=count):
            select_tasks(folder.parent)


@pytest.mark.parametrize(
    ("given", "message"),
    [({"API_KEI": "k"}, "'API_KEY'"), (["NOT_THERE"], "'NOT_THERE'"), ({"API_KEY": ["k"]}, r"is \['k'\]")],
)
def test_a_variable_that_cannot_be_given_is_an_error(folder: Path, given: Any, message: str) -> None:
    """One that no task asks for, that is not there, or that is no text."""
    with pytest.raises(ArgumentError, match=message):
        select_tasks(folder, variables=given)
