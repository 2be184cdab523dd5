"""Whether what an agent sees gives the gold answer away."""

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
_MARK = re.compile(rf"\b{_TELLING}\b[^\n:=]{{0,20}}[:=]\s*(\S[^\n]{{0,80}})", re.IGNORECASE)
_DECODING = re.compile(r"\b(?:decod|decrypt|deciph|cipher|convert|revers|backward|unscrambl|spell)", re.IGNORECASE)
"""Words of a task that is to read a code, where the observation holds the answer for good reason."""
_BRIEF = 200
"""Characters of what is no passage, where an answer is one thing among others."""
_AROUND = " .,;:!?()[]{}<>*\"'`-"


def _decoded(decode: Callable[[str], bytes], text: str) -> str:
    try:
        value = decode(text).decode()
    except ValueError:
        return ""
    return value.strip() if value.isprintable() else ""


_ENCODERS: dict[str, Callable[[str], str]] = {
    "base64": lambda text: base64.b64encode(text.encode()).decode().rstrip("="),
    "hexadecimal": lambda text: text.encode().hex(),
    "backward": lambda text: text[::-1] if len(text) > 3 and text != text[::-1] else "",
    "rot13": lambda text: codecs.encode(text, "rot13") if sum(map(str.isalpha, text)) > 3 else "",
}
_DECODERS: dict[str, Callable[[str], str]] = {
    "base64": lambda text: _decoded(lambda code: base64.b64decode(code + "=" * (-len(code) % 4), validate=True), text),
    "hexadecimal": lambda text: _decoded(bytes.fromhex, text),
    "backward": lambda text: text[::-1],
    "rot13": lambda text: codecs.encode(text, "rot13"),
}


@dataclass
class RowView:
    """What an agent sees of a row before the end.

    Args:
        name: Of the row.
        gold: The gold answer; None where it is not known.
        texts: Observations, and what else is shown as text.
        infos: The infos that came with them.
        question: The column of the question, in a data set; what a prompt holds beside it is the author's.
        later: What came after a response that did not hold the gold answer, by where it came from.
        whole: Whether the gold answer solves the task at once, and is no move among others.
    """

    name: str
    gold: str | None = None
    texts: list[str] = field(default_factory=list)
    infos: list[Mapping[str, Any]] = field(default_factory=list)
    question: str = ""
    later: dict[str, list[str]] = field(default_factory=dict)
    whole: bool = False

    @property
    def text(self) -> str:
        """All that is shown as text."""
        return "\n".join([*self.texts, *(text for each in self.later.values() for text in each)])

    @property
    def asks_to_decode(self) -> bool:
        """Whether to read a text backward, or in a code, is the task."""
        return _DECODING.search("\n".join(self.texts)) is not None

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
        """Return what the text gives behind words such as "answer:", and at its end, by where it stands."""
        found: dict[str, str] = {}
        for match in list(_MARK.finditer(self.text))[:3]:
            value = match[1].strip()
            mark = " ".join(match[0][: match.start(1) - match.start()].split())
            for each in (value, value.rstrip(")]}>-. "), re.split(r"[\s,;)\]>]|-->", value)[0]):
                found[f"what follows {mark!r} in the observation ({len(found)})"] = each
        return found | self._ends()

    def _ends(self) -> dict[str, str]:
        """Return the last line and the last word of each text, as they stand and decoded."""
        found: dict[str, str] = {}
        for source, texts in {"the observation": self.texts[:1], **self.later}.items():
            lines = [line for text in texts for line in re.sub(r"<[^<>]*>", " ", text).splitlines() if line.strip()]
            for what, text in (("line", lines[-1]), ("word", lines[-1].split()[-1])) if lines else ():
                value = text.strip(_AROUND)
                forms = {"": value, ", in small letters": value.lower(), ", with capitals": value.title()}
                if not self.asks_to_decode:
                    forms |= {f", from {name}": decode(value) for name, decode in _DECODERS.items()}
                for form, each in forms.items():
                    if each and each not in found.values():
                        found[f"the last {what} of {source}{form}"] = each
        return found


def _leaves(value: Any, path: str) -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping):
        for key, one in value.items():
            yield from _leaves(one, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list | tuple):
        for at, one in enumerate(value[:10]):
            yield from _leaves(one, f"{path}.{at}")
    elif isinstance(value, str | int | float) and not isinstance(value, bool):
        yield path, str(value)[:_LONGEST]


def find_leaks(views: Sequence[RowView]) -> Iterator[Problem]:
    """Yield the places that give gold answers away more often than chance.

    A gold answer of one letter stands in many a text; so each place is compared with how often it holds the gold
    answers of other rows. What the observation itself gives away is found by answering with it; see ``claims``.
    """
    known = [view for view in views if view.gold]
    golds = [normal(view.gold or "") for view in known]
    if len(set(golds)) > 1:
        for search in (_in_infos, _in_later, _encoded):
            yield from search(known, golds)


