"""Installs small distributions, and runs interpreters that see them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import gem_core

FIXTURES = Path(__file__).parent / "plugin_fixtures"

_HOOK = "from gem_core import EnvSpec, hookimpl\n@hookimpl\ndef gem_register_envs():\n    "
_NAMED = _HOOK + "return [EnvSpec(id=env_id, entry_point='gem_fine_env:FineEnv') for env_id in {}]"
_ONE = _HOOK + "return [EnvSpec(id='{0}:One-v0', entry_point='gem_{0}:one', summary='Nothing to do.', kwargs={1})]\n"

ONE_MODULE = {
    # It cannot be imported.
    "import_error": "from gem_core import nothing_of_this_name",
    "exits": "import sys; sys.exit(3)",
    "mute_error": "class MuteError(Exception):\n    def __str__(self): raise RuntimeError('mute')\nraise MuteError",
    "missing_module": "",
    "missing_attribute": "",
    "uses_registry": "import gem_core\ngem_core.register('uses:One-v0', 'gem_fine_env:FineEnv')",
    # Its hooks are none.
    "misspelt": _HOOK.replace("envs", "env") + "return []",
    "misspelt_unmarked": "def gem_register_env(): return []",
    "unmarked": "def gem_register_envs(): return []",
    "extra_argument": _HOOK.replace("()", "(config)") + "return []",
    # A hook fails, or returns something else.
    "hook_raises": _NAMED.format(["raises:One-v0"])
    + "\n@hookimpl\ndef gem_register_tools():\n    raise ValueError('the first line\\nand the second')",
    "wrong_type": _HOOK + "return [{'id': 'wrong:Type-v0'}]",
    "returns_text": _HOOK + "return 'text:One-v0'",
    "returns_none": _HOOK + "pass",
    "generator_fails": _HOOK
    + "yield EnvSpec(id='midway:One-v0', entry_point='gem_fine_env:FineEnv')\n    raise RuntimeError('no second one')",
    # It loads, and the rest is wrong.
    "heavy_neighbour": _HOOK + "return [EnvSpec(id='heavy:One-v0', entry_point='gem_heavy_missing:HeavyEnv')]",
    "heavy_import": "import numpy as np\n" + _ONE.format("heavy_import", {}) + "def one(): return np.zeros(1)",
    "prints": "print('hello from a plugin')\n" + _ONE.format("prints", {}) + "def one(): pass",
    "wrong_kwargs": _ONE.format("wrong_kwargs", {"size": 3}) + "def one(): pass",
    "taken_id": _NAMED.format(["taken:Own-v0", "fine:One-v0"]),
}
"""Distributions of one module, each with something wrong; the others are folders of ``plugin_fixtures``."""

_POINTS = {"missing_module": "gem_missing_module_typo", "missing_attribute": "gem_missing_attribute:plugin"}


def install(case: str, target: Path) -> Path:
    """Do what an installer does with one distribution, without an installer."""
    site = target / case
    site.mkdir()
    points = {"gem.plugins": {case: _POINTS.get(case, f"gem_{case}")}}
    project: dict[str, Any] = {"name": f"gem-{case.replace('_', '-')}", "version": "1.0", "entry-points": points}
    if case in ONE_MODULE:
        (site / f"gem_{case}.py").write_text(ONE_MODULE[case])
    else:
        project = tomllib.loads((FIXTURES / case / "pyproject.toml").read_text())["project"]
        for module in (FIXTURES / case).glob("*.py"):
            shutil.copy(module, site)
    add_metadata(site, project)
    return site


def add_metadata(site: Path, project: dict[str, Any]) -> None:
    """Write what an installer says of a distribution beside its modules.

    Args:
        site: Folder of the modules.
        project: The table of this name in its pyproject.toml.
    """
    info = site / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.4\nName: {project['name']}\nVersion: {project['version']}\n")
    lines = [
        f"[{group}]\n{name} = {value}\n"
        for group, points in project["entry-points"].items()
        for name, value in points.items()
    ]
    (info / "entry_points.txt").write_text("".join(lines))


def python(code: str, paths: list[Path], **variables: str) -> subprocess.CompletedProcess[str]:
    """Run code in an interpreter that sees the core and the given folders."""
    root = Path(gem_core.__file__).parent.parent
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GEM_")}
    environment |= {
        "PYTHONPATH": os.pathsep.join(map(str, [*paths, root])),
        "PYTHONDONTWRITEBYTECODE": "1",
        **variables,
    }
    return subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=300, check=False
    )


def gem_in(paths: list[Path], *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run the command ``gem`` in such an interpreter."""
    return python(f"from gem_core.cli import main\nmain({list(arguments)!r})", paths, **variables)
