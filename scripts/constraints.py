"""For `make constraints`, to renew what development installs: resolve the newest versions, write constraints.txt.

For several interpreters at once::

    make constraints PYTHONS="python3.11 python3.12 python3.13"

The first one's versions are taken for the others where they fit, so name the oldest first; where an interpreter needs
another version, the lines carry environment markers. Only names and versions are written.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
HEADER = "# Pinned versions for development, written by `make constraints`. Names and versions only.\n"


def main(pythons: list[str]) -> int:
    """Write constraints.txt for the given interpreters."""
    resolved: dict[str, dict[str, str]] = {}
    for python in pythons:
        earlier = next(iter(resolved.values()), {})
        version, packages = resolve(python, earlier)
        print(f"python {version}: {len(packages)} packages")
        resolved[version] = packages
    (ROOT / "constraints.txt").write_text(HEADER + "".join(lines(resolved)), encoding="utf-8")
    return 0


def resolve(python: str, preferred: dict[str, str]) -> tuple[str, dict[str, str]]:
    """Return an interpreter's version ("3.11") and the packages that a fresh environment of it would get.

    Args:
        python: The interpreter's command.
        preferred: Versions to take where they fit, so that all interpreters work with the same.
    """
    with tempfile.TemporaryDirectory() as folder:
        run([python, "-m", "venv", folder])
        inside = str(Path(folder, "bin", "python"))
        version = run([inside, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]).strip()
        constraints = Path(folder, "constraints.txt")
        constraints.write_text("".join(f"{name}=={pin}\n" for name, pin in preferred.items()), encoding="utf-8")
        found = install_report(inside, "-c", str(constraints)) or install_report(inside)
    if found is None:
        sys.exit(f"python {version}: no versions fit together")
    return version, {normal(entry["name"]): entry["version"] for entry in found}


def install_report(python: str, *options: str) -> list[dict[str, Any]] | None:
    """Return the metadata of what pip would install, the repository's own distributions apart; None if it cannot."""
    projects = [".", *(str(path.parent) for path in sorted(ROOT.glob("plugins/*/pyproject.toml")))]
    command = [python, "-m", "pip", "install", "--quiet", "--dry-run", "--report", "-"]
    command += ["-r", "requirements-dev.txt", "-r", "requirements-docs.txt"]
    done = subprocess.run([*command, *options, *projects], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        sys.stderr.write(done.stderr)
        return None
    items = json.loads(done.stdout)["install"]
    return [item["metadata"] for item in items if "dir_info" not in item["download_info"]]


def lines(resolved: dict[str, dict[str, str]]) -> list[str]:
    """Return one line for each package, or one for each version of Python where they differ."""
    written = []
    for name in sorted({name for packages in resolved.values() for name in packages}):
        versions = {python: packages[name] for python, packages in resolved.items() if name in packages}
        if len(set(versions.values())) == 1:
            written.append(f"{name}=={next(iter(versions.values()))}\n")
        else:
            written.extend(
                f'{name}=={version} ; python_version == "{python}"\n' for python, version in sorted(versions.items())
            )
    return written


def normal(name: str) -> str:
    """Return the normal form of a distribution's name."""
    return name.lower().replace("_", "-").replace(".", "-")


def run(command: list[str]) -> str:
    """Run a command in the repository and return what it printed; on failure show it and exit."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{done.stdout}{done.stderr}\n{' '.join(command)} failed")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or [sys.executable]))
