"""``BatchedEngine``: many requests of one response, answered by an engine that takes batches."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

from gem_core.errors import AgentError
from gem_train.adapters.token_agent import Generated

AskBatch = Callable[[list[list[int]], list[dict[str, Any]]], Sequence[Generated]]
"""``ask(prompts, samplings)`` returns one ``Generated`` for each prompt; it may block."""


class BatchedEngine:
    """Turns requests that come at about the same time into one call, as a ``generate`` for ``TokenAgent``.

    It is for engines in the same process that answer a whole batch at once, as ``vllm.LLM.generate`` or that of
    transformers. One batch is answered at a time, in a thread; requests that come meanwhile are the next one.

    Args:
        ask: Answers a batch. What it raises is raised at each of its requests.
        most: Requests in a batch at most; a full batch waits no longer.
        quiet_s: A batch that is not full is sent once no request has come for this many seconds.
    """

    def __init__(self, ask: AskBatch, *, most: int, quiet_s: float = 0.02) -> None:
        self.ask, self.most, self.quiet_s = ask, most, quiet_s
        self._waiting: list[tuple[list[int], dict[str, Any], asyncio.Future[Generated]]] = []
        self._sender: asyncio.Task[None] | None = None

    async def __call__(self, prompt_ids: list[int], **sampling: Any) -> Generated:
        """Return the response to a prompt once its batch is answered."""
        reply: asyncio.Future[Generated] = asyncio.get_running_loop().create_future()
        self._waiting.append((prompt_ids, sampling, reply))
        if self._sender is None or self._sender.done():
            self._sender = asyncio.create_task(self._send())
        return await reply

    async def _send(self) -> None:
        while self._waiting:
            count = 0
            while count < len(self._waiting) < self.most:
                count = len(self._waiting)
                await asyncio.sleep(self.quiet_s)
            batch, self._waiting = self._waiting[: self.most], self._waiting[self.most :]
            prompts, samplings, replies = zip(*batch, strict=True)
            answers: list[Generated | Exception]
            try:
                answers = list(await asyncio.to_thread(self.ask, list(prompts), list(samplings)))
                if len(answers) != len(batch):
                    raise AgentError(f"the engine gave {len(answers)} answers to {len(batch)} prompts")
            except Exception as error:  # noqa: BLE001 - an engine may raise anything
                answers = [error] * len(batch)
            for reply, answer in zip(replies, answers, strict=True):
                if reply.done():  # its episode was given up meanwhile
                    continue
                if isinstance(answer, Exception):
                    reply.set_exception(answer)
                else:
                    reply.set_result(answer)
