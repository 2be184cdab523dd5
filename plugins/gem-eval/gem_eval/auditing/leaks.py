"""Whether what an agent is shown gives the gold answer away."""

from __future__ import annotations

import base64
import codecs
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from gem_eval.auditing.results import Problem, tail
from gem_eval.auditing.texts import holds, normal

_UNLIKELY = 1e-3
_OTHERS = 20
_LONGEST = 2_000
"""Characters of a value in an info that are looked at."""
_SHORT = 60
MOSTLY = 0.9
"""Share of rows that a value which is shown as text must give away: one of three options is right in a third."""
_SHOWN_ANYWAY = {"feedback", "suffix", "messages", "system", "tools", "tool_instructions", "seed", "parsed_action"}
"""Keys of an info whose content the agent sees as text, or has written itself."""
_TELLING = (
    r"(?:answers?|ans|solution|gold|labels?|target|expected|reference|truth|key|hint|secret|hidden|correct|debug)"
)
_MARK = re.compile(
    rf"\b{_TELLING}\b"
    r"[^\n:=]{0,20}[:=]\s*(\S[^\n]{0,80})",
    re.IGNORECASE,
)


@dataclass
class Look:
    """What an agent is shown of a row before the end.

    Args:
        name: Of the row.
        gold: The gold answer; None where it is not known.
        texts: Observations, and what else is shown as text.
        infos: The infos that came with them.
        question: The column of the question, in a data set; what a prompt holds beside it is the author's.
    """

    name: str
    gold: str | None = None
    texts: list[str] = field(default_factory=list)
    infos: list[Mapping[str, Any]] = field(default_factory=list)
    question: str = ""

    @property
    def text(self) -> str:
        """All that is shown as text."""
        return "\n".join(self.texts)

    def leaves(self) -> dict[str, str]:
        """Return the values of the infos by path, as ``extra.answer``, without long ones that are shown as text."""
        shown = normal(self.text)
        found: dict[str, str] = {}
        for info in self.infos:
            for path, value in _leaves(info, ""):
                if path.split(".")[0] not in _SHOWN_ANYWAY and (len(value) < _SHORT or normal(value) not in shown):
                    found.setdefault(path, value)
        return found

    def shows(self, value: str) -> bool:
        """Tell whether a value of an info stands in the text as well, as the options of a question may."""
        return normal(value) in normal(self.text)

    def claims(self) -> dict[str, str]:
        """Return what the text gives behind words such as "answer:", by those words."""
        found: dict[str, str] = {}
        for match in _MARK.finditer(self.text):
            value = match[1].strip()
            mark = " ".join(match[0][: match.start(1) - match.start()].split())
            short = re.split(r"[\s,;)\]>]|-->", value)[0]
            for each in (value, value.rstrip(")]}>-. "), short):
                found.setdefault(f"{mark!r} ({len(found)})", each)
        return dict(list(found.items())[:9])


def find_leaks(looks: Sequence[Look]) -> Iterator[Problem]:
    """Yield the places that give gold answers away more often than chance.

    A gold answer of one letter stands in many a text; so each place is compared with how often it holds the gold
    answers of other rows. In what is shown as text, an answer may stand for good reason, as among the options of a
    question: there only a place that tells which text is the answer is a leak.
    """
    known = [look for look in looks if look.gold]
    golds = [normal(look.gold or "") for look in known]
    if len(set(golds)) < 2:
        return
    yield from _in_infos(known, golds)
    yield from _in_texts(known, golds)
    yield from _encoded(known, golds)


def _in_infos(known: Sequence[Look], golds: Sequence[str]) -> Iterator[Problem]:
    leaves = [{path: normal(value) for path, value in look.leaves().items()} for look in known]
    for path in sorted({path for each in leaves for path in each}):
        values = [each.get(path, "") for each in leaves]
        hits = [at for at, gold in enumerate(golds) if holds(values[at], gold)]
        shown = sum(look.shows(value) for look, value in zip(known, values, strict=True)) > len(known) / 2
        enough = not shown or len(hits) >= MOSTLY * len(known)
        if enough and _beyond_chance(hits, values, golds, holds):
            examples = tuple(f"{known[at].name}: info {path} holds {golds[at]!r:.80}" for at in hits[:3])
            yield Problem(
                "leak", len(hits) / len(known), f"info[{path!r}] holds the gold answer before the end", examples
            )
        elif _tells(values, golds):
            examples = tuple(f"{known[at].name}: {values[at]!r:.40} for {golds[at]!r:.40}" for at in range(3))
            yield Problem("leak", 1.0, f"info[{path!r}] tells the gold answer before the end, as a code", examples)


def _tells(values: Sequence[str], golds: Sequence[str]) -> bool:
    """Tell whether a value decides the gold answer in all rows, and comes often enough for that to be no chance."""
    if not all(values) or len(set(values)) > len(values) / 3 or len(set(golds)) < 2:
        return False
    majority = Counter(golds).most_common(1)[0][1] / len(golds)
    return len(set(zip(values, golds, strict=True))) == len(set(values)) and majority ** len(golds) < _UNLIKELY


