"""``Response`` is a ``str`` in every way, and carries what the server reported."""

from __future__ import annotations

import copy
import json
import pickle
import re
from typing import Any

import pytest

from gem_core import Response

FIELDS = {
    "token_ids": [1, 2],
    "prompt_token_ids": [0],
    "logprobs": [-0.5, -0.25],
    "finish_reason": "length",
    "tool_calls": [{"id": "call_1", "function": {"name": "python", "arguments": "{}"}}],
    "reasoning": "hm",
    "usage": {"total_tokens": 3},
    "model": "m",
}


@pytest.fixture
def response() -> Response:
    """A response with every field reported."""
    return Response(" four ", **FIELDS)  # type: ignore[arg-type]


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_pickle_keeps_text_and_fields(response: Response, protocol: int) -> None:
    """A response survives pickling with all that was reported."""
    again = pickle.loads(pickle.dumps(response, protocol))
    assert type(again) is Response
    assert (again.text, again.reported()) == (" four ", FIELDS)


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy])
def test_copies_keep_text_and_fields(response: Response, duplicate: object) -> None:
    """Shallow and deep copies keep everything."""
    again = duplicate(response)  # type: ignore[operator]
    assert type(again) is Response
    assert (again.text, again.reported()) == (" four ", FIELDS)


def test_deepcopy_shares_nothing(response: Response) -> None:
    """A deep copy has lists of its own."""
    again = copy.deepcopy(response)
    again.token_ids.append(3)
    assert response.token_ids == [1, 2]


def test_json_is_the_text(response: Response) -> None:
    """JSON writes the text alone."""
    assert json.dumps({"action": response}) == '{"action": " four "}'


def test_equality_and_hash_are_those_of_the_text(response: Response) -> None:
    """A response equals its text and is found under it."""
    assert response == " four "
    assert {" four ": 1}[response] == 1


def test_regular_expressions_take_it(response: Response) -> None:
    """A response is searched as any text."""
    assert re.search(r"f(o)ur", response)[1] == "o"


@pytest.mark.parametrize(
    "make",
    [
        str.strip,
        str.lower,
        lambda r: r + "!",
        lambda r: "!" + r,
        lambda r: r[1:],
        lambda r: f"{r}",
        str,
        lambda r: r.text,
    ],
)
def test_new_text_is_a_plain_str(response: Response, make: object) -> None:
    """What makes new text of a response gives a plain str."""
    assert type(make(response)) is str  # type: ignore[operator]


def test_plain_response_reports_nothing() -> None:
    """Fields that were not given are None and left out of reported()."""
    plain = Response("x")
    assert plain.reported() == {}
    assert {getattr(plain, name) for name in FIELDS} == {None}


def test_empty_reports_are_kept() -> None:
    """An empty list was reported; None was not."""
    assert Response("", token_ids=[], reasoning="").reported() == {"token_ids": [], "reasoning": ""}


def test_response_does_not_share_its_lists() -> None:
    """Changing the list that was given does not change the response."""
    ids = [1]
    response = Response("x", token_ids=ids)
    ids.append(2)
    assert response.token_ids == [1]


def test_cut_off_is_the_length_reason(response: Response) -> None:
    """Only the finish reason 'length' says that the text was cut off."""
    assert response.cut_off
    assert not Response("x", finish_reason="stop").cut_off


def test_of_keeps_a_response_and_wraps_text(response: Response) -> None:
    """``of`` returns a response itself, and makes one of plain text."""
    assert Response.of(response) is response
    assert type(Response.of("x")) is Response


@pytest.mark.parametrize("text", [None, 3, b"a"])
def test_text_of_a_response_is_a_string(text: Any) -> None:
    """The content of a message may be None, and must not become the answer 'None'."""
    with pytest.raises(TypeError, match="the text of a response is a str"):
        Response(text)
