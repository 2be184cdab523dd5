"""``check_plugin`` on real distributions, each with something wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
from distributions import install, python

WRONG = {
    "fine": "Every record has a summary. Seen: without one: tool fine_tool, ",
    "hook_raises": "It loads, and its hooks return records. Seen: ValueError: the first line and the second",
    "missing_module": "It loads, and its hooks return records. Seen: ModuleNotFoundError: ",
    "heavy_neighbour": "and takes its arguments. Seen: heavy:One-v0: EntryPointError",
    "heavy_import": "and nothing else. Seen: it imports numpy; import these in the module of the implementation",
    "prints": "It writes nothing to standard output. Seen: hello from a plugin",
    "wrong_kwargs": "Every entry point can be imported, and takes its arguments. Seen: kwargs:One-v0: ArgumentError",
}


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
