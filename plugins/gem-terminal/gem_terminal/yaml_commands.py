"""Commands written as YAML, ``cmd`` and ``timeout_secs``, which agents of ``gem-llm`` put between ``<bash>`` tags."""

from __future__ import annotations

import re
from typing import Any

from gem_terminal.errors import TaskError
from gem_terminal.tasks.parsing import parse

MOST_YAML = 50_000
"""Characters that are read as YAML; its reader takes about a second for a megabyte."""

_FIRST_KEY = re.compile(r"\s*+(?:cmd|timeout_secs)\s*+:(?=\s)")
_FORM = "cmd: ls -l\ntimeout_secs: 10"


def looks_like_yaml(content: str) -> bool:
    """Tell whether the content of ``<bash>`` begins as such a command does; no program is called ``cmd:``."""
    return _FIRST_KEY.match(content) is not None


def read_yaml_command(content: str) -> tuple[str, Any] | str:
    """Return the command and its time limit (None where it has none); text where it cannot be read.

    Args:
        content: YAML from anyone.
    """
    if len(content) > MOST_YAML:
        return f"YAML in <bash> may have {MOST_YAML} characters. Write the command itself between <bash> and </bash>."
    try:
        read = parse("YAML", content)
    except TaskError as error:
        return f"The YAML in <bash> {error} Write the command itself, or\n{_FORM}"
    if not isinstance(read, dict) or not isinstance(read.get("cmd"), str):
        return f"YAML in <bash> must have the command as text under cmd, as in\n{_FORM}"
    unknown = next((key for key in read if key not in ("cmd", "timeout_secs")), None)
    if unknown is not None:
        return f"YAML in <bash> has no {unknown[:50]!r}; there are cmd and timeout_secs, as in\n{_FORM}"
    return read["cmd"], read.get("timeout_secs")
