"""What holds for every file and every distribution of this repository."""

from __future__ import annotations

import ast
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PLUGINS = sorted(path.parent for path in ROOT.glob("plugins/*/pyproject.toml"))
LOCK_FILES = {
    "Pipfile.lock",
    "conda-lock.yml",
    "package-lock.json",
    "pdm.lock",
    "poetry.lock",
    "pylock.toml",
    "uv.lock",
}
# Package hosts, and folders of one machine. Brackets keep the patterns from matching this file.
PRIVATE = re.compile(
    r"(?<![\w.-])/(work|root|home)[/]\w|pypi[.]org|pythonhosted[.]org|registry[.]npmjs|debian[.]org|file:/[/]/"
)
MAX_LINES = 800


_LISTED = subprocess.run(
    ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True
)
if _LISTED.returncode:
    pytest.skip("git does not know this folder", allow_module_level=True)
FILES = sorted(path for path in map(Path, _LISTED.stdout.split("\0")[:-1]) if (ROOT / path).is_file())
MODULES = [
    path for path in FILES if path.suffix == ".py" and re.match(r"gem_core/|plugins/[^/]+/gem_", path.as_posix())
]


def text_of(path: Path) -> str:
    """Return a file's text; empty for one that is not text."""
    content = (ROOT / path).read_bytes()
    return "" if b"\0" in content else content.decode("utf-8")


def test_the_files_are_found():
    """The tests below look at something."""
    assert {Path("pyproject.toml"), Path("Makefile"), Path("gem_core/env/base.py"), Path(".ci/run")} <= set(FILES)


def test_no_file_names_a_package_host_or_a_private_path():
    """Addresses of package hosts and paths of one machine mean nothing elsewhere."""
    found = {str(path): match.group() for path in FILES if (match := PRIVATE.search(text_of(path)))}
    assert found == {}


def test_there_is_no_lock_file():
    """Lock files record addresses; constraints.txt pins versions."""
    assert [str(path) for path in FILES if path.name in LOCK_FILES] == []


def test_constraints_are_names_and_versions_only():
    """A line of constraints.txt is `name==version`, with an environment marker where versions differ."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    form = re.compile(r'[a-z0-9-]+==[\w.]+( ; python_version == "3\.\d+")?')
    assert [line for line in lines if not line.startswith("#") and not form.fullmatch(line)] == []


def test_every_module_begins_with_a_docstring():
    """Each shipped module says in its first line why it exists."""
    first = {str(path): (ast.get_docstring(ast.parse(text_of(path))) or "").partition("\n")[0] for path in MODULES}
    assert {path: line for path, line in first.items() if not line.strip().endswith((".", "?", "!", ":"))} == {}


def test_no_file_is_too_long():
    """A Python file that grows past the limit has two subjects."""
    lengths = {str(path): text_of(path).count("\n") for path in FILES if path.suffix == ".py"}
    assert {path: lines for path, lines in lengths.items() if lines > MAX_LINES} == {}


def test_no_pattern_repeats_a_group_possessively():
    """Python 3.11.2, that of Debian 12, loses its place where such a group fails half-way; 3.11.7 does not."""
    repeated = re.compile(r"\)(?:[*?+]|\{[0-9,]+\})\+")
    lines = {f"{path}:{number}": line for path in MODULES for number, line in enumerate(text_of(path).splitlines(), 1)}
    assert [place for place, line in lines.items() if repeated.search(line) and "[()*+" not in line] == []


@pytest.mark.parametrize("folder", [ROOT, *PLUGINS], ids=lambda folder: folder.name)
def test_distribution_is_like_the_others(folder: Path):
    """README, tests, a licence, a type marker, metadata, and of a plugin one entry point to a module that declares."""
    project, core = (
        tomllib.loads((each / "pyproject.toml").read_text(encoding="utf-8"))["project"] for each in (folder, ROOT)
    )
    package = project["name"].replace("-", "_")
    for name in ("README.md", f"{package}/__init__.py", f"{package}/_plugin.py", f"{package}/py.typed"):
        assert (folder / name).is_file(), f"{folder.name} lacks {name}"
    assert list(folder.glob("tests/test_*.py")), f"{folder.name} has no tests"
    assert project["license"] == "Apache-2.0"
    assert project["license-files"][0] == "LICENSE"
    assert (folder / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    assert project["readme"] == "README.md"
    assert project["description"].strip()
    assert "Typing :: Typed" in project["classifiers"]
    for field in ("version", "requires-python", "classifiers", "urls"):
        assert project[field] == core[field]
    if folder != ROOT:
        assert project["name"] == folder.name
        assert any(re.match(r"gem-core\b", line) for line in project["dependencies"])
        assert list(project["entry-points"]["gem.plugins"].values()) == [f"{package}._plugin"]
