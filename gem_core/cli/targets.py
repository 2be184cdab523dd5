"""What an argument of the command line means: an id, a glob, a folder, a class in a file, or a file of questions."""

from __future__ import annotations

import importlib
import os
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import click

from gem_core.cli.list_command import matching
from gem_core.errors import ArgumentError, UnknownEnvError
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.lookup import registry
from gem_core.registry.requirements import unmet
from gem_core.registry.specs import EnvSpec

_FILE = re.compile(r"(?P<file>.+\.py):(?P<name>\w+)", re.DOTALL)
_NOT_IN_IDS = re.compile(r"[^\w.-]+", re.ASCII)
_ASK_FOR_A_BOX = "{question}\n\nWrite your answer inside \\boxed{}."


def find_env(word: str) -> tuple[EnvSpec, dict[str, Any]]:
    """Return the record of what a word names, and keyword arguments for it: the folder, if one was given.

    A word is an id, a folder that belongs to an environment, a class in a file as ``my_env.py:MyEnv``, or a file of
    questions. The last two are registered, as ``my_env:MyEnv`` and ``file:questions``, also for worker processes.

    Raises:
        ArgumentError: The file cannot be registered under its name.
        UnknownEnvError: There is no such environment, file or folder, or the folder belongs to no environment.
    """
    path = Path(word)
    if match := _FILE.fullmatch(word):
        return _env_of_class(Path(match["file"]), match["name"]), {}
    if _is_data(path) and (path.is_file() or ":" not in word):
        return _env_of_questions(path), {}
    if ":" in word or not (path.is_dir() or os.sep in word):
        return registry().env(word), {}
    if not path.is_dir():
        raise UnknownEnvError(f"there is no folder {word!r}")
    record = registry().env_of_folder(path)
    return record, {record.folder_keyword: word}


def import_envs(word: str) -> None:
    """Import a module, or a file, that registers environments; or register a class in a file as ``find_env`` does.

    Raises:
        ArgumentError: It cannot be imported.
    """
    if word.endswith(".py"):
        _module_of(Path(word))
    elif _FILE.fullmatch(word):
        find_env(word)
    else:
        _imported(word, f"--import {word}")


def _env_of_class(path: Path, name: str) -> EnvSpec:
    """Register a class, or function that returns an environment, in a file."""
    module = _module_of(path)
    maker = load_entry_point(f"{module.__name__}:{name}", str(path))
    record = EnvSpec(
        id=f"{module.__name__}:{name}",
        entry_point=f"{module.__name__}:{name}",
        summary=((maker.__doc__ if isinstance(maker, type) else "") or "").strip().partition("\n")[0],
        seats=tuple(getattr(maker, "possible_agents", ())) if isinstance(maker, type) else (),
    )
    registry().add(record)
    return record


def _module_of(path: Path) -> ModuleType:
    """Import a file as a module of its name, which workers find by the same path of modules."""
    if not path.is_file():
        raise UnknownEnvError(f"there is no file {str(path)!r}")
    folder = str(path.resolve().parent)
    if folder not in sys.path:
        sys.path.insert(0, folder)
    module = _imported(path.stem, str(path)) if path.stem.isidentifier() else None
    if module is None or not module.__file__ or not path.samefile(module.__file__):
        raise ArgumentError(f"{path} cannot be imported as the module {path.stem!r}: give the file another name")
    return module


def _imported(name: str, owner: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except (Exception, SystemExit) as error:  # third-party code may raise anything while it is imported
        raise ArgumentError(f"{owner}: importing {name!r} failed: {type(error).__name__}: {error}") from error


def _is_data(path: Path) -> bool:
    from gem_core.data.rows import ENDINGS, ending  # here, so that completion need not wait for it

    return ending(path) in ENDINGS


def _env_of_questions(path: Path) -> EnvSpec:
    """Register the rows of a file as a ``DatasetEnv``."""
    if not path.is_file():
        raise UnknownEnvError(f"there is no file {str(path)!r}")
    name = _NOT_IN_IDS.sub("-", path.name.partition(".")[0]).strip("-._") or "rows"
    kwargs = {"dataset_name": str(path.resolve()), "prompt_template": _ASK_FOR_A_BOX}
    record = EnvSpec(id=f"file:{name}", entry_point="gem_core:DatasetEnv", kwargs=kwargs, summary=f"Rows of {path}.")
    present = next((each for each in registry().envs() if each.id == record.id), record)
    if present.kwargs != record.kwargs:
        raise ArgumentError(f"{path} and {present.kwargs.get('dataset_name')} are both {record.id}: rename one of them")
    registry().add(record)
    return record


def find_envs(given: tuple[str, ...], *, several: bool) -> list[tuple[EnvSpec, dict[str, Any]]]:
    """Return the environments that words and globs stand for, each with its keyword arguments, and each once.

    Args:
        given: What was typed.
        several: Whether a glob stands for environments of several agents, where it matches those of one as well.
    """
    expanded: list[tuple[EnvSpec, dict[str, Any]]] = []
    for each in given:
        if not any(character in each for character in "*?["):
            expanded.append(find_env(each))
            continue
        records = matching(each)
        of_kind = [record for record in records if bool(record.seats) == several] or records
        kept = [record for record in of_kind if not unmet(record.requires)] or of_kind
        left_out = ", ".join(record.id for record in records if record not in kept)
        if left_out:
            kind = "several agents" if several else "one agent"
            click.echo(f"gem: left out as not for {kind}, or as unable to run here: {left_out}", err=True)
        expanded += [(record, {}) for record in kept]
    return [one for place, one in enumerate(expanded) if one not in expanded[:place]]
