"""A plugin for pytest: ``pytest --gem-envs 'mine:*'`` runs ``check_env`` on each environment that matches.

pytest imports this module at every start, so it imports nothing before the option is used.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import pytest

MARKER = "gem_envs"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options; ``addopts`` of the configuration file may hold them."""
    group = parser.getgroup("gem", "environments of GEM")
    group.addoption(
        "--gem-envs",
        action="append",
        default=[],
        metavar="PATTERN",
        help="Run check_env on each environment that matches: an id, a namespace, or a glob such as 'mine:*'. "
        "Can be repeated; select by '-m gem_envs' or '-k ID'.",
    )
    group.addoption(
        "--gem-skip",
        action="append",
        default=[],
        metavar="SLUG=REASON",
        help="Do not try one promise of the contract, for this reason. Can be repeated.",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Name the marker, and refuse a promise that is skipped without a reason."""
    config.addinivalue_line("markers", f"{MARKER}: the check of an environment that --gem-envs asked for.")
    dict(_skipped(config))


def _skipped(config: pytest.Config) -> Iterator[tuple[str, str]]:
    for entry in config.getoption("gem_skip"):
        slug, _, reason = (part.strip() for part in entry.partition("="))
        if not slug or not reason:
            raise pytest.UsageError(f"--gem-skip takes SLUG=REASON, not {entry!r}")
        yield slug, reason


@pytest.hookimpl(tryfirst=True)  # before -k and -m take away what does not match
def pytest_collection_modifyitems(session: pytest.Session, config: pytest.Config, items: list[pytest.Item]) -> None:
    """Look the ids up now that every conftest.py and test module may have registered its own."""
    patterns = config.getoption("gem_envs")
    if patterns:
        items.extend(session.genitems(_Environments.from_parent(session, name="gem-envs", nodeid="gem-envs")))


class _Environments(pytest.Collector):
    """What the items stand under."""

    def collect(self) -> Iterable[pytest.Item]:
        """Give an item for each environment that matches, and for each pattern that matches none."""
        from gem_core.cli import matching
        from gem_core.errors import GemError

        names: dict[str, None] = {}
        for pattern in self.config.getoption("gem_envs"):
            try:
                ids = [record.id for record in matching(pattern)]
            except GemError:  # the check of this id says so
                ids = [pattern]
            names.update(dict.fromkeys([pattern] if pattern in ids else ids))
        return [EnvItem.from_parent(self, name=name) for name in names]


class EnvItem(pytest.Item):
    """The check of one environment."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.add_marker(MARKER)

    def runtest(self) -> None:
        """Try every promise of the contract."""
        from gem_core.errors import MissingRequirementError
        from gem_core.testing import check_env

        try:
            report = check_env(self.name, skip=dict(_skipped(self.config)))
        except MissingRequirementError as error:
            pytest.skip(str(error))
        self.add_report_section("call", "gem", str(report))

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """Show the broken promises alone: a traceback through the check says nothing more."""
        from gem_core.errors import GemError

        if isinstance(excinfo.value, GemError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Any, int | None, str]:
        """Name the item in the summary."""
        return self.config.rootpath, None, f"check_env({self.name!r})"
