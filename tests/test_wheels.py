"""The wheels that ``make wheels`` builds, installed from their folder in an empty environment."""

from __future__ import annotations

import email
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.thorough
pytest.importorskip("hatchling", reason="it builds the wheels")

ROOT = Path(__file__).resolve().parent.parent
PROJECTS = [ROOT, *sorted(path.parent for path in ROOT.glob("plugins/*/pyproject.toml"))]
PIP = "--disable-pip-version-check", "--no-input", "--quiet"


def run(*command: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a program that sees none of this checkout."""
    outside = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "GEM_", "PYTEST_"))}
    return subprocess.run(
        list(map(str, command)), cwd=cwd, env=outside, capture_output=True, text=True, timeout=600, check=False
    )


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel of every distribution, built by the command of the Makefile."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "pip", "wheel", *PIP, "--no-deps", "--no-build-isolation", "-w", folder]
    done = run(*command, *PROJECTS, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def python(wheels: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of an environment with all wheels; of what others wrote it has what the core and games need."""
    venv = tmp_path_factory.mktemp("fresh") / "venv"
    assert run(sys.executable, "-m", "venv", venv, cwd=wheels).returncode == 0
    python = venv / "bin" / "python"
    install = [python, "-m", "pip", "install", *PIP]
    needed = {line for name in ("gem_core", "gem_games") for line in requirements(wheels, name)}
    done = run(*install, "-c", ROOT / "constraints.txt", *needed, cwd=wheels)
    if done.returncode != 0:
        pytest.skip(f"the package index does not answer: {done.stderr.strip()[-200:]}")
    done = run(*install, "--no-index", "--find-links", wheels, "gem-core", "gem-games", cwd=wheels)
    assert done.returncode == 0, done.stderr
    done = run(*install, "--no-index", "--no-deps", *wheels.glob("*.whl"), cwd=wheels)
    assert done.returncode == 0, done.stderr
    return python


def metadata(wheel: Path) -> tuple[email.message.Message, list[str]]:
    """Return the metadata of a wheel, and the names of its files."""
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (path,) = [name for name in names if name.endswith(".dist-info/METADATA")]
        return email.message_from_bytes(archive.read(path)), names


def requirements(wheels: Path, name: str) -> list[str]:
    """Return what a wheel requires of others, without its extras."""
    (wheel,) = wheels.glob(f"{name}-*.whl")
    listed = metadata(wheel)[0].get_all("Requires-Dist") or []
    return [line for line in listed if "extra ==" not in line and not line.startswith("gem-")]


def test_every_distribution_has_a_wheel_with_what_it_needs(wheels: Path) -> None:
    """Version, addresses, licence and type marker; and no tests."""
    names = {path.name for path in PROJECTS[1:]} | {"gem-core"}
    found = {metadata(wheel)[0]["Name"]: metadata(wheel) for wheel in wheels.glob("*.whl")}
    assert set(found) == names
    for name, (fields, files) in found.items():
        package = name.replace("-", "_")
        assert re.fullmatch(r"\d+\.\d+\.\d+", fields["Version"])
        assert [line.split(", ")[0] for line in fields.get_all("Project-URL")] == ["Documentation", "Paper"]
        assert any(file.endswith(".dist-info/licenses/LICENSE") for file in files), name
        assert f"{package}/py.typed" in files
        assert {file.split("/")[0] for file in files} == {package, f"{package}-{fields['Version']}.dist-info"}


def test_every_plugin_is_found_in_its_wheel(python: Path, tmp_path: Path) -> None:
    """And its environments are listed, without the packages that they need."""
    gem = python.parent / "gem"
    done = run(gem, "plugins", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    for project in PROJECTS:
        name = "gem-core" if project == ROOT else project.name
        assert name in done.stdout
    assert (
        run(gem, "list", cwd=tmp_path).stdout == run(Path(sys.executable).parent / "gem", "list", cwd=tmp_path).stdout
    )
