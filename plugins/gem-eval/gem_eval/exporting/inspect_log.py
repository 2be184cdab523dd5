"""Logs of inspect_ai: what its viewer and ``read_eval_log`` read, written without it.

A log holds one task and one model. A file ``.json`` is one object, with the samples last but one; a file ``.eval`` is a
zip of ``header.json``, ``summaries.json`` and a file for each sample. Written after the fields of ``EvalLog`` in
inspect_ai 0.3.285 (https://inspect.aisi.org.uk/eval-logs.html); fields that we have nothing for have defaults there.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple
from zipfile import ZIP_DEFLATED, ZipFile

from gem_core import Episode
from gem_core.errors import EpisodeFileError
from gem_core.records import to_plain
from gem_eval.exporting.inspect_messages import ImageUrl, as_parts, messages_of
from gem_eval.turns import error_text

if TYPE_CHECKING:
    from gem_eval.records import Row, Run
    from gem_eval.scores import Score

_LIMITS = {
    "turns": "turn",
    "tokens": "context",
    "time": "time",
    "run time": "time",
    "token budget": "token",
    "run tokens": "token",
    "cost": "cost",
    "run cost": "cost",
}
_STOP_REASONS = {"stop": "stop", "length": "max_tokens", "tool_calls": "tool_calls", "content_filter": "content_filter"}
_SUMMARY = (
    "id", "epoch", "input", "target", "metadata", "scores", "model_usage", "started_at", "completed_at", "total_time",
    "uuid",
)  # fmt: skip
_LONGEST_INPUT = 5000


class LogPart(NamedTuple):
    """The episodes of one task and one model of a run.

    Args:
        run: The run.
        id: Name of the task.
        model: Name of the model.
        rows: Its episodes.
        scores: Their scores, one for each metric.
    """

    run: Run
    id: str
    model: str
    rows: list[Row]
    scores: list[Score]


def write_json(part: LogPart, file: BinaryIO) -> None:
    """Write a log as one JSON object."""
    header = _header(part)
    start = _json(header).removesuffix(b"}")
    file.write(start + b', "samples": [')
    for place, (_, sample) in enumerate(_samples(part)):
        file.write((b",\n" if place else b"\n") + _json(sample))
    file.write(b"\n]}\n")


def write_eval(part: LogPart, file: BinaryIO) -> None:
    """Write a log as a zip, a file for each sample."""
    header = _header(part)
    summaries = []
    with ZipFile(file, "w", ZIP_DEFLATED) as archive:
        archive.writestr("_journal/start.json", _json({name: header[name] for name in ("version", "eval", "plan")}))
        for name, sample in _samples(part):
            archive.writestr(name, _json(sample))
            summaries.append(_summary(sample))
        archive.writestr("summaries.json", _json(summaries))
        archive.writestr("header.json", _json(header))


def _samples(part: LogPart) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name of each sample's file, and the sample; a damaged episode is left out."""
    for _, sample in part.run.intact(part.rows, lambda row: _sample(part, row, part.run.episode(row))):
        yield f"samples/{sample['id']}_epoch_{sample['epoch']}.json", sample


def _header(part: LogPart) -> dict[str, Any]:
    """Return all of a log but its samples."""
    info, rows = part.run.info, part.rows
    samples = sorted({row.row for row in rows})
    ended = [row.finished for row in rows if row.finished is not None]
    began = [row.finished - (row.seconds or 0) for row in rows if row.finished is not None]
    started, completed = (_time(min(began)), _time(max(ended))) if ended else (_time(0), _time(0))
    versions = info["versions"] if isinstance(info.get("versions"), Mapping) else {}
    return {
        "version": 2,
        "status": {"running": "started", "finished": "success"}.get(info.get("status", "finished"), "cancelled"),
        "eval": {
            "eval_id": _name(part.run.name, part.id, part.model),
            "run_id": _name(part.run.name, started),
            "created": started,
            "task": part.id,
            "task_id": _name(part.run.name, part.id, part.model),  # alike, the viewer takes them for retries
            "dataset": {"name": part.id, "samples": len(samples), "sample_ids": samples, "shuffled": False},
            "model": part.model,
            "config": {"epochs": 1 + max((row.epoch for row in rows), default=0)},
            "packages": {str(name): str(version) for name, version in versions.items()},
            "metadata": {"gem": info, "run": part.run.name},
        },
        "plan": {"name": "plan", "steps": [{"solver": "gem"}]},
        "results": {
            "total_samples": len(rows),
            "completed_samples": sum(row.error is None for row in rows),
            "scores": [_score(score, rows) for score in part.scores],
        },
        "stats": {"started_at": started, "completed_at": completed, "model_usage": _usage_of_rows(part)},
    }


