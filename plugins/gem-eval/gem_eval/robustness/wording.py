"""``polite`` and ``typos``: the same task with polite words around it, or written carelessly."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from gem_core.env import AnyEnv, is_messages, observation_from
from gem_core.errors import ArgumentError
from gem_core.records import split_observation
from gem_core.types import Observation, ResetResult
from gem_eval.robustness.perturbation import Perturbation

_OPENINGS = (
    "Please read this with care.\n\n",
    "Here is a task for you.\n\n",
    "Hello! Could you help me with the following?\n\n",
    "I would like you to do this:\n\n",
)
_CLOSINGS = ("\n\nThank you!", "\n\nThanks in advance.", "\n\nI look forward to your answer.")

_WORDS = re.compile(r"(?<![\w'\\-])[a-z]{5,}+(?![\w'-])")
# What is quoted or is no language: code, formulas, tags with what they hold, brackets, links and file names.
_QUOTED = re.compile(
    r"`[^`\n]*`|\"[^\"\n]*\"|“[^”\n]*”|(?<!\w)'[^'\n]*'(?!\w)|\$[^$\n]*\$|\\[a-zA-Z]+(?:\{[^{}\n]*\})*"
    r"|<(\w{1,30})>[^<\n]{0,200}</\1>|<[^<>\n]*>|\[[^\[\]\n]*\]|\{[^{}\n]*\}|(?<!\S)\S*?(?:://|\w[./@]\w)\S*"
)
_NO_PROSE = re.compile(r"[=|_{}<>\t]|;\s*$|^\s|^[#>@]|^(?:def|class|import|from|return)\b")


class _Wording(Perturbation):
    """Changes the words of the task in the first observation.

    The board behind them (``info["suffix"]``) and the text that explains tools stay to the letter.
    """

    def after_reset(self, result: ResetResult) -> ResetResult:
        """Change the words."""
        observation, info = super().after_reset(result)
        if info.get("view") is not None or is_messages(observation):
            raise ArgumentError(
                f"{type(self).__name__} changes the task itself; name it before the view of the history"
            )
        feedback, suffix = split_observation(observation, info)
        told = info.get("tool_instructions", {}).get("text")
        feedback = self._changed(feedback, told if isinstance(told, str) else "")
        if "feedback" in info:
            info["feedback"] = feedback
        return observation_from(feedback, suffix), info

    def _changed(self, task: Observation, explanation: str) -> Any:
        if isinstance(task, str):
            words, found, rest = task.partition(explanation) if explanation else (task, "", "")
            return self.change(words) + found + rest
        place = next((place for place, part in enumerate(task) if part.get("type") == "text"), None)
        if place is None:
            return task
        first = {**task[place], "text": self._changed(str(task[place]["text"]), explanation)}
        return [*task[:place], first, *task[place + 1 :]]

    def change(self, text: str) -> str:
        """Return the text of a task in other words; a subclass overrides it."""
        raise NotImplementedError


class Polite(_Wording):
    """Puts a polite sentence before the task, and one after it, drawn from a short list.

    Args:
        env: What is disturbed; inside any view of the history.
        rate: Probability that it happens to an episode.

    Raises:
        ArgumentError: The rate is no number from 0 to 1.
    """

    def __init__(self, env: AnyEnv, rate: float = 1.0) -> None:
        super().__init__(env, rate)

    def change(self, text: str) -> str:
        """Return the text with polite sentences around it."""
        if not self.happens():
            return text
        body = text.rstrip("\n")
        opening, closing = _OPENINGS[self.below(len(_OPENINGS))], _CLOSINGS[self.below(len(_CLOSINGS))]
        return f"{opening}{body}{closing}{text[len(body) :]}"


class Typos(_Wording):
    """Exchanges two neighbouring letters inside some of the words of the task.

    Words of five or more small letters are changed, never their first or last letter. Left alone are code, formulas,
    quotations, tags, brackets, numbers, names, and lines that are no running text. A task about the letters of words
    that it does not quote changes its meaning, as any misspelling would.

    Args:
        env: What is disturbed; inside any view of the history.
        rate: Probability that a word is changed.

    Raises:
        ArgumentError: The rate is no number from 0 to 1.
    """

    def __init__(self, env: AnyEnv, rate: float = 0.1) -> None:
        super().__init__(env, rate)

    def change(self, text: str) -> str:
        """Return the text with misspelt words."""
        return change_prose(text, lambda prose: _WORDS.sub(self._misspell, prose))

    def _misspell(self, found: re.Match[str]) -> str:
        word = found[0]
        if not self.happens():
            return word
        place = 1 + self.below(len(word) - 3)
        return word[:place] + word[place + 1] + word[place] + word[place + 2 :]


def change_prose(text: str, change: Callable[[str], str]) -> str:
    """Return a text of which only running text is changed.

    Args:
        text: Of a task.
        change: Called with each piece of running text within a line.
    """
    lines, fenced = text.split("\n"), False
    for number, line in enumerate(lines):
        if line.lstrip().startswith(("```", "~~~")):
            fenced = not fenced
        elif not fenced and not _NO_PROSE.search(_QUOTED.sub("", line)):
            pieces, at = [], 0
            for quoted in _QUOTED.finditer(line):
                pieces += [change(line[at : quoted.start()]), quoted[0]]
                at = quoted.end()
            lines[number] = "".join([*pieces, change(line[at:])])
    return "\n".join(lines)
