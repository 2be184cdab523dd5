"""An episode as it is shown, in a terminal and in a page: its turns in pieces of text."""

from __future__ import annotations

import json
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from gem_core import Episode, JointEpisode, Observation, Transition
from gem_core.cli import counted
from gem_core.records import Record

if TYPE_CHECKING:
    from gem_eval.records import Row

_SHORTEST_REPEAT = 200
# Shown under names of their own, or (the suffix) as part of the next observation.
_NOT_REST = ("feedback", "suffix", "error", "seed", "episode")


@dataclass(frozen=True)
class Part:
    """A piece of an observation.

    Args:
        kind: ``role`` names who speaks what follows, ``image`` holds the name of an image file.
        text: What it says.
        repeated: Whether the observation of the turn before said it already.
    """

    kind: Literal["text", "role", "image", "other"]
    text: str
    repeated: bool = False

    def __str__(self) -> str:
        """Return it as text."""
        return {"role": f"[{self.text}]", "image": f"[image {self.text}]"}.get(self.kind, self.text)


@dataclass(frozen=True)
class Block:
    """A labelled piece of a turn.

    Args:
        label: ``observation``, ``reasoning`` (taken out of the response by the server), ``response``, ``tool call``
            (``name(arguments)``), ``feedback`` (if it is not the next observation), or ``error`` of the machinery.
        parts: What it says.
        aside: What the server reported of a response: model, tokens, why it stopped.
    """

    label: str
    parts: list[Part]
    aside: str = ""

    @property
    def text(self) -> str:
        """What it says, without what the observation before said already."""
        return text_of(part for part in self.parts if not part.repeated)

    @property
    def repeated(self) -> int:
        """Number of characters that the observation before said already."""
        return sum(len(part.text) for part in self.parts if part.repeated)


@dataclass(frozen=True)
class TurnView:
    """A turn, as every rendering shows it: ``gem show``, the pages, and the report.

    Args:
        number: From 1; of several agents, that of the step in which it acted.
        blocks: What the agent saw and said.
        reward: Reward of the turn.
        flags: ``terminated``, ``truncated`` and ``cut off at the token limit``, where they hold.
        answer: Feedback and errors.
        info: The rest of the info, as plain JSON.
        seat: Of several agents, the seat that acted, and its agent; else empty.
    """

    number: int
    blocks: list[Block]
    reward: float
    flags: list[str]
    answer: list[Block]
    info: dict[str, str]
    seat: str = ""


def turn_views(episode: Record, *, fold: bool = True) -> Iterator[TurnView]:
    """Yield the turns of an episode; of several agents, in the order in which they acted.

    Args:
        episode: The episode, its images as names of files.
        fold: Whether what an observation repeats of the one before, of the same seat, is marked so.
    """
    if isinstance(episode, JointEpisode):
        yield from _joint_views(episode, fold=fold)
        return
    before: Observation = ""
    following = [*(turn.observation for turn in episode.transitions[1:]), episode.final_observation]
    for number, (turn, after) in enumerate(zip(episode.transitions, following, strict=False), start=1):
        yield _turn_view(number, turn, before if fold else "", after)
        before = turn.observation


def _joint_views(joint: JointEpisode, *, fold: bool) -> Iterator[TurnView]:
    views = {seat: turn_views(episode, fold=fold) for seat, episode in joint.seats.items()}
    for number, acted in enumerate(joint.order, start=1):
        for seat in acted:
            view = next(views.get(seat, iter(())), None)
            if view is not None:
                yield replace(view, number=number, seat=f"{seat} ({joint.seats[seat].agent})")


def parts_of(observation: Any, before: Any = "") -> list[Part]:
    """Return the pieces of an observation, or of anything that stands where one should."""
    if isinstance(observation, str):
        repeated = _repeated(observation, before) if isinstance(before, str) else 0
        pieces = [Part("text", observation[:repeated], repeated=True), Part("text", observation[repeated:])]
        return [piece for piece in pieces if piece.text]
    if not isinstance(observation, list):
        return [Part("other", _json(observation))]
    same = 0
    if isinstance(before, list):
        while same < min(len(before), len(observation) - 1) and before[same] == observation[same]:
            same += 1
    return [
        Part(part.kind, part.text, repeated=place < same)
        for place, item in enumerate(observation)
        for part in _parts_of_item(item)
    ]


def text_of(parts: Iterable[Part]) -> str:
    """Return the pieces of an observation as one text."""
    return "\n".join(map(str, parts))


def start_of(episode: Record) -> dict[str, str]:
    """Return what an episode started from, in words; what is empty is left out."""
    facts: dict[str, Any] = {
        "seed": episode.seed,
        "group": episode.group,
        "options": episode.options,
        "arguments": episode.kwargs,
        "wrappers": episode.wrappers,
    }
    if isinstance(episode, Episode):
        read = "" if episode.reads in (None, "observation") else str(episode.reads)
        facts = {"model": episode.agent, **facts}
        facts["tools"], facts["system"] = episode.tools, episode.system
        # Where the agent was sent something else than what is shown of a turn.
        facts["sent"] = ", ".join(filter(None, [read, "tools natively" if episode.native_tools else ""]))
        facts["task"] = episode.info.get("task_id")
    facts["versions"] = episode.versions
    return {name: _words(value) for name, value in facts.items() if value not in (None, "", [], {})}


