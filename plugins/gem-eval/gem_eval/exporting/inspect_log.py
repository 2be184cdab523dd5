"""Logs of inspect_ai: what its viewer and ``read_eval_log`` read, written without it.

A log holds one task and one model: a zip of ``header.json``, ``summaries.json`` and a file for each sample. Written
after the fields of ``EvalLog`` in inspect_ai 0.3.285 (https://inspect.aisi.org.uk/eval-logs.html); fields that we have
nothing for have defaults there.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, BinaryIO
from zipfile import ZIP_DEFLATED, ZipFile

from gem_core import Episode
from gem_core.errors import EpisodeFileError
from gem_core.records import to_plain
from gem_eval.scores import Score, compute_scores
from gem_eval.turns import error_text, parts_of, text_of

if TYPE_CHECKING:
    from gem_eval.records import Row, Run

_ROLES = ("system", "user", "assistant", "tool")
_STOP_REASONS = {"stop": "stop", "length": "max_tokens", "tool_calls": "tool_calls", "content_filter": "content_filter"}
_SUMMARY = ("id", "epoch", "target", "metadata", "scores", "model_usage", "total_time", "uuid", "turn_count")
_LONGEST_INPUT = 5000


def write_log(run: Run, task: str, model: str, rows: Sequence[Row], file: BinaryIO) -> None:
    """Write the episodes of one task and one model; a damaged one is left out, and noted in ``Run.damage``."""
    scores = compute_scores(rows)
    tells = any(score.metric == "success" for score in scores)
    header = _header(run, task, model, rows, scores)
    summaries = []
    with ZipFile(file, "w", ZIP_DEFLATED) as archive:
        archive.writestr("_journal/start.json", _json({name: header[name] for name in ("version", "eval", "plan")}))
        for row, episode in run.intact(rows, run.episode):
            sample = _sample(run, row, episode, tells=tells)
            archive.writestr(f"samples/{sample['id']}_epoch_{sample['epoch']}.json", _json(sample))
            summaries.append(_summary(sample))
        archive.writestr("summaries.json", _json(summaries))
        archive.writestr("header.json", _json(header))


def _header(run: Run, task: str, model: str, rows: Sequence[Row], scores: Sequence[Score]) -> dict[str, Any]:
    """Return all of a log but its samples."""
    samples = sorted({row.row for row in rows})
    ended = [row.finished for row in rows if row.finished is not None] or [0.0]
    began = [row.finished - (row.seconds or 0) for row in rows if row.finished is not None] or [0.0]
    usage = [_usage(row) for row in rows]
    return {
        "version": 2,
        "status": {"running": "started", "finished": "success"}.get(run.info.get("status", "finished"), "cancelled"),
        "eval": {
            "eval_id": _name(run.name, task, model),
            "run_id": _name(run.name, min(began)),
            "created": _time(min(began)),
            "task": task,
            "task_id": _name(run.name, task, model),  # alike, the viewer takes them for retries
            "dataset": {"name": task, "samples": len(samples), "sample_ids": samples, "shuffled": False},
            "model": model,
            "config": {"epochs": 1 + max((row.epoch for row in rows), default=0)},
            "packages": {str(name): str(version) for name, version in dict(run.info.get("versions") or {}).items()},
            "metadata": {"gem": run.info, "run": run.name},
        },
        "plan": {"name": "plan", "steps": [{"solver": "gem"}]},
        "results": {
            "total_samples": len(rows),
            "completed_samples": sum(row.error is None for row in rows),
            "scores": [_score(score, len(rows)) for score in scores],
        },
        "stats": {
            "started_at": _time(min(began)),
            "completed_at": _time(max(ended)),
            "model_usage": {model: {name: math.fsum(each[name] or 0 for each in usage) for name in usage[0]}},
        },
    }


def _score(score: Score, samples: int) -> dict[str, Any]:
    values = {"accuracy" if score.metric == "success" else "mean": score.mean, "stderr": score.stderr}
    values |= {"ci_low": score.low, "ci_high": score.high}
    metrics = {name: {"name": name, "value": value} for name, value in values.items() if value is not None}
    told = {"name": score.metric, "scorer": score.metric, "reducer": "mean", "metrics": metrics}
    return {**told, "scored_samples": score.episodes, "unscored_samples": samples - score.episodes}


def _sample(run: Run, row: Row, episode: Episode, *, tells: bool) -> dict[str, Any]:
    """Return an episode as a sample; it has no score after an error, and none of success where its task never tells."""
    messages = _messages(run, episode)
    answers = [message for message in messages if message["role"] == "assistant"]
    asked = messages[: messages.index(answers[0])] if answers else messages
    scores: dict[str, Any] = {}
    if row.error is None:
        if tells and row.success is not None:
            scores["success"] = {"value": "C" if row.success else "I"}
        if math.isfinite(row.episode_return):
            scores["return"] = {"value": row.episode_return}
    reason = str(episode.transitions[-1].action.finish_reason) if episode.transitions else ""
    choice = {"message": answers[-1], "stop_reason": _STOP_REASONS.get(reason, "unknown")} if answers else None
    sample: dict[str, Any] = {
        "id": row.row,
        "epoch": row.epoch + 1,
        "input": asked,
        "target": "",
        "messages": messages,
        "output": {"model": row.model, "choices": [] if choice is None else [choice]},
        "scores": scores,
        "metadata": {
            "number": row.number,
            "seed": row.seed,
            "return": to_plain(row.episode_return),
            "cut_off": row.cut_off,
            "unreadable": row.unreadable,
            "env": episode.id,
            "arguments": to_plain(dict(episode.kwargs)),
            "wrappers": to_plain(episode.wrappers),
        },
        "model_usage": {row.model: _usage(row)},
        "uuid": _name(run.name, row.id, row.model, row.key, row.epoch),
        "turn_count": row.turns,
        "total_time": row.seconds,
    }
    if row.finished is not None:
        sample |= {"started_at": _time(row.finished - (row.seconds or 0)), "completed_at": _time(row.finished)}
    if episode.error is not None:
        sample["error"] = {"message": error_text(episode.error), "traceback": "", "traceback_ansi": ""}
    if row.cut_off is not None:
        sample["limit"] = {"type": "custom", "limit": 0, "reason": f"cut off by {row.cut_off}"}
    return sample


def _usage(row: Row) -> dict[str, Any]:
    read, written = row.tokens_in or 0, row.tokens_out or 0
    return {"input_tokens": read, "output_tokens": written, "total_tokens": read + written, "total_cost": row.cost}


def _summary(sample: Mapping[str, Any]) -> dict[str, Any]:
    told = {name: sample[name] for name in _SUMMARY if sample.get(name) is not None}
    asked = "\n".join(text_of(parts_of(message["content"])) for message in sample["input"])
    told["error"] = sample["error"]["message"] if "error" in sample else None
    told["limit"] = sample["limit"]["type"] if "limit" in sample else None
    return {**told, "input": asked[:_LONGEST_INPUT], "completed": True, "message_count": len(sample["messages"])}


def _messages(run: Run, episode: Episode) -> list[dict[str, Any]]:
    messages = [_message(message, run) for message in episode.messages]
    answers = [message for message in messages if message["role"] == "assistant"]
    # A chat that the environment keeps itself may show other responses than those that were given.
    if len(answers) == len(episode.transitions):
        for answer, turn in zip(answers, episode.transitions, strict=True):
            if turn.action.reasoning:
                said = answer["content"] if isinstance(answer["content"], list) else [_text(answer["content"])]
                answer["content"] = [{"type": "reasoning", "reasoning": turn.action.reasoning}, *said]
            if turn.action.tool_calls:
                answer["tool_calls"] = [_tool_call(call, place) for place, call in enumerate(turn.action.tool_calls)]
    return messages


def _message(message: Mapping[str, Any], run: Run) -> dict[str, Any]:
    role = message.get("role") if message.get("role") in _ROLES else "user"
    content, calls = message.get("content"), message.get("tool_calls")
    told = {"role": role, "content": [_part(part, run) for part in content] if isinstance(content, list) else content}
    if not isinstance(told["content"], list | str):
        told["content"] = "" if content is None else json.dumps(content, default=repr)
    if role == "assistant" and isinstance(calls, list):
        told["tool_calls"] = [_tool_call(call, place) for place, call in enumerate(calls)]
    if role == "tool":
        told["tool_call_id"] = str(message.get("tool_call_id", ""))
    return told


def _part(part: Any, run: Run) -> dict[str, Any]:
    if not isinstance(part, Mapping) or part.get("type") not in ("text", "image"):
        return _text(part if isinstance(part, str) else json.dumps(part, default=repr))
    if part["type"] == "text":
        return _text(str(part.get("text", "")))
    image = part.get("image")
    try:
        name = str(image["__image__"] if isinstance(image, Mapping) else None)
        run.images.read(name)  # it refuses what is no name of ours, and damaged files
        content = (run.images.path / name).read_bytes()
    except (EpisodeFileError, KeyError):
        return _text("[an image that cannot be read]")
    kind = "png" if name.endswith(".png") else "tiff"
    return {"type": "image", "image": f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}"}


def _text(text: str) -> dict[str, Any]:
    return {"type": "text", "text": text}


def _tool_call(call: Any, place: int) -> dict[str, Any]:
    """Return a native call; arguments that are no JSON object stand under ``"arguments"`` as they were written."""
    call = call if isinstance(call, Mapping) else {}
    function = call.get("function") if isinstance(call.get("function"), Mapping) else {}
    written = function.get("arguments")
    try:
        arguments = json.loads(written) if isinstance(written, str) else written
    except (ValueError, RecursionError):
        arguments = None
    told = {"id": str(call.get("id") or f"call_{place}"), "type": "function", "function": str(function.get("name", ""))}
    return {**told, "arguments": arguments if isinstance(arguments, dict) else {"arguments": written}}


def _name(*parts: object) -> str:
    """Return a name that is the same for the same parts, in the length of inspect_ai's own."""
    return hashlib.sha256(json.dumps(parts, default=str).encode()).hexdigest()[:22]


def _time(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")


def _json(value: Any) -> bytes:
    """Return plain JSON; halves of characters, which inspect_ai refuses, become replacement characters."""
    text = json.dumps(value, ensure_ascii=False, allow_nan=False)
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace").encode("utf-8")
