r"""``MathEnv``: one problem, one response, graded by its ``\boxed{}`` answer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Unpack

from gem_core.data import DatasetEnv, DatasetOptions, Grade
from gem_core.errors import ArgumentError, GradingError
from gem_math.grading import grade as grade_answer

_CHARS_OF_PENALTY = 1000


class MathEnv(DatasetEnv):
    r"""Asks a problem and grades the answer in the last ``\boxed{}``, or ``<answer>``, of the response.

    A right answer has the reward 1, anything else 0, unless the arguments below change that.

    ``info`` holds the verdict (``correct``), what was read out of the response (``parsed_action``) and the ``reason``::

        register("math:Mine", "gem_math:MathEnv", dataset_name="mine.jsonl", question_key="problem")

    A gold answer may be a text, a number, or a list, each element of which is right. Where it has a mark such as
    GSM8K's ``####``, or a box, it is what stands there. ``gem_math.grade`` says what counts as the same answer.
    One that cannot be read, as with a brace too many, is compared as text.

    Args:
        rows: As for ``DatasetEnv``, whose keywords for loading, columns and the prompt are all taken.
        answer_after: The gold answer is what follows the last of these marks, where there is one; None to look for
            none.
        format_reward: Added to the reward of a response that has an answer in a box or tag, right or wrong.
        format_error_reward: The reward of a response that has none; gem-llm's is -0.1 where it is switched on.
        length_penalty: Taken from the reward for each 1,000 characters of the response, but no more than 1 in all.
        partial_credit: Reward the fraction of the parts that are right where the gold answer is a list or a set. A
            response with more parts than the gold answer gets nothing.
        timeout_s: Limit of the computing for one reference, in seconds.
        **options: See ``DatasetEnv``.

    Raises:
        ArgumentError: A number is not finite, or ``timeout_s`` is not above 0.
    """

    concurrency = "thread"  # most answers take a tenth of a millisecond; the others wait for a process

    def __init__(
        self,
        rows: Any = None,
        *,
        answer_after: str | None = "####",
        format_reward: float = 0.0,
        format_error_reward: float = 0.0,
        length_penalty: float = 0.0,
        partial_credit: bool = False,
        timeout_s: float = 1.0,
        **options: Unpack[DatasetOptions],
    ) -> None:
        super().__init__(rows, **options)
        numbers = {
            "format_reward": format_reward,
            "format_error_reward": format_error_reward,
            "length_penalty": length_penalty,
            "timeout_s": timeout_s,
        }
        for name, number in numbers.items():
            if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number):
                raise ArgumentError(f"{name} must be a finite number, not {number!r}")
        if timeout_s <= 0:
            raise ArgumentError(f"timeout_s must be above 0, not {timeout_s!r}")
        self.answer_after = answer_after
        self.format_reward = format_reward
        self.format_error_reward = format_error_reward
        self.length_penalty = length_penalty
        self.partial_credit = partial_credit
        self.timeout_s = timeout_s

    def grade(self, action: str, row: Any) -> Grade:
        """Return the verdict on a response.

        Raises:
            GradingError: The gold answer is empty, or no text and no number.
        """
        found = grade_answer(
            action, self.gold(row), timeout_s=self.timeout_s, partial_credit=self.partial_credit, strict=True
        )
        reward = self.format_error_reward if found.answer is None else found.reward + self.format_reward
        if self.length_penalty:
            reward -= min(self.length_penalty * len(action) / _CHARS_OF_PENALTY, 1.0)
        return Grade(reward=reward, correct=found.correct, answer=found.answer, info={"reason": found.reason})

    def gold(self, row: Any) -> Any:
        """Return the gold answer of a row, or the list of them."""
        answer = row[self.answer_key]
        if isinstance(answer, str):
            return self._behind_mark(answer)
        if isinstance(answer, Sequence):
            return [self._behind_mark(one) if isinstance(one, str) else one for one in answer]
        return answer

    def gold_response(self, row: Any) -> str | None:
        """Return a right response to a row, the first of its gold answers in a box; None where it has none.

        Raises:
            GradingError: The gold answer is malformed.
        """
        gold = self.gold(row)
        if isinstance(gold, list):
            gold = gold[0] if gold else None
        return None if gold is None or not str(gold).strip() else f"\\boxed{{{gold}}}"

    def _behind_mark(self, answer: str) -> str:
        if self.answer_after and self.answer_after in answer:
            behind = answer.rpartition(self.answer_after)[2].strip()
            if not behind:
                raise GradingError(f"nothing follows {self.answer_after!r} in the gold answer {answer[-100:]!r}")
            return behind
        return answer
