"""What the tests of this plugin share."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from counting import CountingRunner
from hypothesis import settings
from judging import Judge, grade

if TYPE_CHECKING:
    from gem_code.verdicts import Verdict

# How long an example takes is a matter of the machine, and of what else runs on it.
settings.register_profile("gem", deadline=None)
settings.load_profile("gem")

SHARED_DATA = Path(__file__).resolve().parents[4] / "shared" / "data"


@pytest.fixture
def judge() -> Judge:
    """Grades a program in the sandbox: ``judge(code, tests, entry=None, prompt=None, **grading)``."""

    def run(code: str, tests: Any, entry: str | None = None, prompt: str | None = None, **options: Any) -> Verdict:
        return grade(code, tests, options.pop("runner", None) or CountingRunner(), entry, prompt, **options)

    return run


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of public data sets, beside the repository or where GEM_SHARED_DATA says; skips where there is none."""
    folder = Path(os.environ.get("GEM_SHARED_DATA", SHARED_DATA))
    if not folder.is_dir():
        pytest.skip(f"there is no {folder}, whose licence terms keep it out of the repository")
    return folder
