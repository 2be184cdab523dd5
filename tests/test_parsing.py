"""The extractors: right, wrong, malformed and hostile text."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_core import extract_code_blocks, extract_last_boxed_answer, extract_last_tagged_answer
from gem_core.parsing import extract_boxed_answers


def pieces(*words: str) -> st.SearchStrategy[str]:
    """Text that is put together from the words that matter, so that they often meet."""
    return st.lists(st.sampled_from(words), max_size=14).map("".join)


BOXES = pieces("\\boxed{", "\\boxed", "\ud800", "{", "}", "\\", "\\{", "\\}", "a", " ", "\n")
TAGS = pieces("<answer>", "</answer>", "<answer", "</", "a", " ", "\n")
FENCES = pieces("```", "~~~", "````", "`", "~", "python", " ", "\n", "\r\n", "x = 1", "   ")


# \boxed{}


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        (r"so it is \boxed{42}.", "42"),
        (r"\boxed {7}", "7"),
        (r"\boxed{\frac{1}{2}}", r"\frac{1}{2}"),
        (r"\boxed{\{1, 2\}}", r"\{1, 2\}"),
        (r"\boxed{\text{a\}b}}", r"\text{a\}b}"),
        (r"\boxed{a\\}", r"a\\"),
        (r"\boxed{a \boxed{b} c}", "b"),
        (r"\boxed{1} and \boxed{2", "1"),
        (r"\\boxed{7}", "7"),
    ],
)
def test_last_complete_box_is_found(text: str, answer: str) -> None:
    """The last box that is closed counts, with its braces nested or escaped."""
    assert extract_last_boxed_answer(text) == answer


def naive_box(text: str) -> str | None:
    """Try every box from the last to the first, each by counting braces."""
    for start in reversed(range(len(text))):
        rest = text[start:]
        if not rest.startswith("\\boxed"):
            continue
        body = rest[len("\\boxed") :].lstrip(" \t")
        if not body.startswith("{"):
            continue
        depth, position = 1, 1
        while position < len(body):
            if body[position] == "\\" and not body[position + 1 :].startswith("\\boxed"):
                position += 2
                continue
            if body[position] == "\\" and not body[position + 1 + len("\\boxed") :].lstrip(" \t").startswith("{"):
                position += 2
                continue
            depth += {"{": 1, "}": -1}.get(body[position], 0)
            if depth == 0:
                return body[1:position].strip()
            position += 1
    return None


@given(BOXES)
def test_box_agrees_with_a_naive_reading(text: str) -> None:
    """One pass finds what trying every box finds."""
    assert extract_last_boxed_answer(text) == naive_box(text)
    assert (extract_boxed_answers(text) or [None])[-1] == naive_box(text)


# <answer>


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("<answer>4</answer>", "4"),
        ("<answer>1</answer> 2</answer>", "1"),
        ("<answer>a<answer>b</answer>", "b"),
        ("<answer>a < b > c</answer>", "a < b > c"),
    ],
)
def test_last_tag_is_found(text: str, answer: str) -> None:
    """The last element that is closed counts, from its own opening tag."""
    assert extract_last_tagged_answer(text) == answer


def naive_tag(text: str) -> str | None:
    """Of all openings, the last that a closing tag follows, up to the first such."""
    for start in reversed(range(len(text))):
        if text.startswith("<answer>", start):
            end = text.find("</answer>", start)
            if end >= 0:
                return text[start + len("<answer>") : end].strip()
    return None


@given(TAGS)
def test_tag_agrees_with_a_naive_reading(text: str) -> None:
    """Searching from the end finds what trying every opening finds."""
    assert extract_last_tagged_answer(text) == naive_tag(text)


# Fenced code


@pytest.mark.parametrize(
    ("text", "blocks"),
    [
        ("```python\nx = 1\n```", [("python", "x = 1")]),
        ("```Python title=x\nx\n```", [("python", "x")]),
        ("````\n```\nx\n```\n````", [("", "```\nx\n```")]),
        ("~~~\n```\nx\n~~~", [("", "```\nx")]),
        ("~~~ a`b c\nx\n~~~", [("a`b", "x")]),
        ("```python\r\nx = 1\r\ny = 2\r\n```\r\n", [("python", "x = 1\r\ny = 2")]),
        ("  ```python\n  if x:\n    y\n z\n  ```", [("python", "if x:\n  y\nz")]),
        ("1. a list:\n     ```\n     x\n     ```", [("", "x")]),
        ("```\nx\n``` not closed\ny\n```", [("", "x\n``` not closed\ny")]),
    ],
)
def test_blocks_are_found(text: str, blocks: list[tuple[str, str]]) -> None:
    """Fences open and close as in CommonMark, with their language and their code."""
    assert [(block.language, block.code) for block in extract_code_blocks(text)] == blocks


def test_languages_are_chosen_whatever_their_case() -> None:
    """Only the languages asked for are kept; an empty one stands for none."""
    text = "```Python\n1\n```\n```\n2\n```\n```js\n3\n```"
    assert [block.code for block in extract_code_blocks(text, "PYTHON", "")] == ["1", "2"]


def naive_blocks(text: str) -> list[tuple[str, str]]:
    """Read line by line."""
    blocks: list[tuple[str, str]] = []
    fence, language, indent, lines = "", "", 0, []
    for line in text.split("\n"):
        body = line.lstrip(" ")
        margin = len(line) - len(body)
        mark = body[:1]
        run = body[: len(body) - len(body.lstrip(mark))] if mark in ("`", "~") else ""
        info = body[len(run) :]
        if len(run) < 3 or (mark == "`" and "`" in info):
            run = ""
        if not fence:
            if run:
                words = info.strip(" \t").split() if not info[:1].strip(" \t") or info.strip(" \t") else []
                fence, language, indent, lines = run, (words[0] if words else "").casefold(), margin, []
        elif run and run[0] == fence[0] and len(run) >= len(fence) and not info.strip():
            blocks.append((language, "\n".join(lines).removesuffix("\r")))
            fence = ""
        else:
            lines.append(line[min(indent, margin) :])
    return blocks


@given(FENCES)
def test_blocks_agree_with_a_reading_line_by_line(text: str) -> None:
    """The regular expression finds what reading line by line finds."""
    assert [(block.language, block.code) for block in extract_code_blocks(text)] == naive_blocks(text)


# Any text


MEGABYTE = 1_000_000
HOSTILE = [
    *(
        "\\boxed{",
        "\\boxed",
        "\\boxed ",
        " " * 1_000_000,
        "\\\\boxed",
        "{",
        "}",
        "\\",
        "\\boxed{{",
        "\\\\boxed",
        "<answer>",
        "</answer>",
        "<answer",
    ),
    *("<", "```\n", "```", "`", "~", "~~~x ", "```x\n", " ", "\n", "   ```\n"),
]


@pytest.mark.parametrize("unit", HOSTILE)
@pytest.mark.few(6)
def test_megabytes_of_one_unit_finish(unit: str) -> None:
    """A million characters of whatever is worst end; in quadratic time they would take hours."""
    text = unit * (MEGABYTE // len(unit))
    for hostile in (text, text + "\\boxed", "\\boxed{1}" + text):
        extract_last_boxed_answer(hostile)
        assert sum(map(len, extract_boxed_answers(hostile))) <= len(hostile)
    extract_last_tagged_answer(text)
    extract_code_blocks(text)


@pytest.mark.parametrize("filler", [" ", "x", "\t", "`", "~", " x"])
@pytest.mark.parametrize("mark", ["```", "~~~"])
@pytest.mark.parametrize("end", ["`", "\n", ""])
def test_a_fence_with_a_line_of_megabytes_finishes(mark: str, filler: str, end: str) -> None:
    """One endless line behind a fence is read once, not once from each of its characters."""
    assert extract_code_blocks(mark + filler * (1_000_000 // len(filler)) + end) == []