def _score(score: Score, rows: Sequence[Row]) -> dict[str, Any]:
    values = {"accuracy" if score.metric == "success" else "mean": score.mean, "stderr": score.stderr}
    values |= {"ci_low": score.low, "ci_high": score.high}
    metrics = {name: {"name": name, "value": value} for name, value in values.items() if value is not None}
    told = {"name": score.metric, "scorer": score.metric, "reducer": "mean", "metrics": metrics}
    return {**told, "scored_samples": score.episodes, "unscored_samples": len(rows) - score.episodes}


def _sample(part: LogPart, row: Row, episode: Episode) -> dict[str, Any]:
    messages = messages_of(episode, _image_reader(part.run))
    first_answer = next((place for place, each in enumerate(messages) if each["role"] == "assistant"), len(messages))
    asked = messages[:first_answer]
    plain = len(asked) == 1 and asked[0]["role"] == "user" and isinstance(asked[0]["content"], str)
    usage = {part.model: _usage(episode, row)} if row.tokens_in is not None or row.tokens_out is not None else {}
    sample: dict[str, Any] = {
        "id": row.row,
        "epoch": row.epoch + 1,
        "input": asked[0]["content"] if plain else asked,
        "target": "",
        "messages": messages,
        "output": _output(part.model, messages, episode),
        "scores": _scores_of_sample(part, row, episode),
        "metadata": {
            "number": row.number,
            "seed": row.seed,
            "turns": row.turns,
            "return": to_plain(row.episode_return),
            "cut_off": row.cut_off,
            "unreadable": row.unreadable,
            "env": episode.id,
            "arguments": to_plain(dict(episode.kwargs)),
            "wrappers": to_plain(episode.wrappers),
        },
        "model_usage": usage,
        "uuid": _name(part.run.name, part.id, part.model, row.key, row.epoch),
        "turn_count": row.turns,
    }
    if row.finished is not None:
        sample |= {"started_at": _time(row.finished - (row.seconds or 0)), "completed_at": _time(row.finished)}
    if row.seconds is not None:
        sample["total_time"] = row.seconds
    if episode.error is not None:
        sample["error"] = {"message": error_text(episode.error), "traceback": "", "traceback_ansi": ""}
    if row.cut_off is not None:
        sample["limit"] = _limit(row)
    return sample


def _scores_of_sample(part: LogPart, row: Row, episode: Episode) -> dict[str, Any]:
    """Return the scores of an episode; none after an error, and none of success where the task never tells."""
    if row.error is not None:
        return {}
    scores: dict[str, Any] = {}
    if row.success is not None and any(score.metric == "success" for score in part.scores):
        parsed = episode.final_info.get("parsed_action")
        answer = {"answer": parsed} if isinstance(parsed, str) else {}
        scores["success"] = {"value": "C" if row.success else "I", **answer}
    if math.isfinite(row.episode_return):
        scores["return"] = {"value": row.episode_return}
    return scores


def _limit(row: Row) -> dict[str, Any]:
    """Return what cut an episode off; its record knows what was reached, which stands for the limit."""
    kind = _LIMITS.get(str(row.cut_off), "custom")
    tokens = (row.tokens_in or 0) + (row.tokens_out or 0)
    reached = {"turn": row.turns, "context": tokens, "token": tokens, "time": row.seconds, "cost": row.cost}.get(kind)
    return {"type": kind, "limit": reached or 0, "reason": f"cut off by {row.cut_off}; 'limit' is what was reached"}


