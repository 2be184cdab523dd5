"""Imports a file of ``examples/trainers`` without its framework, for which stand-ins with its fields take the place."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

TRAINERS = Path(__file__).parents[3] / "examples" / "trainers"


def import_trainer(monkeypatch: pytest.MonkeyPatch, name: str, stand_ins: dict[str, dict[str, Any]]) -> Any:
    """Return a file of ``examples/trainers`` as a module.

    Args:
        monkeypatch: Takes the stand-ins away after the test.
        name: Of the file.
        stand_ins: What each module of the framework offers, by the module's name.
    """
    path = TRAINERS / f"{name}.py"
    if not path.exists():
        pytest.skip("the examples are not beside this distribution")
    for module, offered in stand_ins.items():
        stand_in = ModuleType(module)
        vars(stand_in).update(offered)
        monkeypatch.setitem(sys.modules, module, stand_in)
    spec = importlib.util.spec_from_file_location(f"trainer_{name}", path)
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, loaded)
    spec.loader.exec_module(loaded)
    return loaded
