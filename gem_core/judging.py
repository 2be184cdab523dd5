"""The prompt of a model that judges, and the verdict in its reply."""

from __future__ import annotations

import json
import re
from typing import Any

from gem_core.parsing import without_thinking

_OTHER_LINE_ENDS = str.maketrans({"\x85": "\\u0085", "\u2028": "\\u2028", "\u2029": "\\u2029"})


def json_line(value: Any) -> str:
    """Return plain data as JSON on one line, also for a reader to whom U+2028 or U+0085 begins another one."""
    return json.dumps(value, ensure_ascii=False).translate(_OTHER_LINE_ENDS)


def read_verdict(reply: str, *verdicts: str) -> str | None:
    """Return the verdict on the last line of a reply, as in ``VERDICT: CORRECT``; None without a clear one.

    Thinking is left out. Case and the marks of Markdown do not count. A reply with two verdicts that differ has none.

    Args:
        reply: Text of the model.
        *verdicts: In capitals.
    """
    marks = r"[*_`#>.\s-]*+"
    pattern = re.compile(rf"{marks}verdict{marks}:{marks}({'|'.join(verdicts)}){marks}", re.IGNORECASE)
    lines = [pattern.fullmatch(line) for line in without_thinking(reply).split("\n") if line.strip()]
    found = {line[1].upper() for line in lines if line is not None}
    return found.pop() if len(found) == 1 and lines[-1] is not None else None
