"""Find the program in a response."""

from __future__ import annotations

from collections.abc import Sequence

from gem_core.parsing import extract_code_blocks, without_thinking

_FENCE = "```"


def last_program(response: str, languages: Sequence[str]) -> str | None:
    """Return the last fenced block that is marked with one of some languages, or else the last one; None without one.

    What a response shows behind its program, as an example's output, is rarely marked as a program. Thinking is left
    out. Fences stand at the beginnings of lines, as in Markdown; if there are none of that kind, those are taken that
    models glue to a tag or to text, as in ``<answer>```python``.

    Args:
        response: Any text.
        languages: In small letters; ``""`` stands for blocks that name none.
    """
    text = without_thinking(response)
    blocks = extract_code_blocks(text, *languages)
    if blocks:
        return next((block for block in reversed(blocks) if block.language), blocks[-1]).code
    return _last_glued(text, languages)


def _last_glued(text: str, languages: Sequence[str]) -> str | None:
    """Return the last block between two fences that stand anywhere; time in proportion to the length."""
    # Between the first fence and the second is a block, between the second and the third is text, and so on.
    pieces = text.split(_FENCE)
    marked = unmarked = None
    for block in pieces[1:-1:2]:
        language, line_end, code = block.partition("\n")
        name = language.strip().casefold()
        if line_end and name in languages:
            code = code.removesuffix("\n").removesuffix("\r")
            marked, unmarked = (code, unmarked) if name else (marked, code)
    return unmarked if marked is None else marked
