"""For trying an adapter without a model: a tokenizer, an engine, environments, and checks of what comes out."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from typing import Any

from gem_core import DatasetEnv, Tool, ToolEnv, register
from gem_core.types import StepResult
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


def check(held: bool, promise: str) -> None:
    """Print a promise; end the program with exit code 1 where it was not held.

    Raises:
        SystemExit: It was not.
    """
    sys.stdout.write(f"{'held:  ' if held else 'BROKEN:'} {promise}\n")
    if not held:
        sys.exit(1)


def check_sequence(engine: TrialEngine, ids: Sequence[int], mask: Sequence[Any], logprobs: Sequence[float]) -> None:
    """Check the one sequence of the one episode that an engine has served.

    Args:
        engine: Its ``calls`` are those of the episode.
        ids: The tokens, prompt included.
        mask: True on the tokens that a loss may use; as long as ``ids``.
        logprobs: As long as ``ids``; 0 where nothing was sampled.

    Raises:
        SystemExit: Something is not as it was sent and sampled.
    """
    sampled = [False] * len(ids)
    end = 0
    for prompt_ids, made in engine.calls:
        end = len(prompt_ids) + len(made.token_ids)
        check(list(ids[:end]) == [*prompt_ids, *made.token_ids], "a response stands after its prompt as it was sampled")
        sampled[len(prompt_ids) : end] = [True] * len(made.token_ids)
    check(len(ids) == end and ids[-1] == engine.tokenizer.eos_token_id, "the sequence ends with the last response")
    check(list(map(bool, mask)) == sampled, "the mask is set on sampled tokens, and on no others")
    wanted = [trial_logprob(place) if kept else 0.0 for place, kept in enumerate(sampled)]
    check(list(logprobs) == wanted, "every log-probability is in its place")
    text = engine.tokenizer.decode(list(ids))
    check(text.count("<|im_start|>") == text.count("<|im_end|>"), "every turn is closed once")


class Multiply(Tool):
    """A tool that needs nothing installed."""

    name = "multiply"
    description = "Multiplies two numbers."
    concurrency = "inline"

    class Parameters(Tool.Parameters):
        """Two numbers."""

        left: float
        right: float

    def call(self, arguments: Any, session: Any) -> str:
        """Return the product."""
        return str(arguments.left * arguments.right)


class FailsOnce(DatasetEnv):
    """Fails in the first step that is made in any, as where a sandbox is gone."""

    failures = 0

    def step(self, action: str) -> StepResult:
        """Fail, or grade."""
        if not FailsOnce.failures:
            FailsOnce.failures = 1
            raise OSError("the sandbox is gone")
        return super().step(action)


def register_trial_envs() -> None:
    """Register ``trial:Product-v0``, a question with a tool that pays 0.25 a call, and ``trial:FailsOnce-v0``."""
    rows = [{"question": "What is 6 times 7?", "answer": "42"}]
    register("trial:Product-v0", lambda: ToolEnv(DatasetEnv(rows), [Multiply], tool_reward=0.25))
    register("trial:FailsOnce-v0", lambda: FailsOnce(rows))
