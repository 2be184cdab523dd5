"""``BatchedEngine``: requests of one response become batches."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

from gem_train.adapters import BatchedEngine, Generated


def answered(requests: int, **options: Any) -> tuple[list[Any], list[int]]:
    """Ask for so many responses at once; return them and the sizes of the batches."""
    sizes: list[int] = []

    def ask(prompts: list[list[int]], samplings: list[dict[str, Any]]) -> list[Generated]:
        assert threading.current_thread() is not threading.main_thread()
        sizes.append(len(prompts))
        if options.get("fails"):
            raise RuntimeError("out of memory")
        answers = [
            Generated([*prompt, sampling["max_tokens"]]) for prompt, sampling in zip(prompts, samplings, strict=True)
        ]
        return answers[: options.get("answers")]

    async def run() -> list[Any]:
        engine = BatchedEngine(ask, most=options["most"], quiet_s=0.0)
        asked = (engine([number], max_tokens=number + 10) for number in range(requests))
        return await asyncio.gather(*asked, return_exceptions=True)

    return asyncio.run(run()), sizes


def test_no_batch_is_larger_than_most() -> None:
    """The rest is the next one."""
    found, sizes = answered(5, most=2)
    assert [one.token_ids[0] for one in found] == list(range(5))
    assert sizes == [2, 2, 1]


def test_failure_is_raised_at_every_request_of_the_batch() -> None:
    """Nobody waits for ever."""
    found, _ = answered(3, most=8, fails=True)
    assert [str(one) for one in found] == ["out of memory"] * 3
    found, _ = answered(3, most=8, answers=2)
    assert [str(one) for one in found] == ["the engine gave 2 answers to 3 prompts"] * 3
