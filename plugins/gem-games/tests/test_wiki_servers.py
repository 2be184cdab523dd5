"""Articles of servers, over real connections to a local one that speaks like kiwix-serve and like MediaWiki."""

from __future__ import annotations

import json
import socket
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, quote, unquote, urlsplit

import pytest

import gem_core as gem
from gem_core.testing import check_env
from gem_games.cheap_random import CheapRandom
from gem_games.wiki import backends, web
from gem_games.wiki.graph import ArticleError, ArticleNotFound
from gem_games.wiki.kiwix import KiwixArticles
from gem_games.wiki.mediawiki import MediaWikiArticles
from gem_games.wiki_game import WikiGameEnv

LINKS = {
    "Sea": ["Coast", "End of the world", "River", "AC/DC"],
    "Coast": ["Sea", "Sand", "Shore", "What?"],
    "River": ["Sea", "Coast"],
    "Sand": ["Coast", "Goal & son"],
    "Goal & son": ["Sea"],
    "What?": ["Goal & son"],
    "AC/DC": ["River"],
    "End of the world": [],
}
REDIRECTS = {"Shore": "Coast", "Ocean": "Sea", "Strand": "Shore"}
BOOK = "tiny_en_all_2025-09"
Reply = tuple[int, dict[str, str], bytes]


class Wiki(BaseHTTPRequestHandler):
    """Answers what ``server.reply`` says, and notes what was asked."""

    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        parts = urlsplit(self.path)
        query = {name: values[0] for name, values in parse_qs(parts.query, keep_blank_values=True).items()}
        server: Any = self.server
        server.asked[parts.path] += 1
        server.agents.add(self.headers["User-Agent"])
        status, headers, body = server.reply(parts.path, query)
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body)), **headers}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *args: object) -> None:
        """Say nothing."""


@pytest.fixture
def serve(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[Callable[[str, dict[str, str]], Reply]], Any]]:
    """Return a function that starts a server and returns it, its address as ``url``."""
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    backends._server.cache_clear()
    servers: list[Any] = []

    def start(reply: Callable[[str, dict[str, str]], Reply]) -> Any:
        server: Any = ThreadingHTTPServer(("127.0.0.1", 0), Wiki)
        server.daemon_threads, server.handle_error = True, lambda *about: None  # clients may hang up
        server.reply, server.asked, server.agents = reply, Counter(), set()
        server.url = f"http://127.0.0.1:{server.server_port}"
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        servers.append(server)
        return server

    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


def page(content: str, kind: str = "text/html; charset=utf-8", status: int = 200) -> Reply:
    return status, {"Content-Type": kind}, content.encode()


def moved(place: str) -> Reply:
    return 302, {"Location": place}, b""


# A Kiwix server.


def kiwix_page(title: str) -> str:
    """Return a page as mwoffliner writes them, relative links and all that is no part of the text included."""
    up = "../" * title.count("/")
    links = " ".join(
        f'<a href="{up}{quote(link.replace(" ", "_"), safe="/")}" title="{link}">{link}</a>' for link in LINKS[title]
    )
    return f"""<!DOCTYPE html><html class="client-js"><head><meta charset="UTF-8"><title>{title}</title>
<link href="{up}_mw_/style.css" rel="stylesheet"></head><body class="mw-body"><div id="content">
<h1 id="firstHeading" class="article-header">{title}</h1><div class="mw-content-ltr mw-parser-output" lang="en">
<style>p {{ color: red }}</style><table class="infobox"><tr><td><p>Depth: <a href="{up}Depth.svg">4 km</a></p></td></tr>
</table><div class="hatnote">See also <a href="#cite_note-1">the note</a>.</div>
<p>The <b>{title}</b>&#160;is
wide.<sup class="reference"><a href="#cite_note-1">[1]</a></sup> {links} <a class="new" href="{up}Nothing">red</a>
<a href="{up}Sea_(disambiguation)">other seas</a></p>
<figure><p>A picture.</p><a href="{up}File:Sea.jpg"><img src="{up}_assets_/sea.webp"></a></figure>
<p>It is <a href="https://www.example.org/Blue" class="external">blue</a>, at
<a href="geo:1,2">1 N 2 E</a>. <a href="{up}{quote(title.replace(" ", "_"), safe="/")}">Itself</a>.</p>
<p><a href="{up}Category:Water">Water</a> <a href="http://[broken">?</a> <a>no address</a></p></div></div>
</body></html>"""


