r"""Actions that no environment expects and every environment survives."""

from __future__ import annotations

import json
import random

_LONG = 5_000_000
"""Characters of the longest action."""

_STRUCTURED = 500_000
"""Characters of the long actions with a structure, at which work that grows quadratically cannot go unnoticed."""


def _words(text: str) -> list[str]:
    return text.split()


# Arabic-Indic, Devanagari, Thai, fullwidth, mathematical bold, superscript, circled and Roman.
_DIGITS = _words("٠١٢٣٤٥٦٧٨٩ ०१२३४५६७८९ ๐๑๒๓๔๕๖๗๘๙ ０１２３４５６７８９ 𝟎𝟏𝟐𝟑𝟒𝟓𝟔𝟕𝟖𝟗 ⁰¹²³⁴⁵⁶⁷⁸⁹ ⓪①②③④⑤⑥⑦⑧⑨ ⅠⅡⅢⅣⅤⅥⅦⅧⅨⅩ")  # noqa: RUF001

_NUMBERS = [
    *_words("-0 +7 1e999 -1e999 nan inf -Infinity 0x1F 1_000 1,000 ½ 3.0000000000000001 99999999999999999999"),
    *["-1", "0/0", "10**10**10", "9" * 5_000, "0." + "3" * 5_000, "1/" + "7" * 5_000],
]
_FORMATS = [
    *_words("%s%s%s%s%n %(name)s {0}{1}{}{{} {self.__class__.__mro__} {!r:>99999} ${HOME} $(id) `id` exit()"),
    *_words("../../../../etc/passwd [red]markup[/blue] __import__('sys').exit(1) (?P<a>(a+)+)$ \\1\\g<0>"),
    *["; true #", "' OR '1'='1"],
]
_BOXES = [
    *["\\boxed{ }", "\\boxed{\x00}", "\\boxed{\ud800}", "\\boxed{[A B C D]}", "\\boxed{\n\n1\n\n}"],
    *_words(r"\boxed{ \boxed \boxed{} \boxed{{{{}}}} \boxed{\boxed{\boxed{1}}} \boxed{1}\boxed{ \boxed}1{ \boxed{\{}"),
    *_words(r"\boxed{[]} \boxed{None}"),
]
_TAGS = [
    *_words("<answer> </answer> <answer></answer> </answer><answer> <answer><answer>1</answer> </think> ``````"),
    *_words("<python>print(1) <python></python> <search></search> <tool_call>{}</tool_call> <|im_end|><|endoftext|>"),
    *["<think>never closed", "<tool_call>not json</tool_call>", "```python\nprint(1)", "<![CDATA[x]]><!DOCTYPE x>"],
    '<tool_call>{"name": "no_such_tool", "arguments": {}}</tool_call>',
    '<tool_call>{"name": 7, "arguments": [[[]]]}</tool_call>',
    '<tool_call>{"name": null}</tool_call><tool_call>',
]
_JSON = [
    *["[" * 100_000, '{"a":' * 50_000, "[" * 5_000 + "]" * 5_000, "{" * 400 + "}" * 400],
    *['{"a": 1, "a": 2}', "NaN", '{"a": 1e400}', '"\\ud800"', "[1, 2", "null", '{"index": ' + "8" * 5_000 + "}"],
]
_UNICODE = [
    *["\x00", "1\x00", "\x00" * 1_000, "\ud800", "a\udfffb", "\udc80\ud800", "\ufeff1", "\u202e1\u202c"],
    *[
        "\u200b\u200d\u2060",
        "e" + "\u0301" * 10_000,
        "🙂👩‍👩‍👧‍👦🏳️‍🌈",
        "\U0010ffff\ufffe\uffff",
        "ﬁﬀİıẞß",
        "\x1b[2J\x1b]0;title\x07",
    ],
    *["".join(map(chr, range(32))), "".join(map(chr, range(127, 160)))],
    *["\r\n\r\n", "\u2028\u2029\x85\x0b\x0c", "\xa0\u3000\t "],
]
_BLANK = ["", " ", "\n", "\t\n " * 300]
_REPEATED = [
    *["1", " ", "\n", "{", "\\boxed{", "\\boxed{1}", "<python>", "<answer>1", "</answer>", "<tool_call>"],
    *["```python\n", "1 ", "\\"],
]
_LONGEST = [
    *["a" * _LONG, *(text * (_STRUCTURED // len(text)) for text in _REPEATED)],
    *["-" * 50_000 + "1", "(" * 50_000 + ")" * 50_000, "2**" * 20_000 + "2"],
]
_PUNCTUATION = "{}[]()<>\\/\"'`:,.;|&$#@!?*+-=_~^%"
_FRAGMENTS = [*_NUMBERS[:16], *_FORMATS, *_BOXES, *_TAGS, *_BLANK, *_UNICODE[:9], *_PUNCTUATION, *_DIGITS]


def hostile_actions(count: int = 240, seed: int = 0) -> list[str]:
    """Return texts that a model could send and an author did not think of.

    The fixed ones come first: empty and blank, numbers, digits of other scripts, unclosed and nested boxes, tags that
    look like tool calls, format strings, JSON that nests or overflows, control characters, broken Unicode, and up to 5
    million characters. The rest is mixed from pieces of those and from random characters.

    Args:
        count: How many, 200 at least.
        seed: Decides the generated ones; the same in every process.
    """
    boxed = [*(f"\\boxed{{{text[1:3]}}}" for text in _DIGITS), *(f"\\boxed{{{text}}}" for text in _NUMBERS)]
    fixed = [*_BLANK, *_NUMBERS, *_DIGITS, *boxed, *_BOXES, *_TAGS, *_FORMATS, *_JSON, *_UNICODE, *_LONGEST]
    actions = dict.fromkeys(fixed)
    generator = random.Random(seed)
    while len(actions) < max(count, 200):
        if generator.random() < 0.7:
            text = "".join(generator.choices(_FRAGMENTS, k=generator.randint(2, 12)))
            text = f"\\boxed{{{text}}}" if generator.random() < 0.3 else text
        else:
            limit = generator.choice((0x80, 0x800, 0x10000, 0x110000))
            text = "".join(chr(generator.randrange(limit)) for _ in range(generator.randint(1, 200)))
        # JSON makes one character of a pair of surrogates that happen to meet: lone ones stay, pairs become that.
        actions[json.loads(json.dumps(text))] = None
    return list(actions)
