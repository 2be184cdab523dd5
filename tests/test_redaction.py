"""What is blotted out of records, and what stays."""

from __future__ import annotations

import json
from typing import Any

import pytest

from gem_core.records.episode import Episode
from gem_core.records.redaction import without_secrets


@pytest.mark.parametrize(
    ("options", "written"),
    [
        ({"headers": {"X-Any": "s3cret"}, "top_k": 3}, {"headers": {"X-Any": "***"}, "top_k": 3}),
        ({"env": {"DATABASE_URI": "s3cret", "N": 5}}, {"env": {"DATABASE_URI": "***", "N": "***"}}),
        ({"mcpServers": {"a": {"env": {"T": "x"}}}}, {"mcpServers": {"a": {"env": {"T": "***"}}}}),
        ({"api_key": "s3cret", "hf_token": "s"}, {"api_key": "***", "hf_token": "***"}),
        (["--api-key", "s3cret", "--token=s3cret", "-v"], ["--api-key", "***", "--token=***", "-v"]),
        ("https://me:s3cret@host/mcp?key=s3cret&x=1", "https://***@host/mcp?key=***&x=***"),
        (["postgresql://me:s3cret@host/db"], ["postgresql://***@host/db"]),
    ],
)
def test_secrets_are_blotted_out(options: Any, written: Any) -> None:
    assert without_secrets(options) == written
    assert "s3cret" not in json.dumps(without_secrets(options))


@pytest.mark.parametrize(
    "options",
    [
        {"headers": {"Authorization": "Bearer ${TOKEN}"}, "env": {"KEY": "${env:KEY}", "EMPTY": None}},
        {"max_tokens": 5, "answer_key": "label", "tokenizer": "gpt2", "stop": "</think>", "token": None},
        {"url": "http://127.0.0.1:8000/mcp", "args": ["-y", "server", "/tmp"], "env": "a text"},
        ["--api-key"],
    ],
)
def test_what_is_no_secret_stays(options: Any) -> None:
    assert without_secrets(options) == options


def test_records_of_episodes_hold_no_secrets() -> None:
    """The episode itself, which may be replayed, still does."""
    wrappers = [["mcp", {"url": "http://a/mcp", "headers": {"Authorization": "Bearer s3cret"}}]]
    episode = Episode("a:B", 1, "", {}, kwargs={"judge": {"api_key": "s3cret"}}, wrappers=wrappers)
    record = episode.to_dict()
    assert "s3cret" not in json.dumps(record)
    assert record["wrappers"][0][1]["url"] == "http://a/mcp"
    assert episode.wrappers is wrappers
    assert "s3cret" in json.dumps(wrappers)
