"""For `make trainers`, before a release: run the files of examples/trainers, each in a virtual environment of its own.

    python scripts/trainers.py              # all of them, and a table of the results
    python scripts/trainers.py trl_rollout  # some

What a file needs stands at its top, in a block of inline metadata (PEP 723): the framework first, then others. Those of
its dependencies that are distributions of this repository are installed from here, editable, and those that they need
with them. PyTorch has the version of constraints.txt in all of them. The table ``[tool.gem]`` in the block may name
another interpreter (``python = "3.12"``) and what is installed without its dependencies (``no-deps = ["…"]``).
``[tool.gem.table]`` has the file's row in docs/trainers.md, which ``--write`` puts there with the version of a trial
that passed; other rows keep theirs.

The exit code is 0 where every file that was asked for ran to its end and exited with 0.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parent.parent
TRAINERS = ROOT / "examples" / "trainers"
ALWAYS = ("gem-core", "gem-train")
PAGE = ROOT / "docs" / "trainers.md"
COLUMNS = {
    "framework": "framework",
    "rewards": "rewards of turns",
    "images": "images",
    "groups": "groups",
    "tools": "tool calls",
    "failures": "an episode with an error",
}
BUILD_TOOLS = ("hatchling>=1.27", "editables")
"""Of our own distributions: with these an editable installation needs no environment to be built in."""


class Needs(NamedTuple):
    """What a file needs.

    Args:
        theirs: Requirements from the package index; the first names the framework.
        ours: Requirements that this repository has, as ``"gem-games"``.
        no_deps: What is installed without its dependencies.
        python: The interpreter, as ``"3.12"``; None for the one that runs this script.
    """

    theirs: list[str]
    ours: list[str]
    no_deps: list[str]
    python: str | None

    @property
    def framework(self) -> str:
        """Name of the distribution whose version the table tells."""
        return name_of((self.no_deps + self.theirs)[0]) if self.no_deps or self.theirs else "gem-train"


class Result(NamedTuple):
    """A row of the table."""

    name: str
    framework: str
    version: str
    result: str
    seconds: float


def main() -> int:
    """Install and run what was asked for; return 0 where everything passed."""
    names = sorted(path.stem for path in TRAINERS.glob("*.py"))
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"by default all: {', '.join(names)}")
    parser.add_argument("--venvs", type=Path, default=Path(".venv-trainers"), help="folder that keeps the environments")
    parser.add_argument("--timeout-s", type=float, default=900.0, help="seconds that one file may run (default: 900)")
    parser.add_argument("--write", action="store_true", help="write the table of docs/trainers.md")
    arguments = parser.parse_args()
    for name in arguments.names:
        if name not in names:
            parser.error(f"there is no examples/trainers/{name}.py; there are: {', '.join(names)}")
    results = []
    for name in arguments.names or names:
        results.append(try_one(name, (ROOT / arguments.venvs).resolve() / name, arguments.timeout_s))
        print(f"==> {name}: {results[-1].result}", flush=True)
    print_table(results)
    if arguments.write:
        write_page({row.name: row.version for row in results if row.result == "passed"})
    return 0 if results and all(row.result == "passed" for row in results) else 1


def try_one(name: str, venv: Path, timeout_s: float) -> Result:
    """Install what a file needs and run it."""
    file = TRAINERS / f"{name}.py"
    needs = needs_of(file.read_text(encoding="utf-8"))
    interpreter = sys.executable if needs.python is None else interpreter_of(needs.python)
    if interpreter is None:
        return Result(name, needs.framework, "-", f"python{needs.python} is not installed", 0.0)
    print(f"==> {name}: installing", flush=True)
    problem = install(venv, interpreter, needs)
    if problem is not None:
        print(problem, file=sys.stderr)
        return Result(name, needs.framework, "-", "not installed", 0.0)
    python = venv / "bin" / "python"
    print(f"==> {name}: running {file.relative_to(ROOT)}", flush=True)
    began = time.monotonic()
    result = run_file(python, file, timeout_s)
    return Result(name, needs.framework, version_of(python, needs.framework), result, time.monotonic() - began)


def interpreter_of(version: str) -> str | None:
    """Return an interpreter of a version, as ``"3.12"``, on the PATH or among pyenv's; None where none runs.

    What pyenv puts on the PATH runs only the versions that it was told to use.
    """
    found = [shutil.which(f"python{version}")]
    root = Path(os.environ.get("PYENV_ROOT", "~/.pyenv")).expanduser()
    found += sorted(map(str, root.glob(f"versions/{version}*/bin/python{version}")))
    for path in filter(None, found):
        if subprocess.run([path, "--version"], capture_output=True).returncode == 0:
            return path
    return None


def run_file(python: Path, file: Path, timeout_s: float) -> str:
    """Run a file, its output shown as it comes; return "passed" or what went wrong."""
    process = subprocess.Popen([python, file], cwd=ROOT, stdin=subprocess.DEVNULL, start_new_session=True)
    try:
        code = process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        return f"stopped after {timeout_s:g} s"
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # with what it started
        process.wait()
    return "passed" if code == 0 else f"failed, exit code {code}"


# What a file needs.


def needs_of(source: str) -> Needs:
    """Return what the block of inline metadata in a file's text asks for.

    Raises:
        SystemExit: There is none.
    """
    metadata = metadata_in(source)
    local = distributions()
    own: dict[str, Any] = metadata.get("tool", {}).get("gem", {})
    asked = list(metadata.get("dependencies", []))
    ours = [line for line in asked if name_of(line) in local]
    theirs = [line for line in asked if name_of(line) not in local]
    return Needs(theirs, ours, list(own.get("no-deps", [])), own.get("python"))


def metadata_in(source: str) -> dict[str, Any]:
    """Return the block of inline metadata in a file's text.

    Raises:
        SystemExit: There is none.
    """
    block = re.search(r"^# /// script\n((?:#(?: .*)?\n)+?)# ///$", source, re.MULTILINE)
    if block is None:
        sys.exit("error: a file in examples/trainers begins with '# /// script'; see PEP 723")
    return tomllib.loads("".join(line[2:] + "\n" for line in block.group(1).splitlines()))


def name_of(requirement: str) -> str:
    """Return the name in a requirement, as ``"trl"`` of ``"trl>=1.16"``."""
    return re.split(r"[^\w.-]", requirement.strip(), maxsplit=1)[0].lower().replace("_", "-")


def distributions() -> dict[str, Path]:
    """Return the folder of each distribution of this repository, by name."""
    folders = [ROOT, *(path.parent for path in sorted(ROOT.glob("plugins/*/pyproject.toml")))]
    return {project_in(folder)["name"]: folder for folder in folders}


def project_in(folder: Path) -> dict[str, Any]:
    """Return the table ``project`` of a distribution's pyproject.toml."""
    project: dict[str, Any] = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return project


