"""The types that pass between agents and environments: observations, responses and results of steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

Observation = str | list[dict[str, Any]]
"""Text; or content parts; or, from the chat views, a list of messages."""

Info = dict[str, Any]
"""Plain JSON, images apart."""

Action = str | Mapping[str, str]
"""A response; or ``{agent: response}`` if several agents act."""

StepResult = tuple[Observation, float, bool, bool, Info]
"""``(observation, reward, terminated, truncated, info)``, as in Gymnasium."""

ResetResult = tuple[Observation, Info]

Concurrency = Literal["inline", "thread", "async", "process"]
"""How an environment wants to be run beside others; see ``Env.concurrency``."""

TERMINAL_STATE = "<episode over>"
"""The observation of an episode that has nothing more to say."""


class Response(str):
    """A response of an agent: its text, and what the model server reported about it.

    It is a ``str`` everywhere: a task reads the text, and what makes new text of it (``strip``, ``+``) gives a plain
    ``str``. What was not reported is None.

    Args:
        text: The response to the letter.
        token_ids: The sampled tokens.
        prompt_token_ids: The tokens that they continue.
        logprobs: Natural logarithm of the probability of each sampled token.
        finish_reason: Why sampling ended, as in ``"stop"``, ``"length"``, ``"tool_calls"``.
        tool_calls: Calls in the OpenAI chat format.
        reasoning: Thinking that the server took out of the text.
        usage: Token counts as the server gives them.
        model: The model that the server says it ran.

    Source: fields of the OpenAI chat API and vLLM's additions to it.
    """

    token_ids: list[int] | None
    prompt_token_ids: list[int] | None
    logprobs: list[float] | None
    finish_reason: str | None
    tool_calls: list[dict[str, Any]] | None
    reasoning: str | None
    usage: dict[str, Any] | None
    model: str | None

    def __new__(
        cls,
        text: str = "",
        *,
        token_ids: Sequence[int] | None = None,
        prompt_token_ids: Sequence[int] | None = None,
        logprobs: Sequence[float] | None = None,
        finish_reason: str | None = None,
        tool_calls: Sequence[Mapping[str, Any]] | None = None,
        reasoning: str | None = None,
        usage: Mapping[str, Any] | None = None,
        model: str | None = None,
    ) -> Response:
        """Make a response; see the class.

        Raises:
            TypeError: The text is none, as a server's message that only calls tools has none: give ``""`` then.
        """
        if not isinstance(text, str):
            raise TypeError(f"the text of a response is a str, not {type(text).__name__}; give '' if there is none")
        self = super().__new__(cls, text)
        self.token_ids = None if token_ids is None else list(token_ids)
        self.prompt_token_ids = None if prompt_token_ids is None else list(prompt_token_ids)
        self.logprobs = None if logprobs is None else list(logprobs)
        self.finish_reason = finish_reason
        self.tool_calls = None if tool_calls is None else [dict(call) for call in tool_calls]
        self.reasoning = reasoning
        self.usage = None if usage is None else dict(usage)
        self.model = model
        return self

    def __getnewargs__(self) -> tuple[str]:
        return (str(self),)

    @property
    def text(self) -> str:
        """The text as a plain ``str``."""
        return str.__str__(self)

    @property
    def cut_off(self) -> bool:
        """Whether the model stopped at its token limit instead of by itself."""
        return self.finish_reason == "length"

    def reported(self) -> dict[str, Any]:
        """Return what was reported, without the fields that were not."""
        return {name: value for name, value in vars(self).items() if value is not None}

    @classmethod
    def of(cls, text: str) -> Response:
        """Return a response unchanged, and a plain ``str`` as a response that reports nothing."""
        return text if isinstance(text, cls) else cls(text)
