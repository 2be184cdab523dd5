"""What an agent's response does: a command, keys, the end, or nothing that can be read.

``read_action`` takes any text in time that grows with its length alone.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from gem_core.parsing import CodeBlock, extract_code_blocks, mask, thinking_blocks, unclosed_code_block
from gem_core.tools import CALL_CLOSE, CALL_OPEN, ToolCall, format_calls, json_call, native_calls
from gem_terminal.acting import TOOLS
from gem_terminal.terminus import read_terminus
from gem_terminal.yaml_commands import looks_like_yaml, read_yaml_command

MOST_COMMAND = 1_000_000
"""Characters of the longest command that is taken, and of the longest run of keys."""

_MOST_COUNTED = 20
"""Further actions of a response that are counted, each in one pass over the text."""

# Possessive throughout: no tag is tried twice. A tag and its attributes are at most a few hundred characters.
_OPENING = re.compile(
    r"""<(bash|keys)((?:\s++[\w-]{1,40}+\s*+=\s*+(?:"[^"<>]{0,100}+"|'[^'<>]{0,100}+'|[^\s"'<>]{1,100}+)){0,10})\s*+>"""
)
_ATTRIBUTE = re.compile(r"""([\w-]+)\s*+=\s*+(?:"([^"]*+)"|'([^']*+)'|(\S++))""")
_FINISH = re.compile(r"<finish\s*+(?:/\s*+>|>(?:\s*+</finish\s*+>)?)")
# A tag in quotation marks is spoken of, and is none.
_QUOTED_TAG = re.compile(r"""([`'"])</?(?:bash|keys|finish|tool_call)\s*+/?+>\1""")
_NUMBER = re.compile(r"\+?(?:\d{1,9}(?:\.\d{0,9})?|\.\d{1,9})\s*(?:s|sec|secs|seconds)?", re.ASCII)
_OTHER_TAG = re.compile(r"<(sh|shell|cmd|command|execute|terminal|key|done|submit|exit|Bash|BASH|Keys|Finish)\s*+/?+>")
# An object that begins a line, and is a call beyond doubt.
_BARE_CALL = re.compile(
    r"""^[ \t]*+(?=\{\s*+"(?:name|tool_name)"\s*+:\s*+"(?:bash|keys|finish)"\s*+"""
    r"""(?:\}|,\s*+"(?:arguments|parameters)"\s*+:))\{""",
    re.MULTILINE,
)
_OBJECT = json.JSONDecoder(strict=False)  # a command of several lines may have its line breaks as they are
_TIMEOUTS = ("timeout", "timeout_s", "timeout_sec", "timeout_secs", "timeout_seconds")
_WAITS = ("wait", "wait_s", "wait_sec", "wait_secs", "wait_seconds")

_WRITE = "Write one command as <bash>command</bash>, keys as <keys>text<Enter></keys>, or <finish/> when you are done."


@dataclass(frozen=True, kw_only=True)
class Action:
    """What a response does.

    Args:
        text: What was read of the response: its beginning, as far as the end of the action.
        call_id: Under which a native call is answered; None for an action in the text.
        other_call_ids: Of native calls behind the first, which are not executed.
        ignored: Complete actions behind the first, which are not executed; at most 20 are counted.
    """

    text: str = ""
    call_id: str | None = None
    other_call_ids: tuple[str, ...] = ()
    ignored: int = 0


@dataclass(frozen=True)
class Bash(Action):
    """A command for the shell.

    Args:
        command: Any text but an empty one.
        timeout_s: Seconds that the agent asks for; None where it does not.
    """

    command: str
    timeout_s: float | None = None


@dataclass(frozen=True)
class Keys(Action):
    """Keys for whatever runs in the terminal.

    Args:
        keys: In the notation of ``keys.py``; empty to look at the screen only.
        wait_s: Seconds that the agent asks for; None where it does not.
    """

    keys: str
    wait_s: float | None = None


@dataclass(frozen=True)
class Finish(Action):
    """The end: what is there now is to be verified."""


@dataclass(frozen=True)
class Malformed(Action):
    """Nothing that could be read.

    Args:
        reason: What is wrong, and how to write it right, in sentences for the agent.
    """

    reason: str


def read_action(response: str) -> Action:
    """Return what a response does: a ``Bash``, ``Keys``, ``Finish`` or ``Malformed``.

    Native calls (``Response.tool_calls``) win over text, of which the first complete action counts. What stands in a
    closed thinking block is no action, and neither is a lone tag in quotation marks. A fenced block without a language
    is a command where it is the only block, and there is no other action.
    """
    calls = getattr(response, "tool_calls", None)
    text = str.__str__(response)
    if isinstance(calls, Sequence) and not isinstance(calls, str) and calls:
        return _native(text, calls)
    thinking, opened_before = thinking_blocks(text)
    found = _first(text, thinking)
    if found is None or isinstance(found.action, Malformed):
        around = _first(text, thinking[1:]) if opened_before else None
        # What looks like the end of thinking may stand within a command, as in one that prints it.
        if around is not None and not isinstance(around.action, Malformed) and around.end > thinking[0][1]:
            found = around
    if found is None:
        found = _unmarked(text, thinking)
    if found is None:
        return Malformed(_reason_for_none(text, thinking), text=text)
    return replace(found.action, text=text[: found.end], ignored=_count(text, found.end, thinking))


class _Found(NamedTuple):
    start: int
    end: int
    action: Action


def _count(text: str, start: int, thinking: Sequence[tuple[int, int]]) -> int:
    """Return how many complete actions stand behind a place."""
    text = mask(text, [span for span in thinking if span[0] >= start])[start:]
    for count in range(_MOST_COUNTED):
        found = _first(text, ())
        if found is None or isinstance(found.action, Malformed):
            return count
        text = text[found.end :]
    return _MOST_COUNTED


def _first(text: str, thinking: Sequence[tuple[int, int]]) -> _Found | None:
    """Return the complete action that begins first; without one, the incomplete one that does."""
    seen = mask(text, thinking)
    seen = _QUOTED_TAG.sub(lambda quoted: " " * len(quoted[0]), seen)
    called = _called(text, seen) or _called_bare(text, seen)
    every = [*_tagged(text, seen), _fenced(text, seen), called, _terminus(text, seen), _finished(text, seen)]
    found = [each for each in every if each is not None]
    complete = [each for each in found if not isinstance(each.action, Malformed)]
    first = min(complete or found, key=lambda each: each.start, default=None)
    # An action that is wrong in itself, as one that is empty, is not passed over for a later one: it was meant.
    whole = [each for each in found if each.end >= 0 and (first is None or each.start < first.start)]
    first = min(whole, key=lambda each: each.start, default=first)
    return None if first is None else first._replace(end=first.end if first.end >= 0 else len(text))


def _tagged(text: str, seen: str) -> list[_Found]:
    """Return the first element of each tag, and the first that is never closed."""
    found: list[_Found] = []
    known: set[str] = set()
    for opening in _OPENING.finditer(seen):
        name = opening[1]
        if name in known:
            continue
        known.add(name)
        closing = f"</{name}>"
        end = seen.find(closing, opening.end())
        if end < 0:
            reason = f"<{name}> is never closed. Write {closing} at the end of it."
            found.append(_Found(opening.start(), -1, Malformed(reason)))
        else:
            content = text[opening.end() : end]
            action = _element(name, text[opening.start(2) : opening.end(2)], content, seen[opening.end() : end])
            found.append(_Found(opening.start(), end + len(closing), action))
        if len(known) == 2:
            break
    return found


def _element(name: str, attributes: str, content: str, seen: str) -> Action:
    if f"<{name}>" in seen:
        return Malformed(
            f"<{name}> is opened twice before it is closed, so that it can be read in more than one way. Write one "
            f"<{name}>…</{name}>, and speak of the tag in quotation marks only."
        )
    arguments: dict[str, Any] = {}
    for attribute in _ATTRIBUTE.finditer(attributes):
        arguments[attribute[1].lower()] = attribute[2] or attribute[3] or attribute[4] or ""
    allowed = _TIMEOUTS if name == "bash" else _WAITS
    unknown = next((each for each in arguments if each not in allowed), None)
    if unknown is not None:
        return Malformed(f"<{name}> has no attribute {unknown!r}; there is {allowed[0]}, as in {_example(name)}.")
    if name == "keys":
        return _keys(content, arguments)
    content = TOOLS["bash"].unfenced(content)
    if looks_like_yaml(content):
        read = read_yaml_command(content)
        if isinstance(read, str):
            return Malformed(read)
        content, timeout = read
        if timeout is not None:
            arguments.setdefault("timeout_secs", timeout)
    return _bash(content, arguments)


def _example(name: str) -> str:
    return '<bash timeout="30">make</bash>' if name == "bash" else '<keys wait="5">:wq<Enter></keys>'


def _bash(command: object, arguments: Mapping[str, Any]) -> Action:
    if not isinstance(command, str):
        return Malformed('The command of bash must be text, as in {"name": "bash", "arguments": {"command": "ls"}}.')
    command = command.strip("\r\n")
    if not command.strip():
        return Malformed("The command is empty. Write what the shell should run, as in <bash>ls -l</bash>.")
    if len(command) > MOST_COMMAND:
        return Malformed(f"The command has {len(command)} characters; {MOST_COMMAND} are allowed. Write it in parts.")
    seconds = _seconds(arguments, _TIMEOUTS)
    if isinstance(seconds, str):
        return Malformed(f"{seconds}, as in {_example('bash')}.")
    return Bash(command, seconds)


def _keys(keys: object, arguments: Mapping[str, Any]) -> Action:
    if isinstance(keys, list) and all(isinstance(each, str) for each in keys):
        keys = "".join(keys)
    if not isinstance(keys, str):
        return Malformed('The keys must be text, as in {"name": "keys", "arguments": {"keys": "yes<Enter>"}}.')
    if len(keys) > MOST_COMMAND:
        return Malformed(f"There are {len(keys)} characters of keys; {MOST_COMMAND} are allowed.")
    seconds = _seconds(arguments, _WAITS)
    if isinstance(seconds, str):
        return Malformed(f"{seconds}, as in {_example('keys')}.")
    return Keys(keys, seconds)


def _seconds(arguments: Mapping[str, Any], names: Sequence[str]) -> float | str | None:
    """Return the seconds that are asked for; text where they are no number of seconds."""
    name = next((each for each in names if arguments.get(each) is not None), None)
    if name is None:
        return None
    value = arguments[name]
    seconds = -1.0
    if isinstance(value, str) and (number := _NUMBER.fullmatch(value.strip()[:50])):
        seconds = float(number[0].rstrip("secondr "))
    elif isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= 1e9:
        seconds = float(value)
    if not math.isfinite(seconds) or seconds < 0 or (seconds == 0 and names is _TIMEOUTS):
        return f"{name} must be a number of seconds"
    return seconds


def _fenced(text: str, seen: str) -> _Found | None:
    for block in extract_code_blocks(seen, *TOOLS["bash"].fences):
        # Read again, since quotation marks in it are its own.
        own = next(iter(extract_code_blocks(text[block.start : block.end])), None)
        return _Found(block.start, block.end, _bash(_untagged((own or block).code), {}))
    unclosed: CodeBlock | None = unclosed_code_block(seen, *TOOLS["bash"].fences)
    if unclosed is None:
        return None
    return _Found(unclosed.start, -1, Malformed("The fenced block is never closed. Write ``` on a line at its end."))


def _untagged(code: str) -> str:
    around = code.strip()
    inside = around.removeprefix("<bash>").removesuffix("</bash>")
    return inside if len(around) - len(inside) == len("<bash></bash>") and "</bash>" not in inside else code


def _finished(text: str, seen: str) -> _Found | None:
    found = _FINISH.search(seen)
    return None if found is None else _Found(found.start(), found.end(), Finish())


def _called(text: str, seen: str) -> _Found | None:
    """Read a call in a form that models are trained to write; of those between marks, the first that can be read."""
    calls = [call for call in format_calls(seen, TOOLS) if call.error is None]
    call = min(calls, key=lambda each: each.start, default=None)
    if call is None:
        broken = json_call(seen, TOOLS)
        if broken is None:
            return None
        return _Found(broken.start, broken.end if broken.end > broken.start else -1, _of_call(broken))
    # Read again, since what looks like a tag or thinking in it is its own.
    rest = text[call.start :]
    original = next((each for each in format_calls(rest, TOOLS) if each.start == 0 and each.error is None), None)
    if original is not None:
        call = replace(call, arguments=original.arguments, end=call.start + original.end)
    return _Found(call.start, call.end, _of_call(call))


def _terminus(text: str, seen: str) -> _Found | None:
    read = read_terminus(text, seen)
    if read is None:
        return None
    if not read.keys:
        return _Found(read.start, read.end, Finish())
    return _Found(read.start, read.end, _keys(read.keys, {} if read.wait_s is None else {"wait": read.wait_s}))


def _unmarked(text: str, thinking: Sequence[tuple[int, int]]) -> _Found | None:
    """Read the only fenced block of a response, if it names no language."""
    blocks = extract_code_blocks(mask(text, thinking))
    if len(blocks) != 1 or blocks[0].language:
        return None
    return _Found(blocks[0].start, blocks[0].end, _bash(blocks[0].code, {}))


def _called_bare(text: str, seen: str) -> _Found | None:
    """Read a call without its tags, as many models write it: an object that begins a line, fenced as JSON or not."""
    found = _BARE_CALL.search(seen)
    if found is None:
        return None
    start = found.end() - 1
    try:
        _, end = _OBJECT.raw_decode(text, start)
    except (ValueError, RecursionError):
        reason = "The call is no valid JSON, or is not complete."
        return _Found(start, -1, Malformed(f"{reason} {_WRITE}"))
    call = json_call(f"{CALL_OPEN}{text[start:end]}{CALL_CLOSE}", TOOLS)
    return None if call is None else _Found(start, end, _of_call(call))


def _of_call(call: ToolCall) -> Action:
    if call.error is not None:
        problem = call.error[:1].upper() + call.error[1:]
        return Malformed(
            f"{problem.rstrip('.')}. Write a call as "
            '<tool_call>{"name": "bash", "arguments": {"command": "ls -l"}}</tool_call>.'
        )
    arguments = call.arguments
    if call.name == "finish":
        return Finish()
    names = ("command", "cmd") if call.name == "bash" else ("keys", "keystrokes")
    allowed = {*names, *(_TIMEOUTS if call.name == "bash" else _WAITS)}
    unknown = next((each for each in arguments if each not in allowed), None)
    if unknown is not None:
        known = "command and timeout" if call.name == "bash" else "keys and wait"
        return Malformed(f"{call.name} has no argument {unknown[:50]!r}; there are {known}.")
    what = next((arguments[name] for name in names if name in arguments), None)
    return _bash(what, arguments) if call.name == "bash" else _keys(what, arguments)


def _native(text: str, calls: Sequence[Any]) -> Action:
    read = native_calls(calls, TOOLS)
    first = read[0]
    others = tuple(call.id for call in read[1:] if call.id is not None)
    return replace(_of_call(first), text=text, call_id=first.id, other_call_ids=others, ignored=len(read) - 1)


def _reason_for_none(text: str, thinking: Sequence[tuple[int, int]]) -> str:
    if not text.strip():
        return f"The response is empty. {_WRITE}"
    if thinking and _first(text, ()) is not None:
        return f"What stands in a thinking block is not executed. Write the action behind </think>. {_WRITE}"
    other = _OTHER_TAG.search(text)
    if other is not None:
        return f"There is no <{other[1]}>. {_WRITE}"
    return f"There is no action in the response. {_WRITE}"
