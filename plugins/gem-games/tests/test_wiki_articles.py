"""The embedded articles: every link leads somewhere, every article can be reached, and the text is clean."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections import Counter
from importlib.resources import files

import pytest

from gem_core.errors import ArgumentError
from gem_games.cheap_random import CheapRandom
from gem_games.wiki.embedded import EmbeddedArticles, embedded_articles
from gem_games.wiki.graph import ArticleNotFound

ARTICLES = embedded_articles()
LINES = files("gem_games.wiki").joinpath("articles.jsonl").read_text(encoding="utf-8").splitlines()
SMALL = "\n".join(
    json.dumps({"title": title, "text": text})
    for title, text in [
        ("A", "A leads to [[B]] and [[C|the third]]; [[B]] counts once."),
        ("B", "B leads to [[D]]."),
        ("C", "C leads to [[D]] too."),
        ("D", "D leads nowhere."),
    ]
)


def test_records_have_a_title_and_a_text_and_are_sorted() -> None:
    records = [json.loads(line) for line in LINES]
    assert all(set(record) == {"title", "text"} for record in records)
    titles = [record["title"] for record in records]
    assert titles == sorted(set(titles))
    assert 300 <= len(titles) <= 600


def test_every_link_leads_to_another_article() -> None:
    for title in ARTICLES.titles:
        links = ARTICLES.article(title).links
        assert set(links) <= set(ARTICLES.titles), title
        assert title not in links


def test_every_article_has_three_links_out_and_one_in() -> None:
    links = [ARTICLES.article(title).links for title in ARTICLES.titles]
    assert min(map(len, links)) >= 3
    assert set(Counter(link for own in links for link in own)) == set(ARTICLES.titles)


def test_every_article_can_be_reached_from_every_other_in_nine_links() -> None:
    """So the farthest pair fits into the shortest turn limit."""
    links = {title: ARTICLES.article(title).links for title in ARTICLES.titles}
    for title in links:
        reached = {title}
        for _ in range(9):
            reached |= {link for article in reached for link in links[article]}
        assert reached == set(links), title


def test_texts_are_clean() -> None:
    """Two to four sentences of plain words, the title's own word among them, without markup or stray spaces."""
    for title in ARTICLES.titles:
        text = ARTICLES.article(title).text
        sentences = re.split(r"(?<=[.?!])\s", text)
        assert 2 <= len(sentences) <= 4, title
        assert all(sentence[0].isupper() or sentence[0].isdigit() for sentence in sentences), title
        assert re.fullmatch(r"[\w\s.,;:'()/-]+[.]", text), title
        assert "  " not in text, title
        assert 80 <= len(text) <= 450, title
        assert any(word[:4] in text.casefold() for word in re.findall(r"\w+", title.casefold())), title


def test_links_are_words_of_the_text() -> None:
    """A marked link shows its own title, or words that stand for it."""
    for line in LINES:
        for target, words in re.findall(r"\[\[([^\]|]+)\|([^\]]+)\]\]", line):
            assert target != words, line
            assert words.strip() == words, line


def test_links_are_read_from_the_text_once_each() -> None:
    graph = EmbeddedArticles(SMALL)
    article = graph.article("A")
    assert article.text == "A leads to B and the third; B counts once."
    assert article.links == ("B", "C")
    assert graph.article("D").links == ()


def test_shortest_way() -> None:
    graph = EmbeddedArticles(SMALL)
    assert graph.way("A", "D") == ["A", "B", "D"]
    assert graph.way("C", "C") == ["C"]
    with pytest.raises(ArticleNotFound, match=r"^no links lead from 'D' to 'A'$"):
        graph.way("D", "A")


def test_unknown_title_suggests_the_nearest() -> None:
    with pytest.raises(
        ArticleNotFound, match=r"^there is no embedded article 'Antartica'. Did you mean 'Antarctica'\?$"
    ):
        ARTICLES.article("Antartica")
    with pytest.raises(ArticleNotFound, match=r"^there is no embedded article '\?'.$"):
        ARTICLES.article("?")


def test_pairs_have_the_wanted_distance() -> None:
    starts, distances = Counter[str](), Counter[int]()
    for seed in range(3_000):
        pair = ARTICLES.pair(CheapRandom(seed), 2, 9)
        assert len(ARTICLES.way(pair.start, pair.target)) - 1 == pair.distance
        starts[pair.start] += 1
        distances[pair.distance] += 1
    assert len(starts) > 500
    assert set(distances) >= {2, 3, 4, 5, 6, 7}


def test_pair_goes_on_to_a_start_that_has_targets() -> None:
    graph = EmbeddedArticles(SMALL)
    assert {tuple(graph.pair(CheapRandom(seed), 2, 5)) for seed in range(50)} == {("A", "D", 2)}
    with pytest.raises(ArgumentError, match=r"^no two embedded articles are 3 to 5 links apart; lower min_distance$"):
        graph.pair(CheapRandom(0), 3, 5)


def test_random_articles_are_all_drawn() -> None:
    graph = EmbeddedArticles(SMALL)
    assert {graph.random_article(CheapRandom(seed)).title for seed in range(100)} == set("ABCD")


def test_articles_are_read_only_when_they_are_needed() -> None:
    code = (
        "import gem_games.wiki_game as g, gem_games.wiki.embedded as e; print(e.embedded_articles.cache_info().misses)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "0"