def _in_texts(known: Sequence[Look], golds: Sequence[str]) -> Iterator[Problem]:
    texts = [normal(look.text) for look in known]
    majority = Counter(golds).most_common(1)[0][1] / len(golds)
    before: Counter[str] = Counter()
    for text, gold in zip(texts, golds, strict=True):
        before.update({text[max(0, at - size) : at] for at in _places(text, gold) for size in (8, 14)})
    for mark, _ in before.most_common(20):
        with_it = [at for at, text in enumerate(texts) if mark in text]
        right = [at for at in with_it if holds_behind(texts[at], mark, golds[at])]
        telling = sum(character.isalpha() for character in mark) >= 3
        if not telling or len(right) < 0.8 * len(with_it) or tail(len(right), len(with_it), majority) > _UNLIKELY:
            continue
        examples = tuple(f"{known[at].name}: {mark!r} and then {golds[at]!r:.80}" for at in right[:3])
        share = len(right) / len(known)
        # Questions that are made from one pattern may give a number at the same place in each, and mean it.
        fails = all(_is_said(texts[at], mark, golds[at], normal(known[at].question)) for at in right)
        kind = "leak" if fails else "shown"
        yield Problem(kind, share, f"the gold answer follows {mark!r} in the observation", examples, fails)
        return
    hits = [at for at, text in enumerate(texts) if holds(text, golds[at])]
    if len(hits) >= 0.5 * len(known) and _beyond_chance(hits, texts, golds, holds):
        examples = tuple(f"{known[at].name}: {golds[at]!r:.80}" for at in hits[:3])
        yield Problem(
            "shown",
            len(hits) / len(known),
            "the gold answer stands somewhere in the observation, those of other rows rarely: right where a question "
            "shows its options or a passage",
            examples,
            fails=False,
        )


def _is_said(text: str, mark: str, gold: str, question: str) -> bool:
    """Tell whether a gold answer is called so where it stands behind a mark, or stands outside of the question."""
    start = text.find(mark + gold)
    if re.search(_TELLING, text[max(0, start - 30) : start + len(mark)]):
        return True
    return bool(question) and question in text and mark + gold in text.replace(question, "\n")


def holds_behind(text: str, mark: str, gold: str) -> bool:
    """Tell whether a gold answer stands right behind a mark."""
    start = text.find(mark)
    while start >= 0:
        behind = text[start + len(mark) :]
        if behind.startswith(gold) and not (gold[-1].isalnum() and behind[len(gold) : len(gold) + 1].isalnum()):
            return True
        start = text.find(mark, start + 1)
    return False


_CODES: dict[str, Callable[[str], str]] = {
    "base64": lambda text: base64.b64encode(text.encode()).decode().rstrip("="),
    "hexadecimal": lambda text: text.encode().hex(),
    "backward": lambda text: text[::-1] if len(text) > 3 and text != text[::-1] else "",
    "rot13": lambda text: codecs.encode(text, "rot13") if sum(map(str.isalpha, text)) > 3 else "",
}


def _encoded(known: Sequence[Look], golds: Sequence[str]) -> Iterator[Problem]:
    infos = ["\n".join(look.leaves().values()) for look in known]
    for name, encode in _CODES.items():
        codes = [encode((look.gold or "").strip()) for look in known]
        for place, texts in (("an info", infos), ("the observation", [look.text for look in known])):
            hits = [at for at, code in enumerate(codes) if len(code) >= 4 and code in texts[at]]
            if _beyond_chance(hits, texts, codes, lambda text, code: len(code) >= 4 and code in text):
                examples = tuple(f"{known[at].name}: {codes[at]!r:.80}" for at in hits[:3])
                message = f"{place} holds the gold answer in {name} form"
                # To read a text backward, or in a code, may be the very task.
                yield Problem("leak", len(hits) / len(known), message, examples, place == "an info")


def _beyond_chance(
    hits: Sequence[int], places: Sequence[str], golds: Sequence[str], found: Callable[[str, str], bool]
) -> bool:
    """Tell whether rows hold their own gold answer more often than those of other rows."""
    if len(hits) < 2 and len(hits) < len(golds):
        return False
    pairs = [
        found(place, other)
        for at, place in enumerate(places)
        for other in (golds[at + 1 :] + golds[:at] if isinstance(golds, list) else golds)[:_OTHERS]
        if other != golds[at]
    ]
    least = min(0.02, 1 / (len(pairs) + 1))
    return tail(len(hits), len(golds), max(least, sum(pairs) / max(1, len(pairs)))) < _UNLIKELY


def _places(text: str, gold: str) -> list[int]:
    found = [at.start() for at in re.finditer(re.escape(gold), text)][:5]
    return [at for at in found if holds(text[max(0, at - 1) : at + len(gold) + 1], gold)]


def _leaves(value: Any, path: str) -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping):
        for key, one in value.items():
            yield from _leaves(one, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list | tuple):
        for at, one in enumerate(value[:10]):
            yield from _leaves(one, f"{path}.{at}")
    elif isinstance(value, str | int | float) and not isinstance(value, bool):
        yield path, str(value)[:_LONGEST]
