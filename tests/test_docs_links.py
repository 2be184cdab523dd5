"""Links from the program into the documentation: each leads to a page, and to a heading, that is there."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import gem_core as gem
from gem_core.docs import gallery_page
from gem_core.registry.lookup import registry

if TYPE_CHECKING:
    from command_calls import RunGem
    from in_terminal import InTerminal

ROOT = Path(__file__).resolve().parent.parent
SITE = "https://gem-core.readthedocs.io/"


def links() -> Iterator[tuple[str, str]]:
    """Yield each place in the code that links to a page, and the page."""
    for path in sorted([*ROOT.glob("gem_core/**/*.py"), *ROOT.glob("plugins/*/gem_*/**/*.py")]):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match node:
                case ast.Call(func=ast.Name("page_url"), args=[ast.Constant(value=str(page))]):
                    yield f"{path.relative_to(ROOT)}:{node.lineno}", page


def anchors(text: str) -> set[str]:
    """Return the anchors of a page's headings, as Python-Markdown makes them."""
    prose = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.+)$", prose, re.MULTILINE)
    return {re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower()) for heading in headings}


def source(page: str) -> Path:
    """Return the file that a page of the site is made from."""
    path = ROOT / "docs" / page.strip("/")
    return path / "index.md" if path.is_dir() else path.with_suffix(".md")


@pytest.mark.parametrize("page", sorted({page for _, page in links()}))
def test_every_link_in_the_code_leads_somewhere(page: str) -> None:
    """The page is there, and has the heading."""
    name, _, anchor = page.partition("#")
    assert name.endswith("/")
    assert source(name).is_file(), page
    assert not anchor or anchor in anchors(source(name).read_text(encoding="utf-8")), page


def test_every_environment_of_ours_has_its_page() -> None:
    """What ``gem info`` links to is in the gallery."""
    ours = [env_id for env_id in gem.list_envs() if registry().provider(env_id) is not None]
    assert {gallery_page(env_id) for env_id in ours if not source(gallery_page(env_id)).is_file()} == set()


def test_info_and_list_link_to_the_gallery(run_gem: RunGem, terminal: Callable[..., InTerminal]) -> None:
    """In words and as JSON; in a pipe a list has ids alone."""
    pytest.importorskip("gem_games", reason="it looks at a game; install plugins/gem-games")
    page = f"{SITE}gallery/game/sudoku/"
    assert f"  page:         {page}\n" in run_gem("info", "game:Sudoku-v0-easy").out
    assert json.loads(run_gem("info", "game:Sudoku-v0-easy", "--json").out)["page"] == page
    assert "gallery" not in run_gem("list", "game").out
    terminal("list").wait_for(f"Each family, with episodes to look at: {SITE}gallery/")
    assert "page:" not in run_gem("info", "toy:Countdown-v0").out
