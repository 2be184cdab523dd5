"""A plugin for pytest: ``pytest --gem-envs 'mine:*'`` runs ``check_env`` on each environment that matches.

pytest imports this module at every start, so it imports nothing before the option is used.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import pytest

MARKER = "gem_envs"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options and their counterparts of the configuration file."""
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
    parser.addini("gem_envs", "Patterns as of --gem-envs, one on each line.", type="linelist", default=[])
    parser.addini("gem_skip", "Promises not to try as of --gem-skip, one on each line.", type="linelist", default=[])


def pytest_configure(config: pytest.Config) -> None:
    """Collect environments if the command line or the configuration file names any."""
    config.addinivalue_line("markers", f"{MARKER}: the check of an environment that --gem-envs asked for.")
    # The command line stands in for the file, as it does for pytest's own options.
    patterns = config.getoption("gem_envs") or config.getini("gem_envs")
    if patterns:
        skip = dict(_skipped([*config.getini("gem_skip"), *config.getoption("gem_skip")]))
        config.pluginmanager.register(_Collection(list(patterns), skip), "gem-collection")


def _skipped(entries: Iterable[str]) -> Iterator[tuple[str, str]]:
    for entry in entries:
        slug, equals, reason = (part.strip() for part in entry.partition("="))
        if not slug or not equals or not reason:
            raise pytest.UsageError(f"--gem-skip takes SLUG=REASON, not {entry!r}")
        yield slug, reason


class _Collection:
    """Adds one item for each environment after everything else that was collected."""

    def __init__(self, patterns: list[str], skip: dict[str, str]) -> None:
        self.patterns = patterns
        self.skip = skip

    @pytest.hookimpl(tryfirst=True)  # before -k and -m take away what does not match
    def pytest_collection_modifyitems(
        self, session: pytest.Session, config: pytest.Config, items: list[pytest.Item]
    ) -> None:
        """Look the ids up now that every conftest.py and test module may have registered its own."""
        from gem_core.errors import GemError

        ids: list[str] = []
        message = ""
        try:
            ids = _matching(self.patterns)
        except GemError as error:
            if not hasattr(config, "workerinput"):
                raise pytest.UsageError(f"--gem-envs: {error}") from None
            ids, message = (
                ["--gem-envs"],
                f"--gem-envs: {error}",
            )  # a usage error in a worker of xdist would read as a crash
        collector = _Environments.from_parent(session, name="gem-envs", nodeid="gem-envs")
        collector.items = [EnvItem.from_parent(collector, name=name, skip=self.skip, message=message) for name in ids]
        items.extend(session.genitems(collector))


def _matching(patterns: list[str]) -> list[str]:
    from gem_core.cli import matching

    found: dict[str, None] = {}
    for pattern in patterns:
        ids = [record.id for record in matching(pattern)]
        found.update(dict.fromkeys([pattern] if pattern in ids else ids))
    return list(found)


class _Environments(pytest.Collector):
    """What the items stand under."""

    items: list[pytest.Item]

    def collect(self) -> list[pytest.Item]:
        """Give the items."""
        return self.items


class EnvItem(pytest.Item):
    """The check of one environment, or a message with which it fails."""

    def __init__(self, *, skip: dict[str, str], message: str, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.skip = skip
        self.message = message
        self.add_marker(MARKER)

    def runtest(self) -> None:
        """Try every promise of the contract."""
        from gem_core.errors import MissingRequirementError
        from gem_core.testing.env_check import check_env

        if self.message:
            pytest.fail(self.message, pytrace=False)
        try:
            report = check_env(self.name, skip=self.skip)
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
