"""The page of gem view in a browser: the table, transcripts, keys, links, and a run that grows."""

from __future__ import annotations

import json
from pathlib import Path

import chromium
import pytest
from chromium import Page
from PIL import Image
from recorded import HOSTILE, broken, duel, failed, hostile, maze
from test_view import served, write_run

from gem_core import write_episodes
from gem_eval.records import RunWriter
from gem_eval.show.text import escaped

pytestmark = pytest.mark.skipif(chromium.find() is None, reason="there is no Chromium")

TABLE = "document.querySelectorAll('#rows .outcome').length"
TURNS = "document.querySelectorAll('article .turn').length"


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """A folder with a run of five episodes and a file of three."""
    picture = Image.new("RGB", (8, 8), (200, 40, 40))
    write_run(tmp_path / "runs" / "first", [maze(), failed(), broken(), hostile(), maze(picture)])
    write_episodes(tmp_path / "runs" / "second.jsonl", [maze(), duel(), failed(seed=9)])
    return tmp_path / "runs"


def test_the_page_in_a_browser(runs: Path) -> None:
    """One visit: table, filter, sort, episode, keys, images, search, a link, hostile text, and a run that grows."""
    with served(runs) as address, Page(address) as page:
        page.until(f"{TABLE} === 8")
        assert page.eval("document.querySelectorAll('.run').length") == 2
        # A filter and an order; the address tells them.
        page.eval("document.querySelector('.chip.error').click()")
        page.until(f"{TABLE} === 1 && location.hash === '#outcome=error'")
        page.eval("document.querySelector('#clear').click()")
        page.until(f"{TABLE} === 8")
        page.eval(
            "[...document.querySelectorAll('#head button')].find((each) => each.textContent === 'Return').click()"
        )
        page.until("location.hash === '#sort=return' && document.querySelector('#rows .num')?.textContent === '3'")
        # Episodes by keys, and one beside another.
        page.key("j")
        page.until(f"location.hash.includes('e=first%2F3') && {TURNS} === 2")
        page.eval("location.hash = 'run=first&e=first/1&turn=2'")
        page.until("document.querySelector('article .turn.here h3')?.textContent === 'Turn 2 of 3'")
        page.until("document.querySelector('.row.selected .num').textContent === '1'")
        assert page.eval("document.querySelector('.call .argument + pre').textContent") == "print(6 * 7)"
        page.key("j")
        page.until(f"{TURNS} === 3 && location.hash.includes('e=first%2F2')")
        page.until("document.querySelectorAll('.sibling').length > 1")
        page.key("b")
        page.until(f"{TURNS} > 5")
        page.key("Escape")
        page.until("document.querySelector('#reader').hidden")
        # An image, and text of somebody who means ill.
        page.eval("location.hash = 'e=first/5'")
        page.until("document.querySelector('article img')?.naturalWidth === 8")
        page.eval("location.hash = 'e=first/4'")
        page.until(f"document.querySelector('article .said pre')?.textContent === {json.dumps(escaped(HOSTILE))}")
        # Search in all transcripts, and from hit to hit.
        page.key("Escape")
        page.key("/")
        page.call("Input.insertText", text="NIGHT falls")
        page.key("Enter")
        page.until("document.querySelectorAll('#rows .excerpt mark').length === 2")
        page.eval("document.activeElement.blur()")
        page.key("j")
        page.until("document.querySelector('article mark.here')?.textContent === 'Night falls'")
        page.key("Escape")
        page.key("Escape")
        page.until(f"{TABLE} === 8")
        with RunWriter(runs / "first") as writer:
            episode = failed()
            episode.key = "new"
            writer.write(episode, {"model": "two"})
        page.until(f"{TABLE} === 9 && document.querySelector('.live') !== null")
        assert page.messages == []


def many_rows(path: Path, count: int) -> None:
    """Write a run whose every row is the same episode."""
    write_run(path, [maze()])
    row = json.loads((path / "index.jsonl").read_text())
    with (path / "index.jsonl").open("a") as file:
        for number in range(2, count + 1):
            own = {"number": number, "key": str(number), "episode_return": number % 7, "row": f"maze/{number}"}
            file.write(json.dumps({**row, **own}) + "\n")


@pytest.mark.parametrize("count", [1_000, pytest.param(100_000, marks=pytest.mark.thorough)])
def test_only_what_is_in_sight_is_in_the_page(tmp_path: Path, count: int) -> None:
    """Whatever the length of the table; its end is reached, by the mouse and by keys."""
    many_rows(tmp_path / "run", count)
    with served(tmp_path / "run") as address, Page(address) as page:
        page.until(f"document.querySelector('#summary').textContent.startsWith('{count:,} episodes')")
        page.eval("document.querySelector('#scroller').scrollTop = 1e9")
        last = f"[...document.querySelectorAll('#rows .num.soft')].pop()?.textContent === '{count:,}'"
        page.until(last)
        assert page.eval("document.querySelectorAll('#rows .row').length") < 80
        inside = "document.querySelector('#rows .row:last-child').getBoundingClientRect().bottom <= innerHeight + 1"
        assert page.eval(inside)
        page.eval("document.querySelector('#rows .row:last-child').click()")
        page.until(f"{TURNS} > 2 && location.hash === '#e=run%2F{count}'")
        page.key("k")
        page.until(f"location.hash === '#e=run%2F{count - 1}'")
        page.eval(f"location.hash = 'sort=return&e=run/{count // 2}'")
        page.until(f"document.querySelector('.row.selected .num').textContent === '{count // 2:,}'")
        assert page.messages == []
