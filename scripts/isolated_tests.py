"""For `make test-isolated`, before a release: run each plugin's tests with only the core and what it declares.

An environment has the core, the plugin, what these declare, and pytest. A dependency that a plugin forgot to declare
shows here: in the development environment another plugin may bring it. The distributions are installed from wheels, so
a file that a wheel lacks shows too. A plugin's tests may need more than pytest and hypothesis; its pyproject.toml then
lists that in a dependency group ``test``.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
TEST_TOOLS = ["pytest", "hypothesis", "pytest-xdist"]


def main() -> int:
    """Test the given plugins, one after another; stop at the first that fails."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--venvs", type=Path, required=True, help="folder that keeps the environments")
    parser.add_argument("plugins", nargs="*", type=Path, help="folders of plugins, as in plugins/gem-games")
    arguments = parser.parse_args()
    venvs = (ROOT / arguments.venvs).resolve()
    for plugin in arguments.plugins:
        test(ROOT / plugin, venvs)
    return 0


def test(plugin: Path, venvs: Path) -> None:
    """Run the tests of one plugin in its own environment."""
    print(f"==> testing {plugin.name} with only the core and itself", flush=True)
    ours = needed(plugin)
    venv = venvs / plugin.name
    python = venv / "bin" / "python"
    wheels = [build(source, venvs / "wheels" / source.name) for source in ours]
    requirements = [*TEST_TOOLS, *tested_with(plugin)]
    stamp = venv / ".installed"
    # What the environment was made from; another value makes it anew.
    key = repr([sys.version, requirements, *map(read, ours), (ROOT / "constraints.txt").read_text(encoding="utf-8")])
    if not stamp.exists() or stamp.read_text(encoding="utf-8") != key:
        run([sys.executable, "-m", "venv", "--clear", venv])
        run([python, "-m", "pip", "install", "-c", "constraints.txt", *wheels, *requirements])
        stamp.write_text(key, encoding="utf-8")
    else:
        run([python, "-m", "pip", "install", "--force-reinstall", "--no-deps", "--no-index", *wheels])
    # -P keeps this repository out of sys.path.
    command: list[str | Path] = [
        python,
        "-P",
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-n",
        "auto",
        "--maxprocesses",
        "4",
        "--dist",
        "worksteal",
        plugin.relative_to(ROOT) / "tests",
    ]
    if subprocess.run(command, cwd=ROOT).returncode:
        sys.exit(f"error: {plugin.name} fails with only the core and itself installed")


def needed(plugin: Path) -> list[Path]:
    """Return the folders of the repository's distributions that a plugin and its tests need, itself among them."""
    names = {read(path.parent)["project"]["name"]: path.parent for path in ROOT.glob("plugins/*/pyproject.toml")}
    names["gem-core"] = ROOT
    found: list[Path] = []
    waiting = [plugin, ROOT]
    while waiting:
        folder = waiting.pop()
        if folder in found:
            continue
        found.append(folder)
        lines = read(folder)["project"]["dependencies"] + (tested_with(folder) if folder == plugin else [])
        required = (re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in lines)
        waiting.extend(names[name] for name in required if name in names)
    return found


def tested_with(plugin: Path) -> list[str]:
    """Return what a plugin's tests need besides."""
    group: list[str] = read(plugin).get("dependency-groups", {}).get("test", [])
    return group


def build(source: Path, folder: Path) -> Path:
    """Build a distribution's wheel with this environment's hatchling and return its path."""
    for old in folder.glob("*.whl"):
        old.unlink()
    run([sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "-w", folder, source])
    return next(folder.glob("*.whl"))


def read(folder: Path) -> dict[str, Any]:
    """Return a distribution's pyproject.toml."""
    return tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))


def run(command: list[str | Path]) -> None:
    """Run a command in the repository; show its output only when it fails, and exit then."""
    environment = {**os.environ, "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    done = subprocess.run(
        command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    if done.returncode:
        sys.exit(f"{done.stdout}\nerror: {' '.join(map(str, command))} failed")


if __name__ == "__main__":
    sys.exit(main())