def kiwix(
    root: str = "", prefix: str = "", suggests: bool = True, books: int = 1
) -> Callable[[str, dict[str, str]], Reply]:
    """Return what a Kiwix server answers.

    Args:
        root: Root location of the server.
        prefix: Namespace of the articles: ``A/`` in old books.
        suggests: Whether anything is ever suggested.
        books: How many books the catalogue lists.
    """
    content = f"{root}/content/{BOOK}/"

    def reply(path: str, query: dict[str, str]) -> Reply:
        if path == f"{root}/catalog/v2/entries":
            entry = '<entry><name>tiny</name><link type="text/html" href="{}/content/{}" /></entry>'
            entries = "".join(entry.format(root, BOOK if not i else f"book{i}") for i in range(books))
            return page(f'<?xml version="1.0"?><feed xmlns="http://www.w3.org/2005/Atom">{entries}</feed>', "text/xml")
        if path == f"{root}/suggest" and query["content"] == BOOK:
            hits = [title for title in LINKS if any(word.lower().startswith(query["term"]) for word in title.split())]
            found = [
                f'  {{\n    "value" : "{title}",\n    "label" : "&lt;b&gt;{title}&lt;/b&gt;",\n    "kind" : "path"\n'
                f'      , "path" : "{prefix}{title.replace(" ", "_").replace("&", "&amp;")}"\n  }}'
                for title in hits
                if suggests
            ]
            found.append(
                '  {\n    "value" : "x ",\n    "label" : "containing &apos;x&apos;...",\n    "kind" : "pattern"\n  }'
            )
            return page("[\n" + ",\n".join(found) + "\n]\n", "application/json; charset=utf-8")
        if path == f"{root}/random" and query["content"] == BOOK:
            return moved(f"{content}{prefix}River")
        if not path.startswith(content):
            return page("<html><body><h1>Not Found</h1></body></html>", status=404)
        title = unquote(path[len(content) :]).removeprefix(prefix).replace("_", " ")
        if not title:
            return moved(f"{content}{prefix}Sea")
        if title == "Strand":
            target = f"./{REDIRECTS[title]}"
            return page(f'<html><head><meta http-equiv="refresh" content="0;URL=\'{target}\'" /></head></html>')
        if title in REDIRECTS:
            return moved(f"{content}{prefix}{REDIRECTS[title]}")
        return page(kiwix_page(title)) if title in LINKS else page("Not Found", status=404)

    return reply


@pytest.mark.parametrize(("root", "prefix"), [("", ""), ("/kiwix", ""), ("", "A/")])
def test_kiwix_article(serve: Any, root: str, prefix: str) -> None:
    """Its text without tables, notes and pictures; links to articles of the book alone, in order."""
    graph = KiwixArticles(serve(kiwix(root, prefix)).url + root, BOOK)
    article = graph.article("Sea")
    assert article.title == "Sea"
    assert article.text == (
        "The Sea is wide. Coast End of the world River AC/DC red other seas\n"
        "It is blue, at 1 N 2 E. Itself.\nWater ? no address"
    )
    assert article.links == ("Coast", "End of the world", "River", "AC/DC")
    assert graph.article("AC/DC").links == ("River",)
    assert graph.article("Coast").links == ("Sea", "Sand", "Shore", "What?")
    assert graph.article("What?").links == ("Goal & son",)
    assert graph.article("Goal & son").title == "Goal & son"


@pytest.mark.parametrize("title", ["Ocean", "Sea"])
def test_kiwix_redirects_lead_to_the_article(serve: Any, title: str) -> None:
    assert KiwixArticles(serve(kiwix()).url, BOOK).article(title).title == "Sea"


def test_kiwix_pages_that_refresh_lead_to_the_article(serve: Any) -> None:
    assert KiwixArticles(serve(kiwix()).url, BOOK).article("Strand").title == "Coast"


def test_kiwix_articles_are_kept(serve: Any) -> None:
    server = serve(kiwix())
    graph = KiwixArticles(server.url, BOOK)
    assert graph.article("Ocean") is graph.article("Ocean") is graph.article("Sea")
    assert server.asked[f"/content/{BOOK}/Sea"] == 2  # as the main page, and as an article
    assert all("gem-games" in agent for agent in server.agents)


def test_kiwix_finds_its_only_book(serve: Any) -> None:
    graph = KiwixArticles(serve(kiwix("/kiwix")).url + "/kiwix/")
    assert graph.article("Sand").links == ("Coast", "Goal & son")


