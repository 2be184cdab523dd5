"""The agent that asks a model behind an OpenAI-compatible server."""

from __future__ import annotations

import json
import math
import os
import re
import urllib.parse
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from gem_core import Observation, Response
from gem_core.background import in_thread, on_library_loop
from gem_core.errors import (
    ArgumentError,
    ContextOverflowError,
    GemError,
    MissingRequirementError,
    RequestError,
    UnknownModelError,
)
from gem_core.suggestions import did_you_mean
from gem_openai.chat_format import has_images, messages_from
from gem_openai.client import ChatClient, ServerFault

if TYPE_CHECKING:
    from gem_core.rollouts import Context

DEFAULT_BASE_URL = "https://api.openai.com/v1"
START_TIMEOUT_S = 30.0

_OWN_FIELDS = {"model", "messages", "stream", "tools"}
_OVERFLOW = re.compile(r"context_length_exceeded|maximum context length|available context size", re.IGNORECASE)


class OpenAIAgent:
    """Asks a model by the OpenAI chat API: one request for each turn, many episodes at once.

    It reads the conversation so far. Where a view was named, that decides what the model sees: text and content parts
    become one message of the user, a list of messages is sent as it is. Tools are offered in the API's own way. A
    request that is not answered ends its episode as an error; the run goes on.

    The key is read from the environment, and is in no attribute, message or record. Without one, none is sent.

    Args:
        model: Name of the model.
        base_url: Address of the server; None takes ``OPENAI_BASE_URL``, or else OpenAI's own.
        api_key_env: Name of the environment variable that holds the key.
        system: System prompt; None takes ``info["system"]`` of the episode's start, if there is one. A list of messages
            that brings its own keeps it.
        temperature: Of sampling; None leaves it to the server, as with all that follow.
        top_p: Share of probability to sample from.
        max_tokens: Longest answer, in tokens.
        seed: Seed of sampling. The same for every request.
        stop: Text, or several, at which the model stops.
        extra_body: More fields of the request, as ``{"top_k": 20}``.
        max_concurrency: Requests at once; more wait for a place.
        timeout_s: Limit of a request in seconds, from when it has its place, all attempts and waits included.
        attempt_timeout_s: Limit of one attempt, after which it is tried again, so that a connection that hangs does not
            use up the request; None for no other limit.
        max_retries: Attempts after the first. A request is tried again on 408, 409, 425, 429, 5xx, a broken connection
            or an answer that is no completion; after a random wait of up to 0.5, 1, 2, … 30 s, or what ``Retry-After``
            asks for.
        stream: Whether the server sends the answer in pieces, which some proxies need to keep long requests open.
        return_token_ids: Whether to ask for token ids and log-probabilities, as training needs them. A server that
            refuses to give them is not asked again.
        native_tools: Whether tools are offered in the API's own way. If not, the model calls them in its text, as it
            must where the server has no parser of tool calls.

    Raises:
        ArgumentError: A value that cannot be right.
    """

    reads = "messages"

    def __init__(
        self,
        model: str = "",
        *,
        base_url: str | None = None,
        api_key_env: str = "OPENAI_API_KEY",
        system: str | None = None,
        temperature: float | None = None,
        top_p: float | None = None,
        max_tokens: int | None = None,
        seed: int | None = None,
        stop: str | Sequence[str] | None = None,
        extra_body: Mapping[str, Any] | None = None,
        max_concurrency: int = 64,
        timeout_s: float = 1800.0,
        attempt_timeout_s: float | None = 600.0,
        max_retries: int = 8,
        stream: bool = False,
        return_token_ids: bool = False,
        native_tools: bool = True,
    ) -> None:
        if not model:
            raise ArgumentError("the agent 'openai' needs the name of a model, as in openai:MODEL")
        _check_whole("max_concurrency", max_concurrency, 1)
        _check_whole("max_retries", max_retries, 0)
        _check_seconds("timeout_s", timeout_s)
        if attempt_timeout_s is not None:
            _check_seconds("attempt_timeout_s", attempt_timeout_s)
        self.model = model
        self.system = system
        self.max_concurrency = max_concurrency
        self.native_tools = native_tools
        self.base_url = _checked_url(base_url or os.environ.get("OPENAI_BASE_URL") or DEFAULT_BASE_URL)
        self.client = ChatClient(
            self.base_url,
            _checked_key_name(api_key_env),
            max_concurrency=max_concurrency,
            max_retries=max_retries,
            attempt_timeout_s=attempt_timeout_s,
        )
        sampling = {"temperature": temperature, "top_p": top_p, "max_tokens": max_tokens, "seed": seed, "stop": stop}
        fields = _checked_fields(sampling, extra_body or {})
        optional: dict[str, Any] = {}
        if return_token_ids:
            optional |= {"return_token_ids": True, "logprobs": True}
        if stream:
            optional["stream_options"] = {"include_usage": True}
            fields["stream"] = True
        self._fields = optional | fields
        self._optional = optional.keys() - fields.keys()  # left out once the server has refused them
        self._refused: set[str] = set()
        self._timeout_s = timeout_s
        self._prepared = self._answered = False

    def __repr__(self) -> str:
        return f"OpenAIAgent({self.model!r}, base_url={self.base_url!r})"

    async def __call__(self, observation: Observation, context: Context) -> Response:
        """Return the model's answer to an observation.

        Raises:
            RequestError: The server gave no answer; the message says why.
            ContextOverflowError: The history is longer than the model takes.
            MissingRequirementError: The server refused the key or the address, and has not answered before.
            UnknownModelError: It refused the model, and has not answered before.
        """
        return await on_library_loop(self._answer(observation, context))

    async def prepare(self) -> None:
        """Find out at the start whether server, key and model are right, by one cheap request.

        Raises:
            MissingRequirementError: The server does not answer, or wants another key.
            UnknownModelError: It does not have the model.
        """
        if not self._prepared:
            await on_library_loop(self._try_server())
            self._prepared = True

    async def aclose(self) -> None:
        """Close the connections; the agent can still be used, and opens new ones."""
        await on_library_loop(self.client.aclose())

    # One turn.

    async def _answer(self, observation: Observation, context: Context) -> Response:
        system = context.system if self.system is None else self.system
        if has_images(observation):
            messages = await in_thread(messages_from, observation, system)
        else:
            messages = messages_from(observation, system)
        payload = {"model": self.model, "messages": messages, **self._fields}
        if context.tools and self.native_tools:
            payload["tools"] = context.tools
        try:
            response = await self._ask(payload, self._timeout_s, deadline=context.deadline)
        except ServerFault as fault:
            if context.turn > 0 and fault.status == 400 and _OVERFLOW.search(fault.body):
                raise ContextOverflowError(f"the history is longer than {self.model} takes") from None
            if not self._answered and fault.status in (401, 404):
                raise self._at_start(fault) from None
            message = f"{self.model} at {self.base_url} gave no answer: {fault.message}"
            raise RequestError(message, cause=fault.cause) from None
        self._answered = True
        return response

    async def _ask(self, payload: Mapping[str, Any], timeout_s: float, **options: Any) -> Response:
        """Send a request; leave out an optional field that the server refuses, from then on."""
        while True:
            sent = {name: value for name, value in payload.items() if name not in self._refused}
            if "max_tokens" in payload and "max_tokens" in self._refused:
                sent["max_completion_tokens"] = payload["max_tokens"]  # its name for newer models of OpenAI
            try:
                response: Response = await self.client.request(
                    "/chat/completions", sent, timeout_s=timeout_s, **options
                )
                return response
            except ServerFault as fault:
                refused = {name for name in self._optional if name in sent and name in fault.body}
                if "max_tokens" in sent and "max_completion_tokens" in fault.body:
                    refused.add("max_tokens")
                # 403 is OpenAI's answer where a model gives no log-probabilities.
                if fault.status not in (400, 403, 422) or not refused:
                    raise
                self._refused |= refused

    # The start.

    async def _try_server(self) -> None:
        if self.base_url == DEFAULT_BASE_URL and not self.client.key():
            raise MissingRequirementError(
                f"{self.base_url} wants a key: set {self.client.key_name}, or name another server by --base-url"
            )
        names: list[str] | None = None
        try:
            names = _model_names(await self.client.request("/models", timeout_s=START_TIMEOUT_S, patient=False))
        except ServerFault as fault:
            # Not every server lists its models, and not every key may see them.
            if fault.unreachable or fault.transient or fault.status in (401, None):
                raise self._at_start(fault) from None
        if names is not None and self.model in names:
            return
        payload = {"model": self.model, "messages": [{"role": "user", "content": "Hi"}], "max_tokens": 1}
        try:
            await self._ask(payload, START_TIMEOUT_S, patient=False)
        except ServerFault as fault:
            named = self.model in fault.body or fault.code == "model_not_found"
            if fault.status not in (400, 422) or named:
                raise self._at_start(fault, names, named) from None
            # It has the model, and refused something else about so short a request.

    def _at_start(self, fault: ServerFault, names: list[str] | None = None, named: bool = False) -> GemError:
        where, key_name = self.base_url, self.client.key_name
        if fault.unreachable:
            return MissingRequirementError(
                f"cannot reach {where}: {fault.message}; start the server or correct --base-url"
            )
        if fault.status == 401:
            wants = f"refuses the key in {key_name}" if self.client.key() else f"wants a key: set {key_name}"
            return MissingRequirementError(f"{where} {wants} ({fault.message})")
        if named or (fault.status == 404 and names is not None) or fault.code == "model_not_found":
            hint = did_you_mean(self.model, list(map(self.client.shown, names))) if names else ""
            listed = self.client.shown(f"{', '.join(names[:10])}{', …' if len(names) > 10 else ''}") if names else ""
            known = f" It has: {listed}." if names else ""
            return UnknownModelError(f"{where} refuses the model {self.model!r}.{hint}{known} ({fault.message})")
        if fault.status is not None and (fault.status == 404 or 300 <= fault.status < 400):
            return MissingRequirementError(
                f"there is no chat API at {where} ({fault.message}); correct --base-url, which often ends in /v1"
            )
        return MissingRequirementError(f"{where} does not answer: {fault.message}")


