"""Messages, names, schemas and results: what servers and agents write, however odd."""

from __future__ import annotations

import base64
import io
import json
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from gem_core.errors import ArgumentError
from gem_tools.mcp.config import Server
from gem_tools.mcp.listing import Offer
from gem_tools.mcp.names import chosen, legal, tool_names
from gem_tools.mcp.results import from_call
from gem_tools.mcp.tool import McpTool
from gem_tools.mcp.transports import BoundedLines

PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=12,
)


def response(number: int, words: str) -> bytes:
    """Return an answer as Python servers write it."""
    return json.dumps({"jsonrpc": "2.0", "id": number, "result": {"text": words}}).encode() + b"\n"


# Lines.


def lines_of(max_chars: int) -> BoundedLines:
    """Return a decoder of lines that are at most so long."""
    decoder = BoundedLines()
    decoder.max_chars = max_chars
    return decoder


def decoded(stream: bytes, max_chars: int, cuts: list[int]) -> str:
    """Return what the library reads of a stream that arrives in pieces."""
    decoder = lines_of(max_chars)
    return "".join(decoder.decode(stream[start:end]) for start, end in zip([0, *cuts], [*cuts, None], strict=True))


@given(st.lists(st.integers(0, 40), max_size=8).map(sorted))
def test_lines_are_the_same_however_they_arrive(cuts):
    """The pipe cuts where it likes; what is no UTF-8 is replaced."""
    stream = b"".join(response(number, "\u00e4" * number) for number in range(3)) + b"not JSON\n\xff\n"
    assert decoded(stream, 10_000, cuts) == stream.decode(errors="replace")


@pytest.mark.parametrize("size", [1000, 65536, 10**6])
def test_a_line_that_is_too_long_is_no_message(size):
    """It is not kept, however it arrives."""
    stream = b"x" * 200_000 + b"\n"
    assert "over 10,000,000 bytes" in decoded(stream, 150_000, list(range(size, len(stream), size)))


@pytest.mark.parametrize(
    ("written", "read"),
    [(r"\ud800!", "\ufffd!"), (r"\uDC00\ud83d\ude00", "\ufffd\U0001f600"), (r"\\ud800 \n\u00e4", "\\ud800 \n\u00e4")],
)
def test_half_of_a_character_does_not_cost_the_answer(written, read):
    assert json.loads(decoded(f'{{"a": "{written}"}}\n'.encode(), 1000, [])) == {"a": read}


# Names.


@given(
    st.lists(
        st.tuples(st.sampled_from(["a", "b", "ü"]), st.text(max_size=70) | st.sampled_from(["x", "X", "a_x", "x_2"])),
        max_size=12,
        unique=True,
    )
)
def test_names_are_legal_unique_and_the_same_again(offered):
    names = tool_names(offered)
    assert len({name.casefold() for name in names}) == len(offered)
    assert all(re.fullmatch(r"[a-zA-Z0-9_-]{1,64}", name) for name in names)
    assert names == tool_names(offered)


def test_names_stay_as_they_are_where_they_can():
    assert tool_names([("a", "read"), ("b", "write-it")]) == ["read", "write-it"]
    assert tool_names([("a", "read"), ("b", "read"), ("b", "own")]) == ["a_read", "b_read", "own"]
    assert tool_names([("a", "x.y"), ("a", "x/y"), ("a", "x_y")]) == ["x_y", "x_y_2", "x_y_3"]
    assert tool_names([("my server", "do"), ("my-server", "do"), ("c", "my_server_do")]) == [
        "my_server_do",
        "my-server_do",
        "my_server_do_2",
    ]
    assert legal("a" * 64) == "a" * 64
    assert len(legal("a" * 65)) == 64
    assert legal("a" * 65) != legal("a" * 66)
    assert legal("…") == "tool"


def test_filters_take_names_and_patterns():
    names = ["read_a", "read_b", "write"]
    assert chosen(names, None, None) == set(names)
    assert chosen(names, "read_*", ["read_b"]) == {"read_a"}
    with pytest.raises(ArgumentError, match=re.escape("include: no tool 'rad'; there are read_a, read_b, write")):
        chosen(names, ["rad"], None)
    with pytest.raises(ArgumentError, match=re.escape("exclude: no tool 'x*'")):
        chosen(names, None, "x*")


# Arguments.


@pytest.mark.parametrize(
    "value",
    ["\ud800", {"\udfff": 1}, float("nan"), "x" * 6_000_000, json.loads("[" * 100 + "]" * 100), object()],
    ids=["half", "half of a key", "nan", "long", "deep", "object"],
)
def test_what_cannot_be_sent_is_refused(value):
    tool = McpTool("tool", Server("server", command="x"), Offer("tool", "", {}), {})
    assert tool.validate({"a": ["x"]}) == {"a": ["x"]}
    with pytest.raises(ArgumentError):
        tool.validate({"a": value})


# Results.


def picture(form: str, size: tuple[int, int] = (2, 2), mode: str = "RGB") -> str:
    """Return an image as servers send it."""
    file = io.BytesIO()
    Image.new(mode, size).save(file, form)
    return base64.b64encode(file.getvalue()).decode()


def text(words: str) -> dict[str, str]:
    """Return a block of text."""
    return {"type": "text", "text": words}


def test_structured_content_is_shown_where_there_is_no_text():
    assert from_call({"content": [], "structuredContent": {"n": "ä"}}) == (
        '{"n": "ä"}',
        {"structured": {"n": "ä"}},
    )
    assert from_call({"content": [text("n is ä")], "structuredContent": {"n": "ä"}})[0] == "n is ä"


@pytest.mark.parametrize("form", ["PNG", "JPEG", "GIF", "WEBP"])
def test_images_are_content_parts(form):
    blocks = [text("before"), {"type": "image", "data": picture(form), "mimeType": "image/x"}, text("after")]
    observation, _ = from_call({"content": blocks})
    assert [part["type"] for part in observation] == ["text", "image", "text"]
    assert observation[1]["image"].size == (2, 2)


def test_images_that_unpack_to_too_much_are_not_unpacked():
    data = picture("PNG", (7_000, 7_000), "1")
    observation, _ = from_call({"content": [{"type": "image", "data": data, "mimeType": "image/png"}]})
    assert observation.startswith("[image") and "cannot be shown as text]" in observation  # noqa: PT018


def test_only_so_many_images_are_shown():
    block = {"type": "image", "data": picture("PNG"), "mimeType": "image/png"}
    observation, _ = from_call({"content": [block] * 3}, max_images=2)
    assert [part["type"] for part in observation] == ["image", "image", "text"]
    assert observation[2]["text"] == "[1 more images are not shown.]"


@given(PLAIN, st.sampled_from(["text", "image", "audio", "resource", "resource_link", "x"]))
def test_any_result_is_shown(value, kind):
    """A server may write anything where content is expected."""
    blocks = [
        {"type": kind, "text": value, "data": value, "resource": value, "uri": value, "mimeType": value, "name": value}
    ]
    for content in (value, blocks, [*blocks, value]):
        assert isinstance(from_call({"content": content, "structuredContent": value})[0], str | list)
