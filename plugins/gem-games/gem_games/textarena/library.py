"""Loads games of TextArena, mended where they need a download, print, or do not compile on Python 3.11.

What is mended was seen in textarena 0.7.4:

- the word games load lists and a tagger through nltk, which downloads them: they get ``gem_games.words`` instead;
- ``EnglishDictionary`` spends a second on tables whose order depends on the hash seed: it is replaced;
- some games go through a ``set`` of words: theirs has an order;
- some games print what they deal: ``print`` is silent inside the library;
- six games raise when someone has won: ``endings.py`` puts them right;
- six modules have nested quotes in f-strings, which Python 3.11 cannot read: such lines get other quotes.
"""

from __future__ import annotations

import importlib
import importlib.util
import re
import sys
from collections.abc import Iterator
from functools import cache
from types import ModuleType, SimpleNamespace
from typing import Any

from gem_games import words as our_words
from gem_games.textarena import endings
from gem_games.textarena.fence import LOCK

_INNER_QUOTES = re.compile(r'\["(\w+)"\]')
_MOST_LINES = 100


class _Words:
    """What the games ask of ``nltk.corpus.words``."""

    @staticmethod
    @cache
    def words(name: str = "en") -> list[str]:
        """Return the common words for ``"en-basic"``, else all words."""
        if name == "en-basic":
            return list(our_words.words())
        return [word for length in our_words.LENGTHS for word in our_words.word_list(length).every]


class _Ordered(set[Any]):
    """A set that is gone through in alphabetical order, whatever the hash seed."""

    def __iter__(self) -> Iterator[Any]:
        return iter(sorted(super().__iter__(), key=repr))

    def __deepcopy__(self, memo: dict[int, Any]) -> _Ordered:
        return self if len(self) > 1_000 else _Ordered(self)


class _Dictionary:
    """What the games ask of ``EnglishDictionary``."""

    def __init__(self, **_: Any) -> None:
        self.nltk_words = _everything()

    def is_english_word(self, word: str) -> bool:
        """Whether it is a word."""
        return our_words.is_word(word)

    def get_all_words(self) -> set[str]:
        """Return all words."""
        return _everything()

    def get_basic_words(self) -> set[str]:
        """Return the common words."""
        return _Ordered(_Words.words("en-basic"))


@cache
def _everything() -> set[str]:
    return _Ordered(_Words.words("en"))


def _tagged(tokens: list[str]) -> list[tuple[str, str]]:
    return [(word, "NN" if word.lower() in our_words.nouns(len(word)) else "JJ") for word in tokens]


def _nothing(*_: Any, **__: Any) -> bool:
    return True


_NLTK = SimpleNamespace(download=_nothing, pos_tag=_tagged, corpus=SimpleNamespace(words=_Words))


def load(name: str) -> tuple[Any, bool, int | None]:
    """Make a game of TextArena, without its wrappers.

    Args:
        name: Its id there.

    Returns:
        The game, whether its wrappers put an action into brackets, and how many characters they leave of one.
    """
    with LOCK:
        nltk: Any = importlib.import_module("nltk")
        corpus: Any = importlib.import_module("nltk.corpus")
        kept = nltk.download, corpus.words
        nltk.download, corpus.words = _nothing, _Words
        try:
            registration = importlib.import_module("textarena.envs.registration")
            record = registration.ENV_REGISTRY[name]
            module_name, _, class_name = record.entry_point.partition(":")
            module = _module(module_name)
            _mend()
        finally:
            nltk.download, corpus.words = kept
        wrappers = {wrapper.__name__ for wrapper in record.default_wrappers or ()}
        game = getattr(module, class_name)(**record.kwargs)
        clip = 1_000 if "ClipCharactersActionWrapper" in wrappers else None
        return game, "ActionFormattingWrapper" in wrappers, clip


def _module(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except SyntaxError as error:
        if sys.version_info >= (3, 12) or not error.filename:
            raise
        _read_with_other_quotes(name, error.filename)
        return importlib.import_module(name)


def _read_with_other_quotes(name: str, path: str) -> None:
    """Put a module into ``sys.modules`` whose f-strings have quotes that Python 3.11 can read."""
    with open(path, encoding="utf-8") as file:
        lines = file.read().splitlines()
    for _ in range(_MOST_LINES):
        try:
            code = compile("\n".join(lines) + "\n", path, "exec")
            break
        except SyntaxError as error:
            number = (error.lineno or 1) - 1
            mended = _INNER_QUOTES.sub(r"['\1']", lines[number])
            if mended == lines[number]:
                raise
            lines[number] = mended
    else:
        raise SyntaxError(f"{path} has too many lines that cannot be read")
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None:
        raise ImportError(f"{path} is no module")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        exec(code, module.__dict__)  # the installed library's own code
    except BaseException:
        del sys.modules[name]
        raise


def _mend() -> None:
    """Replace what the loaded modules of the library would download, or print to."""
    spaces = [vars(module) for name, module in list(sys.modules.items()) if name.startswith("textarena.envs.")]
    endings.put_right(importlib.import_module("textarena.state"), spaces)
    for space in spaces:
        space["print"] = _nothing
        space["set"] = _Ordered
        if "nltk" in space:
            space["nltk"] = _NLTK
            if "words" in space:
                space["words"] = _Words
            if "pos_tag" in space:
                space["pos_tag"] = _tagged
        if "EnglishDictionary" in space:
            space["EnglishDictionary"] = _Dictionary
        if "en_uk_dict" in space:
            space["en_uk_dict"] = _everything()
