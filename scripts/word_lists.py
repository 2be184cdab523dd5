"""For maintainers of gem-games, to renew its words: make the lists from SCOWL and WordNet, fit for children.

``python scripts/word_lists.py --scowl DIR --wordnet DIR --cuss FILE`` writes ``gem_games/data/words/NN.txt``, a file
for each length of 2 to 20 letters. A file has three blocks with an empty line between them: common nouns, other common
words, further words. Nothing is downloaded; what was used for the lists as shipped is named in ``SOURCES.md`` there.

Words that one would not show to a child are left out. How words are chosen:

1. *Common* are those of SCOWL's levels 10 and 20 in American and general English, *further* ones those of the levels
   up to 70 in any spelling. Only words of the letters a to z count, so no names and no abbreviations. UKACD, which asks
   for more than a notice, is only in the levels above.
2. A word goes if the list ``cuss`` is surer of it than 0, if WordNet marks a sense as an obscenity, a slur or a
   disparagement, if it stands in ``word_lists_removed.txt``, or if it is no entry of WordNet and taking off
   an ending leads to such a word.
3. A further word goes as well if the explanation of one of its senses speaks of such things (``_TOUCHY``); a common one
   only if its first sense does. Words that are kept all the same are listed in the same file.
4. A common word is a noun if WordNet counts it as a noun at least as often as in all other parts of speech.
"""

from __future__ import annotations

import argparse
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

_ROOT = Path(__file__).resolve().parents[1]
_TARGET = _ROOT / "plugins/gem-games/gem_games/data/words"
_RULES = Path(__file__).with_name("word_lists_removed.txt")
_LENGTHS = range(2, 21)
_COMMON_LEVELS, _LEVELS = (10, 20), (10, 20, 35, 40, 50, 55, 60, 70)
_MAIN_SPELLINGS = "english", "american"
_WORD = re.compile(r"[a-z]+")
_POINTER_TO_USAGE = re.compile(r" ;u (\d{8}) (\w) (\w\w)\w\w")
_EXAMPLE = re.compile(r'; ?".*')
_PART_OF_NUMBER = {"1": "n", "2": "v", "3": "a", "4": "r", "5": "a"}
_BAD_USAGE = {"obscenity", "disparagement", "ethnic_slur", "street_name"}
_TOUCHY = re.compile(
    r"vulgar|obscen|offensive (?:term|name|word)|derogat|ethnic slur|slang term for|\bsexual|\berotic|\bgenital|"
    r"prostitute|sexual intercourse|\bcopulat|masturbat|pornograph|have sex|orgasm|fornicat|seductive|\bvagina|\bpenis|"
    r"testicle|scrotum|\banus\b|\bfeces|faeces|excrement|defecat|drug addict|narcotic|\bheroin\b|cocaine|cannabis|"
    r"marijuana|\brape\b|incest|pedophil|genocide|suicide|castrat|abortion|\blewd|\blust|\bnude|brothel|venereal"
)
_ENDINGS = (
    ("s", ""), ("es", ""), ("ies", "y"), ("ed", ""), ("ed", "e"), ("ing", ""), ("ing", "e"), ("er", ""), ("er", "e"),
    ("ers", ""), ("ers", "e"), ("y", ""), ("ly", ""), ("ish", ""), ("ness", ""), ("like", ""), ("less", ""),
    ("ier", "y"), ("iest", "y"), ("ied", "y"), ("ily", "y"), ("iness", "y"), ("est", ""),
)  # fmt: skip


class Rules(NamedTuple):
    """What ``word_lists_removed.txt`` says.

    Args:
        kept: Words that no rule removes.
        removed: Words that go, with what is derived from them.
        stems: Letters that no word may contain.
        further: Words that are no answers: not common, and accepted all the same.
        no_nouns: Words that WordNet takes for nouns, and readers do not.
    """

    kept: set[str]
    removed: set[str]
    stems: set[str]
    further: set[str]
    no_nouns: set[str]


