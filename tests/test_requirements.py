"""What has to be there, and the advice when it is not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from gem_core.registry.requirements import unmet

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    ("requirement", "advice"),
    [
        ("key:GEMT_KEY", "it needs a key: set the environment variable GEMT_KEY"),
        ("package:gemt-none", "it needs the package gemt-none: 'pip install gemt-none'"),
        ("package:gemt.none.deep", "it needs the package gemt.none.deep: 'pip install gemt.none.deep'"),
        ("package:gemt-none[x]", "it needs an extra of gemt-none: 'pip install \"gemt-none[x]\"'"),
        ("package:gem-core[gemt]", "it needs an extra of gem-core: 'pip install \"gem-core[gemt]\"'"),
        ("command:gemt-none", "it needs the command 'gemt-none' on the PATH: install it"),
        ("never:its data were withdrawn", "its data were withdrawn"),
    ],
)
def test_unmet_requirement_has_advice(requirement: str, advice: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each kind of requirement says what to set, install or start."""
    monkeypatch.delenv("GEMT_KEY", raising=False)
    assert unmet([requirement]) == {requirement: advice}


@pytest.mark.parametrize(
    "requirement",
    [
        "key:GEMT_KEY",
        "package:pluggy",
        "package:typing-extensions",
        "package:gem-core",
        "package:gem-core[images]",
        "network",
        "hub",
        "other:x",
        "",
    ],
)
def test_met_and_untried_requirements_are_silent(requirement: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is there, and what is known only in use, gives no advice."""
    monkeypatch.setenv("GEMT_KEY", "secret")
    assert unmet([requirement]) == {}


def test_empty_key_is_unmet(monkeypatch: pytest.MonkeyPatch) -> None:
    """A variable that is set to nothing is no key."""
    monkeypatch.setenv("GEMT_KEY", "")
    assert list(unmet(["key:GEMT_KEY"])) == ["key:GEMT_KEY"]


def test_command_on_the_path_is_met(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A command is looked for on the PATH."""
    command = tmp_path / "gemt-command"
    command.write_text("")
    command.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert unmet(["command:gemt-command"]) == {}


def test_docker_host_meets_docker(monkeypatch: pytest.MonkeyPatch) -> None:
    """An engine elsewhere, named by DOCKER_HOST, is an engine."""
    monkeypatch.setenv("DOCKER_HOST", "tcp://engine:2375")
    assert unmet(["docker"]) == {}
