"""A tokenizer of characters in which most texts have many spellings, and an agent that samples any of them."""

from __future__ import annotations

import random
from typing import Any

import gem_core as gem

ALTERNATIVE = 1000
"""Added to the id of a character, it gives another id of the same character."""

END = 2
"""Id of the token that ends a turn; it stands in no text."""


class Spelling:
    """Encodes each character by its code point, decodes the alternative id as well: what was sampled cannot be guessed.

    Its template writes chats in the manner of ChatML, without the thinking of earlier turns.
    """

    eos_token = "\x02"
    eos_token_id = END

    def __init__(self) -> None:
        self.encoded: list[str] = []
        """The texts that were tokenized."""

    def encode(self, text: str, *, add_special_tokens: bool) -> list[int]:
        assert add_special_tokens is False
        self.encoded.append(text)
        return [ord(character) for character in text]

    def decode(self, ids: Any) -> str:
        return "".join(chr(int(token) % ALTERNATIVE) for token in ids)

    def apply_chat_template(
        self, messages: list[dict[str, Any]], *, tokenize: bool, add_generation_prompt: bool, tools: Any = None
    ) -> str:
        assert tokenize is False
        lines = [f"<tools {len(tools)}>"] if tools else []
        for message in messages:
            content = str(message["content"])
            if message["role"] == "assistant":
                content = content.rpartition("</think>")[2]
            lines.append(f"<{message['role']}>{content}{self.eos_token}\n")
        return "".join(lines) + ("<assistant>" if add_generation_prompt else "")


class SpellingAgent:
    """Plays valid random actions in sampled spellings, and reports their ids.

    Args:
        prefix: Stands before each action.
        prompts: Whether it also reports the ids of its prompts: the earlier ones, and what was appended.
        ends: Whether it samples the token that ends a turn.
    """

    def __init__(self, prefix: str = "", *, prompts: bool = False, ends: bool = True) -> None:
        self.prefix, self.prompts, self.ends = prefix, prompts, ends
        self.random = random.Random(0)
        self.tokenizer = Spelling()

    def __call__(self, observation: Any, context: gem.Context) -> gem.Response:
        text = self.prefix + context.sample_random_action()
        ids = [ord(character) + ALTERNATIVE * self.random.randrange(2) for character in text]
        ids += [END] * self.ends
        return gem.Response(
            text,
            token_ids=ids,
            prompt_token_ids=self.prompt(observation, context) if self.prompts else None,
            logprobs=[-self.random.random() for _ in ids],
            finish_reason="stop",
        )

    def prompt(self, observation: str, context: gem.Context) -> list[int]:
        known: list[int] = []
        if context.responses:
            last = context.responses[-1]
            assert last.prompt_token_ids is not None
            assert last.token_ids is not None
            known = last.prompt_token_ids + last.token_ids
        return known + [ord(character) for character in observation[len(self.tokenizer.decode(known)) :]]
