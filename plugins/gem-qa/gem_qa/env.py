"""``QAEnv``: a question, a short answer, and a verdict by exact match, token F1 or a judge."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, Unpack

from gem_core.data import DatasetEnv, DatasetOptions, Grade, Row, RowSource
from gem_core.errors import ArgumentError
from gem_core.parsing import extract_last_boxed_answer, extract_last_tagged_answer, without_thinking
from gem_qa.answers import accepted_answers, scores, unwrapped
from gem_qa.judging import MODEL_PREFIX, Judge, find_judge, verdict_of

TAGGED = "{question}\n\nGive the answer alone, in as few words as it takes, between <answer> and </answer>."
BOXED = "{question}\n\nGive the answer alone, in as few words as it takes, inside \\boxed{}."


class QAEnv(DatasetEnv):
    r"""Asks a question and compares a short answer with the accepted ones.

    The answer is read from the last ``<answer>…</answer>``, or else the last ``\boxed{}``; in a task that asks for a
    box, the other way round. LaTeX around the whole of it, as ``\text{}``, does not count. The reward is 1 for an
    answer that is one of those accepted after normalisation, and else 0 (see ``gem_qa.answers``). ``info`` tells
    ``exact_match``, ``f1`` and the ``reason`` of the verdict. Any data
    set will do::

        register("qa:Mine", "gem_qa:QAEnv", dataset_name="mine.jsonl", question_key="query", answer_key="answers")

    Args:
        rows: See ``DatasetEnv``, as for all that is not listed here.
        reward: ``"exact"``, or ``"f1"`` for the share of words that agree; ``info["correct"]`` is exact match either
            way.
        extract_boxed: Whether the prompt asks for a box instead of tags.
        judge: Asked about answers that are no exact match; its verdict is the reward then. A function of the question,
            the accepted answers and the answer, plain or ``async``, that returns True, False or a number from 0 to 1;
            or ``"package.module:function"``; or ``"openai:MODEL"`` for a model behind an OpenAI-compatible server. A
            judge that fails ends the episode as an error, never as a reward of 0.
        judge_url: Address of that server; by default ``OPENAI_BASE_URL``, or else OpenAI's own.
        judge_options: More for it, as ``{"api_key_env": "JUDGE_KEY"}``; see ``gem info openai``.
        judge_timeout_s: Seconds that a function may take to judge; what takes longer is an error too. None for no
            limit. A model has a limit of its own, ``timeout_s`` among its options.
        **options: See ``DatasetEnv``. The column of the answer holds a text, or a list of accepted ones.

    Raises:
        DatasetError: There are no such rows, or the first has no answer.
        ArgumentError: A value that is not accepted.
    """

    def __init__(
        self,
        rows: RowSource | None = None,
        *,
        reward: Literal["exact", "f1"] = "exact",
        extract_boxed: bool = False,
        judge: str | Judge | None = None,
        judge_url: str | None = None,
        judge_options: Mapping[str, Any] | None = None,
        judge_timeout_s: float | None = 300.0,
        **options: Unpack[DatasetOptions],
    ) -> None:
        if reward not in ("exact", "f1"):
            raise ArgumentError(f"reward must be 'exact' or 'f1', not {reward!r}")
        options.setdefault("prompt_template", BOXED if extract_boxed else TAGGED)
        super().__init__(rows, **options)
        self.reward = reward
        self.extract_boxed = extract_boxed
        is_number = isinstance(judge_timeout_s, int | float) and not isinstance(judge_timeout_s, bool)
        if judge_timeout_s is not None and not (is_number and judge_timeout_s > 0):
            raise ArgumentError(f"judge_timeout_s must be seconds above 0, or None, not {judge_timeout_s!r}")
        is_model = isinstance(judge, str) and judge.startswith(MODEL_PREFIX)
        self.judge_timeout_s = None if is_model else judge_timeout_s
        self._judge = find_judge(judge, judge_url, judge_options)
        if self._judge is not None:
            vars(self)["concurrency"] = "thread"  # it waits for somebody

    def grade(self, action: str, row: Row) -> Grade:
        """Return the verdict on a response.

        Raises:
            GradingError: The row has no accepted answer, or the judge gave no verdict.
        """
        accepted = accepted_answers(row[self.answer_key])
        answer = self.answer_in(action)
        if answer is None:
            return Grade(0.0, False, None, {"exact_match": False, "f1": 0.0, "reason": "no answer was given"})
        correct, f1 = scores(answer, accepted)
        info: dict[str, Any] = {"exact_match": correct, "f1": f1}
        value = float(correct) if self.reward == "exact" else f1
        reason = "it is an accepted answer" if correct else "it is none of the accepted answers"
        if self._judge is not None and not correct and answer:
            question = str(row[self.question_key])
            value = verdict_of(self._judge, question, accepted, answer, timeout_s=self.judge_timeout_s)
            correct = value == 1.0
            reason = f"the judge says {value:g}"
        return Grade(value, correct, answer, {**info, "reason": reason})

    def answer_in(self, action: str) -> str | None:
        """Return the answer that a response gives outside its thinking; None without one."""
        action = without_thinking(action)
        tagged, boxed = extract_last_tagged_answer, extract_last_boxed_answer
        first, second = (boxed, tagged) if self.extract_boxed else (tagged, boxed)
        answer = first(action)
        answer = second(action) if answer is None else answer
        return None if answer is None else unwrapped(answer)

    def gold_response(self, row: Row) -> str | None:
        """Return a right response to a row: the first of its accepted answers.

        Raises:
            GradingError: The row has no accepted answer.
        """
        answer = accepted_answers(row[self.answer_key])[0]
        return f"\\boxed{{{answer}}}" if self.extract_boxed else f"<answer>{answer}</answer>"