def test_kiwix_with_several_books_asks_for_one(serve: Any) -> None:
    url = serve(kiwix(books=2)).url
    with pytest.raises(ArticleError) as caught:
        KiwixArticles(url).article("Sea")
    assert str(caught.value) == f"the Kiwix server at {url} has 2 books; give one as book: book1, {BOOK}"


def test_kiwix_without_the_book(serve: Any) -> None:
    url = serve(kiwix()).url
    with pytest.raises(ArticleError) as caught:
        KiwixArticles(url, "other").article("Sea")
    assert str(caught.value) == f"the Kiwix server at {url} has no book 'other'; see {url} for those it has"


@pytest.mark.parametrize("title", ["Nothing", "../../catalog/v2/entries", "\ud800", "x" * 5_000, "Sea\x00", "a?b#c"])
def test_kiwix_has_no_such_article(serve: Any, title: str) -> None:
    with pytest.raises(ArticleNotFound):
        KiwixArticles(serve(kiwix()).url, BOOK).article(title)


@pytest.mark.thorough
def test_kiwix_draws_the_same_article_for_a_seed(serve: Any) -> None:
    graph, other = (KiwixArticles(serve(kiwix()).url, BOOK) for _ in range(2))
    drawn = [graph.random_article(CheapRandom(seed)).title for seed in range(100)]
    assert drawn == [other.random_article(CheapRandom(seed)).title for seed in range(100)]
    assert "End of the world" not in drawn
    assert len(set(drawn)) >= 4


def test_kiwix_draws_itself_if_nothing_is_suggested(serve: Any) -> None:
    assert KiwixArticles(serve(kiwix(suggests=False)).url, BOOK).random_article(CheapRandom(0)).title == "River"


@pytest.mark.parametrize("body", ["", "[", "{}", "[1]", "[" * 100_000, '[{"kind": "path"}]', "null"])
def test_kiwix_with_broken_suggestions(serve: Any, body: str) -> None:
    def reply(path: str, query: dict[str, str]) -> Reply:
        return page(body, "application/json") if path == "/suggest" else kiwix()(path, query)

    with pytest.raises(ArticleError, match=r"gave suggestions that cannot be read|has no article with links"):
        KiwixArticles(serve(reply).url, BOOK).random_article(CheapRandom(0))


# A MediaWiki.


def wiki_links(query: dict[str, str], batch: int) -> dict[str, Any]:
    """Return a batch of what an article links to."""
    names = [*LINKS[query["titles"]], "Missing", "Mercury"]
    first = int(query.get("gplcontinue", "7|0|0").rpartition("|")[2])
    pages: list[dict[str, Any]] = []
    for name in names[first : first + batch]:
        record: dict[str, Any] = {"ns": 0, "title": REDIRECTS.get(name, name), "pageid": 7}
        if name == "Missing":
            record = {"ns": 0, "title": name, "missing": True}
        elif name == "Mercury":
            record["pageprops"] = {"disambiguation": ""}
        pages.append(record)
    if first + batch >= len(names):
        return {"batchcomplete": True, "query": {"pages": pages}}
    more = {"gplcontinue": f"7|0|{first + batch}", "continue": "gplcontinue||"}
    return {"continue": more, "query": {"pages": pages}}


def wiki_article(title: str, extracts: bool) -> dict[str, Any]:
    """Return what there is under a title."""
    own = REDIRECTS.get(title, title)
    if own == "Mercury":
        record = {"pageid": 8, "ns": 0, "title": own, "pageprops": {"disambiguation": ""}, "extract": "Many."}
    elif own not in LINKS:
        record = {"ns": 0, "title": own, "missing": True}
    else:
        record = {"pageid": 7, "ns": 0, "title": own} | ({"extract": f"The {own} is wide.\n"} if extracts else {})
    return {"batchcomplete": True, "query": {"pages": [record]}}


def mediawiki(extracts: bool = True, batch: int = 2) -> Callable[[str, dict[str, str]], Reply]:
    """Return what the API of a MediaWiki answers, with links in batches and pages that must be left out."""

    def reply(path: str, query: dict[str, str]) -> Reply:
        if path != "/w/api.php" or (query["format"], query["formatversion"]) != ("json", "2"):
            return page("not here", status=404)
        if query["action"] == "parse":
            text = f'<div class="mw-parser-output"><p>The {query["page"]} is <b>wide</b>.</p></div>'
            answer: dict[str, Any] = {"parse": {"title": query["page"], "pageid": 7, "text": text}}
        elif query.get("generator") == "links":
            answer = wiki_links(query, batch)
        elif query.get("list") == "allpages":
            titles = [title for title in sorted([*LINKS, "Mercury"]) if title >= query.get("apfrom", "")]
            answer = {"query": {"allpages": [{"pageid": 7, "ns": 0, "title": title} for title in titles[:3]]}}
        else:
            answer = wiki_article(query["titles"], extracts)
        return page(json.dumps(answer), "application/json; charset=utf-8")

    return reply


