"""Loads games of TextArena, mended where they need a download, print, or do not compile on Python 3.11.

What is mended was seen in textarena 0.7.4:

- the word games load lists and a tagger through nltk, which downloads them: they get ``gem_games.words`` instead;
- ``EnglishDictionary`` spends a second on tables whose order depends on the hash seed: it is replaced;
- some games go through a ``set`` of words: theirs has an order;
- the library draws from global generators: what its modules call ``random`` and ``np`` is of ``fence.py``;
- some games print what they deal: ``print`` is silent inside the library;
- seven modules have nested quotes in f-strings, which Python 3.11 cannot read: such lines are written in another way;
- three games ask a language model through a service: ``Judge`` takes its place.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import re
import sys
from collections.abc import Iterator
from functools import cache
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

from gem_games import words as our_words
from gem_games.textarena.fence import LOCK, STAND_INS
from gem_games.textarena.judging import Judge

_INNER_QUOTES = re.compile(r'\["(\w+)"\]')
_INNER_STRING = re.compile(r'f"\{([^{}"]+)\}\{([^{}"]+)\}"')
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


@cache
def _nouns() -> frozenset[str]:
    return frozenset(word for length in our_words.LENGTHS for word in our_words.nouns(length))


def _tagged(tokens: list[str]) -> list[tuple[str, str]]:
    nouns = _nouns()
    return [(word, "NN" if word.lower() in nouns else "JJ") for word in tokens]


def _nothing(*_: Any, **__: Any) -> bool:
    return True


_NLTK = SimpleNamespace(download=_nothing, pos_tag=_tagged, corpus=SimpleNamespace(words=_Words))


class _Recipe(NamedTuple):
    """How to make a game: its class, what that is called with, and what the game's own wrappers do to an action."""

    build: Any
    kwargs: dict[str, Any]
    brackets: bool
    clip: int | None


def load(name: str, max_turns: int | None = None) -> tuple[Any, bool, int | None]:
    """Make a game of TextArena, without its wrappers.

    Args:
        name: Its id there.
        max_turns: In place of the limit that is registered, if its constructor takes one.

    Returns:
        The game, whether its wrappers put an action into brackets, and how many characters they leave of one.
    """
    with LOCK:
        recipe = _recipe(name)
        return _built(recipe, max_turns), recipe.brackets, recipe.clip


def _built(recipe: _Recipe, max_turns: int | None) -> Any:
    kwargs = dict(recipe.kwargs)
    taken = inspect.signature(recipe.build).parameters
    if max_turns is not None and "max_turns" in taken:
        kwargs["max_turns"] = max_turns
    if "jury_class" in taken:
        kwargs["jury_class"] = Judge
    agents: Any = importlib.import_module("textarena.agents")
    kept, agents.OpenRouterAgent = agents.OpenRouterAgent, Judge  # it wants a key when it is made
    try:
        return recipe.build(**kwargs)
    finally:
        agents.OpenRouterAgent = kept


@cache
def _recipe(name: str) -> _Recipe:
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
    clip = 1_000 if "ClipCharactersActionWrapper" in wrappers else None
    return _Recipe(getattr(module, class_name), record.kwargs, "ActionFormattingWrapper" in wrappers, clip)


def _module(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except SyntaxError as error:
        if not error.filename:
            raise
        _read_mended(name, error.filename)
        return importlib.import_module(name)


def _read_mended(name: str, path: str) -> None:
    """Put a module into ``sys.modules`` that is read with what Python cannot read written in another way."""
    with open(path, encoding="utf-8") as file:
        lines = file.read().splitlines()
    for _ in range(_MOST_LINES):
        try:
            code = compile("\n".join(lines) + "\n", path, "exec")
            break
        except SyntaxError as error:
            number = (error.lineno or 1) - 1
            mended = _INNER_STRING.sub(r"str(\1) + str(\2)", _INNER_QUOTES.sub(r"['\1']", lines[number]))
            if mended == lines[number]:
                raise
            lines[number] = mended
    else:
        raise SyntaxError(f"{path} has too many lines that cannot be read")
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None:
        raise ImportError(f"{path} is no module")
    package = name.rpartition(".")[0]
    above = None if package in sys.modules else importlib.util.find_spec(package)
    if above is not None:  # not run: it would import the module that cannot be read
        sys.modules[package] = importlib.util.module_from_spec(above)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        exec(code, module.__dict__)  # the installed library's own code
    except BaseException:
        del sys.modules[name]
        raise


def _mend() -> None:
    """Replace what the loaded modules of the library would download, print to, or draw from."""
    spaces = [vars(module) for name, module in list(sys.modules.items()) if name.startswith("textarena.envs.")]
    vars(importlib.import_module("textarena.core")).update(STAND_INS)  # whose reset seeds
    for space in spaces:
        space["print"] = _nothing
        space["set"] = _Ordered
        space.update({name: stand_in for name, stand_in in STAND_INS.items() if name in space})
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
