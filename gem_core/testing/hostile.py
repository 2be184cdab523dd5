r"""Actions that no environment expects and every environment survives."""

from __future__ import annotations

import json
import random

_LONG = 5_000_000
"""Characters of the longest action."""

_STRUCTURED = 500_000
"""Characters of the long actions with a structure, at which work that grows quadratically cannot go unnoticed."""

_DIGITS_OF_OTHER_SCRIPTS = {
    "Arabic-Indic": "٠١٢٣٤٥٦٧٨٩",
    "Devanagari": "०१२३४५६७८९",
    "Thai": "๐๑๒๓๔๕๖๗๘๙",
    "fullwidth": "０１２３４５６７８９",  # noqa: RUF001
    "mathematical bold": "𝟎𝟏𝟐𝟑𝟒𝟓𝟔𝟕𝟖𝟗",  # noqa: RUF001
    "superscript": "⁰¹²³⁴⁵⁶⁷⁸⁹",
    "circled": "⓪①②③④⑤⑥⑦⑧⑨",
    "Roman": "ⅠⅡⅢⅣⅤⅥⅦⅧⅨⅩ",
}

_NUMBERS = (
    "-0",
    "+7",
    "1e999",
    "-1e999",
    "nan",
    "inf",
    "-Infinity",
    "0x1F",
    "1_000",
    "1,000",
    "½",
    "3.0000000000000001",
    "99999999999999999999",
    "-1",
    "0/0",
    "10**10**10",
    "9" * 5_000,
    "0." + "3" * 5_000,
    "1/" + "7" * 5_000,
)

_FORMATS = (
    "%s%s%s%s%n",
    "%(name)s",
    "{0}{1}{}{{}",
    "{self.__class__.__mro__}",
    "{!r:>99999}",
    "${HOME}",
    "$(id)",
    "`id`",
    "; true #",
    "' OR '1'='1",
    "../../../../etc/passwd",
    "[red]markup[/blue]",
    "__import__('sys').exit(1)",
    "exit()",
    "(?P<a>(a+)+)$",
    "\\1\\g<0>",
)

_BOXES = (
    "\\boxed{",
    "\\boxed",
    "\\boxed{}",
    "\\boxed{ }",
    "\\boxed{{{{}}}}",
    "\\boxed{\\boxed{\\boxed{1}}}",
    "\\boxed{1}\\boxed{",
    "\\boxed}1{",
    "\\boxed{\\{}",
    "\\boxed{\x00}",
    "\\boxed{\ud800}",
    "\\boxed{[]}",
    "\\boxed{[A B C D]}",
    "\\boxed{None}",
    "\\boxed{\n\n1\n\n}",
)

_TAGS = (
    "<answer>",
    "</answer>",
    "<answer></answer>",
    "</answer><answer>",
    "<answer><answer>1</answer>",
    "<think>never closed",
    "</think>",
    "<python>print(1)",
    "<python></python>",
    "<search></search>",
    "<tool_call>{}</tool_call>",
    "<tool_call>not json</tool_call>",
    '<tool_call>{"name": "no_such_tool", "arguments": {}}</tool_call>',
    '<tool_call>{"name": 7, "arguments": [[[]]]}</tool_call>',
    '<tool_call>{"name": null}</tool_call><tool_call>',
    "<|im_end|><|endoftext|>",
    "```python\nprint(1)",
    "``````",
    "<![CDATA[x]]><!DOCTYPE x>",
)

_JSON = (
    "[" * 100_000,
    '{"a":' * 50_000,
    "[" * 5_000 + "]" * 5_000,
    '{"a": 1, "a": 2}',
    "NaN",
    '{"a": 1e400}',
    '"\\ud800"',
    "[1, 2",
    "null",
    "{" * 400 + "}" * 400,
    '{"index": ' + "8" * 5_000 + "}",
)

_UNICODE = (
    "\x00",
    "1\x00",
    "\x00" * 1_000,
    "\ud800",
    "a\udfffb",
    "\udc80\ud800",
    "\ufeff1",
    "\u202e1\u202c",
    "\u200b\u200d\u2060",
    "e" + "\u0301" * 10_000,
    "🙂👩‍👩‍👧‍👦🏳️‍🌈",
    "\U0010ffff\ufffe\uffff",
    "ﬁﬀİıẞß",
    "\x1b[2J\x1b]0;title\x07",
    "".join(map(chr, range(32))),
    "".join(map(chr, range(127, 160))),
    "\r\n\r\n",
    "\u2028\u2029\x85\x0b\x0c",
    "\xa0\u3000\t ",
)

_BLANK = ("", " ", "\n", "\t\n " * 300)

_LONGEST = (
    "a" * _LONG,
    "1" * _STRUCTURED,
    " " * _STRUCTURED,
    "\n" * _STRUCTURED,
    "{" * _STRUCTURED,
    "\\boxed{" * (_STRUCTURED // 7),
    "\\boxed{1}" * (_STRUCTURED // 9),
    "<python>" * (_STRUCTURED // 8),
    "<answer>1" * (_STRUCTURED // 9),
    "</answer>" * (_STRUCTURED // 9),
    "<tool_call>" * (_STRUCTURED // 11),
    "```python\n" * (_STRUCTURED // 10),
    "1 " * (_STRUCTURED // 2),
    "\\" * _STRUCTURED,
    "-" * 50_000 + "1",
    "(" * 50_000 + ")" * 50_000,
    "2**" * 20_000 + "2",
)

_FRAGMENTS = (
    *_NUMBERS[:16],
    *_FORMATS,
    *_BOXES,
    *_TAGS,
    *_BLANK,
    *_UNICODE[:9],
    *"{}[]()<>\\/\"'`:,.;|&$#@!?*+-=_~^%",
    *_DIGITS_OF_OTHER_SCRIPTS.values(),
)


def hostile_actions(count: int = 240, seed: int = 0) -> list[str]:
    """Return texts that a model could send and an author did not think of.

    The fixed ones come first: empty and blank, numbers, digits of other scripts, unclosed and nested boxes, tags that
    look like tool calls, format strings, JSON that nests or overflows, control characters, broken Unicode, and up to 5
    million characters. The rest is mixed from pieces of those and from random characters.

    Args:
        count: How many, 200 at least.
        seed: Decides the generated ones; the same in every process.
    """
    fixed = [*_BLANK, *_NUMBERS, *_boxed_numbers(), *_BOXES, *_TAGS, *_FORMATS, *_JSON, *_UNICODE, *_LONGEST]
    actions = dict.fromkeys(fixed)
    generator = random.Random(seed)
    while len(actions) < max(count, 200):
        text = _mixed(generator) if generator.random() < 0.7 else _random_text(generator)
        # JSON makes one character of a pair of surrogates that happen to meet: lone ones stay, pairs become that.
        actions[json.loads(json.dumps(text))] = None
    return list(actions)


def _boxed_numbers() -> list[str]:
    digits = list(_DIGITS_OF_OTHER_SCRIPTS.values())
    return [*digits, *(f"\\boxed{{{text[1:3]}}}" for text in digits), *(f"\\boxed{{{text}}}" for text in _NUMBERS)]


def _mixed(generator: random.Random) -> str:
    text = "".join(generator.choices(_FRAGMENTS, k=generator.randint(2, 12)))
    return f"\\boxed{{{text}}}" if generator.random() < 0.3 else text


def _random_text(generator: random.Random) -> str:
    limit = generator.choice((0x80, 0x800, 0x10000, 0x110000))
    return "".join(chr(generator.randrange(limit)) for _ in range(generator.randint(1, 200)))
