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
    """A broken promise, or an id that there is not, fails without a traceback; what cannot run here is skipped."""
    skip = "--gem-skip", "hostile-actions=tried elsewhere"
    patterns = "fit:*", "ill:Bad-v0", "far:*", "fit:Goood-v0"
    result = folder.runpytest_subprocess(*(f"--gem-envs={each}" for each in patterns), *skip, "-v", "-rs", "-rP")
    result.assert_outcomes(passed=2, failed=2, skipped=1)
    result.stdout.fnmatch_lines(["*gem-envs::fit:Good-v0 PASSED*", "*gem-envs::far:Away-v0 SKIPPED*"])
    result.stdout.fnmatch_lines(["ill:Bad-v0 breaks * promises:", "  episode: *To mend it: *"])
    result.stdout.fnmatch_lines(["no environment 'fit:Goood-v0'. Did you mean 'fit:Good-v0'*"])
    result.stdout.fnmatch_lines(["*not tried, hostile-actions: tried elsewhere"])
    result.stdout.no_fnmatch_line("*Traceback*")


@pytest.mark.thorough
def test_it_works_with_xdist_and_selections(folder: pytest.Pytester) -> None:
    """Every worker collects the same items; by -k, and by -m beside tests of other kinds."""
    pytest.importorskip("xdist")
    folder.makepyfile("def test_other(): pass")
    selection = "--gem-envs", "fit", "-n", "2"
    folder.runpytest_subprocess(*selection, "-k", "Other-v0").assert_outcomes(passed=1)
    folder.runpytest_subprocess(*selection, "-m", "gem_envs").assert_outcomes(passed=2)


def test_skip_without_a_reason_is_a_usage_error(folder: pytest.Pytester) -> None:
    """A reason is what the next reader needs."""
    result = folder.runpytest_subprocess("--gem-envs", "fit", "--gem-skip", "hostile-actions")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["ERROR: --gem-skip takes SLUG=REASON, not 'hostile-actions'"])


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
