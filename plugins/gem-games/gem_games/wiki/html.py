"""Reading an article's page: its paragraphs as plain text, its links, and where it leads on at once."""

from __future__ import annotations

import re
from html.parser import HTMLParser

_LONGEST_TEXT = 10_000
_MOST_LINKS = 5_000
_SPACES = re.compile(r"\s+")
_REFRESH = re.compile(r"\s*0\s*;\s*url\s*=\s*(.+)", re.IGNORECASE)
# Elements without an end tag never count as open.
_VOID = frozenset(
    ["area", "base", "br", "col", "embed", "hr", "img", "input", "link", "meta", "source", "track", "wbr"]
)
_UNREAD = frozenset(["script", "style", "table", "figure", "math", "nav", "footer", "header", "noscript"])
_UNREAD_CLASSES = frozenset(
    ["reference", "mw-editsection", "hatnote", "navbox", "infobox", "thumb", "toc", "noprint", "reflist", "metadata"]
)
_OUTSIDE_CLASSES = frozenset(["external", "extiw", "new", "image", "mw-file-description", "internal"])


class PageReader(HTMLParser):
    """Reads one page; afterwards ``text``, ``links`` and ``refresh`` hold what it says.

    ``links`` are the addresses in ``href``, as they are written. ``refresh`` is the address of a page that the browser
    is sent to at once; ``""`` without one.
    """

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.links: list[str] = []
        self.refresh = ""
        self._paragraphs: list[str] = []
        self._pieces: list[str] | None = None
        self._unread: list[str] = []
        self._length = 0
        self.feed(page)
        self.close()
        self._end_paragraph()
        self.text = "\n".join(self._paragraphs)[:_LONGEST_TEXT]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note a link, a paragraph, a refresh, or something that is not part of the text."""
        attributes = dict(attrs)
        classes = (attributes.get("class") or "").split()
        if tag == "a":
            self._note_link(attributes.get("href") or "", classes)
        elif tag == "meta" and (attributes.get("http-equiv") or "").lower() == "refresh":
            match = _REFRESH.match(attributes.get("content") or "")
            self.refresh = match[1].strip("'\" ") if match else self.refresh
        if self._unread:
            # Only elements of the same name can close it, so the others need not be counted.
            if tag == self._unread[0]:
                self._unread.append(tag)
        elif tag not in _VOID and (tag in _UNREAD or not _UNREAD_CLASSES.isdisjoint(classes)):
            self._unread.append(tag)
        elif tag == "p":
            self._end_paragraph()
            self._pieces = []

    def handle_endtag(self, tag: str) -> None:
        """Note the end of a paragraph, or of what is not part of the text."""
        if self._unread:
            if tag == self._unread[0]:
                self._unread.pop()
        elif tag == "p":
            self._end_paragraph()

    def handle_data(self, data: str) -> None:
        """Collect the text of a paragraph."""
        if self._pieces is not None and not self._unread and self._length < _LONGEST_TEXT:
            self._pieces.append(data)
            self._length += len(data)

    def _note_link(self, href: str, classes: list[str]) -> None:
        if href and not href.startswith("#") and _OUTSIDE_CLASSES.isdisjoint(classes) and len(self.links) < _MOST_LINKS:
            self.links.append(href)

    def _end_paragraph(self) -> None:
        if self._pieces:
            text = _SPACES.sub(" ", "".join(self._pieces)).strip()
            if text:
                self._paragraphs.append(text)
        self._pieces = None
