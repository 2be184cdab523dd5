"""Every example of the README and of the pages in docs/ runs as it stands, and every link leads somewhere.

Blocks of Python are scripts of their own. Commands are typed one after the other, in one folder for each page. A block
that begins with the name of a file, as in ``# gem_mine/_plugin.py``, is that file.
"""

from __future__ import annotations

import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from distributions import gem_in

from gem_core.parsing import extract_code_blocks
from gem_core.tools.env import ToolEnv

for _plugin in Path(__file__).parent.parent.glob("plugins/*/gem_*"):
    pytest.importorskip(_plugin.name, reason="the examples use all plugins")

ROOT = Path(__file__).parent.parent
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in [
        ROOT / "README.md",
        *sorted((ROOT / "docs").glob("*.md")),
        *sorted((ROOT / "docs/concepts").glob("*.md")),
    ]
}
ELSEWHERE = {"docs/terminal.md", "docs/mcpmark.md", "docs/python-tool.md", "docs/search.md", "docs/mcp.md"}
"""They need containers, a database or a server: the plugins' own tests run them."""
FILE = re.compile(r"# ([\w./-]+\.\w+)\n")
NOT_TYPED = "pip install ", "make ", "export ", "python examples/", "gem train-study ", "gem train train:"
"""Needs the network or minutes, or has a test of its own; and so do commands that ask a model."""


def examples() -> list[pytest.ParameterSet]:
    """Return each block of Python that is no file; in a quick run the README's, and some of the others."""
    return [
        pytest.param(block.code, id=f"{page}:{number}", marks=() if page == "README.md" else pytest.mark.few(8))
        for page, text in PAGES.items()
        if page not in ELSEWHERE
        for number, block in enumerate(extract_code_blocks(text, "python"))
        if not FILE.match(block.code)
    ]


def commands(page: str) -> list[str]:
    """Return what a page tells a reader to type."""
    lines = [line for block in extract_code_blocks(PAGES[page], "console") for line in block.code.splitlines()]
    return [line for line in lines if not line.startswith(NOT_TYPED) and "openai:" not in line]


@pytest.mark.parametrize("code", examples())
def test_python_example_runs(code: str, tmp_path: Path) -> None:
    """In an empty folder, without a warning."""
    (tmp_path / "example.py").write_text(code, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-W", "error", "example.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stderr == ""
    assert done.returncode == 0
    assert done.stdout


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=() if page == "README.md" else pytest.mark.thorough)
        for page in PAGES
        if page not in ELSEWHERE and commands(page)
    ],
)
def test_commands_run(page: str, tmp_path: Path) -> None:
    """In this order, from an empty folder; pip writes into a folder of the test, not into this environment."""
    folder, site, start = tmp_path / "folder", tmp_path / "site", tmp_path / "start"
    for path in (folder, site, start):
        path.mkdir()
    # A .pth file counts only in a folder of packages: this one makes the interpreter treat ours as such.
    (start / "sitecustomize.py").write_text(f"import site\nsite.addsitedir({str(site)!r})\n")
    variables = {name: value for name, value in os.environ.items() if not name.startswith(("GEM_", "PYTEST_", "PIP_"))}
    variables |= {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": os.pathsep.join(map(str, [start, ROOT])),
        "PIP_TARGET": str(site),
        "PIP_NO_INDEX": "1",
        "PIP_DISABLE_PIP_VERSION_CHECK": "1",
    }
    for command in commands(page):
        if command.startswith("cd "):
            folder = folder / command.removeprefix("cd ")
            continue
        done = subprocess.run(
            ["sh", "-c", command], cwd=folder, env=variables, capture_output=True, text=True, timeout=300, check=False
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        assert done.stdout or " > " in command, command


def test_every_block_is_run() -> None:
    """All but settings and output are Python or commands, so that the tests above run them."""
    languages = {block.language for text in PAGES.values() for block in extract_code_blocks(text)}
    assert languages == {"python", "console", "json", "toml", "yaml", "text"}


def test_the_plugin_written_by_hand_is_found(tmp_path: Path) -> None:
    """Its two files, installed, are listed without importing its environment."""
    files = {
        match[1]: block.code
        for block in extract_code_blocks(PAGES["docs/environments.md"])
        if (match := FILE.match(block.code))
    }
    (tmp_path / "gem_mine").mkdir()
    (tmp_path / "gem_mine" / "__init__.py").touch()
    (tmp_path / "gem_mine" / "_plugin.py").write_text(files["gem_mine/_plugin.py"], encoding="utf-8")
    ((group, entry),) = re.findall(r'entry-points\."(.+?)"\]\n(.+)', files["pyproject.toml"])
    installed = tmp_path / "gem_mine-0.1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: gem-mine\nVersion: 0.1.0\n")
    (installed / "entry_points.txt").write_text(f"[{group}]\n{entry.replace(chr(34), '')}\n")
    done = gem_in([tmp_path], "list", "mine")
    assert done.stdout.split()[0] == "mine:Reverse-v0"
    assert done.stderr == ""


@pytest.mark.parametrize("page", [*PAGES, "CONTRIBUTING.md"])
def test_every_file_that_a_page_names_is_there(page: str) -> None:
    """Links, and paths in backticks; not what stands in blocks of code."""
    text = re.sub(r"^```.*?^```", "", (ROOT / page).read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    linked = [(ROOT / page).parent / path for path in re.findall(r"\]\((?!http)([^)#]+)[^)]*\)", text)]
    named = [ROOT / path for path in re.findall(r"`((?:gem_core|plugins|docs|benchmarks|scripts)/[\w./-]*)`", text)]
    assert [path for path in linked + named if not path.exists()] == []


def test_every_page_is_in_the_index() -> None:
    """docs/index.md links to each guide of docs/, but for how we write."""
    pages = {Path(page).name for page in PAGES if page.count("/") == 1} - {"README.md", "index.md", "style.md"}
    assert {path for path in pages if f"({path})" not in PAGES["docs/index.md"]} == set()


def test_every_option_of_tools_stands_in_the_table() -> None:
    """With its default, so that the page does not fall behind."""
    rows = dict(re.findall(r"^\| `(\w+)` \| ([^|]+) \|", PAGES["docs/tools.md"], re.MULTILINE))
    options = list(inspect.signature(ToolEnv.__init__).parameters.values())[3:]
    assert [option.name for option in options] == list(rows)
    for option in options:
        default = f"{option.default:g}" if isinstance(option.default, float) else str(option.default)
        assert rows[option.name].strip('`"') == default
