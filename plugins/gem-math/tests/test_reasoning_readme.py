"""The example of the README about ReasoningGym runs as it stands."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gem_core.parsing import extract_code_blocks

README = Path(__file__).parent.parent / "README.md"


def test_the_example_runs() -> None:
    """And its environments ask what it says they ask."""
    (code,) = [block.code for block in extract_code_blocks(README.read_text("utf-8"), "python") if '"rg:' in block.code]
    names: dict[str, Any] = {}
    exec(compile(code, str(README), "exec"), names)
    assert names["terminated"]
    assert names["info"]["parsed_action"] == "42"
    assert names["mixed"].reset(seed=1)[1]["source"] in ("leg_counting", "maze")
    assert names["harder"].reset(seed=1)[0]
