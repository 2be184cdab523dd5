"""Tokenizers of Hugging Face, made on the spot: bytes, a few merges, and chat templates of our own."""

from __future__ import annotations

from typing import Any

import pytest

CHATML = (
    "{% if tools %}<|im_start|>system\nTools:{% for tool in tools %} {{ tool.function.name }}{% endfor %}<|im_end|>\n"
    "{% endif %}{% for message in messages %}<|im_start|>{{ message.role }}\n{{ message.content }}<|im_end|>\n"
    "{% endfor %}{% if add_generation_prompt %}<|im_start|>assistant\n{% endif %}"
)
"""Each message as it is; knows tools."""

NO_TOOLS = CHATML[CHATML.index("{% for message") :]
"""The same, but says nothing about tools."""

STRIPPING = CHATML.replace("message.content", "message.content | trim")
"""Strips white space around a message."""

DROPPING = CHATML.replace("message.content", "message.content if loop.last else message.content.split('</think>')[-1]")
"""Drops the reasoning of earlier turns."""

END = "<|im_end|>"


def chat_tokenizer(template: str = CHATML) -> Any:
    """Return a byte-level tokenizer with a chat template, in which ``ab`` and ``abc`` are tokens as well as letters."""
    tokenizers, transformers = pytest.importorskip("tokenizers"), pytest.importorskip("transformers")
    letters = sorted(tokenizers.pre_tokenizers.ByteLevel.alphabet())
    vocabulary = {token: place for place, token in enumerate([*letters, "ab", "abc"])}
    made = tokenizers.Tokenizer(tokenizers.models.BPE(vocabulary, [("a", "b"), ("ab", "c")]))
    made.pre_tokenizer = tokenizers.pre_tokenizers.ByteLevel(add_prefix_space=False, use_regex=False)
    made.decoder = tokenizers.decoders.ByteLevel()
    made.add_special_tokens(["<|im_start|>", END, "<|endoftext|>"])
    return transformers.PreTrainedTokenizerFast(
        tokenizer_object=made,
        eos_token=END,
        pad_token="<|endoftext|>",
        additional_special_tokens=["<|im_start|>"],
        chat_template=template,
    )
