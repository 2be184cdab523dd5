"""Users that act by rules, without a model: they know their instruction and read what the assistant says."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from gem_core.errors import AgentError, ArgumentError
from gem_tau.prompts import STOP, part_of

if TYPE_CHECKING:
    from gem_core.rollouts import Context
    from gem_core.types import Observation

CHARACTERS = ("patient", "forgetful", "terse")

_PATIENCE = {"patient": 12, "forgetful": 12, "terse": 5}
"""Messages after which a user leaves."""

_ASKED = {
    "email": r"e-?mail",
    "order": r"\border\b",
    "item": r"\bitem\b|\bproduct\b",
    "colour": r"\bcolou?r\b|\bvariant\b",
    "reason": r"\breason\b|\bwhy\b",
    "refund": r"\brefund|\bmoney\b|\bpayment\b",
    "address": r"(?<!e-mail )(?<!email )\baddress\b",
}
"""Words of a question, by what it asks for."""

_TOLD = {
    "email": "My email address is {}.",
    "order": "The order is {}.",
    "item": "It is about the {}.",
    "colour": "I would like it in {}.",
    "reason": "The reason is: {}.",
    "refund": "The money should go to the {}.",
    "address": "The new address is {}.",
}

_FACT = re.compile(r"- (\w+): (.+)")
_WANT = re.compile(r"(?:(Then you|If that cannot be done, you)|You) want to (.+)\.")
_SENTENCE = re.compile(r"[^.!?\n]+[.!?]?")
_NUMBER = re.compile(r"#\d{4}")
_CONFIRM = re.compile(
    r"yes or no|\(yes/no\)|\bconfirm|\bshall i\b|\bshould i\b|\bproceed\b|is that right", re.IGNORECASE
)
_SETTLED = re.compile(
    r"\bdone\b|\bha(?:s|ve) been\b|\bis now\b|\bcomes to\b|\bcannot\b|\bunable\b|\bsorry\b|anything else", re.IGNORECASE
)
_REFUSED = re.compile(r"\bcannot\b|\bcan't\b|\bunable\b|\bsorry\b", re.IGNORECASE)
_INVITED = re.compile(r"anything else", re.IGNORECASE)


@dataclass
class Want:
    """One thing that a user wants, and what it knows about it."""

    text: str
    only_if_refused: bool = False
    facts: dict[str, str] = field(default_factory=dict)


class ScriptedUser:
    """A user of a character, by rules.

    ``patient`` tells all at once and exactly, checks what is read back, and mentions a further wish by itself.
    ``forgetful`` exchanges two digits of an order number at first, leaves out the rest, but checks what is read back.
    ``terse`` answers one thing at a time, says yes to everything, and leaves after five messages.

    It understands the instructions of ``tau:Sample``. Of any other it says all in its first message, agrees to what it
    is asked to confirm, answers other questions with the sentences that share words with them, and leaves once the
    assistant says that something is done or cannot be done.

    Args:
        character: ``patient``, ``forgetful`` or ``terse``.

    Raises:
        ArgumentError: There is no such character.
    """

    reads = "messages"

    def __init__(self, character: str = "patient") -> None:
        if character not in CHARACTERS:
            raise ArgumentError(f"there is no tau-user:{character}; there are: {', '.join(CHARACTERS)}")
        self.character = character

    def __call__(self, observation: Observation, context: Context) -> str:
        """Answer what the assistant said last."""
        if context.seat != "user":
            raise AgentError("a tau-user plays only the user, as in --agent user=tau-user:patient")
        messages = context.messages
        instruction = part_of(str(messages[0]["content"]))
        said = [str(message["content"]) for message in messages if message["role"] == "assistant"]
        heard = str(messages[-1]["content"])
        if len(said) >= _PATIENCE[self.character]:
            return STOP
        facts, wants = read_instruction(instruction)
        if not wants:
            return _retell(instruction, said, heard)
        return _Reply(self.character, facts, wants, said, heard).text()


def read_instruction(instruction: str) -> tuple[dict[str, str], list[Want]]:
    """Return what an instruction of ``tau:Sample`` says of the user, and its wants."""
    facts: dict[str, str] = {}
    wants: list[Want] = []
    for line in instruction.splitlines():
        if wanted := _WANT.fullmatch(line):
            wants.append(Want(wanted[2], only_if_refused=str(wanted[1]).startswith("If")))
        elif fact := _FACT.fullmatch(line):
            (wants[-1].facts if wants else facts)[fact[1]] = fact[2]
    return facts, wants


class _Reply:
    """What a user answers now."""

    def __init__(self, character: str, facts: dict[str, str], wants: list[Want], said: list[str], heard: str) -> None:
        self.character, self.own, self.said, self.heard = character, facts, said, heard
        told = "\n".join(said).lower()
        self.waiting = [want for want in wants if want.text not in told]
        self.want = next((want for want in reversed(wants) if want.text in told), wants[0])
        self.facts = facts | self.want.facts

    def text(self) -> str:
        if not self.said:
            return self._wish(self.waiting[0])
        if _CONFIRM.search(self.heard):
            return self._checked()
        asked = self._asked()
        if asked:
            return self._answers(asked)
        if _SETTLED.search(self.heard):
            return self._goes_on()
        return f"I want to {self.want.text}."

    def _asked(self) -> list[str]:
        questions = " ".join(part for part in _SENTENCE.findall(self.heard) if part.endswith("?"))
        return [name for name, words in _ASKED.items() if re.search(words, questions, re.IGNORECASE)]

    def _wish(self, want: Want) -> str:
        if self.character == "terse":
            return want.text.capitalize() + "."
        told = want.facts if self.said else self.own | want.facts
        if self.character == "forgetful":
            told = {name: value for name, value in want.facts.items() if name == "order"}
        return " ".join([f"I want to {want.text}.", *(self._told(*fact) for fact in told.items())])

    def _answers(self, asked: list[str]) -> str:
        known = [name for name in asked if name in self.facts]
        if self.character == "terse":
            answers = [f"{self.facts[name]}." for name in known]
            return next((answer for answer in answers if answer not in self.said), [*answers, "I do not know."][0])
        lines = [self._told(name, self.facts[name]) for name in known]
        if len(known) < len(asked):
            lines.append("I do not know the rest." if known else "I do not know.")
            if "item" in self.facts and "item" not in known:
                lines.append(self._told("item", self.facts["item"]))
        return " ".join(lines)

    def _told(self, name: str, value: str) -> str:
        if self.character == "forgetful" and name == "order":
            wrong = value[:-2] + value[:-3:-1]
            if not any(wrong in text or value in text for text in self.said):
                return _TOLD[name].format(wrong)
        return _TOLD[name].format(value)

    def _checked(self) -> str:
        """Say yes, or what is wrong or missing in what was read back."""
        if self.character == "terse":
            return "Yes."
        lines = [
            _TOLD[name].format(value)
            for name, value in self.want.facts.items()
            if value.lower() not in self.heard.lower()
        ]
        new = [line for line in lines if not self._has_corrected(line)]
        return " ".join(["No, not quite.", *new]) if new else "Yes, please."

    def _goes_on(self) -> str:
        order = self.want.facts.get("order", "")
        named = _NUMBER.findall(self.heard)
        line = _TOLD["order"].format(order)
        if order and named and order not in named and self.character != "terse" and not self._has_corrected(line):
            return f"No, that is another one. {line}"
        tells = self.character == "patient" or _INVITED.search(self.heard)
        for want in self.waiting:
            if tells and (not want.only_if_refused or _REFUSED.search(self.heard)):
                return self._wish(want)
        return STOP

    def _has_corrected(self, line: str) -> bool:
        return any(text.startswith("No") and line in text for text in self.said)


def _retell(instruction: str, said: Sequence[str], heard: str) -> str:
    """Answer by an instruction of any form."""
    own = _in_first_person(instruction)
    if not said:
        return own
    if _CONFIRM.search(heard):
        return "Yes, please go ahead."
    if _SETTLED.search(heard):
        return STOP
    asked = _words(heard)
    lines = [line.strip() for line in _SENTENCE.findall(own) if asked & _words(line)]
    return " ".join(lines) or "I do not know."


def _words(text: str) -> set[str]:
    return set(re.findall(r"[a-z]{4,}", text.lower()))


_FIRST_PERSON = {
    "you are": "I am",
    "you're": "I'm",
    "yourself": "myself",
    "yours": "mine",
    "your": "my",
    "you": "I",
}
_SECOND_PERSON = re.compile(rf"\b({'|'.join(_FIRST_PERSON)})\b", re.IGNORECASE)


def _in_first_person(instruction: str) -> str:
    return _SECOND_PERSON.sub(lambda found: _FIRST_PERSON[found[0].lower()], instruction).strip()
