"""No code reads the data of GEM's plugins, which hold answers of tasks."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from gem_tools.python import Pool
from gem_tools.python.hidden import hidden_folders, plugin_folders
from gem_tools.requirements import bubblewrap

VICTIM = "iniconfig"  # comes with pytest, and stands here for a plugin


@pytest.fixture
def plugin(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The folder of an installed package that is taken for a plugin's."""
    entry = importlib.metadata.EntryPoint("victim", f"{VICTIM}._plugin", "gem.plugins")
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda **_: [entry])
    spec = importlib.util.find_spec(VICTIM)
    assert spec is not None
    return next(iter(spec.submodule_search_locations or []))


def test_installed_plugins_are_found() -> None:
    """At least the one that this is."""
    assert "gem_tools" in {os.path.basename(folder) for folder in plugin_folders()}


def test_a_plugin_is_hidden_where_it_would_show(plugin: str, tmp_path: Path) -> None:
    """By its path inside the sandbox; elsewhere there is nothing to hide."""
    assert plugin_folders() == [plugin]
    above = os.path.dirname(os.path.dirname(plugin))
    assert hidden_folders([(above, "/venv/lib")]) == [f"/venv/lib/{os.path.relpath(plugin, above)}"]
    assert hidden_folders([(str(tmp_path), "/data")]) == []
    assert hidden_folders([(f"{plugin}-other", "/data")]) == []


@pytest.mark.skipif(
    bubblewrap("", closely=True).status != "met", reason="bubblewrap is not installed, or may not start here"
)
def test_code_finds_nothing_of_a_plugin(plugin: str) -> None:
    """Its folder is empty and cannot be written; other packages are there."""
    pool = Pool("bubblewrap", num_workers=1)
    try:
        outcome = pool.run(
            "import os, sys, pluggy\n"
            f"folders = [os.path.join(path, {VICTIM!r}) for path in sys.path]\n"
            "found = [folder for folder in folders if os.path.isdir(folder)]\n"
            "print(len(found), [os.listdir(folder) for folder in found])\n"
            "try:\n    open(found[0] + '/x', 'w')\nexcept OSError as error:\n    print(error.strerror)\n"
        )
    finally:
        pool.close()
    assert outcome.stdout.splitlines()[0] == "1 [[]]", outcome
    assert outcome.stdout.splitlines()[1] in ("Read-only file system", "Permission denied")
