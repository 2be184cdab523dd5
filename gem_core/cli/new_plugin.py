"""Writes a new plugin: a distribution that installs, registers, and passes its own tests."""

from __future__ import annotations

import keyword
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from gem_core.errors import ArgumentError

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable


class Kind(NamedTuple):
    """What is written of one thing that a plugin offers, in its README.

    Args:
        noun: What it is.
        offer: What the one that is written does.
    """

    noun: str
    offer: str


KINDS = {
    "env": Kind("an environment", "`@name@:Letters-v0`, a game: find a hidden word, letter by letter."),
    "tool": Kind("a tool", "the tool `@slug@_note`, which keeps notes during an episode."),
    "wrapper": Kind("a wrapper", "the wrapper `@slug@_length`: long responses cost a part of the reward."),
    "dataset": Kind("a data set", "`@name@:Capitals-v0`, a data set: the questions of `capitals.jsonl`."),
    "agent": Kind("an agent", "the agent `@slug@_last`, which answers with the last word that it reads."),
    "command": Kind("a command", "the command `gem @name@-returns`: what the episodes of a file came to."),
    "backend": Kind("a vector backend", "the vector backend `@slug@_threads`, a fixed number of threads."),
}
LICENSES = ("Apache-2.0", "none")

_NAME = re.compile(r"[a-z][a-z0-9]*([-_.]?[a-z0-9]+)*", re.ASCII)
_MAX_NAME = 30
_TAKEN = {"core", "new"}
_ENV_SPECS = {
    "env": ("Letters", "env:LettersEnv", "Find a hidden word, letter by letter."),
    "dataset": ("Capitals", "dataset:CapitalsEnv", "Name the capital of a country."),
}


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
    example = "take letters, digits and hyphens, beginning with a letter, as in 'my-games'"
    if not _NAME.fullmatch(bare) or len(bare) > _MAX_NAME:
        raise ArgumentError(f"{name[:100]!r} cannot be the name of a plugin; {example}")
    normal = re.sub(r"[-_.]+", "-", bare)
    slug = normal.replace("-", "_")
    if normal in _TAKEN or normal == "gem" or keyword.iskeyword(slug) or f"gem_{slug}" in sys.stdlib_module_names:
        raise ArgumentError(f"{name!r} is a word with a meaning of its own; choose another name")
    return Names(normal, f"gem-{normal}", f"gem_{slug}", slug)


def render(names: Names, kinds: Sequence[str], license_name: str = "Apache-2.0") -> dict[str, str]:
    """Return the text of every file of a new plugin, by its path in the distribution."""
    folder = files("gem_core.cli.templates") / "plugin"
    chosen = [kind for kind in KINDS if kind in kinds]
    words = {**vars(names), **_words(names, folder, chosen, license_name)}

    def filled(*path: str) -> str:
        text = (folder.joinpath(*path)).read_text(encoding="utf-8")
        for _ in range(2):  # what is filled in holds words itself
            for word, value in words.items():
                text = text.replace(f"@{word}@", value)
        return text

    package = names.package
    written = {
        "pyproject.toml": filled("pyproject.toml.tmpl"),
        "README.md": filled("README.md.tmpl"),
        ".gitignore": filled("gitignore.tmpl"),
        ".github/workflows/tests.yml": filled("github", "tests.yml.tmpl"),
        f"{package}/__init__.py": filled("package", "__init__.py.tmpl"),
        f"{package}/_plugin.py": filled("package", "_plugin.py.tmpl"),
        f"{package}/py.typed": "",
        f"tests/test_{package}.py": filled("tests", "test_plugin.py.tmpl"),
    }
    for kind in chosen:
        test = filled("tests", f"{kind}.tmpl")
        # Where the package stands among the imports depends on its name.
        test = re.sub(r"(?m)(^from gem_.*\n)+", lambda block: "".join(sorted(block[0].splitlines(True))), test)
        written[f"tests/test_{package}_{kind}.py"] = test
        written[f"{package}/{kind}.py"] = filled("package", f"{kind}.py.tmpl")
    if "dataset" in chosen:
        written[f"{package}/capitals.jsonl"] = filled("package", "capitals.jsonl.tmpl")
    return written


def write(target: Path, texts: dict[str, str]) -> None:
    """Write the files of a plugin into a folder that is not there yet, or is empty.

    Raises:
        ArgumentError: There is something already; nothing is ever overwritten.
    """
    if target.is_symlink() or (target.exists() and not target.is_dir()):
        raise ArgumentError(f"{target} is there already, and is no folder; choose another with --into")
    if target.is_dir() and any(target.iterdir()):
        raise ArgumentError(f"the folder {target} is there already, and is not empty; choose another with --into")
    for name, text in texts.items():
        path = target / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("x", encoding="utf-8", newline="\n") as file:
            file.write(text)


def first_steps(names: Names, kinds: Sequence[str]) -> str:
    """Return the command that tries a new plugin."""
    if "env" in kinds or "dataset" in kinds:
        env = "Letters-v0" if "env" in kinds else "Capitals-v0"
        around = ",".join(_wrappers(names, kinds))
        return f"gem run {names.name}:{env} --episodes 5 --seed 1" + (f" --wrappers {around}" if around else "")
    return f"gem plugins {names.name}"


def _wrappers(names: Names, kinds: Sequence[str]) -> list[str]:
    found = {"tool": f"{names.slug}_note", "wrapper": f"{names.slug}_length"}
    return [name for kind, name in found.items() if kind in kinds]


def _words(names: Names, folder: Traversable, kinds: Sequence[str], license_name: str) -> dict[str, str]:
    envs = [
        f'EnvSpec(\n    id="@name@:{env}-v0",\n    entry_point="@package@.{entry_point}",\n    summary="{summary}",\n),'
        for env, entry_point, summary in (_ENV_SPECS[kind] for kind in kinds if kind in _ENV_SPECS)
    ]
    with_hooks = [kind for kind in KINDS if kind in kinds or (kind == "env" and envs)]
    hooks = "".join(
        (folder / f"hooks_{kind}.tmpl").read_text(encoding="utf-8") for kind in with_hooks if kind != "dataset"
    )
    dependencies = ['"gem-core>=0.1"', *(['"click>=8.1"'] if "command" in kinds else [])]
    dependencies += ['"pydantic>=2.8"'] if "tool" in kinds else []
    nouns = [KINDS[kind].noun for kind in kinds]
    described = nouns[0] if len(nouns) == 1 else f"{', '.join(nouns[:-1])} and {nouns[-1]}"
    return {
        "description": f"A plugin of GEM with {described}.",
        "license": "" if license_name == "none" else f'license = "{license_name}"\n',
        "dependencies": ", ".join(dependencies),
        "specs": ", ".join(sorted(set(re.findall(r"\w+Spec", "".join([*envs, hooks]))))),
        "hooks": hooks.rstrip("\n"),
        "envs": "\n".join(envs).replace("\n", "\n        "),
        "offers": "It offers:\n\n" + "\n".join(f"- {KINDS[kind].offer}" for kind in kinds),
        "files": "".join(f"- `@package@/{kind}.py` holds {KINDS[kind].noun}.\n" for kind in kinds),
        "try": first_steps(names, kinds),
    }
