"""For `make docs`, hooks of mkdocs: pages from outside docs/, and links that work on GitHub and on the site alike.

Pages link to each other by their places in the repository. What lies outside docs/ gets a page of the site: the
plugins' READMEs and the changelog always, other files where a page links to them. Links are rewritten to these pages.
"""

from __future__ import annotations

import posixpath
import re
import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
LINK = re.compile(
    r"^(?P<fence>```+).*?^(?P=fence)$|`[^`\n]+`|(?<=\]\()(?P<target>[^)\s]+)(?=\))", re.MULTILINE | re.DOTALL
)
"""The target of a link; code is matched too, so that nothing in it is taken for a link."""
SCHEME = re.compile(r"[a-z]+:")
MOVED = {"README.md": "index.md", "CHANGELOG.md": "changelog.md"}
LANGUAGES = {".py": "python", ".toml": "toml", ".sh": "bash", ".yaml": "yaml", ".yml": "yaml", ".json": "json"}


def on_config(config: Any) -> Any:
    """Take the site's address from where the distribution names it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    config.site_url = project["urls"].get("Documentation", "")
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the pages from outside docs/, and put each page into a folder of its own.

    The theme's offline mode names each page's file in links, as it must where there is no server. In a folder, as its
    ``index.html``, a page has the same address with a server: ``tools/`` as well as ``tools/index.html``.
    """
    from mkdocs.structure.files import File, InclusionLevel  # type: ignore[import-not-found]

    in_docs = {f"docs/{file.src_uri}": file.content_string for file in files.documentation_pages()}
    for place, text in outside_pages(in_docs).items():
        listed = place.endswith("README.md") or place in MOVED
        inclusion = InclusionLevel.INCLUDED if listed else InclusionLevel.NOT_IN_NAV
        files.append(File.generated(config, page_of(place), content=text, inclusion=inclusion))
    for file in files.documentation_pages():
        if not file.dest_uri.endswith("index.html"):
            file.dest_uri = f"{file.dest_uri.removesuffix('.html')}/index.html"
            file.__dict__.pop("url", None)
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Rewrite a page's links to files of the repository."""
    uri = page.file.src_uri
    if uri == "index.md":
        page.meta["hide"] = ["navigation"]  # which would list this page alone
    if uri.startswith("reference/") or uri in ("style.md", "changelog.md"):
        page.meta["search"] = {"boost": 0.1}  # guides and questions come first
    elif uri in ("index.md", "questions.md"):
        page.meta["search"] = {"boost": 4}
    place = next((old for old, new in MOVED.items() if new == uri and page.file.generated_by), None)
    if place is None:
        place = uri if page.file.generated_by else f"docs/{uri}"
    return rewrite_links(markdown, lambda target: link_on_site(target, place, uri))


def outside_pages(in_docs: dict[str, str]) -> dict[str, str]:
    """Return the text of each page from outside docs/, by its place in the repository.

    Args:
        in_docs: Text of each page of docs/, by its place in the repository.
    """
    always = ["CHANGELOG.md", *(path.relative_to(ROOT).as_posix() for path in sorted(ROOT.glob("plugins/*/README.md")))]
    found: dict[str, str] = {}
    waiting = [*always, *linked_places(in_docs)]
    while waiting:
        place = waiting.pop()
        if place in found or place.startswith("docs/") or place == "README.md":
            continue
        found[place] = outside_page(ROOT / place)
        waiting += linked_places({place: found[place]})
    return found


def linked_places(pages: dict[str, str]) -> Iterable[str]:
    """Yield the places in the repository to which pages link."""
    for place, text in pages.items():
        for target in link_targets(text):
            linked, _ = split_target(target, place)
            if linked and (ROOT / linked).exists():
                yield linked


def outside_page(path: Path) -> str:
    """Return a page that shows a file, or lists a folder."""
    name = path.relative_to(ROOT).as_posix()
    if path.suffix == ".md":
        return path.read_text(encoding="utf-8")
    hidden = "---\nsearch:\n  exclude: true\n---\n"
    if path.is_dir():
        entries = sorted(entry.name for entry in path.iterdir() if entry.is_file() and entry.name[0] not in "._")
        return f"{hidden}# `{name}`\n\n" + "".join(f"- [`{entry}`]({path.name}/{entry})\n" for entry in entries)
    language = LANGUAGES.get(path.suffix, "text")
    return f"{hidden}# `{name}`\n\n````{language}\n{path.read_text(encoding='utf-8').rstrip()}\n````\n"


def page_of(place: str) -> str:
    """Return where among the site's sources a file or folder of the repository has its page."""
    if place.startswith("docs/"):
        return place.removeprefix("docs/")
    return MOVED.get(place, place if place.endswith(".md") else f"{place}.md")


def link_targets(markdown: str) -> list[str]:
    """Return the targets of a text's links."""
    return [match["target"] for match in LINK.finditer(markdown) if match["target"]]


def rewrite_links(markdown: str, rewritten: Callable[[str], str]) -> str:
    """Return a text with the target of each link rewritten."""
    return LINK.sub(lambda match: rewritten(match["target"]) if match["target"] else match[0], markdown)


def split_target(target: str, place: str) -> tuple[str, str]:
    """Return where in the repository a link of the file at ``place`` leads, and its anchor; "" for a link elsewhere."""
    path, mark, anchor = target.partition("#")
    if not path or SCHEME.match(path):
        return "", target
    linked = posixpath.normpath(posixpath.join(posixpath.dirname(place), path))
    if re.fullmatch(r"plugins/[^/]+", linked):
        linked = f"{linked}/README.md"
    return linked, mark + anchor


def link_on_site(target: str, place: str, uri: str) -> str:
    """Return a link's target as the site needs it.

    Args:
        target: The link, as it is written.
        place: Where the page that holds it lies in the repository.
        uri: Where that page lies among the site's sources.
    """
    linked, anchor = split_target(target, place)
    if not linked:
        return target
    if linked.startswith("docs/") and (ROOT / linked).is_dir():
        linked = f"{linked}/index.md"
    return posixpath.relpath(page_of(linked), posixpath.dirname(uri)) + anchor