def _output(model: str, messages: Sequence[dict[str, Any]], episode: Episode) -> dict[str, Any]:
    answers = [message for message in messages if message["role"] == "assistant"]
    if not answers or not episode.transitions:
        return {"model": model, "choices": []}
    reason = _STOP_REASONS.get(str(episode.transitions[-1].action.finish_reason), "unknown")
    return {"model": model, "choices": [{"message": answers[-1], "stop_reason": reason}]}


def _usage(episode: Episode, row: Row) -> dict[str, Any]:
    """Return the tokens of an episode: those read from the server's cache apart, as inspect_ai counts them."""
    cached = _detail(episode, "prompt_tokens_details", "cached_tokens")
    reasoning = _detail(episode, "completion_tokens_details", "reasoning_tokens")
    read, written = row.tokens_in or 0, row.tokens_out or 0
    return {
        "input_tokens": read - min(cached or 0, read),
        "output_tokens": written,
        "total_tokens": read + written,
        "input_tokens_cache_read": cached,
        "reasoning_tokens": reasoning,
        "total_cost": row.cost,
    }


def _detail(episode: Episode, group: str, name: str) -> int | None:
    """Return the sum of a count that servers give in a group of details; None if none does."""
    groups = [(turn.action.usage or {}).get(group) for turn in episode.transitions]
    counts = [each.get(name) for each in groups if isinstance(each, Mapping)]
    return sum(known) if (known := [count for count in counts if type(count) is int]) else None


def _usage_of_rows(part: LogPart) -> dict[str, Any]:
    read, written = (sum(getattr(row, name) or 0 for row in part.rows) for name in ("tokens_in", "tokens_out"))
    costs = [row.cost for row in part.rows if row.cost is not None]
    told = {"input_tokens": read, "output_tokens": written, "total_tokens": read + written}
    return {part.model: {**told, "total_cost": math.fsum(costs) if costs else None}} if read or written else {}


def _summary(sample: Mapping[str, Any]) -> dict[str, Any]:
    told = {name: sample[name] for name in _SUMMARY if name in sample}
    if not isinstance(sample["input"], str):
        parts = [part for message in sample["input"] for part in as_parts(message["content"])]
        told["input"] = "\n".join(part["text"] for part in parts if part["type"] == "text")
    told["input"] = told["input"][:_LONGEST_INPUT]
    told["error"] = sample["error"]["message"] if "error" in sample else None
    told["limit"] = sample["limit"]["type"] if "limit" in sample else None
    return {**told, "completed": True, "message_count": len(sample["messages"]), "turn_count": sample["turn_count"]}


def _image_reader(run: Run) -> ImageUrl:
    def read(image: Any) -> str | None:
        name = image.get("__image__") if isinstance(image, Mapping) else None
        try:
            run.images.read(name)  # it refuses what is no name of ours, and damaged files
        except EpisodeFileError:
            return None
        content = (run.images.path / str(name)).read_bytes()
        kind = "png" if str(name).endswith(".png") else "tiff"
        return f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}"

    return read


def _name(*parts: object) -> str:
    """Return a name that is the same for the same parts, in the length of inspect_ai's own."""
    return hashlib.sha256(json.dumps(parts, default=str).encode()).hexdigest()[:22]


def _time(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")


def _json(value: Any) -> bytes:
    """Return plain JSON; halves of characters, which inspect_ai refuses, become replacement characters."""
    return json.dumps(_well_formed(value), ensure_ascii=True, allow_nan=False).encode("ascii")


def _well_formed(value: Any) -> Any:
    if isinstance(value, str):
        return value if value.isascii() else value.encode("utf-8", "replace").decode("utf-8")
    if isinstance(value, Mapping):
        return {_well_formed(str(name)): _well_formed(part) for name, part in value.items()}
    return [_well_formed(part) for part in value] if isinstance(value, list | tuple) else value
