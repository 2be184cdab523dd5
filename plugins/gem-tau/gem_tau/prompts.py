"""What the two seats are told: how the assistant calls its tools, and how the user is to be played."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from typing import Any

from gem_core.tools import CALL_CLOSE, CALL_OPEN

GREETING = "Hi! How can I help you today?"
"""What the user answers first, as in tau-bench; the assistant does not see it."""

STOP = "###STOP###"
"""Ends the conversation when the user writes it."""

STOPS = (STOP, "###TRANSFER###", "###OUT-OF-SCOPE###")
"""All that ends a conversation; the last two are written by users that know tau2-bench."""

NOTHING_SAID = "(nothing was said)"
"""What one sees where the other said nothing."""

_PART = re.compile(r"<your part>\n(.*)\n</your part>", re.DOTALL)

_TOOLS = """\
You have these tools, each described by its name and the JSON Schema of its arguments:
{tools}

To call one, write {form} and nothing else: its result comes back to you, and the user sees neither. Make one call in \
a response. A response without a call is said to the user."""

_USER = """\
You play a customer who writes to the support of a company. What you read are the messages of its assistant.

<your part>
{instruction}
</your part>

How to play your part:
- Write what the customer writes, in the first person, one short message at a time, and nothing about this game.
- Do not tell everything at once. Say what the conversation needs now, and leave the rest until it is asked or due.
- You know what your part says, and no more. Asked for anything else, say that you do not know or do not have it; \
never make up a name, a number or a wish.
- Use your own words instead of copying those of your part, and keep to the character that it describes.
- Once all that you want is done, or has been refused for good, write {stop} alone, without another \
word. That ends the conversation."""


def user_system(instruction: str) -> str:
    """Return the system text of the user's seat."""
    return _USER.format(instruction=instruction.strip(), stop=STOP)


def part_of(system: str) -> str:
    """Return the instruction in the system text of the user's seat; the text itself if it has no such part."""
    found = _PART.search(system)
    return found[1] if found else system


def tool_instructions(schemas: Iterable[Mapping[str, Any]]) -> str:
    """Return how to call the tools, for a model that is not offered their schemas."""
    described = "\n".join(json.dumps(schema["function"], ensure_ascii=False) for schema in schemas)
    return _TOOLS.format(tools=described, form=f'{CALL_OPEN}{{"name": …, "arguments": {{…}}}}{CALL_CLOSE}')
