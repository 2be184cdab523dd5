"""What the tests of this plugin share."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from memory_backend import plain_task
from scripted import Script

from gem_terminal import TerminalEnv, episode, terminal_env

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Task

REAL = (
    "test_docker_files",
    "test_docker_images",
    "test_docker_machines",
    "test_docker_services",
    "test_docker_leftovers",
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


@pytest.fixture
def make(monkeypatch: pytest.MonkeyPatch, script: Script) -> Iterator[Callable[..., TerminalEnv]]:
    """Make environments on the memory backend; closing them leaves no machine."""
    made: list[TerminalEnv] = []

    def make(*tasks: Task, pool_size: int = 0, **options: Any) -> TerminalEnv:
        chosen = tasks or [plain_task(name) for name in ("one", "two", "three")]
        monkeypatch.setattr(terminal_env, "select_tasks", lambda *_: chosen)
        made.append(TerminalEnv("anywhere", backend=script.backend, pool_size=pool_size, **options))
        return made[-1]

    yield make
    for env in made:
        env.close()
    assert script.backend.live == {}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave them to ``make test-thorough``."""
    folder = Path(__file__).parent
    for item in items:
        if item.path.parent == folder and item.path.stem in REAL:
            item.add_marker(pytest.mark.thorough)
