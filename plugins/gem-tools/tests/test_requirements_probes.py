"""Whether there is bubblewrap, as ``gem doctor`` and ``make`` ask."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from gem_tools.requirements import bubblewrap


@pytest.mark.parametrize(
    ("script", "status", "detail"),
    [
        ("#!/bin/sh\nexit 0\n", "met", "a sandbox starts"),
        ("#!/bin/sh\necho 'bwrap: no permission' >&2\nexit 1\n", "unmet", "it fails: bwrap: no permission"),
    ],
)
def test_bubblewrap_is_tried(
    script: str, status: str, detail: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Being on the PATH is not enough: many systems refuse user namespaces."""
    bwrap = tmp_path / "bwrap"
    bwrap.write_text(script)
    bwrap.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    finding = bubblewrap("", closely=True)
    assert (finding.status, finding.detail) == (status, detail)
