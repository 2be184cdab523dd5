"""The example of the guide about figures runs as it stands."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from gem_core.parsing import extract_code_blocks

if TYPE_CHECKING:
    import pytest

GUIDE = Path(__file__).parents[3] / "docs" / "mathematics.md"


def test_the_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """It writes the figure, and its answer is right."""
    monkeypatch.chdir(tmp_path)
    blocks = extract_code_blocks(GUIDE.read_text("utf-8"), "python")
    (code,) = [block.code for block in blocks if "math:GeometrySample" in block.code]
    names: dict[str, Any] = {}
    exec(compile(code, str(GUIDE), "exec"), names)
    assert names["reward"] == 1.0
    assert (tmp_path / "figure.png").stat().st_size > 1_000
    assert "How long is the side BC" in capsys.readouterr().out
