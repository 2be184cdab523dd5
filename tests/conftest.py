"""Registers small environments for every test of the core; offers an empty registry and terminals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import toys
import vector_envs
from command_calls import Outcome, RunGem
from distributions import install
from in_terminal import InTerminal

from gem_core.cli import main
from gem_core.registry import lookup as registry
from gem_core.registry import plugins
from gem_core.registry.specs import NamedSpec

toys.register_toys()
vector_envs.register_vector_envs()


@pytest.fixture
def own_registry(monkeypatch: pytest.MonkeyPatch) -> registry.Registry:
    """A registry that holds only what the core offers and what a test registers."""
    fresh = registry.Registry()
    monkeypatch.setattr(plugins, "find_plugins", list)
    monkeypatch.setattr(registry, "_registry", fresh)
    return fresh


@pytest.fixture
def offer(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Add records of tools, wrappers and requirements to the registry, as a plugin would, for one test."""

    def add(*records: NamedSpec) -> None:
        found = registry.registry()
        found.load()
        for record in records:
            space = "requirement" if record.kind == "requirement" else "wrapper"
            monkeypatch.setitem(found._spaces[space], record.name, record)

    return add


@pytest.fixture(scope="session")
def toolbox_site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which a third party's distribution of tools is installed."""
    return install("toolbox", tmp_path_factory.mktemp("toolbox"))


@pytest.fixture
def toolbox(toolbox_site: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make that distribution visible to this process, and load the plugins anew."""
    monkeypatch.syspath_prepend(toolbox_site)
    monkeypatch.setattr(registry, "_registry", registry.Registry())
    toys.register_toys()
    return toolbox_site


@pytest.fixture
def run_gem(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RunGem:
    """Call the command in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> Outcome:
        with pytest.raises(SystemExit) as caught:
            main(arguments)
        captured = capsys.readouterr()
        return Outcome(int(caught.value.code or 0), captured.out, captured.err)

    return call


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Callable[..., InTerminal]]:
    """Start the command in a terminal of its own; it is ended with the test."""
    started: list[InTerminal] = []

    def start(*arguments: str, **env: str) -> InTerminal:
        started.append(InTerminal(list(arguments), tmp_path, **env))
        return started[-1]

    yield start
    for each in started:
        each.close()
