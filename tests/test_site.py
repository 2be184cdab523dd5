"""The documentation's site: pages that are made by scripts, links between pages, and the check of the built site."""

from __future__ import annotations

from pathlib import Path

import api_reference
import check_site
import command_reference
import pytest
import site_hooks

ROOT = Path(__file__).parent.parent


def test_commands_are_described_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a narrow terminal too; after a change of a command, `make docs-pages` writes the page again."""
    for plugin in ROOT.glob("plugins/*/gem_*"):
        pytest.importorskip(plugin.name, reason="the page has the commands of all plugins")
    monkeypatch.setenv("COLUMNS", "40")
    page = (ROOT / "docs" / "reference" / "commands.md").read_text(encoding="utf-8")
    assert page == command_reference.page()


def test_packages_are_described_as_they_are() -> None:
    """Each package has its page, and none is left over; `make docs-pages` writes them again."""
    folder = ROOT / "docs" / "reference"
    pages = {path.name: path.read_text(encoding="utf-8") for path in folder.glob("*.md")}
    made = {name: text for name, text in pages.items() if name not in api_reference.FROM_ELSEWHERE}
    assert made == api_reference.pages()


@pytest.mark.parametrize(
    ("place", "target", "on_site"),
    [
        ("docs/tools.md", "../plugins/gem-tau", "plugins/gem-tau/README.md"),
        ("docs/tools.md", "../CHANGELOG.md", "changelog.md"),
        ("docs/tools.md", "../examples/train_hf.py", "examples/train_hf.py.md"),
        ("plugins/gem-tau/README.md", "../../docs/tau.md", "../../tau.md"),
        ("plugins/gem-tau/README.md", "../../README.md", "../../index.md"),
    ],
)
def test_a_link_is_rewritten_for_the_site(place: str, target: str, on_site: str) -> None:
    """What works between files of the repository works between pages of the site."""
    assert site_hooks.link_on_site(target, place, site_hooks.page_of(place)) == on_site


def test_a_link_in_code_is_left_alone() -> None:
    """Only links of the text are rewritten, also those whose text is code."""
    text = "[`a`](x.md) `[b](x.md)`\n\n```text\n[c](x.md)\n```\n"
    assert site_hooks.rewrite_links(text, lambda target: "y.md") == text.replace("[`a`](x.md)", "[`a`](y.md)")


def test_links_that_lead_nowhere_are_found(tmp_path: Path) -> None:
    """A missing file, a missing anchor, and what a browser would load from another host; all else is right."""
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "index.html").write_text('<p id="here"><a href="../index.html#top">up</a></p>', encoding="utf-8")
    (tmp_path / "index.html").write_text(
        '<h1 id="top"></h1><a href="a/">a</a><a href="a/index.html#here">b</a><a href="#top">c</a>'
        '<a href="https://example.org/">d</a><a href="b/">e</a><a href="a/index.html#there">f</a>'
        '<script src="https://example.org/s.js"></script>',
        encoding="utf-8",
    )
    assert check_site.check(tmp_path) == [
        "index.html: b/: no such file",
        "index.html: a/index.html#there: no such anchor",
        "index.html: https://example.org/s.js: loaded from another host",
    ]
