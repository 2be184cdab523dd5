"""What the tests of this plugin share."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from scripted import Script

from gem_terminal import episode

# How long an example takes is a matter of the machine, and of what else runs on it.
settings.register_profile("gem", deadline=None)
settings.load_profile("gem")

REAL = (
    "test_docker_held_up",
    "test_docker_leftovers",
    "test_docker_machines",
    "test_docker_services",
    "test_local_endings",
    "test_shell_keys",
    "test_shell_limits",
    "test_terminal_command",
    "test_terminal_real",
)
"""Files of tests on real machines, which take long."""


@pytest.fixture
def short_path() -> Iterator[Path]:
    """Give a folder for UNIX sockets, whose paths may have about a hundred bytes: TMPDIR may be longer, as on macOS."""
    with tempfile.TemporaryDirectory(prefix="gem-", dir="/tmp") as folder:
        yield Path(folder)


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Script:
    """What happens in the machines of a test."""
    script = Script()
    monkeypatch.setattr(episode, "Shell", script.shell)
    monkeypatch.setattr(episode, "verify", script.verify)
    return script


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave them to ``make test-thorough``."""
    folder = Path(__file__).parent
    for item in items:
        if item.path.parent == folder and item.path.stem in REAL:
            item.add_marker(pytest.mark.thorough)
