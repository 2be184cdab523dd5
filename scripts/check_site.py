"""For `make docs`: check that all links and anchors of the pages lead somewhere, and nothing loads from elsewhere.

    python scripts/check_site.py site

Reads the HTML files of a folder. Links to other sites are not followed.
"""

from __future__ import annotations

import posixpath
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

LOADED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "link": "href"}
"""Elements that a browser loads by itself, with the attribute that says from where."""
NOT_LOADED = {"canonical", "prev", "next", "alternate"}
"""Kinds of ``link`` that only name an address."""


class Link(NamedTuple):
    """Where an element points to, and whether a browser loads it by itself."""

    address: str
    loaded: bool


class PageReader(HTMLParser):
    """Collects the links and anchors of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[Link] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what one element points to, and its anchor."""
        values = {name: value for name, value in attrs if value is not None}
        self.anchors |= {values[name] for name in ("id", "name") if name in values}
        if tag == "a" and "href" in values:
            self.links.append(Link(values["href"], loaded=False))
        elif LOADED.get(tag) in values and values.get("rel") not in NOT_LOADED:
            self.links.append(Link(values[LOADED[tag]], loaded=True))


def read_page(path: Path) -> PageReader:
    """Return the links and anchors of an HTML file."""
    reader = PageReader()
    reader.feed(path.read_text(encoding="utf-8"))
    return reader


def check(site: Path) -> list[str]:
    """Return a line for each link that leads nowhere, and each thing that is loaded from another host."""
    pages = {path.relative_to(site).as_posix(): read_page(path) for path in sorted(site.rglob("*.html"))}
    return [
        f"{name}: {link.address}: {problem}"
        for name, page in pages.items()
        for link in page.links
        if (problem := problem_of(link, name, pages, site))
    ]


def problem_of(link: Link, name: str, pages: dict[str, PageReader], site: Path) -> str:
    """Return what is wrong with a link of the page ``name``; "" if nothing is."""
    parts = urlsplit(link.address)
    if parts.scheme or parts.netloc:
        return "loaded from another host" if link.loaded and parts.scheme != "data" else ""
    if name == "404.html":  # served in place of any page, it has addresses from the root of the host
        return ""
    target = name
    if parts.path:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(name), unquote(parts.path)))
        if (site / target).is_dir():
            target = posixpath.normpath(posixpath.join(target, "index.html"))
    if not (site / target).is_file():
        return "no such file"
    if parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
        return "no such anchor"
    return ""


def main(arguments: list[str]) -> int:
    """Check the site in the folder that is named, and print what is wrong."""
    site = Path(arguments[0])
    problems = check(site)
    for problem in problems:
        print(problem)
    count = sum(1 for _ in site.rglob("*.html"))
    if not count:
        print(f"{site}: no page")
    print(f"{count} pages, {len(problems)} problems")
    return 1 if problems or not count else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
