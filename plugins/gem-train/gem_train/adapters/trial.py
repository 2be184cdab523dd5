"""A tokenizer and an engine for trying an adapter without a model: what they do is known token by token."""

from __future__ import annotations

import importlib
from typing import Any

from gem_train.adapters.token_agent import Generated

CHATML = (
    "{% if tools %}<|im_start|>system\nTools:{% for tool in tools %} {{ tool.function.name }}{% endfor %}<|im_end|>\n"
    "{% endif %}{% for message in messages %}<|im_start|>{{ message.role }}\n{{ message.content }}<|im_end|>\n"
    "{% endfor %}{% if add_generation_prompt %}<|im_start|>assistant\n{% endif %}"
)
"""A chat template that writes each message as it is, between the marks of ChatML."""


def trial_tokenizer(template: str = CHATML) -> Any:
    """Return a fast tokenizer of transformers over bytes, in which ``box`` and ``ed`` are tokens as well as letters.

    Args:
        template: Its chat template, which ends a turn with ``<|im_end|>``.
    """
    tokenizers, transformers = importlib.import_module("tokenizers"), importlib.import_module("transformers")
    letters = sorted(tokenizers.pre_tokenizers.ByteLevel.alphabet())
    vocabulary = {token: place for place, token in enumerate([*letters, "bo", "box", "ed"])}
    made = tokenizers.Tokenizer(tokenizers.models.BPE(vocabulary, [("b", "o"), ("bo", "x"), ("e", "d")]))
    made.pre_tokenizer = tokenizers.pre_tokenizers.ByteLevel(add_prefix_space=False, use_regex=False)
    made.decoder = tokenizers.decoders.ByteLevel()
    made.add_special_tokens(["<|im_start|>", "<|im_end|>", "<|endoftext|>"])
    return transformers.PreTrainedTokenizerFast(
        tokenizer_object=made,
        eos_token="<|im_end|>",
        pad_token="<|endoftext|>",
        additional_special_tokens=["<|im_start|>"],
        chat_template=template,
    )


class TrialEngine:
    """Writes given texts letter by letter, which is not how the tokenizer would write them.

    The n-th response of an episode is the n-th text, however many episodes run at once; the last one is repeated. The
    log-probability of the token at place p of a sequence is -(p + 1) / 1024, so that it is known wherever it ends up.

    Args:
        tokenizer: Of ``trial_tokenizer``.
        texts: What to write.

    ``calls`` holds the prompt of each request and what was written.
    """

    def __init__(self, tokenizer: Any, texts: list[str]) -> None:
        self.tokenizer = tokenizer
        self.texts = texts
        self.calls: list[tuple[list[int], Generated]] = []
        self._begin = tokenizer.encode("<|im_start|>assistant\n", add_special_tokens=False)

    async def __call__(self, prompt_ids: list[int], *, max_tokens: int | None = None, **sampling: Any) -> Generated:
        """Write the next response of an episode, which stops after ``max_tokens``."""
        size = len(self._begin)
        turn = sum(prompt_ids[at : at + size] == self._begin for at in range(len(prompt_ids))) - 1
        text = self.texts[min(turn, len(self.texts) - 1)]
        ids = [token for letter in text for token in self.tokenizer.encode(letter, add_special_tokens=False)]
        ids.append(self.tokenizer.eos_token_id)
        cut = max_tokens is not None and len(ids) > max_tokens
        ids = ids[:max_tokens]
        logprobs = [trial_logprob(len(prompt_ids) + place) for place in range(len(ids))]
        self.calls.append((list(prompt_ids), Generated(ids, logprobs, "length" if cut else "stop")))
        return self.calls[-1][1]


def trial_logprob(place: int) -> float:
    """Return the log-probability of the token at a place of a sequence."""
    return -(place + 1) / 1024
