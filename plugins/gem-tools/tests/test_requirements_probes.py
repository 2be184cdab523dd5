"""Whether there is bubblewrap, as ``gem doctor`` and ``make`` ask."""

from __future__ import annotations

from typing import TYPE_CHECKING

from python_levels import why_not

from gem_tools.requirements import bubblewrap

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def test_bubblewrap_is_tried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Being on the PATH is not enough: many systems refuse user namespaces."""
    assert bubblewrap("", closely=True).status == ("met" if why_not("bubblewrap") is None else "unmet")
    program = tmp_path / "bwrap"
    program.write_text("#!/bin/sh\necho 'bwrap: no permission' >&2\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    assert bubblewrap("").status == "met"
    finding = bubblewrap("", closely=True)
    assert finding.status == "unmet"
    assert "no permission" in finding.detail
