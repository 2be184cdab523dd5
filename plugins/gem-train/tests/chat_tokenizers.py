"""Chat templates for the tests, and a tokenizer that has them."""

from __future__ import annotations

from typing import Any

import pytest

from gem_train.adapters import trial_tokenizer
from gem_train.adapters.trial import CHATML

NO_TOOLS = CHATML[CHATML.index("{% for message") :]
"""Says nothing about tools."""

STRIPPING = CHATML.replace("message.content", "message.content | trim")
"""Strips white space around a message."""

DROPPING = CHATML.replace("message.content", "message.content if loop.last else message.content.split('</think>')[-1]")
"""Drops the reasoning of earlier turns."""

END = "<|im_end|>"


def chat_tokenizer(template: str = CHATML) -> Any:
    """Return a byte-level tokenizer of transformers, in which ``box`` is a token as well as three letters."""
    pytest.importorskip("transformers")
    return trial_tokenizer(template)
