"""Corpora and their indices: what is read, what is found, and what is kept on disk."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gem_core.errors import ArgumentError, DatasetError
from gem_tools.search.corpus import PASSAGE_CHARS, find_corpus
from gem_tools.search.index import Index, best, open_index
from gem_tools.search.words import query_words, singular, split_words

ROWS = [
    {"id": "r", "title": "Rivers", "text": "The Loire flows through France."},
    {"id": "m", "title": "Mountains", "text": "The Jura lies between France and Switzerland."},
    {"id": 7, "text": "Nothing of either."},
    {"id": "0", "contents": '"A Title"\nin the form of Search-R1'},
    {"text": "unnamed"},
]


def written(path: Path, *rows: object) -> Path:
    path.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    return path


def found(index: Index, query: str, top_k: int = 5) -> list[str]:
    return [passage.id for passage in index.search(query, top_k)]


@pytest.fixture
def corpus(tmp_path: Path) -> Path:
    return written(tmp_path / "corpus.jsonl", *ROWS)


def test_the_passage_that_fits_best_comes_first(corpus: Path, tmp_path: Path) -> None:
    """With its title, its text and a score; one that has none of the words is left out."""
    index = open_index(corpus, tmp_path / "cache")
    assert found(index, "Switzerland and France") == ["m", "r"]
    assert [found(index, query) for query in ("loires", "either", "unnamed", "Kazakhstan", "")] == [
        ["r"],
        ["7"],
        ["5"],
        [],
        [],
    ]
    (passage,) = index.search("mountain", 1)
    assert (passage.title, passage.text) == ("Mountains", ROWS[1]["text"])
    assert passage.score is not None
    assert passage.score > 0
    assert index.search("form", 1)[0].title == "A Title"


def test_the_best_are_those_of_a_full_sort() -> None:
    """Of equals the first, for any number of them, and any number of zeros."""
    random = np.random.default_rng(0)
    for size in (1, 5, 100):
        for _ in range(50):
            scores = random.integers(0, 4, size).astype(np.float32)
            order = [int(place) for place in np.lexsort((np.arange(size), -scores)) if scores[place] > 0]
            for count in (1, 3, 100):
                assert best(scores, count).tolist() == order[:count]


def test_a_folder_is_cut_into_passages(tmp_path: Path) -> None:
    """Between paragraphs, with the file's name as title; what is hidden or no text is left alone."""
    folder = tmp_path / "texts"
    (folder / "sub").mkdir(parents=True)
    (folder / "sub" / "long_story.txt").write_bytes(b"Wolves howl.\r\n\r\n" + b"filler " * 400 + b"\n\nOwls hoot.")
    (folder / "short.md").write_bytes("Café \udcff".encode("utf-8", "surrogateescape"))
    (folder / ".hidden.txt").write_text("owls")
    (folder / "image.png").write_text("owls")
    os.mkfifo(folder / "pipe.txt")
    index = open_index(folder, tmp_path / "cache")
    (passage,) = index.search("owls", 5)
    assert passage.id.startswith("sub/long_story.txt#")
    assert passage.title == "long story"
    assert [len(p.text) <= PASSAGE_CHARS for p in index.search("filler", 50)] == [True] * 3
    assert found(index, "cafe") == ["short.md"]


@pytest.mark.parametrize("line", [b"{", b"[]", b'{"id": 1}', b'{"text": "x", "title": 3}', b"[" * 100_000])
def test_a_line_that_is_no_passage_is_named(tmp_path: Path, line: bytes) -> None:
    """And nothing is left in the cache."""
    corpus = tmp_path / "c.jsonl"
    corpus.write_bytes(b'{"text": "good"}\n' + line + b"\n")
    with pytest.raises(DatasetError, match=r"c.jsonl, line 2"):
        open_index(corpus, tmp_path / "cache")
    assert [path for path in (tmp_path / "cache").iterdir() if path.is_dir()] == []


def test_hostile_text_is_indexed(tmp_path: Path) -> None:
    """Broken encodings, control characters, lone surrogates, empty texts, and nothing but signs."""
    corpus = tmp_path / "c.jsonl"
    lines = [b'{"text": "\\ud800 lone"}', b'{"text": "\xff\xfe broken"}', b'{"text": ""}', b"", b'{"text": "\\u0000!"}']
    corpus.write_bytes(b"\xef\xbb\xbf" + b"\n".join(lines))
    index = open_index(corpus, tmp_path)
    assert len(index) == 4
    assert index.search("lone", 1)[0].text == "\ufffd lone"


