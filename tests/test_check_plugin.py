"""``check_plugin`` on real distributions, each with something wrong."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from distributions import install, python

WRONG = {
    "fine": "Every record has a summary. Seen: without one: tool fine_tool, ",
    "hook_raises": "It loads, and its hooks return records. Seen: ValueError: the first line and the second",
    "missing_module": "It loads, and its hooks return records. Seen: ModuleNotFoundError: ",
    "heavy_neighbour": "gem_heavy_neighbour.py:9: its entry point: there is no module 'gem_heavy_missing'",
    "heavy_import": "and nothing else. Seen: it imports numpy; import these in the module of the implementation",
    "prints": "It writes nothing to standard output. Seen: hello from a plugin",
    "wrong_kwargs": "Every entry point can be imported, and takes its arguments. Seen: kwargs:One-v0: ",
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


MAT_ENV = "its entry point: 'gem_dangling_env' has no 'MatEnv'. Did you mean 'MathEnv'?"
DANGLING = {
    "dangling:Typo-v0": f"gem_dangling.py:25: {MAT_ENV} Correct the entry point 'gem_dangling_env:MatEnv'",
    "dangling:NoModule-v0": "gem_dangling.py:25: its entry point: there is no module 'gem_dangling_envs' (entry point "
    "'gem_dangling_envs:MathEnv'); correct the entry point, or install the distribution that has it",
    "dangling:NoClass-v0": "gem_dangling.py:25: its entry point: 'gem_dangling_env' has no 'Easy'. Correct the entry "
    "point 'gem_dangling_env:MathEnv.Easy'",
    "dangling:Number-v0": "gem_dangling.py:25: its entry point: 'gem_dangling_env:LIMIT' is a int, which cannot be "
    "called",
    "dangling:NoEnv-v0": "gem_dangling.py:25: 'gem_dangling_env:Helper' does not derive from gymnasium.Env",
    "dangling:MissingImport-v0": "gem_dangling_import.py:4: its entry point: 'gem_dangling_import' needs the module "
    "'gem_not_installed_anywhere', which is not installed; try 'pip install gem-not-installed-anywhere'",
    "dangling:Deeper-v0": "gem_dangling_deeper.py:3: its entry point: importing 'gem_dangling_deeper' failed: "
    "JSONDecodeError: Expecting value: line 1 column 1 (char 0)",
    "dangling:Syntax-v0": "gem_dangling_syntax.py:3: its entry point: importing 'gem_dangling_syntax' failed: "
    "SyntaxError: '(' was never closed (gem_dangling_syntax.py, line 3)",
    "dangling:Raises-v0": "gem_dangling_raises.py:7: its entry point: importing 'gem_dangling_raises' failed: "
    "JSONDecodeError: Expecting value: line 1 column 1 (char 0)",
    "dangling:Exits-v0": "gem_dangling_exits.py:3: its entry point: importing 'gem_dangling_exits' failed: "
    "SystemExit: 3",
    "dangling:Dies-v0": "gem_dangling.py:25: while its entry point was imported, the interpreter ended with exit code "
    "7",
    "dangling:Kwargs-v0": "gem_dangling.py:26: its kwargs: got an unexpected keyword argument 'lenght'. Did you mean "
    "'length'? It accepts: length",
    "dangling:UnmetTypo-v0": f"gem_dangling.py:29: {MAT_ENV} Correct the entry point 'gem_dangling_env:MatEnv'",
    "tool dangling": "gem_dangling.py:36: its entry point: 'gem_dangling_env' has no 'Tool'. Did you mean "
    "'make_tool'? Correct the entry point 'gem_dangling_env:Tool'",
    "tool dangling_class": "gem_dangling.py:37: 'gem_dangling_env:Helper' does not derive from gem_core.Tool",
    "tool dangling_status": "gem_dangling.py:38: its status: 'gem_dangling_env' has no 'stat'. Correct the entry point "
    "'gem_dangling_env:stat'",
    "requirement dangling": "gem_dangling.py:51: 'gem_dangling:weather' returned 'met', and no RequirementStatus",
    "command dangling": "gem_dangling.py:45: 'gem_dangling_env:make_tool' is a function, and no click.Command",
}


def checked(case: str, site: Path, *arguments: str) -> tuple[int, list[str]]:
    """Return the exit code of ``gem plugins --check`` and the problems that it names."""
    code = f"from gem_core.cli import main\nmain(['plugins', {case!r}, '--check', '--json', *{arguments!r}])"
    done = python(code, [site])
    (plugin,) = json.loads(done.stdout)
    return done.returncode, plugin["problems"]


def test_every_entry_point_is_imported_and_file_and_line_are_named(tmp_path: Path) -> None:
    """What cannot be imported, or is something else, is named; what is fine, or needs what is not here, is not."""
    site = install("dangling", tmp_path)
    assert checked("dangling", site) == (1, [f"{name}: {site}/{problem}" for name, problem in DANGLING.items()])


@pytest.mark.thorough
def test_a_module_that_hangs_is_ended(tmp_path: Path) -> None:
    """It is named with the line where it hangs, waited for once, and what is in other modules is tried all the same."""
    site = install("hangs", tmp_path)
    code, problems = checked("hangs", site, "--timeout", "5")
    assert code == 1
    assert problems in (
        [
            f"hangs:One-v0: {site}/gem_hangs_env.py:5: while its entry point was imported, it took too long "
            "(and 1 more)",
            f"hangs:Typo-v0: {site}/gem_hangs.py:12: its entry point: 'gem_hangs' has no 'Typo'. Correct the entry "
            "point 'gem_hangs:Typo'",
        ],
        ["while it was loaded, it took too long"],  # on a machine that is busy elsewhere
    )
