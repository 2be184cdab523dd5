"""``turn_tokens``: the tokens of each turn of a recorded episode, sampled ones as they are."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple, Protocol, runtime_checkable

from gem_core.errors import ArgumentError
from gem_core.records import Episode
from gem_core.types import Observation, Response
from gem_train.text import encodable


@runtime_checkable
class Encoder(Protocol):
    """A tokenizer as Hugging Face has it.

    Messages also need its ``apply_chat_template``; ``eos_token_id`` ends responses, if there is one.
    """

    def encode(self, text: str, *, add_special_tokens: bool) -> Sequence[int]:
        """Return the ids of a text."""

    def decode(self, token_ids: Any) -> str:
        """Return the text of ids."""


Tokenizer = Encoder | Callable[[str], Sequence[int]]
"""A tokenizer as Hugging Face has it; or a function that returns the ids of a text."""


class TurnTokens(NamedTuple):
    """The tokens of one turn.

    Args:
        prompt: What the model was sent.
        response: What it sampled.
        logprobs: Of the response; None where the sampler did not report them.
        complete: False for a response whose ids are not known and whose text lacks its thinking or tool calls.
    """

    prompt: list[int]
    response: list[int]
    logprobs: list[float] | None
    complete: bool


def turn_tokens(episode: Episode, tokenizer: Tokenizer | None) -> Iterator[TurnTokens]:
    """Yield the tokens of each turn.

    Ids that were reported are used as they are. A prompt whose ids were not is tokenized from what was sent; where that
    is the earlier prompt, the response to the letter, and more, the earlier ids stay and only the rest is tokenized.

    Raises:
        ArgumentError: Ids are missing and there is no tokenizer, or it cannot tokenize what was sent.
    """
    text_of = cache(lambda turn: _prompt_text(episode, turn, tokenizer))
    before: list[int] = []
    for turn, transition in enumerate(episode.transitions):
        action = transition.action
        if tokenizer is None and (action.token_ids is None or action.prompt_token_ids is None):
            missing = "token_ids" if action.token_ids is None else "prompt_token_ids"
            raise _problem(episode, turn, f"the response has no {missing}; {_ADVICE}")
        prompt = action.prompt_token_ids
        if prompt is None:
            last = _text_of_response(episode.transitions[turn - 1].action, tokenizer) if turn else None
            earlier = None if last is None else text_of(turn - 1) + last
            prompt = _encoded_prompt(text_of(turn), earlier, before, tokenizer)
        complete = action.token_ids is not None or not _lacks_parts(action)
        response, logprobs = action.token_ids, action.logprobs
        if response is None:  # some servers report log-probabilities of tokens whose ids they keep to themselves
            response, logprobs = _encoded_response(action, complete, tokenizer), None
        if logprobs is not None and len(logprobs) != len(response):
            raise _problem(episode, turn, f"it has {len(response)} token_ids and {len(logprobs)} logprobs")
        yield TurnTokens(prompt, response, logprobs, complete)
        before = prompt + response


_ADVICE = (
    "give tokenizer=, one of Hugging Face or a function that returns the ids of a text, or let the agent report them, "
    "as 'openai:' agents do with return_token_ids=True where the server is vLLM"
)


def _prompt_text(episode: Episode, turn: int, tokenizer: Any) -> str:
    """Return what the model was sent as text: a text as it is, messages as the chat template writes them."""
    sent = episode.sent(turn)
    if isinstance(sent, str):
        return sent
    if _has_image(sent):
        raise _problem(episode, turn, "an image has no token ids of its own; let the agent report prompt_token_ids")
    if not any("role" in part for part in sent):
        return "".join(str(part.get("text", "")) for part in sent)
    if not hasattr(tokenizer, "apply_chat_template"):
        raise _problem(episode, turn, "the model was sent messages; give a tokenizer that has apply_chat_template()")
    tools = episode.info.get("tools") if episode.native_tools else None
    return str(tokenizer.apply_chat_template(sent, tools=tools, tokenize=False, add_generation_prompt=True))


def _has_image(observation: Observation) -> bool:
    return not isinstance(observation, str) and any(
        _has_image(part.get("content") or "") if "role" in part else part.get("type") != "text" for part in observation
    )


def _encoded_prompt(text: str, earlier: str | None, before: list[int], tokenizer: Any) -> list[int]:
    """Return the ids of a prompt; the tokens before stay where the text is the earlier one and more."""
    if earlier is None or not text.startswith(earlier):
        return _encoded(text, tokenizer)
    ids = _encoded(text[len(earlier) :], tokenizer)
    # The model may have sampled the token that ends a turn, which its text lacks: it stands there once.
    repeats = isinstance(tokenizer, Encoder) and before and ids[:1] == before[-1:]
    return before + (ids[1:] if repeats and not earlier.endswith(tokenizer.decode(ids[:1])) else ids)


def _text_of_response(action: Response, tokenizer: Any) -> str | None:
    """Return the text whose ids are taken for the response; None where it is not known."""
    if action.token_ids is None or not _lacks_parts(action):
        return action.text
    return str(tokenizer.decode(action.token_ids)) if isinstance(tokenizer, Encoder) else None


def _lacks_parts(action: Response) -> bool:
    """Tell whether a server took thinking or calls out of the text."""
    return bool(action.tool_calls or action.reasoning)


def _encoded_response(action: Response, complete: bool, tokenizer: Any) -> list[int]:
    """Return the ids of a text, ended as a model would have ended it."""
    ids = _encoded(action.text, tokenizer)
    end = getattr(tokenizer, "eos_token_id", None)
    return ids if end is None or action.cut_off or not complete or ids[-1:] == [end] else [*ids, end]


def _encoded(text: str, tokenizer: Any) -> list[int]:
    text = encodable(text)
    if isinstance(tokenizer, Encoder):
        return list(tokenizer.encode(text, add_special_tokens=False))
    if not callable(tokenizer):
        raise ArgumentError(
            f"a tokenizer has encode() and decode(), or is a function that returns the ids of a text, not {tokenizer!r}"
        )
    return list(tokenizer(text))


def _problem(episode: Episode, turn: int, message: str) -> ArgumentError:
    return ArgumentError(f"{episode.id}, episode {episode.key}.{episode.repeat}, turn {turn}: {message}")
