"""Variables that tasks take from their host: only those that are given, and an error for those that are missing."""

from __future__ import annotations

from pathlib import Path

import pytest
from task_writing import HARBOR, TERMINAL_BENCH, write

from gem_core.errors import ArgumentError
from gem_terminal.selecting import GivenVariables, read_tasks, select_tasks

TOML = '[environment.env]\nKEY = "${API_KEY}"\nMODEL = "${MODEL:-small}"\n[verifier.env]\nKEY = "${API_KEY}"\n'
COMPOSE = "services: {client: {build: ., environment: ['KEY=$API_KEY', 'MODEL=${MODEL:-small}']}}\n"


@pytest.fixture(params=["harbor", "terminal-bench"])
def folder(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A task that asks for a key, and for a model that has a default, in each format; this process has the key."""
    monkeypatch.setenv("API_KEY", "from the host")
    if request.param == "harbor":
        return write(tmp_path / "t", HARBOR, {"task.toml": TOML})
    return write(tmp_path / "t", TERMINAL_BENCH, {"docker-compose.yaml": COMPOSE})


@pytest.mark.parametrize(
    ("given", "key", "model"),
    [
        ({"API_KEY": "k"}, "k", "small"),
        ({"API_KEY": "k", "MODEL": 5}, "k", "5"),
        (["API_KEY=a=b", "MODEL="], "a=b", ""),
        (["API_KEY"], "from the host", "small"),
        ("API_KEY", "from the host", "small"),
    ],
)
def test_a_task_gets_what_is_given(folder: Path, given: GivenVariables, key: str, model: str) -> None:
    """By name and value, or by the name alone for the value in the environment of this process."""
    (task,) = select_tasks(folder, variables=given)
    # An empty value counts as none with ``:-`` in Compose files, as it does there.
    expected = model or ("small" if task.format == "terminal-bench" else "")
    assert (task.environment.main.env["KEY"], task.environment.main.env["MODEL"]) == (key, expected)
    assert task.variables == {"API_KEY": None, "MODEL": "small"}
    assert task.environment.unsupported == ()


def test_a_missing_variable_is_an_error_that_names_the_ways_to_give_it(folder: Path) -> None:
    """Of make too, before anything is built; the value that this process has gets nowhere."""
    where = "task.toml, 'environment.env.KEY'" if (folder / "task.toml").exists() else "docker-compose.yaml"
    with pytest.raises(ArgumentError) as raised:
        select_tasks(folder)
    ways = (where, "variables={'API_KEY': '…'}", "variables=['API_KEY']", "--variable API_KEY=…", "--set 'variables=")
    assert [words for words in ways if words not in str(raised.value)] == []
    (task,) = read_tasks(folder).tasks
    assert task.environment.unsupported == (f"{where}: a value of the variable 'API_KEY', which variables= gives",)
    assert "from the host" not in repr(task)


def test_only_the_tasks_that_are_chosen_need_their_variables(folder: Path) -> None:
    """Of a set, the others may lack them; those that lack one are counted."""
    write(folder.parent / "other", HARBOR)
    assert [task.name for task in select_tasks(folder.parent, "other")] == ["other"]
    with pytest.raises(ArgumentError, match="the task 't' needs variables"):
        select_tasks(folder.parent)
    write(folder.parent / "more", HARBOR, {"task.toml": TOML})
    with pytest.raises(ArgumentError, match="2 of 3 tasks need variables"):
        select_tasks(folder.parent)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"API_KEI": "k"}, "Did you mean 'API_KEY'?"),
        (["NOT_THERE"], "'NOT_THERE' is not in the environment"),
        ({"API_KEY": ["k"]}, r"'API_KEY' is \['k'\]"),
    ],
)
def test_a_variable_that_cannot_be_given_is_an_error(folder: Path, given: GivenVariables, message: str) -> None:
    """One that no task asks for, that is not there, or that is no text."""
    with pytest.raises(ArgumentError, match=message):
        select_tasks(folder, variables=given)
