"""``check_plugin`` on real distributions, each with something wrong."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from distributions import gem_in, install, python

WRONG = {
    "fine": "Every record has a summary. Seen: without one: tool fine_tool, ",
    "hook_raises": "It loads, and its hooks return records. Seen: ValueError: the first line and the second",
    "missing_module": "It loads, and its hooks return records. Seen: ModuleNotFoundError: ",
    "heavy_neighbour": "its entry point: there is no module 'gem_heavy_missing'",
    "heavy_import": "and nothing else. Seen: it imports numpy; import these in the module of the implementation",
    "prints": "It writes nothing to standard output. Seen: hello from a plugin",
    "wrong_kwargs": "Every entry point can be imported, and takes its arguments. Seen: wrong_kwargs:One-v0: ",
}


@pytest.mark.few(3)
@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_named(case: str, tmp_path: Path) -> None:
    """In an interpreter of its own, so that nothing that is loaded here hides it."""
    code = (
        "from gem_core.testing import CheckError, check_plugin\n"
        f"try:\n    print('kept', len(check_plugin('gem-{case.replace('_', '-')}')))\n"
        "except CheckError as error:\n    print(error)\n"
    )
    done = python(code, [install(case, tmp_path)])
    assert WRONG[case] in done.stdout, done.stdout + done.stderr


DANGLING = {
    "dangling:Typo-v0": "Did you mean 'MathEnv'?",  # and UnmetTypo, in the same line
    "dangling:NoModule-v0": "no module 'gem_dangling_envs'",
    "dangling:NoClass-v0": "'gem_dangling_env' has no 'Easy'",
    "dangling:Number-v0": "'gem_dangling_env:LIMIT' is a int",
    "dangling:NoEnv-v0": "does not derive from gymnasium.Env",
    "dangling:MissingImport-v0": "gem_dangling_import.py:4: ",
    "dangling:Deeper-v0": "gem_dangling_deeper.py:3: ",
    "dangling:Syntax-v0": "gem_dangling_syntax.py:3: ",
    "dangling:Raises-v0": "gem_dangling_raises.py:7: ",
    "dangling:Exits-v0": "SystemExit: 3",
    "dangling:Kwargs-v0": "'lenght'. Did you mean 'length'?",
    "tool dangling": "Did you mean 'make_tool'?",
    "tool dangling_class": "does not derive from gem_core.Tool",
    "tool dangling_status": "its status: ",
    "requirement dangling": "no RequirementStatus",
    "command dangling": "no click.Command",
    "command dangling_dies": "exit code 7",
}
"""Each record with something wrong, and what is said of it."""


def checked(case: str, site: Path) -> tuple[int, list[str]]:
    """Return the exit code of ``gem plugins --check`` and the problems that it names."""
    done = gem_in([site], "plugins", case, "--check", "--json")
    (plugin,) = json.loads(done.stdout)
    return done.returncode, plugin["problems"]


def test_every_entry_point_is_imported(tmp_path: Path) -> None:
    """What cannot be imported, or is something else, is named; what is fine, or needs what is not here, is not."""
    code, problems = checked("dangling", install("dangling", tmp_path))
    assert code == 1
    assert len(problems) == len(DANGLING)
    for (name, part), problem in zip(DANGLING.items(), problems, strict=True):
        assert problem.startswith(f"{name}: ")
        assert part in problem


def test_a_module_that_hangs_is_ended(tmp_path: Path) -> None:
    """It is named, and what comes after it is not tried."""
    code = (
        "from gem_core.registry.lookup import registry\nfrom gem_core.testing.plugin_check import inspect_plugin\n"
        "print(*inspect_plugin(registry().plugins_named('hangs')[0].entry_point, 5.0).problems(), sep='\\n')"
    )
    (problem,) = python(code, [install("hangs", tmp_path)]).stdout.splitlines()
    assert "no answer within 5 s" in problem
