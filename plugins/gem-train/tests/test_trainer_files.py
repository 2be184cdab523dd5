"""The files of examples/trainers that need no framework run as they are; `make trainers` runs all of them."""

from __future__ import annotations

import asyncio
import sys
from types import ModuleType

import pytest
from trainer_files import import_trainer


@pytest.mark.parametrize("name", ["rl2_env", "roll_env"])
def test_file_holds_what_it_promises(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each checks an episode token by token."""
    pytest.importorskip("transformers")
    monkeypatch.setenv("GEM_TOKENIZER", "set by the file")
    monkeypatch.setitem(sys.modules, "gem", ModuleType("gem"))
    del sys.modules["gem"]  # what the file for ROLL puts there goes with the test
    result = import_trainer(monkeypatch, name, {}).main()
    if asyncio.iscoroutine(result):
        asyncio.run(result)
    assert capsys.readouterr().out.count("held:") >= 8
