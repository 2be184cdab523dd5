"""The rooms of the core and their order: imports go down only, and plugins import what is public."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
CORE = ROOT / "gem_core"

LAYERS = [
    "errors failures types parsing suggestions progress arguments background closing docs terminal",
    "registry",
    "_plugin",
    "env",
    "data",
    "records",
    "wrappers",
    "tools",
    "making",
    "vector",
    "rollouts",
    "agents",
    "api",
    "gymnasium_envs",
    "testing cli",
]
"""From the bottom to the top. A room imports from its own layer and from those below."""

PUBLIC = {"gem_core", *(f"gem_core.{name}" for name in set(" ".join(LAYERS).split()) - {"_plugin", "api", "agents"})}
"""What plugins may import from: the package, its top-level modules, and what a room's ``__init__`` names."""

MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(CORE.rglob("*.py"))
}


def imports(path: Path) -> Iterator[tuple[int, str, list[str]]]:
    """Yield line, module and names of every import, those in functions and for the type checker included."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.lineno, node.module, [alias.name for alias in node.names]
        elif isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name, []


def modules_imported_by(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and name of the core's own modules that a file imports."""
    for line, module, names in imports(path):
        inside = [f"{module}.{name}" for name in names if f"{module}.{name}" in MODULES]
        for name in inside or [module]:
            if name in MODULES and name != "gem_core":
                yield line, name


def layer_of(module: str) -> int:
    room = module.split(".")[1]
    return next(number for number, layer in enumerate(LAYERS) if room in layer.split())


def test_imports_go_down_only():
    """No module imports a room above its own, not even in a function or for its types."""
    top = ("gem_core", "gem_core.__main__")
    upward = [
        f"{path.relative_to(ROOT)}:{line} imports {imported}"
        for module, path in MODULES.items()
        if module not in top
        for line, imported in modules_imported_by(path)
        if layer_of(imported) > layer_of(module)
    ]
    assert not upward


def test_modules_do_not_import_each_other_in_a_circle():
    """Within a room, too, there is an order."""
    needs = {
        name: {imported for _, imported in modules_imported_by(path)}
        for name, path in MODULES.items()
        if path.name != "__init__.py"
    }
    needs = {name: {module for module in found if module in needs} for name, found in needs.items()}
    while leaves := {name for name, found in needs.items() if not found}:
        needs = {name: found - leaves for name, found in needs.items() if name not in leaves}
    assert not needs


def test_plugins_import_public_names_only():
    """A plugin of this project uses nothing that another's could not rely on."""
    private = [
        f"{path.relative_to(ROOT)}:{line}: from {module} import {', '.join(names)}"
        for path in sorted((ROOT / "plugins").glob("*/gem_*/**/*.py"))
        for line, module, names in imports(path)
        if module.split(".")[0] == "gem_core"
        and (module not in PUBLIC or any(name.startswith("_") and name != "__version__" for name in names))
    ]
    assert not private
