"""A tokenizer of characters in which every text has many spellings, and an agent that samples any of them."""

from __future__ import annotations

import random
from typing import Any

import gem_core as gem

ALTERNATIVE = 1_000_000
"""Added to the id of a character, it gives another id of the same character."""

END = 2
"""Id of the token that ends a turn; the text of a response lacks it."""


def spelled(text: str, random: random.Random | None = None) -> list[int]:
    """Return the ids of a text; with a generator, in any spelling."""
    return [ord(character) + (ALTERNATIVE * random.randrange(2) if random else 0) for character in text]


class Spelling:
    """Encodes a character as its code point, and decodes another id as well: which one was sampled cannot be guessed.

    Its template writes chats in the manner of ChatML, without the thinking of earlier turns.
    """

    eos_token_id = END

    def __init__(self) -> None:
        self.encoded: list[str] = []
        """The texts that were tokenized."""

    def encode(self, text: str, *, add_special_tokens: bool) -> list[int]:
        assert add_special_tokens is False
        self.encoded.append(text)
        return spelled(text)

    def decode(self, token_ids: Any) -> str:
        return "".join(chr(int(token) % ALTERNATIVE) for token in token_ids)

    def apply_chat_template(
        self, messages: list[dict[str, Any]], *, tokenize: bool, add_generation_prompt: bool, tools: Any = None
    ) -> str:
        assert tokenize is False
        lines = [f"<{len(tools)} tools>"] if tools else []
        for message in messages:
            content = str(message["content"])
            if message["role"] == "assistant":
                content = content.rpartition("</think>")[2]
                content += "".join(call["function"]["arguments"] for call in message.get("tool_calls", ()))
            lines.append(f"<{message['role']}>{content}{chr(END)}\n")
        return "".join(lines) + ("<assistant>" if add_generation_prompt else "")


class SpellingAgent:
    """Plays valid random actions in sampled spellings, and reports their ids.

    Args:
        prefix: Stands before each action.
        prompts: Whether it also reports the ids of its prompts: the earlier ones, and those of what was appended.
        ends: Whether it samples the token that ends a turn.
    """

    def __init__(self, prefix: str = "", *, prompts: bool = False, ends: bool = True) -> None:
        self.prefix, self.prompts, self.ends = prefix, prompts, ends
        self.random = random.Random(0)

    def __call__(self, observation: Any, context: gem.Context) -> gem.Response:
        text = self.prefix + context.sample_random_action()
        ids = spelled(text, self.random) + [END] * self.ends
        return gem.Response(
            text,
            token_ids=ids,
            prompt_token_ids=_prompt(observation, context.responses) if self.prompts else None,
            logprobs=[-self.random.random() for _ in ids],
            finish_reason="stop" if self.ends else "length",
        )


def _prompt(observation: str, responses: list[gem.Response]) -> list[int]:
    known: list[int] = []
    if responses:
        known = [*(responses[-1].prompt_token_ids or ()), *(responses[-1].token_ids or ())]
    return known + spelled(observation[len(known) :])