@pytest.mark.parametrize("batch", [1, 2, 500])
def test_mediawiki_article(serve: Any, batch: int) -> None:
    """Its links come from all batches, redirects followed, without missing pages and those that tell meanings apart."""
    graph = MediaWikiArticles(serve(mediawiki(batch=batch)).url + "/w/api.php")
    article = graph.article("Sea")
    assert (article.title, article.text) == ("Sea", "The Sea is wide.")
    assert article.links == ("AC/DC", "Coast", "End of the world", "River")
    assert graph.article("Coast").links == ("Sand", "Sea", "What?")  # Shore leads to Coast itself
    assert graph.article("End of the world").links == ()
    assert graph.article("Ocean").title == "Sea"


def test_mediawiki_without_extracts_parses_the_page(serve: Any) -> None:
    graph = MediaWikiArticles(serve(mediawiki(extracts=False)).url + "/w/api.php")
    assert graph.article("Goal & son").text == "The Goal & son is wide."


@pytest.mark.parametrize("title", ["Nothing", "Sea|Coast", "Mercury", "\ud800", ""])
def test_mediawiki_has_no_such_article(serve: Any, title: str) -> None:
    with pytest.raises(ArticleNotFound):
        MediaWikiArticles(serve(mediawiki()).url + "/w/api.php").article(title)


def test_mediawiki_draws_the_same_article_for_a_seed(serve: Any) -> None:
    graph, other = (MediaWikiArticles(serve(mediawiki()).url + "/w/api.php") for _ in range(2))
    drawn = [graph.random_article(CheapRandom(seed)).title for seed in range(60)]
    assert drawn == [other.random_article(CheapRandom(seed)).title for seed in range(60)]
    assert set(drawn) == set(LINKS) - {"End of the world"}


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("<html>", "does not answer in JSON"),
        ("[" * 100_000, "does not answer in JSON"),
        ("[]", "refuses the request: no object"),
        ('{"error": {"code": "readapidenied", "info": "You need read permission."}}', "You need read permission."),
        ('{"error": "x"}', "refuses the request: no object"),
    ],
)
def test_mediawiki_that_refuses(serve: Any, body: str, message: str) -> None:
    with pytest.raises(ArticleError, match=message):
        MediaWikiArticles(serve(lambda path, query: page(body)).url).article("Sea")


@pytest.mark.parametrize("body", ["{}", '{"query": []}', '{"query": {"pages": {}}}', '{"query": {"pages": [1]}}'])
def test_mediawiki_without_pages(serve: Any, body: str) -> None:
    graph = MediaWikiArticles(serve(lambda path, query: page(body)).url)
    with pytest.raises(ArticleNotFound):
        graph.article("Sea")
    with pytest.raises(ArticleError, match=r"has no article with links; give the address of its api.php as url"):
        graph.random_article(CheapRandom(0))


# What any server can do to us.


def fetching(server: Any, **kwargs: Any) -> MediaWikiArticles:
    return MediaWikiArticles(server.url, pause_s=0, **kwargs)


def test_busy_server_is_asked_again(serve: Any) -> None:
    replies = iter([(503, {"Retry-After": "0"}, b""), (429, {}, b""), page("{}")])
    with pytest.raises(ArticleNotFound):  # the third answer
        fetching(serve(lambda path, query: next(replies))).article("Sea")


def test_server_that_stays_busy(serve: Any) -> None:
    server = serve(lambda path, query: (503, {}, b""))
    with pytest.raises(
        ArticleError, match=r"answered 503 Service Unavailable; give the address of its api\.php as url"
    ):
        fetching(server).article("Sea")
    assert server.asked == {"": 3} or server.asked == {"/": 3}


def test_server_that_refuses_is_not_asked_again(serve: Any) -> None:
    server = serve(lambda path, query: (403, {}, b""))
    with pytest.raises(ArticleError, match="answered 403 Forbidden"):
        fetching(server).article("Sea")
    assert sum(server.asked.values()) == 1


