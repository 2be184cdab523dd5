"""``.dockerignore``: which files of a build's folder are not part of it."""

from __future__ import annotations

import re
from pathlib import Path

from gem_terminal.errors import TaskError

_MOST_PATTERNS = 1000
_PIECE = re.compile(r"\*\*/|\*\*|\*|\?|\[[^\]]+\]|\\.|.", re.DOTALL)
_SPECIAL = re.compile(r"[\\\[&~|^]")


class Ignored:
    """The patterns of a ``.dockerignore``; the last that matches counts.

    Args:
        text: What the file says.
    """

    def __init__(self, text: str) -> None:
        self._rules: list[tuple[bool, re.Pattern[str]]] = []
        for line in text.removeprefix("\ufeff").splitlines():
            pattern = line.strip()
            if pattern.startswith("#"):
                continue
            kept = pattern.startswith("!")
            pattern = "/".join(part for part in pattern.removeprefix("!").strip().split("/") if part not in ("", "."))
            if pattern:
                self._rules.append((kept, _compiled(pattern)))
        if len(self._rules) > _MOST_PATTERNS:
            raise TaskError(f".dockerignore has {len(self._rules)} patterns; at most {_MOST_PATTERNS} are read")
        self.makes_exceptions = any(kept for kept, _ in self._rules)

    def __call__(self, path: str) -> bool:
        """Return whether a path, relative to the folder, is left out; what is in a folder goes with it."""
        parts = path.split("/")
        above = ["/".join(parts[:count]) for count in range(1, len(parts) + 1)]
        left_out = False
        for kept, pattern in self._rules:
            if left_out == kept and any(pattern.fullmatch(each) for each in above):
                left_out = not kept
        return left_out


def read(context: Path, dockerfile: str) -> Ignored:
    """Return what a build leaves out: the Dockerfile's own ``.dockerignore`` comes before that of the folder.

    Raises:
        TaskError: It cannot be read.
    """
    for path in (context / f"{dockerfile}.dockerignore", context / ".dockerignore"):
        try:
            return Ignored(path.read_text("utf-8"))
        except FileNotFoundError:
            continue
        except (OSError, UnicodeDecodeError) as error:
            raise TaskError(f"{path} cannot be read: {error}") from error
    return Ignored("")


def _compiled(pattern: str) -> re.Pattern[str]:
    """Return a pattern of Go's ``filepath.Match``, with ``**`` for any number of folders, as a regular expression."""
    if len(pattern) > 1000 or pattern.count("*") > 10:
        raise TaskError(f".dockerignore has a pattern with too much in it: {pattern[:80]!r}")
    try:
        return re.compile(_PIECE.sub(_translated, pattern), re.DOTALL)
    except re.error as error:
        raise TaskError(f".dockerignore has a pattern that cannot be read: {pattern[:80]!r}") from error


def _translated(piece: re.Match[str]) -> str:
    text = piece[0]
    fixed = {"**/": "(?:.*/)?", "**": ".*", "*": "[^/]*", "?": "[^/]"}.get(text)
    if fixed is not None:
        return fixed
    if len(text) > 2 and text.startswith("["):
        negated = text[1] in "^!"
        inner = _SPECIAL.sub(r"\\\g<0>", text[1 + negated : -1])
        return f"[{'^' * negated}{inner}]"
    return re.escape(text.removeprefix("\\") or text)
