"""After a change of the search tool: how long a query takes, and to index a corpus once and to open it again.

By default 50,000 synthetic passages; the budget is for a million: ``python benchmarks/search.py --passages 1000000``,
which takes some minutes and 4 GB of memory the first time, and seconds from the cache after that. Words are drawn as in
natural text, frequent ones far more often (Zipf's law), English stop words first among them; passages have 60 to 100
words, as those of the corpora that search agents are trained on. A query is six to twelve words in a row out of a
passage. The peer, gem-llm, has no search of its own to compare with: it asks a server.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import sys
import time
from pathlib import Path

import numpy as np

import harness
from gem_core.records import whole_file

BUDGET_S, BUDGET_AT = 0.020, 1_000_000
VOCABULARY = 200_000
SHIFT = 2.7  # of Mandelbrot's form of Zipf's law, as for English
BATCH = 10_000


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--ours", default=sys.executable, help="interpreter that has gem_core and gem_tools")
    parser.add_argument("--peer", help="not used here; 'make bench' names it to every benchmark")
    parser.add_argument("--passages", type=int, default=50_000)
    parser.add_argument("--queries", type=int, default=1000)
    parser.add_argument("--folder", type=Path, default=Path("runs", "bench-search"), help="keeps corpus and index")
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(measured(options.folder, options.passages, options.queries)))
        return
    options.folder.mkdir(parents=True, exist_ok=True)
    command = [options.ours, __file__, "--measure", "--passages", str(options.passages)]
    figures = harness.run_once([*command, "--queries", str(options.queries), "--folder", str(options.folder)])
    show(figures, options.passages, options.queries)


def measured(folder: Path, passages: int, queries: int) -> dict[str, float]:
    """Return the figures, taken in this process; a corpus and an index that are there are used again."""
    from gem_tools.search.index import open_index

    corpus = folder / f"{passages}.jsonl"
    if not corpus.exists():
        write_corpus(corpus, passages)
    there = set((folder / "index").glob("*/offsets.npy"))
    started = time.perf_counter()
    index = open_index(corpus, folder / "index")
    figures = {"first_open_s": time.perf_counter() - started}
    figures["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    figures["built"] = float(set((folder / "index").glob("*/offsets.npy")) != there)
    asked = some_queries(corpus, passages, queries)
    times = []
    for query in asked:
        started = time.perf_counter()
        found = index.search(query, 3)
        times.append(time.perf_counter() - started)
        if not found:
            sys.exit(f"error: nothing was found for {query!r}, which stands in the corpus")
    figures["median_s"] = statistics.median(times)
    figures["p95_s"] = statistics.quantiles(times, n=20)[-1]
    del index
    started = time.perf_counter()
    open_index(corpus, folder / "index")
    figures["open_s"] = time.perf_counter() - started
    return figures


def write_corpus(corpus: Path, passages: int) -> None:
    """Write synthetic passages, the same for the same number."""
    random = np.random.default_rng(0)
    words = vocabulary()
    weights = 1.0 / (np.arange(VOCABULARY) + SHIFT)
    bounds = np.cumsum(weights / weights.sum())
    with whole_file(corpus) as stream:
        for first in range(0, passages, BATCH):
            for number in range(first, min(first + BATCH, passages)):
                drawn = np.searchsorted(bounds, random.random(int(random.integers(60, 101))))
                text = " ".join(words[place] for place in np.minimum(drawn, VOCABULARY - 1))
                stream.write(json.dumps({"id": number, "title": f"Passage {number}", "text": text}).encode() + b"\n")


def vocabulary() -> list[str]:
    """Return words, the most frequent first: English stop words, then made-up ones."""
    from gem_tools.search.words import STOP_WORDS

    syllables = [consonant + vowel for consonant in "bcdfgklmnprtvz" for vowel in "aeiou"]
    base = len(syllables)
    made_up = (
        "".join(syllables[number // base**place % base] for place in range(2 + (number >= base**2)))
        for number in range(VOCABULARY)
    )
    return [*sorted(STOP_WORDS), *made_up][:VOCABULARY]


def some_queries(corpus: Path, passages: int, count: int) -> list[str]:
    """Return pieces of passages from all over the corpus."""
    random = np.random.default_rng(1)
    wanted = set(random.integers(0, passages, count).tolist())
    queries = []
    with corpus.open(encoding="utf-8") as stream:
        for number, line in enumerate(stream):
            if number in wanted:
                words = json.loads(line)["text"].split()
                length = int(random.integers(6, 13))
                start = int(random.integers(0, len(words) - length))
                queries.append(" ".join(words[start : start + length]))
    return queries


def show(figures: dict[str, float], passages: int, queries: int) -> None:
    """Print the table."""
    first = "indexed, once" if figures["built"] else "opened, from the cache"
    rows = [
        [f"query, median of {queries}", f"{figures['median_s'] * 1e3:.2f} ms"],
        ["query, 95th percentile", f"{figures['p95_s'] * 1e3:.2f} ms"],
        [first, f"{figures['first_open_s']:.2f} s"],
        ["memory then, at most", f"{figures['peak_mb']:.0f} MB"],
        ["opened again", f"{figures['open_s'] * 1e3:.2f} ms"],
    ]
    harness.print_table(f"Search in {passages:,} passages", ["", ""], rows)
    if passages >= BUDGET_AT:
        met = harness.verdict(figures["median_s"], BUDGET_S)
        print(f"  budget: a median query under {BUDGET_S * 1e3:.0f} ms in a million passages: {met}")
    else:
        print(f"  the budget is for a million passages: --passages {BUDGET_AT}")


if __name__ == "__main__":
    main()