def test_server_that_hangs(serve: Any) -> None:
    """It is given up after the time limit, also if it sends a byte now and then."""
    hang = threading.Event()

    def reply(path: str, query: dict[str, str]) -> Reply:
        hang.wait(30)
        return page("{}")

    try:
        with pytest.raises(ArticleError, match=r"took longer than timeout_s=0\.05"):
            fetching(serve(reply), timeout_s=0.05).article("Sea")
    finally:
        hang.set()


def test_slow_drip_meets_the_same_limit(serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    graph = fetching(serve(lambda path, query: page("x" * 200_000)))
    moments = iter(range(0, 1_000, 6))
    monkeypatch.setattr(web.time, "monotonic", lambda: next(moments))
    with pytest.raises(ArticleError, match="took longer than timeout_s=10"):
        graph.article("Sea")


def test_answer_without_end(serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web, "_MOST_BYTES", 100_000)
    with pytest.raises(ArticleError, match="answered more than 100,000 bytes to one request"):
        fetching(serve(lambda path, query: page("x" * 200_000))).article("Sea")


@pytest.mark.parametrize(
    "reply",
    [
        (302, {"Location": "file:/etc/passwd"}, b""),
        (302, {"Location": "/"}, b""),
        (200, {"Content-Length": "100"}, b"{}"),
        (200, {"Transfer-Encoding": "chunked"}, b"zz\r\n"),
    ],
)
def test_broken_answers_are_errors_of_the_server(serve: Any, reply: Reply) -> None:
    with pytest.raises(ArticleError, match="the server of articles at http"):
        fetching(serve(lambda path, query: reply)).article("Sea")


def test_unknown_charset_is_read_as_utf_8(serve: Any) -> None:
    body = b'{"query": {"pages": [{"ns": 0, "title": "Sea", "extract": "\xc3\xa9\xff"}]}}'
    server = serve(lambda path, query: (200, {"Content-Type": "text/html; charset=klingon"}, body))
    assert fetching(server).article("Sea").text == "é\ufffd"


def closed_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


def test_no_server_says_how_to_start_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    url = f"http://127.0.0.1:{closed_port()}"
    with pytest.raises(ArticleError) as caught:
        gem.make("game:WikiGame-v0-easy", backend="kiwix", url=url).reset(seed=0)
    assert str(caught.value).startswith(f"the server of articles at {url} cannot be read (")
    assert str(caught.value).endswith(
        "; start one with 'kiwix-serve --port 8080 FILE.zim' and give its url, or play with backend='embedded'"
    )


# The game.


@pytest.mark.parametrize("backend", ["kiwix", "mediawiki"])
@pytest.mark.few(1)
def test_game_on_a_server_keeps_the_contract(serve: Any, backend: str) -> None:
    server = serve(kiwix() if backend == "kiwix" else mediawiki())
    url = server.url if backend == "kiwix" else server.url + "/w/api.php"
    env = gem.make("game:WikiGame-v0-easy", backend=backend, url=url, variant="freenav", max_distance=2)
    check_env(env)


def test_games_share_what_was_fetched(serve: Any) -> None:
    server = serve(kiwix())
    first, second = (WikiGameEnv(backend="kiwix", url=server.url, book=BOOK) for _ in range(2))
    assert first.graph is second.graph
    assert first.reset(seed=5) == second.reset(seed=5)


def test_server_that_dies_in_the_middle_truncates(serve: Any) -> None:
    """With an error in info and no reward: it is no failure of the agent."""
    alive = [True]
    server = serve(lambda path, query: kiwix()(path, query) if alive else (500, {}, b""))
    env = WikiGameEnv(backend=KiwixArticles(server.url, BOOK, pause_s=0), min_distance=1)
    env.reset(seed=0, options={"start": "Sea", "target": "Goal & son"})
    assert env.step("\\boxed{Coast}")[1:4] == (-0.05, False, False)
    alive.clear()
    _, reward, terminated, truncated, info = env.step("\\boxed{Sand}")
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["error"]["kind"] == "articles"
    assert "answered 500 Internal Server Error" in info["error"]["message"]


def test_redirected_link_reaches_the_target(serve: Any) -> None:
    env = WikiGameEnv(backend=KiwixArticles(serve(kiwix()).url, BOOK))
    env.reset(seed=0, options={"start": "River", "target": "Shore"})
    assert env.target == "Coast"
    assert env.step("\\boxed{Coast}")[1] == 1.0
