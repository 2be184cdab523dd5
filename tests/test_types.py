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


def test_it_is_its_text() -> None:
    """To JSON, regular expressions and dictionaries; what makes new text of it gives a plain str."""
    response = Response(" four ", **FIELDS)
    assert json.dumps({"action": response}) == '{"action": " four "}'
    assert {" four ": 1}[response] == 1
    assert re.search("four", response)
    for new in (response.strip(), response + "!", response[1:], f"{response}", str(response), response.text):
        assert type(new) is str


def test_what_was_not_reported_is_none() -> None:
    """And left out of reported(); an empty list was reported."""
    plain = Response.of("x")
    assert plain.reported() == {}
    assert {getattr(plain, name) for name in FIELDS} == {None}
    assert Response("", token_ids=[], reasoning="").reported() == {"token_ids": [], "reasoning": ""}
    assert not Response("x", finish_reason="stop").cut_off


def test_text_of_a_response_is_a_string() -> None:
    """The content of a message may be None, and must not become the answer 'None'."""
    with pytest.raises(TypeError):
        Response(None)  # type: ignore[arg-type]