def test_what_is_no_corpus_is_refused(tmp_path: Path) -> None:
    """As is one without a word in it, which would find nothing, whatever is asked."""
    (tmp_path / "empty").mkdir()
    for place in ("no such file", tmp_path / "empty", "/dev/null", "a\0b"):
        with pytest.raises(ArgumentError):
            find_corpus(place)
    for number, content in enumerate(["", "\n\n", '{"text": "!!!"}']):
        (tmp_path / f"{number}.jsonl").write_text(content)
        with pytest.raises(DatasetError):
            open_index(tmp_path / f"{number}.jsonl", tmp_path)


# The cache.


def test_an_index_is_built_once_until_the_corpus_changes(corpus: Path, tmp_path: Path) -> None:
    """Tools of one process share it."""
    index = open_index(corpus, tmp_path / "cache")
    assert open_index(corpus, tmp_path / "cache") is index
    corpus.write_text(corpus.read_text(encoding="utf-8").replace("Loire", "Rhone"), encoding="utf-8")
    assert found(open_index(corpus, tmp_path / "cache"), "rhone") == ["r"]


@pytest.mark.parametrize("damage", ["cut", "gone", "empty", "unfinished"])
def test_a_damaged_index_is_built_again(corpus: Path, tmp_path: Path, damage: str) -> None:
    """As if somebody cleared the cache in part, or a process was killed while it built."""
    cache = tmp_path / "cache"
    open_index(corpus, cache)
    (folder,) = (path for path in cache.iterdir() if path.is_dir())
    if damage == "cut":
        os.truncate(folder / "passages.bin", 3)
    elif damage == "gone":
        (folder / "offsets.npy").unlink()
    elif damage == "empty":
        os.truncate(folder / "offsets.npy", 0)
    else:
        folder.rename(folder.with_name(f"{folder.name}.tmp"))
    assert found(open_index(corpus, cache), "loire") == ["r"]
    assert [path.name for path in cache.iterdir() if path.is_dir()] == [folder.name]


PROCESS = """
import sys
from gem_tools.search.index import open_index
print([p.id for p in open_index(sys.argv[1], sys.argv[2]).search("loire", 1)])
"""


@pytest.mark.thorough
def test_several_processes_may_build_at_once(corpus: Path, tmp_path: Path) -> None:
    """One index is left, and each finds what it should."""
    command = [sys.executable, "-c", PROCESS, str(corpus), str(tmp_path / "cache")]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(4)]
    assert [process.communicate(timeout=120)[0] for process in running] == ["['r']\n"] * 4
    assert len([path for path in (tmp_path / "cache").iterdir() if path.is_dir()]) == 1


def test_a_cache_folder_that_cannot_be_used_is_refused(corpus: Path, tmp_path: Path) -> None:
    """The error names the option."""
    with pytest.raises(ArgumentError, match="cache_dir"):
        open_index(corpus, corpus / "cache")


# Words.


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Dvořák's 9th", ["dvorak", "s", "9th"]),
        ("1,234,567 and 12,34", ["1234567", "and", "12", "34"]),
        ("東京 Tower", ["東", "京", "tower"]),
        ("한국", ["한", "국"]),
        ("snake_case", ["snake", "case"]),
        ("Straße", ["strasse"]),
        ("!?", []),
    ],
)
def test_words_are_split_for_the_index(text: str, words: list[str]) -> None:
    """Lower case, without accents, numbers whole, and scripts without spaces by the letter."""
    assert split_words(text) == words


def test_plurals_are_found_by_the_singular() -> None:
    """By rules of English endings."""
    plurals = {"cities": "city", "houses": "house", "glass": "glass", "virus": "virus", "cats": "cat", "gas": "gas"}
    assert [singular(word) for word in plurals] == [*plurals.values()]


def test_stop_words_are_looked_for_only_alone() -> None:
    """So that "The Who" can be found."""
    assert query_words("Where was the composer of the operas born?") == ["composer", "opera", "born"]
    assert query_words("The Who") == ["the", "who"]
    assert len(query_words(" ".join(f"w{n}" for n in range(300)))) == 64