def episodes_of(record: Record) -> list[Episode]:
    """Return the episode of each seat, or that of an agent alone."""
    return [record] if isinstance(record, Episode) else list(record)


def some_success(episode: Record) -> bool | None:
    """Return whether an episode succeeded; of several agents, whether one of them did."""
    verdicts = [own.success for own in episodes_of(episode)]
    return True if True in verdicts else None if None in verdicts or not verdicts else False


def figures_of(episode: Episode) -> str:
    """Return the return, the turns and what cut the episode off, in words."""
    first = f" ({episode.first_reward:g} before the first turn)" if episode.first_reward else ""
    cut_off = "" if episode.cut_off is None else f", cut off by {episode.cut_off}"
    return f"return {episode.episode_return:g}{first}, {counted(episode.turns, 'turn')}{cut_off}"


def outcome_of(*verdicts: bool | None, failed: bool) -> str:
    """Return how an episode ended, in one word.

    Args:
        verdicts: The success of the agent, or of each seat; ``"split"`` if seats differ.
        failed: Whether the machinery had an error.
    """
    if failed:
        return "error"
    words = {True: "success", False: "failure", None: "unscored"}
    return words[verdicts[0]] if len(set(verdicts)) == 1 else "split"


def outcome_of_row(row: Row) -> str:
    """Return the outcome of an episode by its row; see ``outcome_of``."""
    seats = [own.success for own in (row.seats or {}).values()] or [row.success]
    return outcome_of(*seats, failed=row.error is not None)


def error_text(error: Mapping[str, Any] | None) -> str:
    """Return an error of the machinery in words; empty where there was none."""
    return "" if error is None else f"{error.get('kind')}: {error.get('message')}"


def _turn_view(number: int, turn: Transition, before: Observation, after: Observation) -> TurnView:
    action, info = turn.action, turn.info if isinstance(turn.info, dict) else {"info": turn.info}
    feedback = info.get("feedback")
    error = info.get("error")
    flags = {"terminated": turn.terminated, "truncated": turn.truncated, "cut off at the token limit": action.cut_off}
    blocks = [
        Block("observation", parts_of(turn.observation, before)),
        Block("reasoning", parts_of(_words(action.reasoning))),
        Block("response", parts_of(action.text), _reported(turn)),
        *(Block("tool call", parts_of(_call(call))) for call in action.tool_calls or ()),
    ]
    failed = error_text(error if error is None or isinstance(error, dict) else {"kind": "unknown", "message": error})
    answer = [
        Block("feedback", [] if feedback in (None, "") or feedback == after else parts_of(feedback)),
        Block("error", parts_of(failed)),
    ]
    return TurnView(
        number=number,
        blocks=[block for block in blocks if block.parts or block.label in ("observation", "response")],
        reward=turn.reward,
        flags=[name for name, holds in flags.items() if holds],
        answer=[block for block in answer if block.parts],
        info={name: _words(value) for name, value in info.items() if name not in _NOT_REST and value is not None},
    )


def _parts_of_item(item: Any) -> list[Part]:
    if isinstance(item, str):
        return [Part("text", item)]
    if not isinstance(item, dict):
        return [Part("other", _json(item))]
    if "role" in item:
        calls = item.get("tool_calls")
        parts = [Part("role", _words(item["role"])), *parts_of(item.get("content") or "")]
        return parts + [Part("text", _call(call)) for call in (calls if isinstance(calls, list) else [])]
    if item.get("type") == "text":
        return [Part("text", _words(item.get("text")))]
    image = item.get("image")
    if item.get("type") == "image" and isinstance(image, dict) and isinstance(image.get("__image__"), str):
        return [Part("image", image["__image__"])]
    return [Part("other", _json(item))]


def _repeated(text: str, before: str) -> int:
    """Return how many characters at the start stand in the text before as well: whole lines, and enough of them."""
    # 0.3 ms for 200,000 characters; os.path.commonprefix takes 13.
    lengths = range(1, min(len(text), len(before)) + 1)
    length = bisect_left(lengths, True, key=lambda length: not before.startswith(text[:length]))
    if length < len(text):
        length = text.rfind("\n", 0, length) + 1
    return length if length >= _SHORTEST_REPEAT else 0


def _call(call: Any) -> str:
    function = call.get("function") if isinstance(call, dict) else None
    if not isinstance(function, dict):
        return _json(call)
    return f"{_words(function.get('name'))}({_words(function.get('arguments'))})"


def _reported(turn: Transition) -> str:
    action = turn.action
    usage = action.usage or {}
    prompt, sampled = usage.get("prompt_tokens"), usage.get("completion_tokens")
    facts = [
        _words(action.model),
        "" if prompt is None else f"{_words(prompt)} prompt tokens",
        "" if sampled is None else f"{_words(sampled)} sampled tokens",
        "" if action.finish_reason is None else f"finish reason {_words(action.finish_reason)}",
    ]
    return " · ".join(fact for fact in facts if fact)


def _words(value: Any) -> str:
    return "" if value is None else value if isinstance(value, str) else _json(value)


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, default=repr)
