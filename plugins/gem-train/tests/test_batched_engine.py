"""``BatchedEngine``: requests of one response become batches."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest

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


def test_requests_that_come_together_are_one_batch() -> None:
    """Each has its own prompt, sampling and answer."""
    found, sizes = answered(5, most=8)
    assert [one.token_ids for one in found] == [[number, number + 10] for number in range(5)]
    assert sizes == [5]


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


def test_abandoned_request_does_not_spoil_its_batch() -> None:
    """An episode may be given up while its batch is answered."""
    begun, go_on = threading.Event(), threading.Event()

    def ask(prompts: list[list[int]], samplings: list[dict[str, Any]]) -> list[Generated]:
        begun.set()
        go_on.wait(30)
        return [Generated(prompt) for prompt in prompts]

    async def run() -> Generated:
        engine = BatchedEngine(ask, most=2)
        first, second = (asyncio.create_task(engine([number])) for number in (1, 2))
        await asyncio.to_thread(begun.wait, 30)
        first.cancel()
        go_on.set()
        with pytest.raises(asyncio.CancelledError):
            await first
        return await second

    assert asyncio.run(run()).token_ids == [2]