class WordNet:
    """What is read of WordNet's files: parts of speech with their counts, explanations and marks of usage."""

    def __init__(self, folder: Path) -> None:
        self.glosses: dict[str, list[str]] = defaultdict(list)
        """Explanations of a word's senses, the most frequent one of each part of speech first."""
        self.noun_share: dict[str, tuple[int, int]] = {}
        """How often a word was counted as a noun, and how often as something else."""
        self.marked: set[str] = set()
        synsets = {}
        for part, letter in (("noun", "n"), ("verb", "v"), ("adj", "a"), ("adv", "r")):
            for line in _lines(folder / f"data.{part}"):
                fields = line.split()
                words = [fields[4 + 2 * i].lower() for i in range(int(fields[3], 16))]
                synsets[fields[0], letter] = words, line
        self._mark(synsets)
        counts = self._counts(folder / "cntlist.rev")
        for part, letter in (("noun", "n"), ("verb", "v"), ("adj", "a"), ("adv", "r")):
            for line in _lines(folder / f"index.{part}"):
                word, _, senses, *rest = line.split()
                self.glosses[word] += [
                    _EXAMPLE.sub("", synsets[offset, letter][1].partition("| ")[2]) for offset in rest[-int(senses) :]
                ]
                noun, other = self.noun_share.get(word, (-1, -1))
                count = counts[word, letter]
                share = (max(noun, 0) + count, other) if letter == "n" else (noun, max(other, 0) + count)
                self.noun_share[word] = share

    def _mark(self, synsets: dict[tuple[str, str], tuple[list[str], str]]) -> None:
        for words, line in synsets.values():
            for offset, letter, source in _POINTER_TO_USAGE.findall(line):
                if synsets[offset, letter][0][0] in _BAD_USAGE:
                    self.marked.update(words if source == "00" else [words[int(source, 16) - 1]])

    @staticmethod
    def _counts(path: Path) -> dict[tuple[str, str], int]:
        counts: dict[tuple[str, str], int] = defaultdict(int)
        for line in _lines(path):
            key, _, count = line.split()
            word, _, sense = key.partition("%")
            counts[word, _PART_OF_NUMBER[sense[0]]] += int(count)
        return counts


def main() -> None:
    """Read the sources and write the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scowl", type=Path, required=True, help="folder with english-words.10 and its kin")
    parser.add_argument("--wordnet", type=Path, required=True, help="folder with data.noun and its kin")
    parser.add_argument("--cuss", type=Path, required=True, help="index.js of the package cuss")
    arguments = parser.parse_args()
    rules, wordnet = _rules(_RULES), WordNet(arguments.wordnet)
    bad = _cuss(arguments.cuss) | wordnet.marked | rules.removed
    common = set(_scowl(arguments.scowl, _MAIN_SPELLINGS, _COMMON_LEVELS))
    everything = set(_scowl(arguments.scowl, None, _LEVELS))

    def is_clean(word: str, *, first_sense_only: bool) -> bool:
        if word in rules.kept:
            return True
        forms = [word] if word in wordnet.glosses else [word, *_base_forms(word)]
        if any(stem in word for stem in rules.stems) or any(form in bad - rules.kept for form in forms):
            return False
        glosses = (wordnet.glosses.get(form, [])[: 1 if first_sense_only else None] for form in forms)
        return not any(_TOUCHY.search(gloss) for group in glosses for gloss in group)

    common = {word for word in common - rules.further if is_clean(word, first_sense_only=True)}
    further = {word for word in everything - common if is_clean(word, first_sense_only=False) or word in rules.further}
    nouns = {word for word in common - rules.no_nouns if _is_noun(wordnet.noun_share.get(word, (-1, -1)))}
    for length in _LENGTHS:
        blocks = [sorted(word for word in group if len(word) == length) for group in (nouns, common - nouns, further)]
        _TARGET.mkdir(parents=True, exist_ok=True)
        text = "\n\n".join("\n".join(block) for block in blocks) + "\n"
        (_TARGET / f"{length:02}.txt").write_text(text, encoding="ascii")
    print(f"{len(nouns):,} common nouns, {len(common - nouns):,} other common words, {len(further):,} further words")


def _is_noun(share: tuple[int, int]) -> bool:
    noun, other = share
    return noun >= 1 and noun >= other


def _base_forms(word: str) -> Iterator[str]:
    """Give what is left of a word without its ending, a doubled letter before it undone."""
    for ending, instead in _ENDINGS:
        if word.endswith(ending) and len(word) - len(ending) >= 2:
            base = word.removesuffix(ending)
            yield base + instead
            if not instead and len(base) > 3 and base[-1] == base[-2]:
                yield base[:-1]


def _scowl(folder: Path, spellings: Iterable[str] | None, levels: Iterable[int]) -> Iterator[str]:
    for level in levels:
        names = [f"{spelling}-words.{level}" for spelling in spellings] if spellings else [f"*-words.{level}"]
        for path in (path for name in names for path in sorted(folder.glob(name))):
            yield from filter(_WORD.fullmatch, path.read_text(encoding="latin-1").split())


def _cuss(path: Path) -> set[str]:
    """Return the words that the list is surer of than 0."""
    return set(re.findall(r"^\s*'?([a-z]+)'?: [12]", path.read_text(encoding="utf-8"), re.MULTILINE))


def _rules(path: Path) -> Rules:
    groups: dict[str, set[str]] = {name: set() for name in Rules._fields}
    name = ""
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            name = line.strip("[]")
        elif line and not line.startswith("#"):
            groups[name].update(line.split())
    return Rules(**groups)


def _lines(path: Path) -> Iterator[str]:
    """Give the lines of a file of WordNet without its licence, which is indented."""
    return (line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("  "))


if __name__ == "__main__":
    main()
