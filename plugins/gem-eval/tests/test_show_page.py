"""The page of gem show --html: self-contained, closed to the network, and inert whatever the episodes hold."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pages import Page, hash_of
from PIL import Image
from recorded import HOSTILE, hostile, maze, turn, write_all

from gem_core import Episode, write_episodes
from gem_core.cli import main
from gem_core.records import ImageFolder
from gem_eval.episode_data import MOST_TEXT
from gem_eval.show.page import PageWriter
from gem_eval.show.text import escaped

ANY_TEXT = st.text(st.characters(codec=None, categories=None), max_size=60)


def page_of(*episodes: Episode, folder: Path = Path("none")) -> Page:
    """The page of some episodes."""
    writer = PageWriter("run.jsonl", ImageFolder(folder))
    for number, episode in enumerate(episodes, start=1):
        writer.add(number, episode)
    return Page(writer.html())


def data_of(page: Page) -> Any:
    return json.loads(page.raw["script"][0])


@pytest.fixture
def written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Write the page of five episodes with the command."""
    monkeypatch.chdir(tmp_path)
    write_all(tmp_path / "run.jsonl")

    def call(*arguments: str) -> tuple[Page, str]:
        with pytest.raises(SystemExit) as caught:
            main(["show", "run.jsonl", "--html", "out/page.html", *arguments])
        assert not caught.value.code
        return Page((tmp_path / "out" / "page.html").read_text("utf-8")), capsys.readouterr().out

    return call


def test_the_page_needs_nothing_but_itself(written) -> None:
    """No element names anything outside, and neither script nor style does."""
    page, out = written()
    assert out == "5 episodes written to out/page.html\n"
    for tag, attributes in page.elements:
        assert tag not in ("link", "iframe", "object", "embed", "base", "form", "img", "a")
        assert not {"src", "href", "srcset", "data", "action", "style", "background"} & {*attributes}
        assert not [name for name in attributes if name.startswith("on")]
    for text in (page.raw["script"][1], *page.raw["style"]):
        assert not re.search(
            r"@import|url\(|\bfetch\(|XMLHttpRequest|WebSocket|import\(|eval\(|innerHTML|insertAdj", text
        )
        assert {*re.findall(r"https?://[^\s\"']+", text)} <= {"http://www.w3.org/2000/svg"}


def test_the_policy_allows_its_own_script_and_style_and_images_as_data(written) -> None:
    """By their hashes; nothing else is loaded, sent or run."""
    page, _ = written()
    assert page.policy == {
        "default-src": ["'none'"],
        "script-src": [hash_of(page.raw["script"][1])],
        "style-src": [hash_of(page.raw["style"][0])],
        "img-src": ["data:"],
        "base-uri": ["'none'"],
        "form-action": ["'none'"],
    }
    assert len(page.raw["script"]) == 2
    assert len(page.raw["style"]) == 1


def test_hostile_text_stays_text(written) -> None:
    """It is in the data with its control characters as codes, and nowhere else in the page."""
    page, _ = written()
    evil = data_of(page)["episodes"][3]
    assert evil["final"] == [{"kind": "text", "text": escaped(HOSTILE), "repeated": False}]
    assert evil["turns"][0]["blocks"][2]["parts"][0]["text"] == escaped(HOSTILE)
    tags = [tag for tag, _ in page.elements]
    assert tags == [tag for tag, _ in page_of(maze()).elements]
    assert "<" not in page.raw["script"][0]


@settings(deadline=None)
@given(ANY_TEXT)
def test_any_text_stays_text(text: str) -> None:
    """The data parse back, and the elements are those of any page."""
    page = page_of(Episode(text, 1, text, {}, [turn(text, text, **{text: text})], text, group=text), hostile())
    said = data_of(page)["episodes"][0]["turns"][0]["blocks"][1]["parts"]
    assert "".join(part["text"] for part in said) == escaped(text)
    assert [tag for tag, _ in page.elements] == [tag for tag, _ in page_of(maze()).elements]


def test_the_data_hold_what_is_shown(written) -> None:
    """Turns with rewards for the bars, what the server reported, and folded observations."""
    page, out = written("--env", "maze:*", "--limit", "1")
    (episode,) = data_of(page)["episodes"]
    assert data_of(page)["notes"] == ["2 more episodes are left out of this page; --limit 3 takes all."]
    assert out == "1 episode written to out/page.html (2 more left out: raise --limit)\n"
    assert (episode["number"], episode["outcome"], episode["return"]) == (1, "success", "0.75")
    assert [turn["reward"] for turn in episode["turns"]] == [0.25, -0.5, 1.0]
    assert [p["text"] for b in episode["turns"][0]["blocks"] if b["label"] == "tool call" for p in b["parts"]] == [
        'python({"code": "print(6 * 7)"})'
    ]
    assert episode["turns"][1]["flags"] == ["cut off at the token limit"]
    assert [part["repeated"] for part in episode["turns"][1]["blocks"][0]["parts"]] == [True, False]
    assert episode["start"]["task"] == "room-7"


def test_images_stand_in_the_page_once(written) -> None:
    """As data, written anew as PNG; a name that is none of ours is not looked for."""
    page, _ = written()
    ((name, source),) = data_of(page)["images"].items()
    assert data_of(page)["episodes"][4]["turns"][0]["blocks"][0]["parts"][1] == {
        "kind": "image",
        "text": name,
        "repeated": False,
    }
    assert base64.b64decode(source.removeprefix("data:image/png;base64,")).startswith(b"\x89PNG")
    assert data_of(page)["notes"] == ["Images that cannot be read, or would be too much: 1. Their names stand instead."]


def test_images_of_any_mode_stand_in_the_page_up_to_a_limit(tmp_path: Path) -> None:
    pictures = [Image.new("F", (4, 4), 0.5), Image.new("CMYK", (4, 4)), Image.new("RGBA", (4, 4))]
    parts: Any = [{"type": "image", "image": picture} for picture in pictures]
    write_episodes(tmp_path / "run.jsonl", [Episode("toy:A-v0", 1, parts, {})])
    record = json.loads((tmp_path / "run.jsonl").read_text("ascii"))
    for limit, expected in ((10**6, 3), (0, 0)):
        writer = PageWriter("run", ImageFolder(tmp_path / "run.images"), most_image_bytes=limit)
        writer.add(1, Episode.from_dict(record))
        assert len(data_of(Page(writer.html()))["images"]) == expected


def test_long_texts_and_strange_numbers_do_not_break_the_page() -> None:
    """JSON has no infinity: the bar is flat and the text says it."""
    turns = [turn("a", "b", float("inf")), turn("a", "b", float("nan"))]
    page = page_of(Episode("toy:A-v0", 1, "a", {}, turns, "c"), Episode("toy:A-v0", 1, "x" * (MOST_TEXT + 1234), {}))
    strange, long = data_of(page)["episodes"]
    assert [(each["reward"], each["rewardText"]) for each in strange["turns"]] == [(0.0, "inf"), (0.0, "nan")]
    assert long["observation"][0]["text"].endswith("x\n… 1,234 more characters")
