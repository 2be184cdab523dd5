"""What holds for every file and every distribution of this repository."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PLUGINS = sorted(path.parent for path in ROOT.glob("plugins/*/pyproject.toml"))
NOT_OURS = {"build", "dist", "runs", "__pycache__", "results"}
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
# Tests go through what users have. These do not, since nothing public shows or sets what they need; others are refused.
# Not ours are names of TextArena, Gymnasium and threading.
PRIVATE_IN_TESTS = {
    "plugins/gem-games/tests/test_fifteen_puzzle.py": {"_put"},
    "plugins/gem-games/tests/test_minesweeper.py": {"_set_mines"},
    "plugins/gem-games/tests/test_sokoban.py": {"_set_cells"},
    "plugins/gem-games/tests/test_sudoku.py": {"_put"},
    "plugins/gem-games/tests/test_verdicts.py": {"_begin", "_put", "_set_cells", "_set_mines"},
    "plugins/gem-math/tests/test_reasoning.py": {"_all", "_pool", "_process", "_rows"},
    "plugins/gem-qa/tests/test_qa_judging.py": {"_judge"},
    "plugins/gem-tools/tests/test_python_attacks_memory.py": {"_spare_uid"},
    "plugins/gem-tools/tests/test_python_attacks_oneself.py": {"_spare_uid"},
    "plugins/gem-tools/tests/test_python_docker.py": {"_answer"},
    "plugins/gem-tools/tests/test_python_levels.py": {"_warned", "_working"},
    "plugins/gem-tools/tests/test_requirements_probes.py": {"_working"},
    "tests/conftest.py": {"_registry", "_spaces"},
    "tests/test_completion.py": {"_registry"},
    "tests/test_tool_limits.py": {"_sessions"},
    "tests/testing/reference_envs.py": {"_np_random"},
}


def repository_files() -> list[Path]:
    """Return the files of the repository, relative to it: those that git knows, or all where git does not answer."""
    try:
        command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, check=True, text=True)
        names = [Path(name) for name in done.stdout.split("\0") if name]
    except (OSError, subprocess.CalledProcessError):
        names = []
        for folder, folders, files in os.walk(ROOT):
            folders[:] = [name for name in folders if name not in NOT_OURS and not re.match(r"\.(?!ci$)", name)]
            names += [Path(folder, file).relative_to(ROOT) for file in files if not file.endswith(".egg-info")]
    return sorted(name for name in names if (ROOT / name).is_file())


FILES = repository_files()
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


def test_every_folder_of_plugins_is_a_distribution():
    """A folder under plugins/ has its own pyproject.toml."""
    folders = {path.parts[1] for path in FILES if path.parts[0] == "plugins" and len(path.parts) > 2}
    assert folders == {plugin.name for plugin in PLUGINS}


@pytest.mark.parametrize("plugin", PLUGINS, ids=lambda plugin: plugin.name)
def test_plugin_has_what_a_distribution_needs(plugin: Path):
    """README, tests, a licence, a type marker, metadata, and one entry point to a module that only declares."""
    package = plugin.name.replace("-", "_")
    for name in ("README.md", f"{package}/__init__.py", f"{package}/_plugin.py", f"{package}/py.typed"):
        assert (plugin / name).is_file(), f"{plugin.name} lacks {name}"
    assert list(plugin.glob("tests/test_*.py")), f"{plugin.name} has no tests"

    project = tomllib.loads((plugin / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    core = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["name"] == plugin.name
    assert project["license"] == "Apache-2.0"
    assert project["readme"] == "README.md"
    assert project["requires-python"] == core["requires-python"]
    assert project["description"].strip()
    assert any(re.match(r"gem-core\b", line) for line in project["dependencies"])
    assert project["classifiers"] == core["classifiers"]
    assert project["urls"] == core["urls"]
    assert list(project["entry-points"]["gem.plugins"].values()) == [f"{package}._plugin"]


@pytest.mark.parametrize("folder", [ROOT, *PLUGINS], ids=lambda folder: folder.name)
def test_distribution_names_its_version_licence_and_pages(folder: Path):
    """The version of all, the one licence as a file, the documentation and the paper."""
    project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    core = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["version"] == core["version"]
    assert project["license-files"][0] == "LICENSE"
    assert (folder / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    assert list(project["urls"]) == ["Documentation", "Paper"]
    assert all(address.startswith("https://") for address in project["urls"].values())


@pytest.mark.parametrize("folder", [ROOT, *PLUGINS], ids=lambda folder: folder.name)
def test_wheel_holds_the_type_marker(folder: Path):
    """Users' type checkers read our annotations: each wheel has ``py.typed``, and the metadata says so."""
    wheel = pytest.importorskip("hatchling.builders.wheel", reason="what a wheel holds is asked of hatchling")
    project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    held = {file.distribution_path for file in wheel.WheelBuilder(str(folder)).recurse_included_files()}
    assert f"{project['name'].replace('-', '_')}/py.typed" in held
    assert "Typing :: Typed" in project["classifiers"]


def test_the_systems_are_named():
    """Linux and macOS, in the metadata and to the reader."""
    core = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = {line for line in core["classifiers"] if line.startswith("Operating System")}
    assert named == {"Operating System :: MacOS", "Operating System :: POSIX :: Linux"}
    assert "Linux and macOS" in (ROOT / "README.md").read_text(encoding="utf-8")


def private_names(path: Path) -> set[str]:
    """Return the private names that a file reads, imports or replaces in others; ``self._x`` is its own."""
    private = re.compile(r"_[a-z]\w*")
    found: set[str] = set()
    for node in ast.walk(ast.parse(text_of(path))):
        match node:
            case ast.Attribute(value=ast.Name("self" | "cls" | "os") | ast.Call(func=ast.Name("super"))):
                pass
            case ast.Attribute(attr=name):
                found.add(name)
            case ast.ImportFrom(module=str(module), names=names) if module.startswith("gem_"):
                found |= {alias.name for alias in names} - {"_plugin"}
            case ast.Call(func=ast.Name("getattr") | ast.Attribute(attr="setattr" | "delattr"), args=args):
                values = [arg.value for arg in args if isinstance(arg, ast.Constant)]
                found |= {value.rpartition(".")[2] for value in values if isinstance(value, str)}
    return {name for name in found if private.fullmatch(name)}


def test_tests_use_no_private_names():
    """A test that holds on to the inside breaks when the inside is mended, and tells no user's story."""
    written = "plugin_fixtures/"  # programs of broken plugins
    tests = [
        path
        for path in FILES
        if path.suffix == ".py" and "tests" in path.parts and written not in path.as_posix()
        if path.parts[0] == "tests" or path.match("plugins/*/tests/**/*.py") or path.match("plugins/*/tests/*.py")
    ]
    found = {path.as_posix(): private_names(path) for path in tests}
    more = {path: names - PRIVATE_IN_TESTS.get(path, set()) for path, names in found.items()}
    assert not {path: names for path, names in more.items() if names}