def editable(ours: list[str]) -> list[str]:
    """Return pip's arguments that install distributions of this repository, and those that they need, from here."""
    local = distributions()
    wanted: dict[str, str] = {}  # the extras of each, as "[torch]"
    waiting = [*ALWAYS, *ours]
    while waiting:
        line = waiting.pop(0)
        name, extras = name_of(line), re.search(r"\[.*?\]", line)
        if name not in local or (name in wanted and extras is None):
            continue
        wanted[name] = extras.group() if extras else wanted.get(name, "")
        waiting += project_in(local[name]).get("dependencies", [])
    return [part for name, extras in wanted.items() for part in ("-e", f"{local[name]}{extras}")]


# Virtual environments.


def install(venv: Path, interpreter: str, needs: Needs) -> str | None:
    """Make a virtual environment that has what is needed, unless it is there; return what went wrong, if anything."""
    pin = next(
        line for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines() if "torch==" in line
    )
    ours = editable(needs.ours)
    projects = [project_in(Path(folder.partition("[")[0])) for folder in ours[1::2]]
    made_from = hashlib.sha256(repr([interpreter, str(venv), needs, pin, projects]).encode()).hexdigest()
    stamp = venv / ".installed"
    if stamp.exists() and stamp.read_text(encoding="utf-8") == made_from:
        return None
    options = ("--quiet", "--disable-pip-version-check", "--no-input")
    pip: list[str | Path] = [venv / "bin" / "python", "-m", "pip", "install", *options]
    pinned = venv / "pin.txt"
    commands: list[list[str | Path]] = [[interpreter, "-m", "venv", "--clear", venv]]
    if any(name_of(line) == "torch" for line in needs.theirs):
        # First and alone, so that nothing else decides which of its builds comes.
        commands.append([*pip, pin])
    commands.append([*pip, "-c", pinned, *BUILD_TOOLS, *needs.theirs])
    if needs.no_deps:
        commands.append([*pip, "--no-deps", *needs.no_deps])
    # Once more with theirs, so that pip knows of both what they ask for.
    commands.append([*pip, "--no-build-isolation", "-c", pinned, *ours, *needs.theirs])
    for command in commands:
        done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        if done.returncode:
            return f"{done.stdout}error: {' '.join(map(str, command))} failed"
        pinned.write_text(f"{pin}\n", encoding="utf-8")
    stamp.write_text(made_from, encoding="utf-8")
    return None


def version_of(python: Path, distribution: str) -> str:
    """Return the version that an environment has of a distribution, or "-"."""
    program = f"import importlib.metadata as m; print(m.version({distribution!r}))"
    done = subprocess.run([python, "-c", program], capture_output=True, text=True)
    return done.stdout.strip() or "-"


def print_table(results: list[Result]) -> None:
    """Print a row for each file."""
    rows = [("file", "framework", "version", "result", "seconds")]
    rows += [(row.name, row.framework, row.version, row.result, f"{row.seconds:.1f}") for row in results]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    print()
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


# The page.


def write_page(versions: dict[str, str]) -> None:
    """Write the table of docs/trainers.md, with new versions of some files."""
    text = PAGE.read_text(encoding="utf-8")
    tried = dict(re.findall(r"^\| .*? \| `(\w+)\.py` \| (.*?) \|", text, re.MULTILINE)) | versions
    before, _, rest = text.partition("| framework |")
    PAGE.write_text(before + table_of(tried) + rest.partition("\n\n")[1] + rest.partition("\n\n")[2], encoding="utf-8")


def table_of(tried: dict[str, str]) -> str:
    """Return the table: what the files say of themselves, and the versions that their trials passed with."""
    first, *others = COLUMNS.values()
    lines = [f"| {' | '.join([first, 'file', 'passed with', *others])} |", f"|{' --- |' * (len(COLUMNS) + 2)}"]
    for path in sorted(TRAINERS.glob("*.py"), key=lambda path: (path.stem != "verl_agent_loop", path.stem)):
        said = metadata_in(path.read_text(encoding="utf-8"))["tool"]["gem"]["table"]
        framework, *cells = (said[name] for name in COLUMNS)
        lines.append(
            f"| {' | '.join([framework, f'`{path.name}`', said.get('tried') or tried.get(path.stem, '-'), *cells])} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
