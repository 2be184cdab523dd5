"""``TokenAgent``: an agent that sends a model tokens and takes tokens from it, over any engine."""

from __future__ import annotations

import json
import re
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from gem_core.env import is_messages, texts_of
from gem_core.errors import AgentError, ArgumentError, ContextOverflowError, RequestError
from gem_core.types import Observation, Response
from gem_train.adapters.chat_template import ChatTemplate, Message

if TYPE_CHECKING:
    from gem_core.rollouts import Context


class Generated(NamedTuple):
    """What an engine sampled.

    Args:
        token_ids: The sampled tokens, the one that ended the turn included.
        logprobs: Natural logarithm of the probability of each; None where the engine does not tell.
        finish_reason: ``"stop"``, or ``"length"`` where the limit of tokens cut the response off.
    """

    token_ids: Sequence[int]
    logprobs: Sequence[float] | None = None
    finish_reason: str = "stop"


_CALL = re.compile(r"<tool_call>(.*?)</tool_call>", re.DOTALL)

Generate = Callable[..., Awaitable[Generated]]
"""``await generate(prompt_ids, **sampling)`` samples a continuation. It raises ``RequestError`` where only this episode
is lost; any other exception stops the run."""


class TokenAgent:
    """Sends a model the tokens of the conversation and returns the tokens that it sampled.

    The first prompt of an episode is the chat template's rendering, with the tools. A later one is the prompt before,
    the response exactly as it was sampled, and the bridge: what the template writes after a response, which is the end
    of the turn, the new messages and the beginning of the next response. A sampled token is never made anew from text.

    That holds as long as the template renders a longer chat as a shorter one and more. Where it rewrites what came
    before, as templates do that drop the reasoning of earlier turns, the model is sent what the template writes: the
    prompt is rendered anew and does not begin with the tokens so far. ``gem_train.batches`` begins a new row there.
    White space that a template strips from a response is no such change: the sampled tokens stay.

    Tools are described by the template if it can; otherwise the environment's text explains them. In the first case,
    calls as Qwen and Hermes write them, ``<tool_call>{"name": …, "arguments": …}</tool_call>`` after any thinking,
    become native calls of the response, as a server makes them (vLLM: ``--tool-call-parser hermes``). So the record and
    the role of a result are those of an evaluation by ``openai:`` agents. Calls of other forms stay in the text, and
    their results come from the user.

    Args:
        generate: Samples a continuation; see ``Generate``.
        tokenizer: One of transformers, with a chat template; or an object with ``apply_chat_template``, ``encode``,
            ``decode`` and ``all_special_ids`` that work as theirs do.
        max_tokens: Longest response; None leaves it to the engine.
        max_context: Most tokens of prompt and response together; None for no limit. A response may be shorter than
            ``max_tokens`` because of it.
        sampling: More keyword arguments for ``generate``, as ``{"temperature": 1.0}``.
        chat_template_kwargs: More keyword arguments for the template, as ``{"enable_thinking": False}``.

    Raises:
        ArgumentError: The template leaves responses out, so that nothing can follow one.
    """

    reads = "messages"

    def __init__(
        self,
        generate: Generate,
        tokenizer: Any,
        *,
        max_tokens: int | None = None,
        max_context: int | None = None,
        sampling: Mapping[str, Any] | None = None,
        chat_template_kwargs: Mapping[str, Any] | None = None,
    ) -> None:
        for name, limit in (("max_tokens", max_tokens), ("max_context", max_context)):
            if limit is not None and (type(limit) is not int or limit < 1):
                raise ArgumentError(f"{name} must be a positive whole number or None, not {limit!r}")
        self.generate = generate
        self.template = ChatTemplate(tokenizer, **(chat_template_kwargs or {}))
        self.max_tokens = max_tokens
        self.max_context = max_context
        self.sampling = dict(sampling or {})
        self.native_tools = self.template.describes_tools

    async def __call__(self, observation: Observation, context: Context) -> Response:
        """Return a response with its tokens.

        Raises:
            ContextOverflowError: Prompt and response have no room in ``max_context``.
            RequestError: The engine gave up, which ends the episode as an error.
            ArgumentError: The observation holds an image, which no tokenizer reads.
        """
        prompt_ids = self.prompt(observation, context)
        sampling, limit = dict(self.sampling), self.max_tokens
        if self.max_context is not None:
            room = self.max_context - len(prompt_ids)
            if room < 1:
                raise ContextOverflowError(
                    f"the prompt has {len(prompt_ids)} tokens, and max_context is {self.max_context}"
                )
            limit = room if limit is None else min(limit, room)
        if limit is not None:
            sampling["max_tokens"] = limit
        return self._response(prompt_ids, await self.generate(prompt_ids, **sampling), context)

    def prompt(self, observation: Observation, context: Context) -> list[int]:
        """Return the tokens that the next response continues."""
        messages = _as_messages(observation, context.system)
        tools = context.tools if self.native_tools else None
        place = _place_of_response(messages, context)
        # A response with native calls stands in the chat as it was sampled, so that no call is written anew.
        sampled = {
            call["id"]: self.template.decode(said.token_ids)
            for said in context.responses
            for call in said.tool_calls or ()
            if said.token_ids is not None
        }
        for message in messages:
            if (calls := message.get("tool_calls")) and calls[0]["id"] in sampled:
                message["content"] = sampled[calls[0]["id"]]
                del message["tool_calls"]
        continued = self._continued(messages, place, tools, context)
        return continued or self.template.encode(self.template.render(messages, tools))

    def _continued(self, messages: list[Message], place: int | None, tools: Any, context: Context) -> list[int] | None:
        """Return the prompt before, its response and the bridge; None where the prompt has to be rendered anew."""
        last = context.responses[-1] if place is not None else Response()
        if place is None or last.token_ids is None or last.prompt_token_ids is None:
            return None
        bridge = self.template.bridge(messages, place, tools)
        if bridge is None:
            return None
        return [*last.prompt_token_ids, *last.token_ids, *self.template.follow(last.token_ids, bridge)]

    def _response(self, prompt_ids: list[int], generated: Generated, context: Context) -> Response:
        ids, logprobs = list(map(int, generated.token_ids)), generated.logprobs
        if generated.finish_reason not in ("stop", "length"):
            raise RequestError(f"the engine ended a response with {generated.finish_reason!r}", cause="aborted")
        if logprobs is not None and len(logprobs) != len(ids):
            raise AgentError(f"generate() returned {len(ids)} tokens and {len(logprobs)} log-probabilities")
        text = self.template.decode(ids)
        calls = _calls_in(text, context.turn) if self.native_tools and context.tools else []
        return Response(
            _before_calls(text) if calls else text,
            tool_calls=calls or None,
            token_ids=ids,
            prompt_token_ids=prompt_ids,
            logprobs=None if logprobs is None else list(map(float, logprobs)),
            finish_reason=generated.finish_reason,
        )


