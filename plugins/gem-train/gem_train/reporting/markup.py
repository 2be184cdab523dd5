"""Pages in one file: text is escaped, figures stand in them as SVG, nothing is loaded from elsewhere."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gem_train.reporting.drawing import Key

_PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>$title</title>
<style>
$style</style>
</head>
<body>
<main>
<h1>$title</h1>
$content
</main>
</body>
</html>
""")


def write_page(path: str | Path, title: str, content: Sequence[str]) -> Path:
    """Write a page, and return its path.

    Args:
        path: Where it goes.
        title: Its title, as plain text.
        content: Markup, one piece after the other; empty ones are left out.
    """
    style = Path(__file__).with_name("page.css").read_text(encoding="utf-8")
    page = _PAGE.substitute(title=text(title), style=style, content="\n".join(filter(None, content)))
    Path(path).write_text(page, encoding="utf-8")
    return Path(path)


def text(value: str, longest: int | None = None) -> str:
    """Return plain text as markup, cut to a length in characters.

    What is not shown, or turns the text around it, stands as its code; so does what UTF-8 cannot hold.
    """
    more = ""
    if longest is not None and len(value) > longest:
        value, more = value[:longest], f"\n… {len(value) - longest:,} more characters"
    shown = (each if _is_visible(each) else each.encode("unicode_escape").decode("ascii") for each in value)
    return escape("".join(shown) + more)


def paragraphs(plain: str) -> str:
    """Return plain text as markup; an empty line begins a paragraph."""
    return "\n".join(f"<p>{text(part)}</p>" for part in plain.split("\n\n") if part.strip())


def section(title: str, *content: str) -> str:
    """Return a section with a heading; empty where there is nothing in it."""
    shown = "\n".join(filter(None, content))
    return f"<section>\n<h2>{text(title)}</h2>\n{shown}\n</section>" if shown else ""


def figure(caption: str, drawn: str) -> str:
    """Return a figure, given as markup, with its caption in plain text."""
    return f"<figure>\n{drawn}\n<figcaption>{text(caption)}</figcaption>\n</figure>"


def panels(drawn: Sequence[str], legend: Sequence[Key] = ()) -> str:
    """Return panels, as many side by side as there is room for, below their legend."""
    keys = "".join(
        f'<span><i class="{key.look}" style="--key: var(--s{key.series})"></i>{text(key.label)}</span>'
        for key in legend
    )
    shown = f'<div class="legend">{keys}</div>\n' if keys else ""
    return f'{shown}<div class="panels">\n{"".join(drawn)}\n</div>'


def table(rows: Sequence[Mapping[str, object]]) -> str:
    """Return a table of rows that have the same names; an underscore in a name is shown as a blank."""
    if not rows:
        return ""
    head = "".join(f"<th{_alignment(value)}>{text(name.replace('_', ' '))}</th>" for name, value in rows[0].items())
    body = "\n".join(
        f"<tr>{''.join(f'<td{_alignment(value)}>{_cell(value)}</td>' for value in row.values())}</tr>" for row in rows
    )
    return f'<div class="scroll"><table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table></div>'


def _is_visible(character: str) -> bool:
    return character in "\n\t" or not unicodedata.category(character).startswith("C")


def _alignment(value: object) -> str:
    return "" if isinstance(value, str) else ' class="number"'


def _cell(value: object) -> str:
    """Return a value as markup: a number with four digits, what is not known as a dash."""
    if value is None or value != value:
        return "-"
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"
    return text(str(value))
