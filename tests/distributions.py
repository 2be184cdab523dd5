"""Installs the distributions of plugin_fixtures, and runs interpreters that see them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import gem_core

FIXTURES = Path(__file__).parent / "plugin_fixtures"


def install(case: str, target: Path) -> Path:
    """Do what an installer does with the folder of one distribution, without an installer."""
    site = target / case
    site.mkdir()
    for module in (FIXTURES / case).glob("*.py"):
        shutil.copy(module, site)
    project = tomllib.loads((FIXTURES / case / "pyproject.toml").read_text())["project"]
    info = site / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    header = f"Metadata-Version: 2.4\nName: {project['name']}\nVersion: {project['version']}\n"
    (info / "METADATA").write_text(header)
    lines = [
        f"[{group}]\n{name} = {value}\n"
        for group, points in project["entry-points"].items()
        for name, value in points.items()
    ]
    (info / "entry_points.txt").write_text("".join(lines))
    return site


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
