"""What holds for all tests: what a quick run leaves out, and Ctrl-C in the programs that they start."""

from __future__ import annotations

import signal

import pytest
from hypothesis import settings

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts what runs in the background so, as many CI systems do; and programs inherit it.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--thorough``."""
    parser.addoption("--thorough", action="store_true", help="run all tests: whole matrices, and all that takes long")


def pytest_configure(config: pytest.Config) -> None:
    """Say how many examples hypothesis tries; how long one takes is a matter of the machine, and never a failure."""
    examples = 300 if config.getoption("--thorough") else 25
    settings.register_profile("gem", deadline=None, max_examples=examples)
    settings.load_profile("gem")


@pytest.fixture(scope="session")
def many(request: pytest.FixtureRequest) -> int:
    """How often to repeat what is tried with many seeds."""
    return 1_000 if request.config.getoption("--thorough") else 20


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is marked ``thorough``, and of what is marked ``few(n)`` all but n cases."""
    if config.getoption("--thorough"):
        return
    cases: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("few"):
            cases.setdefault(item.nodeid.partition("[")[0], []).append(item)
    left_out = {item for item in items if item.get_closest_marker("thorough")}
    for same in cases.values():
        marker = same[0].get_closest_marker("few")
        most = marker.args[0] if marker else 0
        # Spread over the matrix, whose last parameter varies fastest.
        left_out |= set(same) - {same[place * len(same) // most] for place in range(most)}
    config.hook.pytest_deselected(items=[item for item in items if item in left_out])
    items[:] = [item for item in items if item not in left_out]