def _leak(
    known: Sequence[RowView], hits: Sequence[int], message: str, examples: Sequence[str], fails: bool = True
) -> Problem:
    """Return what some rows give away, each row with its example; a note if that may be meant."""
    shown = tuple(f"{known[at].name}: {examples[at]}" for at in hits[:3])
    return Problem("leak" if fails else "shown", len(hits) / len(known), message, shown, fails)


def _in_infos(known: Sequence[RowView], golds: Sequence[str]) -> Iterator[Problem]:
    leaves = [{path: normal(value) for path, value in view.leaves().items()} for view in known]
    for path in sorted({path for each in leaves for path in each}):
        values = [each.get(path, "") for each in leaves]
        hits = [at for at, gold in enumerate(golds) if holds(values[at], gold)]
        shown = sum(view.shows(value) for view, value in zip(known, values, strict=True)) > len(known) / 2
        enough = not shown or len(hits) >= MOSTLY * len(known)
        if enough and _beyond_chance(hits, values, golds):
            message = f"info[{path!r}] holds the gold answer before the end"
            yield _leak(known, hits, message, [f"info {path} holds {gold!r:.80}" for gold in golds])
        elif _tells(values, golds):
            message = f"info[{path!r}] tells the gold answer before the end, as a code"
            told = [f"{value!r:.40} for {gold!r:.40}" for value, gold in zip(values, golds, strict=True)]
            yield _leak(known, range(len(known)), message, told)


def _tells(values: Sequence[str], golds: Sequence[str]) -> bool:
    """Tell whether a value decides the gold answer in all rows, and comes often enough for that to be no chance."""
    if not all(values) or len(set(values)) > len(values) / 3:
        return False
    return len(set(zip(values, golds, strict=True))) == len(set(values)) and _majority(golds) ** len(golds) < _UNLIKELY


def _majority(golds: Sequence[str]) -> float:
    """Return how often the most frequent gold answer is right."""
    return Counter(golds).most_common(1)[0][1] / len(golds)


def _in_later(known: Sequence[RowView], golds: Sequence[str]) -> Iterator[Problem]:
    """Yield what tells the answer after another response: feedback, and tools that were called once."""
    for source in sorted({source for view in known for source in view.later}):
        texts = [normal("\n".join(view.later.get(source, ()))) for view in known]
        hits = [at for at, view in enumerate(known) if view.whole and holds(texts[at], golds[at])]
        hits = [at for at in hits if not holds(normal(known[at].texts[0]), golds[at])]
        if hits and _beyond_chance(hits, texts, golds):
            brief = all(len(texts[at]) <= _BRIEF + len(golds[at]) for at in hits)
            examples = [f"{gold!r:.80} in {text!r:.80}" for gold, text in zip(golds, texts, strict=True)]
            yield _leak(known, hits, f"{source} holds the gold answer", examples, brief)


def _encoded(known: Sequence[RowView], golds: Sequence[str]) -> Iterator[Problem]:
    infos = ["\n".join(view.leaves().values()) for view in known]
    for name, encode in _ENCODERS.items():
        codes = [code if len(code) >= 4 else "" for code in (encode((view.gold or "").strip()) for view in known)]
        for place, texts in (("an info", infos), ("the observation", [view.text for view in known])):
            hits = [at for at, code in enumerate(codes) if code and code in texts[at]]
            if _beyond_chance(hits, texts, codes, lambda text, code: bool(code) and code in text):
                # To read a text backward, or in a code, may be the very task; what stands beside a question is not.
                asked = [known[at] for at in hits if known[at].asks_to_decode]
                beside = [view for view in asked if view.question and encode(view.gold or "") not in view.question]
                fails = place == "an info" or len(asked) < len(hits) or beside == asked
                examples = [f"{code!r:.80}" for code in codes]
                yield _leak(known, hits, f"{place} holds the gold answer in {name} form", examples, fails)


def _beyond_chance(
    hits: Sequence[int], texts: Sequence[str], golds: Sequence[str], found: Callable[[str, str], bool] = holds
) -> bool:
    """Tell whether texts hold the gold answer of their own row more often than those of other rows."""
    if len(hits) < 2 and len(hits) < len(golds):
        return False
    pairs = [
        found(text, other)
        for at, text in enumerate(texts)
        for other in [*golds[at + 1 :], *golds[:at]][:_OTHERS]
        if other != golds[at]
    ]
    least = min(0.02, 1 / (len(pairs) + 1))
    return tail(len(hits), len(golds), max(least, sum(pairs) / max(1, len(pairs)))) < _UNLIKELY
