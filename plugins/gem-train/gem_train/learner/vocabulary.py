"""A word-level vocabulary, built from the text that an environment shows and reads."""

from __future__ import annotations

import re
import string
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

_SEGMENT = re.compile(r"[^\d\n]+")
_TWO_WORDS = re.compile(r"(?<![^\W\d_])[^\W\d_]{2,}[^\w\n]+[^\W\d_]{2,}")

_WORD = re.compile(
    r"\d+"  # a number, always by itself, so that "25" is one token wherever it stands
    r"| ?\\[^\W\d_]+\{"  # \boxed{
    r"| {2,}"  # the space between columns
    r"| ?[^\W\d_]+(?: (?=\d))?"  # a word with the space before it, and that after it where a number follows
    r"| ?[^\w\s](?: (?=\d))?"  # a mark
    r"|.",
    re.DOTALL,
)

PAD, END, ANSWER, UNKNOWN = range(4)
"""Ids of the special tokens: padding, the end of a response, the place where one begins, any other character."""

_SPECIAL = ("<pad>", "<end>", "<answer>", "�")


class Vocabulary:
    """Phrases that come back again and again, words, and characters, with their ids.

    A phrase that is not in it is read word by word, and a word that is not in it character by character, so that
    nothing is lost. What a model writes is made of words.

    Args:
        words: Phrases, words and characters in the order of their ids, after the special tokens; see ``build``.
    """

    def __init__(self, words: Sequence[str]) -> None:
        self.words = list(words)
        self.texts = [*_SPECIAL, *self.words]
        self._ids = {word: index for index, word in enumerate(self.texts) if index >= len(_SPECIAL)}

    @classmethod
    def build(cls, texts: Iterable[str], size: int = 2048) -> Vocabulary:
        """Return the vocabulary of the printable ASCII characters, of all others seen, and of what is commonest.

        Args:
            texts: What the environment wrote and what players answered.
            size: The most entries.
        """
        seen = list(texts)
        words = Counter(word for text in seen for word in _WORD.findall(text))
        phrases = Counter(phrase[0] for text in seen for phrase in _phrases(text))
        often = max(2, len(seen) // 200)
        characters = sorted({*string.printable, *(character for word in words for character in word)})[:size]
        longer = [word for word, _ in words.most_common() if len(word) > 1]
        longer += [phrase for phrase, count in phrases.most_common() if count >= often]
        return cls([*characters, *longer[: size - len(characters)]])

    def __len__(self) -> int:
        return len(self.texts)

    def encode(self, text: str, *, phrases: bool = True) -> list[int]:
        """Return the ids of a text, without special tokens.

        Args:
            text: Any text.
            phrases: Whether phrases are single tokens; False for what a model is to write.
        """
        ids: list[int] = []
        end = 0
        for found in _phrases(text) if phrases else ():
            if (known := self._ids.get(found[0])) is not None:
                ids += self._words(text[end : found.start()])
                ids.append(known)
                end = found.end()
        return ids + self._words(text[end:])

    def decode(self, ids: Iterable[int]) -> str:
        """Return the text of ids; special tokens have none."""
        return "".join(self.texts[index] for index in ids if index >= UNKNOWN)

    def _words(self, text: str) -> list[int]:
        ids = []
        for word in _WORD.findall(text):
            if (known := self._ids.get(word)) is not None:
                ids.append(known)
            else:
                ids.extend(self._ids.get(character, UNKNOWN) for character in word)
        return ids


def _phrases(text: str) -> Iterator[re.Match[str]]:
    """Yield what stands in one line with no number in it, if it has two words or more."""
    return (found for found in _SEGMENT.finditer(text) if _TWO_WORDS.search(found[0]))
