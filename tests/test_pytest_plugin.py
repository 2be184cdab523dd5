"""``pytest --gem-envs``, in a pytest of its own."""

from __future__ import annotations

import pytest

pytest_plugins = ["pytester"]

CONFTEST = """
import sys
sys.path.insert(0, {tests!r})
import gem_core as gem
from gem_core.types import TERMINAL_STATE

class Good(gem.Env):
    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.number = int(self.np_random.integers(10))
        return f"Say {{self.number}}.", {{}}

    def step(self, action):
        return TERMINAL_STATE, float(action == str(self.number)), True, False, {{}}

    def sample_random_action(self):
        return str(int(self.action_random.integers(10)))


class Bad(Good):
    def step(self, action):
        return TERMINAL_STATE, float(int(action)), True, False, {{}}

gem.register("fit:Good-v0", Good)
gem.register("fit:Other-v0", Good)
gem.register("ill:Bad-v0", Bad)
gem.register("far:Away-v0", Good, requires=("key:GEMT_NOT_SET",))
"""


@pytest.fixture
def folder(pytester: pytest.Pytester, request: pytest.FixtureRequest) -> pytest.Pytester:
    """A folder whose conftest registers four environments, under warnings as errors and a strict configuration."""
    pytester.makeconftest(CONFTEST.format(tests=str(request.config.rootpath / "tests")))
    pytester.makeini("[pytest]\naddopts = --strict-markers --strict-config\nfilterwarnings = error\n")
    return pytester


def test_each_match_is_an_item_that_runs_check_env(folder: pytest.Pytester) -> None:
    """By a glob; without any file of tests."""
    result = folder.runpytest_subprocess("--gem-envs", "fit:*", "-v")
    result.assert_outcomes(passed=2)
    result.stdout.fnmatch_lines(["*gem-envs::fit:Good-v0 PASSED*", "*gem-envs::fit:Other-v0 PASSED*"])


def test_failure_is_the_broken_promises_without_a_traceback(folder: pytest.Pytester) -> None:
    """What check_env says, and no more."""
    result = folder.runpytest_subprocess("--gem-envs", "ill:Bad-v0")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["collected 1 item", "ill:Bad-v0 breaks * promises:", "  episode: *To mend it: *"])
    result.stdout.no_fnmatch_line("*Traceback*")
    result.stdout.no_fnmatch_line("*pytest_plugin.py*")


@pytest.mark.thorough
def test_items_are_selected_by_id_and_by_marker(folder: pytest.Pytester) -> None:
    """By -k, and by -m beside tests of other kinds."""
    folder.makepyfile("def test_other(): pass")
    folder.runpytest_subprocess("--gem-envs", "fit", "-k", "Other-v0").assert_outcomes(passed=1, deselected=2)
    folder.runpytest_subprocess("--gem-envs", "fit", "-m", "gem_envs").assert_outcomes(passed=2, deselected=1)


def test_unknown_pattern_is_a_usage_error_with_the_nearest(folder: pytest.Pytester) -> None:
    """Exit code 4, one line."""
    result = folder.runpytest_subprocess("--gem-envs", "fit:Goood-v0")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(
        ["ERROR: --gem-envs: no environment matches 'fit:Goood-v0'. Did you mean 'fit:Good-v0'*"]
    )


@pytest.mark.thorough
def test_unmet_requirement_is_a_skip_with_its_reason(folder: pytest.Pytester) -> None:
    """A machine without the key has not broken anything."""
    result = folder.runpytest_subprocess("--gem-envs", "far:*", "-rs")
    result.assert_outcomes(skipped=1)
    result.stdout.fnmatch_lines(
        ["*far:Away-v0 cannot run here: it needs a key: set the environment variable GEMT_NOT_SET*"]
    )


@pytest.mark.thorough
def test_patterns_may_stand_in_the_configuration(folder: pytest.Pytester) -> None:
    """The command line stands in for them where it gives its own."""
    folder.makeini("[pytest]\ngem_envs =\n    fit:Good-v0\n    far:*\n")
    folder.runpytest_subprocess().assert_outcomes(passed=1, skipped=1)
    folder.runpytest_subprocess("--gem-envs", "fit:Other-v0").assert_outcomes(passed=1)


@pytest.mark.thorough
def test_promise_is_skipped_with_a_reason(folder: pytest.Pytester) -> None:
    """By its slug; a slug that does not exist fails each item with the nearest."""
    skip = "hostile-actions=tried elsewhere"
    result = folder.runpytest_subprocess("--gem-envs", "fit:Good-v0", "--gem-skip", skip, "-rP")
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["*not tried, hostile-actions: tried elsewhere"])
    result = folder.runpytest_subprocess("--gem-envs", "fit:Good-v0", "--gem-skip", "hostile-action=x")
    result.stdout.fnmatch_lines(["no promise 'hostile-action'. Did you mean 'hostile-actions'?*"])
    result.assert_outcomes(failed=1)


def test_skip_without_a_reason_is_a_usage_error(folder: pytest.Pytester) -> None:
    """A reason is what the next reader needs."""
    result = folder.runpytest_subprocess("--gem-envs", "fit", "--gem-skip", "hostile-actions")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["ERROR: --gem-skip takes SLUG=REASON, not 'hostile-actions'"])


@pytest.mark.thorough
def test_it_works_with_xdist(folder: pytest.Pytester) -> None:
    """Every worker collects the same items; an unknown pattern is a failure that says so."""
    pytest.importorskip("xdist")
    folder.runpytest_subprocess("--gem-envs", "fit:*", "--gem-envs", "far:*", "-n", "2").assert_outcomes(
        passed=2, skipped=1
    )
    result = folder.runpytest_subprocess("--gem-envs", "fti:*", "-n", "2")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["--gem-envs: no environment matches 'fti:*"])


def test_it_costs_nothing_while_it_is_not_used(folder: pytest.Pytester) -> None:
    """Neither a package that is heavy, nor an item."""
    folder.makeconftest("")
    folder.makepyfile(
        "import sys\n"
        "def test_modules():\n"
        "    heavy = {'gymnasium', 'numpy', 'pydantic', 'click', 'gem_core.registry.lookup', 'gem_core.errors'}\n"
        "    assert heavy & set(sys.modules) == set()\n"
        "    assert 'gem_core.testing.pytest_plugin' in sys.modules\n"
    )
    folder.runpytest_subprocess("-p", "no:hypothesispytest").assert_outcomes(passed=1)