def _model_names(listing: Mapping[str, Any]) -> list[str] | None:
    models = listing.get("data")
    if not isinstance(models, list):
        return None
    return [model["id"] for model in models if isinstance(model, dict) and isinstance(model.get("id"), str)]


def _checked_url(url: str) -> str:
    url = url.strip().rstrip("/")
    try:
        host = (urllib.parse.urlsplit(url).hostname or "").encode("idna")
    except ValueError:  # a bracket is open, or a label is empty or too long
        host = b""
    if not host or not re.fullmatch(r"https?://[^\s/@?#]+(/[^\s@?#]*)?", url):
        # It is not shown: it may hold a password.
        raise ArgumentError(
            "the base URL must look like http://localhost:8000/v1, without a user, a query or a key in it"
        )
    return url


def _checked_key_name(name: str) -> str:
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII):
        # It is not shown: it may be the key itself.
        raise ArgumentError("api_key_env is the name of an environment variable, as in OPENAI_API_KEY, not the key")
    return name


def _check_whole(name: str, number: object, least: int) -> None:
    if type(number) is not int or number < least:
        raise ArgumentError(f"{name} must be a whole number from {least} up, not {number!r}")


def _check_seconds(name: str, seconds: object) -> None:
    if not isinstance(seconds, int | float) or not 0 < seconds < math.inf:
        raise ArgumentError(f"{name} must be a number of seconds above 0, not {seconds!r}")


def _checked_fields(sampling: Mapping[str, Any], extra_body: Mapping[str, Any]) -> dict[str, Any]:
    taken = sorted(_OWN_FIELDS & set(extra_body))
    if taken:
        raise ArgumentError(f"extra_body cannot set {', '.join(taken)}: the agent does")
    fields = {name: value for name, value in sampling.items() if value is not None} | dict(extra_body)
    try:
        json.dumps(fields, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"the fields of a request must be plain JSON: {error}") from None
    return fields
