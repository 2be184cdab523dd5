"""For `make docs-pages`, after a public name changed: write the pages of docs/reference/ that describe packages.

    python scripts/api_reference.py

A page names the package and what it offers; `make docs` fills in signatures and docstrings. A name is described once:
what ``gem_core`` itself offers is left out at ``gem_core.env``. Nothing is imported.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "docs" / "reference"
MODULES = ("gem_core.errors", "gem_core.types", "gem_core.parsing", "gem_core.registry.hookspecs")
"""Modules that are public as a whole."""
FROM_ELSEWHERE = {"commands.md", "glossary.md"}
"""Pages that other scripts write, or people."""
INDEX = """# Reference

[Commands](commands.md) shows what each command of `gem` offers, the [glossary](glossary.md) what our words mean. The
other pages describe what can be imported.

## The core

{core}

## Plugins

`gem_games`, `gem_ray` and most of `gem_tools` have nothing to import: they are used by ids and names.

{plugins}
"""


class Package(NamedTuple):
    """A package or module to describe."""

    name: str
    summary: str
    offered: list[str]


def packages() -> Iterator[Package]:
    """Yield each package that offers names, then the modules that are public as a whole."""
    for root in [ROOT / "gem_core", *sorted(ROOT.glob("plugins/*/gem_*"))]:
        for path in sorted(root.rglob("__init__.py")):
            package = read_package(path, ".".join(path.parent.relative_to(root.parent).parts))
            if package.offered:
                yield package
    for name in MODULES:
        yield read_package(ROOT / Path(*name.split(".")).with_suffix(".py"), name)


def read_package(path: Path, name: str) -> Package:
    """Return what a file says of itself."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    summary = (ast.get_docstring(tree) or "").partition("\n\n")[0].replace("\n", " ")
    offered: list[str] = []
    stub = path.with_suffix(".pyi")
    if stub.exists():
        imports = [
            node for node in ast.parse(stub.read_text(encoding="utf-8")).body if isinstance(node, ast.ImportFrom)
        ]
        offered = sorted(each.name for node in imports for each in node.names)
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            offered = ast.literal_eval(node.value)
    return Package(name, summary, [name for name in offered if not name.startswith("__")])


def pages() -> dict[str, str]:
    """Return the text of each page, by its file's name."""
    texts: dict[str, str] = {}
    rows: dict[str, str] = {}
    described: dict[str, dict[str, str]] = {}
    for package in sorted(packages(), key=lambda package: package.name):
        distribution = package.name.partition(".")[0]
        earlier = described.setdefault(distribution, {})
        elsewhere = {name: earlier[name] for name in package.offered if name in earlier}
        earlier |= {name: package.name for name in package.offered if name not in earlier}
        texts[f"{package.name}.md"] = page(package, elsewhere)
        rows[package.name] = f"| [`{package.name}`]({package.name}.md) | {package.summary} |"
    return {"index.md": index(rows), **texts}


def page(package: Package, elsewhere: dict[str, str]) -> str:
    """Return the text of one page.

    Args:
        package: What it describes.
        elsewhere: Names that the page of another package describes, with that package.
    """
    text = f"# {package.name}\n\n::: {package.name}\n"
    members = [name for name in package.offered if name not in elsewhere]
    if package.offered:
        text += "    options:\n" + (f"      members: [{', '.join(members)}]\n" if members else "      members: false\n")
    if elsewhere:
        names = ", ".join(f"[`{name}`]({home}.md#{home}.{name})" for name, home in elsewhere.items())
        text += f"\n## Described elsewhere\n\n{names}\n"
    return text


def index(rows: dict[str, str]) -> str:
    """Return the page that lists the others."""
    core = [row for name, row in rows.items() if name.startswith("gem_core")]
    plugins = [row for name, row in rows.items() if not name.startswith("gem_core")]
    head = "| import | holds |\n| --- | --- |\n"
    return INDEX.format(core=head + "\n".join(core), plugins=head + "\n".join(plugins))


def main() -> int:
    """Write the pages, and remove those of packages that are gone."""
    texts = pages()
    for path in FOLDER.glob("*.md"):
        if path.name not in texts and path.name not in FROM_ELSEWHERE:
            path.unlink()
    for name, text in texts.items():
        (FOLDER / name).write_text(text, encoding="utf-8")
    print(f"wrote {len(texts)} pages")
    return 0


if __name__ == "__main__":
    sys.exit(main())
