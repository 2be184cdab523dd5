"""``Response`` is a ``str`` in every way, and carries what the server reported."""

from __future__ import annotations

import copy
import json
import pickle
import re
from typing import Any

import pytest

from gem_core import Response

FIELDS: dict[str, Any] = {
    "token_ids": [1, 2],
    "prompt_token_ids": [0],
    "logprobs": [-0.5, -0.25],
    "finish_reason": "length",
    "tool_calls": [{"id": "call_1", "function": {"name": "python", "arguments": "{}"}}],
    "reasoning": "hm",
    "usage": {"total_tokens": 3},
    "model": "m",
}


@pytest.mark.parametrize(
    "duplicate",
    [copy.copy, copy.deepcopy, *(lambda r, p=p: pickle.loads(pickle.dumps(r, p)) for p in (2, 5)), Response.of],
)
def test_copies_keep_text_and_fields(duplicate: Any) -> None:
    """Copied, pickled, or taken as it is; what is given is copied, and a deep copy shares nothing."""
    fields = copy.deepcopy(FIELDS)
    response = Response(" four ", **fields)
    fields["token_ids"].append(3)
    again = duplicate(response)
    assert type(again) is Response
    assert (again.text, again.reported()) == (" four ", FIELDS)
    assert again.cut_off
    copy.deepcopy(response).token_ids.append(4)
    assert response.token_ids == [1, 2]


def test_it_is_its_text_to_json_regular_expressions_and_dictionaries() -> None:
    """A response equals its text."""
    response = Response(" four ", **FIELDS)
    assert json.dumps({"action": response}) == '{"action": " four "}'
    assert {" four ": 1}[response] == 1
    found = re.search(r"f(o)ur", response)
    assert found is not None
    assert found[1] == "o"


@pytest.mark.parametrize(
    "make", [str.strip, lambda r: r + "!", lambda r: r[1:], lambda r: f"{r}", str, lambda r: r.text]
)
def test_new_text_is_a_plain_str(make: Any) -> None:
    """What makes new text of a response gives a plain str."""
    assert type(make(Response(" four ", **FIELDS))) is str


def test_what_was_not_reported_is_none() -> None:
    """And left out of reported(); an empty list was reported."""
    plain = Response.of("x")
    assert plain.reported() == {}
    assert {getattr(plain, name) for name in FIELDS} == {None}
    assert Response("", token_ids=[], reasoning="").reported() == {"token_ids": [], "reasoning": ""}
    assert not Response("x", finish_reason="stop").cut_off


@pytest.mark.parametrize("text", [None, 3, b"a"])
def test_text_of_a_response_is_a_string(text: Any) -> None:
    """The content of a message may be None, and must not become the answer 'None'."""
    with pytest.raises(TypeError):
        Response(text)