def _calls_in(text: str, turn: int) -> list[dict[str, Any]]:
    """Return the calls in a text as native ones; none if one of them cannot be read, for the environment to say so."""
    calls: list[dict[str, Any]] = []
    try:
        for place, written in enumerate(_CALL.findall(text.rpartition("</think>")[2])):
            call = json.loads(written)
            function = {"name": str(call["name"]), "arguments": json.dumps(call["arguments"])}
            calls.append({"id": f"call_{turn}_{place}", "type": "function", "function": function})
    except (ValueError, LookupError, TypeError, RecursionError):
        return []
    return calls


def _before_calls(text: str) -> str:
    thinking, end, said = text.rpartition("</think>")
    return f"{thinking}{end}{said.partition('<tool_call>')[0]}".rstrip()


def _place_of_response(messages: list[Message], context: Context) -> int | None:
    """Return the place of the last response among the messages; None unless it follows what it answered."""
    if not context.transitions:
        return None
    last = context.transitions[-1]
    if is_messages(last.observation) or is_messages(context.observation):
        # A view, or the environment itself, keeps the chat, and may have left something out.
        answered = _as_messages(last.observation, context.system)
        place = len(answered) if messages[: len(answered)] == answered else -1
    else:
        added = last.info.get("messages")
        place = len(messages) - 1 - (len(added) if isinstance(added, list) else 1)
    if not 0 < place < len(messages):
        return None
    message = messages[place]
    return place if (message["role"], message["content"]) == ("assistant", last.action.text) else None


def _as_messages(observation: Observation, system: str | None) -> list[Message]:
    """Return an observation as messages whose content is text.

    Raises:
        ArgumentError: It holds an image.
    """
    if is_messages(observation):
        messages = cast("list[Message]", observation)
    else:
        messages = [{"role": "system", "content": system}] if system is not None else []
        messages.append({"role": "user", "content": observation})
    return [{**message, "content": _text(message.get("content"))} for message in messages]


def _text(content: Any) -> str:
    parts = content if isinstance(content, list) else []
    if any(part.get("type") != "text" for part in parts):
        raise ArgumentError("TokenAgent reads text, and the observation holds an image; give it tasks without images")
    return "".join(texts_of(parts)) if parts else str(content or "")
