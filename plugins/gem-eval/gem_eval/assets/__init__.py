"""Templates, styles and scripts of the pages, and how a page that is one file takes them in."""

from __future__ import annotations

import base64
import hashlib
import re
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

from gem_eval.show.text import escaped

if TYPE_CHECKING:
    from jinja2 import Environment

_BREAKABLE = re.compile(r"[:/_.]+")


def read_assets(*names: str) -> str:
    """Return the text of files of this folder, one after the other, with line feeds alone: a policy has their hash."""
    folder = resources.files(__name__)
    return "".join((folder / name).read_text(encoding="utf-8").replace("\r\n", "\n") for name in names)


def hash_source(text: str) -> str:
    """Return what allows a style or a script by its hash in a Content-Security-Policy."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}"


def render(template: str, **values: Any) -> str:
    """Fill a template of this folder.

    Text of others is escaped, and characters that hide or reorder stand as their codes.

    Args:
        template: Its name.
        values: What stands in it.
    """
    return _environment().get_template(template).render(values)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup, escape

    def visible(value: Any) -> Any:
        return escaped(value) if isinstance(value, str) and not isinstance(value, Markup) else value

    def breakable(name: str) -> Markup:
        """Return a name that may be broken after each mark in it."""
        return Markup(_BREAKABLE.sub(r"\g<0><wbr>", str(escape(escaped(name)))))

    def cut(text: str, longest: int) -> str:
        rest = len(text) - longest
        return text if rest <= 0 else f"{text[:longest]}\n… {rest:,} more characters"

    environment = Environment(
        loader=PackageLoader("gem_eval", "assets"),
        autoescape=True,
        finalize=visible,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "breakable": breakable,
        "cut": cut,
        "hash": hash_source,
    }
    return environment
