"""What of an interpreter's libraries no sandbox shows: packages of GEM's plugins, whose data hold answers of tasks."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
from collections.abc import Sequence


def hidden_folders(mounts: Sequence[tuple[str, str]]) -> list[str]:
    """Return the folders of plugins that would show in a sandbox, by the paths that they would have there.

    Args:
        mounts: What is shown, each with the path that it has there.
    """
    found = []
    for folder in plugin_folders():
        for source, target in mounts:
            inside = os.path.relpath(os.path.realpath(folder), os.path.realpath(source))
            if not inside.startswith(os.pardir):
                found.append(os.path.normpath(os.path.join(target, inside)))
    return sorted(set(found))


def plugin_folders() -> list[str]:
    """Return where the packages of all installed plugins lie; none of them is imported."""
    packages = {entry.module.partition(".")[0] for entry in importlib.metadata.entry_points(group="gem.plugins")}
    folders: list[str] = []
    for package in packages:
        try:
            spec = importlib.util.find_spec(package)
        except (ImportError, ValueError):  # a plugin that is broken has nothing to show
            continue
        folders += list((spec.submodule_search_locations if spec is not None else None) or [])
    return [folder for folder in folders if os.path.isdir(folder)]
