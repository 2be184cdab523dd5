r"""Find answers in responses, in ``\boxed{}``, ``<answer>`` tags and fenced code; and the thinking before them.

Every function here takes any text at all and needs time in proportion to its length.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import NamedTuple

THINKING_MARKS = (
    ("<thinking>", "</thinking>"),
    ("<thought>", "</thought>"),
    ("[THINK]", "[/THINK]"),  # Mistral
    ("<seed:think>", "</seed:think>"),  # Seed-OSS
    ("<mm:think>", "</mm:think>"),  # MiniMax M3
    ("<longcat_think>", "</longcat_think>"),
    ("◁think▷", "◁/think▷"),  # Kimi-VL
    ("<|START_THINKING|>", "<|END_THINKING|>"),  # Cohere
    ("<|channel|>analysis<|message|>", "<|end|>"),  # gpt-oss
    ("<|channel>thought", "<channel|>"),  # Gemma 4
)
"""The marks that model families put around thinking; most use ``<think>…</think>``, whose tag callers may replace."""

_ENDS_OF_ANYTHING = ("<|end|>", "<channel|>")

# Tokens that some servers leave at the end of a response; they are no part of it.
_END_TOKENS = (
    "<end_code>", "<end_of_turn>", "<turn|>", "</s>", "<|im_end|>", "<|eot_id|>", "<|eom_id|>", "<|end|>", "<|return|>",
    "<|endoftext|>", "<|end_of_text|>", "<｜end▁of▁sentence｜>",
)  # fmt: skip
_MOST_END_TOKENS = 5
_LINE_BREAKS = re.compile(r"\n{3,}+")

_BOXED = "\\boxed"
# A backslash escapes the character after it, so that LaTeX's \{ and \} do not count as braces. The start of
# a box is never taken out: models that escape twice write \\boxed{7} and mean a box.
_BRACE_OR_BOX = re.compile(r"\\boxed[ \t]*+\{|\\(?!\\boxed[ \t]*+\{).|[{}]", re.DOTALL)
# Possessive, so that a long line that is no fence after all is not tried again from each of its characters.
_FENCE = re.compile(r"^([ \t]*+)(?:(`{3,}+)[ \t]*+([^\s`]*+)[^\n`]*+|(~{3,}+)[ \t]*+([^\s]*+)[^\n]*+)$", re.MULTILINE)


class CodeBlock(NamedTuple):
    """A fenced block of code.

    Args:
        language: First word after the opening fence, in lower case; ``""`` if there is none.
        code: Text between the fences, without the last line break and the indentation of the opening fence.
        start: Index of the opening fence in the text.
        end: Index after the closing fence.
    """

    language: str
    code: str
    start: int
    end: int


def without_thinking(action: str, tag: str = "think") -> str:
    """Return a response without its thinking, which holds no answer and no word to others.

    Templates often open the block in the prompt, so that a response holds only the end of it: all up to the last
    closing tag goes. A block that is never closed goes to the end.
    """
    opening, closing = f"<{tag}>", f"</{tag}>"
    end = action.rfind(closing)
    first = action.find(opening)
    if end >= 0:
        before = action[:first] if 0 <= first < end else ""
        action = before + action[end + len(closing) :].lstrip()
    action = action.partition(opening)[0]
    for opening, closing in THINKING_MARKS:
        end = -1 if closing in _ENDS_OF_ANYTHING else action.find(closing)
        if end >= 0 and opening not in action[:end]:
            action = action[end + len(closing) :]
        if opening in action:
            before, *blocks = action.split(opening)
            action = before + "".join(block.partition(closing)[2] for block in blocks)
    return action


def thinking_blocks(text: str, tag: str | None = "think") -> tuple[list[tuple[int, int]], bool]:
    """Return the closed thinking blocks, and whether the first was opened before the response, as templates do.

    Args:
        text: A response.
        tag: Name of the tag around thinking, beside ``THINKING_MARKS``; with None, nothing is thinking.
    """
    if tag is None:
        return [], False
    blocks: list[tuple[int, int]] = []
    opened_before = 0
    for opening, closing in [(f"<{tag}>", f"</{tag}>"), *THINKING_MARKS]:
        end = text.find(closing)
        at = 0
        if end >= 0 and closing not in _ENDS_OF_ANYTHING and opening not in text[:end]:
            at = end + len(closing)
            opened_before = max(opened_before, at)
        while end >= 0 and (start := text.find(opening, at)) >= 0 and (end := text.find(closing, start)) >= 0:
            at = end + len(closing)
            blocks.append((start, at))
    return ([(0, opened_before)] if opened_before else []) + blocks, opened_before > 0


def visible_text(action: str, tag: str = "think") -> str:
    """Return the text that other agents see: the response without its thinking, even if the block is not closed."""
    text = without_end_tokens(str.__str__(action))
    thinking = thinking_blocks(text, tag)[0]
    if thinking:
        text = _LINE_BREAKS.sub("\n\n", mask(text, thinking))
    return without_thinking(text, tag).strip()


def without_end_tokens(text: str) -> str:
    """Return a response without the tokens that end a turn."""
    for _ in range(_MOST_END_TOKENS):
        rest = text.rstrip()
        if not rest.endswith(_END_TOKENS):
            break
        text = next(rest.removesuffix(token) for token in _END_TOKENS if rest.endswith(token))
    return text


def mask(text: str, spans: Iterable[tuple[int, int]]) -> str:
    """Return the text with each span replaced by line breaks, so that all other offsets stay."""
    pieces, position = [], 0
    for start, end in sorted(spans):
        if end > position:
            pieces += [text[position:start], "\n" * (end - max(start, position))]
            position = end
    return "".join([*pieces, text[position:]]) if pieces else text


def extract_last_boxed_answer(text: str) -> str | None:
    r"""Return the content of the last complete ``\boxed{}``, without white space around it; None without one.

    Braces may be nested; escaped ones (``\{``) are LaTeX's visible braces and do not count.

    Source: the boxed-answer convention of MATH, arXiv:2103.03874.
    """
    last = text.rfind(_BOXED)
    if last < 0:
        return None
    # Nearly always the last box is complete and plain, so that is tried first.
    content_start = last + len(_BOXED) + 1
    content_end = text.find("}", content_start)
    if content_end >= 0 and text[content_start - 1] == "{":
        content = text[content_start:content_end]
        if content.isalnum():
            return content
        if "{" not in content and "\\" not in content:
            return content.strip()
    # The last box may be incomplete; only then is the text read from its beginning.
    answers = extract_boxed_answers(text[last:]) or extract_boxed_answers(text)
    return answers[-1] if answers else None


def extract_boxed_answers(text: str) -> list[str]:
    r"""Return the contents of all complete ``\boxed{}`` in order, without white space around them.

    Of boxes inside each other only the innermost is returned: together, the contents are no longer than the text.
    """
    open_braces: list[int | None] = []
    answers: list[str] = []
    last_start = -1
    for match in _BRACE_OR_BOX.finditer(text):
        token = match[0]
        if token == "{":
            open_braces.append(None)
        elif len(token) > 2:
            open_braces.append(match.end())
        elif token == "}" and open_braces:
            start = open_braces.pop()
            if start is not None and start > last_start:
                last_start = start
                answers.append(text[start : match.start()].strip())
    return answers


def extract_last_tagged_answer(text: str, tag: str = "answer") -> str | None:
    """Return the content of the last complete ``<tag>…</tag>``, without white space around it; None without one."""
    end = text.rfind(f"</{tag}>")
    while end >= 0:
        opening = f"<{tag}>"
        start = text.rfind(opening, 0, end)
        if start < 0:
            return None
        previous_end = text.rfind(f"</{tag}>", start, end)
        if previous_end < 0:
            return text[start + len(opening) : end].strip()
        # A closing tag without an opening one of its own: the element ends at the closing tag before it.
        end = text.find(f"</{tag}>", start)
    return None


def extract_code_blocks(text: str, *languages: str) -> list[CodeBlock]:
    """Return the complete fenced blocks of a text in order, as CommonMark finds them.

    A fence may be indented by any white space, as inside a list; its indentation is taken off the lines of the block.

    Args:
        text: Markdown.
        *languages: Keep only these languages, whatever their case; ``""`` stands for blocks that name none.

    Source: fenced code blocks of CommonMark 0.31, section 4.5.
    """
    wanted = {language.casefold() for language in languages}
    return [block for block in _fenced(text) if block.end >= 0 and (not wanted or block.language in wanted)]


def unclosed_code_block(text: str, *languages: str) -> CodeBlock | None:
    """Return the fenced block that is opened and never closed, its ``end`` being -1; None without one.

    Args:
        text: Markdown.
        *languages: Return it only if it is in one of these; see ``extract_code_blocks``.
    """
    wanted = {language.casefold() for language in languages}
    for block in _fenced(text):
        if block.end < 0 and (not wanted or block.language in wanted):
            return block
    return None


def _fenced(text: str) -> Iterator[CodeBlock]:
    if "```" not in text and "~~~" not in text:
        return  # what most texts are found out by at once
    opening: re.Match[str] | None = None
    for fence in _FENCE.finditer(text):
        if opening is None:
            opening = fence
        elif _closes(fence, opening):
            yield _block(text, opening, max(fence.start() - 1, opening.end() + 1), fence.end())
            opening = None
    if opening is not None:
        yield _block(text, opening, len(text), -1)


def _closes(fence: re.Match[str], opening: re.Match[str]) -> bool:
    mark, first = fence[2] or fence[4], opening[2] or opening[4]
    return mark[0] == first[0] and len(mark) >= len(first) and not fence[0].strip().strip(mark[0])


def _block(text: str, opening: re.Match[str], code_end: int, end: int) -> CodeBlock:
    code = text[opening.end() + 1 : code_end].removesuffix("\r")
    indent = len(opening[1])
    if indent:
        code = re.sub(rf"^[ \t]{{1,{indent}}}", "", code, flags=re.MULTILINE)
    return CodeBlock((opening[3] or opening[5] or "").casefold(), code, opening.end(1), end)
