"""Writes a new plugin: a distribution that installs, registers, and passes its own tests."""

from __future__ import annotations

import keyword
import re
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from gem_core.errors import ArgumentError

_TEMPLATES = files("gem_core.cli.templates") / "plugin"
KINDS: dict[str, dict[str, Any]] = tomllib.loads((_TEMPLATES / "kinds.toml").read_text(encoding="utf-8"))
"""What is written of each thing that a plugin may offer."""

_NAME = re.compile(r"[a-z](?:[-_.]?[a-z0-9]){0,29}", re.ASCII)
_TAKEN = {"core", "new", "gem"}


@dataclass(frozen=True)
class Names:
    """What a plugin is called in each place, as for ``my-games``.

    Args:
        name: The entry point, and the namespace of its ids: ``my-games``.
        distribution: What is installed: ``gem-my-games``.
        package: What is imported: ``gem_my_games``.
        slug: What tools and wrappers begin with: ``my_games``.
    """

    name: str
    distribution: str
    package: str
    slug: str


def names_of(name: str) -> Names:
    """Return the names of a plugin.

    Args:
        name: Letters, digits and single hyphens, beginning with a letter; a leading ``gem-`` is dropped.

    Raises:
        ArgumentError: It cannot be the name of a distribution and a package.
    """
    bare = re.sub(r"^gem[-_.]", "", name.lower())
    if not _NAME.fullmatch(bare):
        example = "take at most 30 letters, digits and hyphens, beginning with a letter, as in 'my-games'"
        raise ArgumentError(f"{name[:100]!r} cannot be the name of a plugin; {example}")
    normal = re.sub(r"[_.]", "-", bare)
    slug = normal.replace("-", "_")
    if normal in _TAKEN or keyword.iskeyword(slug) or f"gem_{slug}" in sys.stdlib_module_names:
        raise ArgumentError(f"{name!r} is a word with a meaning of its own; choose another name")
    return Names(normal, f"gem-{normal}", f"gem_{slug}", slug)


def render(names: Names, kinds: Sequence[str]) -> dict[str, str]:
    """Return the text of every file of a new plugin, by its path in the distribution."""
    chosen = {kind: KINDS[kind] for kind in KINDS if kind in kinds}
    specs = [each["spec"].strip() for each in chosen.values() if "spec" in each]
    hooked = {"env" if kind == "dataset" else kind for kind in chosen}
    hooks = "".join(_template(f"hooks_{kind}") for kind in KINDS if kind in hooked)
    needed = ["gem-core>=0.1", *(each["dependency"] for each in chosen.values() if "dependency" in each)]
    words = {
        "description": f"A plugin of GEM with {', '.join(each['noun'] for each in chosen.values())}.",
        "dependencies": ", ".join(f'"{each}"' for each in needed),
        "hooks": hooks.rstrip("\n"),
        "envs": "\n        ".join(specs),
        "specs": ", ".join(sorted(set(re.findall(r"\w+Spec", "".join([*specs, hooks]))))),
        "offers": "It offers:\n\n" + "\n".join(f"- {each['offer']}" for each in chosen.values()),
        "files": "".join(f"- `@package@/{kind}.py` holds {each['noun']}.\n" for kind, each in chosen.items()),
        "try": first_steps(names, kinds),
        **vars(names),  # last, as the others hold them
    }
    package = names.package
    sources = {
        "pyproject.toml": "pyproject.toml",
        "README.md": "README.md",
        ".gitignore": "gitignore",
        ".github/workflows/tests.yml": "github/tests.yml",
        f"{package}/__init__.py": "package/__init__.py",
        f"{package}/_plugin.py": "package/_plugin.py",
        f"tests/test_{package}.py": "tests/test_plugin.py",
        **{f"{package}/{kind}.py": f"package/{kind}.py" for kind in chosen},
        **{f"tests/test_{package}_{kind}.py": f"tests/{kind}" for kind in chosen},
        **({f"{package}/capitals.jsonl": "package/capitals.jsonl"} if "dataset" in chosen else {}),
    }
    texts = {path: _filled(_template(source), words) for path, source in sources.items()}
    # Where the package stands among the imports of a test depends on its name.
    texts = {
        path: re.sub(r"(?m)(^from gem_.*\n)+", lambda block: "".join(sorted(block[0].splitlines(True))), text)
        for path, text in texts.items()
    }
    return {**texts, f"{package}/py.typed": ""}


def write(target: Path, texts: dict[str, str]) -> None:
    """Write the files of a plugin into a folder that is not there yet, or is empty.

    Raises:
        ArgumentError: There is something already; nothing is ever overwritten.
    """
    if target.is_symlink() or (target.exists() and (not target.is_dir() or any(target.iterdir()))):
        raise ArgumentError(f"{target} is there already, and is no empty folder; choose another with --into")
    for name, text in texts.items():
        path = target / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8", newline="\n")


def first_steps(names: Names, kinds: Sequence[str]) -> str:
    """Return the command that tries a new plugin."""
    tried = next((KINDS[kind]["try"] for kind in KINDS if kind in kinds and "try" in KINDS[kind]), None)
    if tried is None:
        return f"gem plugins {names.name}"
    around = ",".join(name for kind, name in (("tool", "@slug@_note"), ("wrapper", "@slug@_length")) if kind in kinds)
    return _filled(tried + (f" --wrappers {around}" if around else ""), vars(names))


def _template(name: str) -> str:
    return (_TEMPLATES / f"{name}.tmpl").read_text(encoding="utf-8")


def _filled(text: str, words: dict[str, str]) -> str:
    for word, value in words.items():
        text = text.replace(f"@{word}@", value)
    return text
