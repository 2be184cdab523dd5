"""Pieces of a page: text of others is escaped in every one of them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape
from typing import NamedTuple

from gem_eval.show.text import escaped

_MARKS = re.compile(r"[:/_.]+")


class Cell(NamedTuple):
    """A cell of a table.

    Args:
        html: What it holds, escaped.
        kind: Its class.
        span: How many rows it is high.
    """

    html: str
    kind: str = "number"
    span: int = 1


def text(value: object, longest: int | None = None) -> str:
    """Return text of others as HTML: characters that hide or reorder as their codes, and cut to a length."""
    found = str(value)
    if longest is not None and len(found) > longest:
        found = f"{found[:longest]}\n… {len(found) - longest:,} more characters"
    return escape(escaped(found))


def name_cell(value: object, span: int = 1) -> Cell:
    """Return a cell with a name, which heads its rows."""
    return Cell(name(value), "name", span)


def name(value: object) -> str:
    """Return a name as HTML, which may be broken after each mark in it."""
    return _MARKS.sub(r"\g<0><wbr>", text(value))


def table(headers: Sequence[Cell], rows: Iterable[tuple[str, Sequence[Cell]]]) -> str:
    """Return a table.

    Args:
        headers: Its first line.
        rows: Of each row its class, and its cells; names head the row.
    """
    head = "".join(f'<th scope="col" class="{cell.kind}">{cell.html}</th>' for cell in headers)
    body = "\n".join(f'<tr class="{kind}">{"".join(map(_cell, cells))}</tr>' for kind, cells in rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>'


def section(anchor: str, title: str, *content: str) -> str:
    """Return a section; empty where it has no content."""
    shown = "\n".join(each for each in content if each)
    return f'<section id="{anchor}">\n<h2>{title}</h2>\n{shown}\n</section>' if shown else ""


def figure(title: str, svg: str) -> str:
    """Return a plot with its title."""
    return f"<figure><figcaption>{text(title)}</figcaption>{svg}</figure>"


def _cell(cell: Cell) -> str:
    span = f' rowspan="{cell.span}"' if cell.span > 1 else ""
    if cell.kind == "name":
        return f'<th scope="row{"group" if span else ""}" class="name"{span}>{cell.html}</th>'
    return f'<td class="{cell.kind}">{cell.html}</td>'
