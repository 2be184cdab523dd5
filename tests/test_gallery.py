"""The gallery of the documentation: a page for each environment, as ``scripts/gallery.py`` writes it."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from gem_core.registry.known_distributions import KNOWN_DISTRIBUTIONS

DOCS = Path(__file__).parent.parent / "docs"
PLUGINS = [name for name, offered in KNOWN_DISTRIBUTIONS.items() if "namespace" in offered]
for plugin in PLUGINS:
    pytest.importorskip(plugin.replace("-", "_"), reason=f"the gallery shows all plugins; install plugins/{plugin}")
gallery, gallery_drawing, gallery_sections = map(
    pytest.importorskip, ("gallery", "gallery_drawing", "gallery_sections")
)


@pytest.fixture(scope="module")
def rendered() -> dict[str, str]:
    """Return what the script writes."""
    return gallery.render()


def test_pages_are_what_the_script_writes(rendered: dict[str, str]) -> None:
    """After a change, run ``python scripts/gallery.py``."""
    files = [
        *(DOCS / "gallery").rglob("*.md"),
        *(DOCS / "gallery").glob(".nav.yml"),
        *(DOCS / "images" / "gallery").rglob("*.svg"),
    ]
    there = {path.relative_to(DOCS).as_posix(): path.read_text(encoding="utf-8") for path in files}
    assert sorted(there) == sorted(rendered)
    assert [path for path, text in rendered.items() if there[path] != text] == []


def test_pictures_are_small_and_well_formed(rendered: dict[str, str]) -> None:
    """At most 40 kB each, and all of the gallery 3 MB; none loads anything."""
    pictures = {path: text for path, text in rendered.items() if path.endswith(".svg")}
    assert len(pictures) > 20
    for path, text in pictures.items():
        assert len(text.encode()) <= 40_000, path
        ElementTree.fromstring(text)
        assert not re.search(r"<script|href=\"http|url\(", text), path
    assert sum(len(text.encode()) for text in rendered.values()) <= 3_000_000


def test_text_of_an_episode_cannot_break_a_page_or_a_picture() -> None:
    """A response is untrusted: marks of HTML, fences and control characters are shown as text."""
    hostile = "</code></pre><script>x</script>\n```python\n&amp;\x00\x1b[31m"
    episode = {
        "id": "a:B",
        "player": "random",
        "seed": 1,
        "options": {},
        "opening": hostile,
        "turns": [{"number": 1, "seat": None, "action": hostile, "reward": 0.0, "answer": hostile}],
        "num_turns": 1,
        "returns": {"": 0.0},
        "success": {"": False},
    }
    told = "\n".join(gallery_sections.transcript(episode))
    assert "<script" not in told
    assert "```" not in told
    picture = gallery_drawing.card("a:B", "random", [gallery_drawing.Frame(hostile, hostile, hostile, 0.0, hostile)])
    assert [node for node in ElementTree.fromstring(picture).iter() if node.tag.endswith("script")] == []
