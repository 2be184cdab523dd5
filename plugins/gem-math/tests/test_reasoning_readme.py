"""The example of the guide to ReasoningGym runs as it stands."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gem_core.parsing import extract_code_blocks

pytest.importorskip("reasoning_gym", reason="rg:* needs gem-math[reasoning-gym], which needs a C compiler")

GUIDE = Path(__file__).parents[3] / "docs" / "reasoning-gym.md"


def test_the_example_runs() -> None:
    """And its environments ask what it says they ask."""
    (code,) = [block.code for block in extract_code_blocks(GUIDE.read_text("utf-8"), "python") if '"rg:' in block.code]
    names: dict[str, Any] = {}
    exec(compile(code, str(GUIDE), "exec"), names)
    assert names["terminated"]
    assert names["info"]["parsed_action"] == "42"
    assert names["mixed"].reset(seed=1)[1]["source"] in ("leg_counting", "maze")
    assert names["harder"].reset(seed=1)[0]
