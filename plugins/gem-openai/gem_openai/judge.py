"""``ModelJudge``: a model that gives a verdict about text whose author wants to pass."""

from __future__ import annotations

import hashlib
import inspect
import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from gem_core.errors import GemError, GradingError
from gem_core.parsing import without_thinking
from gem_core.rollouts import Agent, Context

_OTHER_LINE_ENDS = str.maketrans({"\x85": "\\u0085", "\u2028": "\\u2028", "\u2029": "\\u2029"})


class ModelJudge:
    """Asks a model for a verdict about text that may try to talk it round.

    The text stands between marks that depend on everything asked, and only one clear verdict on the last line of the
    reply counts. A model can still be fooled: read some of its verdicts before you rely on them.

    Args:
        agent: The model, as ``load_agent("openai:MODEL", system=…)``. Its system text should say that what stands
            between the marks is data, and how a verdict is written.
        verdicts: What each verdict means, as ``{"CORRECT": True, "INCORRECT": False}``.
    """

    def __init__(self, agent: Agent, verdicts: Mapping[str, bool | None]) -> None:
        self.agent, self.verdicts = agent, dict(verdicts)

    async def ask(
        self, before: str, evidence: Sequence[Any], question: str, *, episode: str = ""
    ) -> tuple[bool | None, str]:
        """Return what the verdict means, and the reply.

        Args:
            before: What stands before the marks.
            evidence: What is judged, as plain data: each value is one line of JSON.
            question: What stands behind the marks.
            episode: Key of the episode that is judged, for the agent's context.

        Raises:
            GradingError: The model did not answer, or gave no clear verdict.
        """
        context = Context(episode=episode, env_id="", group=None, turn=0, info={}, tools=[], transitions=[])
        try:
            answered: Any = self.agent(prompt(before, evidence, question), context)
            reply = await answered if inspect.isawaitable(answered) else answered
        except GemError as error:
            raise GradingError(f"the judge gave no verdict: {error}") from error
        verdict = read_verdict(reply, *self.verdicts)
        if verdict is None:
            raise GradingError(
                f"the judge's reply does not end with one clear verdict of {', '.join(self.verdicts)}, but with "
                f"{reply.strip()[-100:]!r}"
            )
        return self.verdicts[verdict], reply


def prompt(before: str, evidence: Sequence[Any], question: str) -> str:
    """Return a prompt with evidence between marks, a value to a line."""
    # Without line ends that JSON leaves as they are, and that begin another line to some readers.
    text = "\n".join(json.dumps(each, ensure_ascii=False).translate(_OTHER_LINE_ENDS) for each in evidence)
    # Evidence cannot contain the hash of itself, so it cannot close its own mark.
    mark = hashlib.sha256(json.dumps([before, text, question]).encode()).hexdigest()[:16]
    return f"{before}, between the marks {mark}:\n<{mark}>\n{text}\n</{mark}>\n{question}"


def read_verdict(reply: str, *verdicts: str) -> str | None:
    """Return the verdict on the last line of a reply, as in ``VERDICT: CORRECT``; None without a clear one.

    Thinking is left out. Case and the marks of Markdown do not count. A reply with two verdicts that differ has none.

    Args:
        reply: Text of the model.
        *verdicts: In capitals.
    """
    marks = r"[*_`#>.\s-]*+"
    pattern = re.compile(rf"{marks}verdict{marks}:{marks}({'|'.join(verdicts)}){marks}", re.IGNORECASE)
    lines = [pattern.fullmatch(line) for line in without_thinking(reply).split("\n") if line.strip()]
    found = {line[1].upper() for line in lines if line is not None}
    return found.pop() if len(found) == 1 and lines[-1] is not None else None
