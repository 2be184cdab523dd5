"""What two runs differ in, by what their ``run.json`` says."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

_MOST = 8
_LONGEST = 60


def asked_of(info: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a run plays, which is the same in all its sessions: all that scores depend on but the code.

    Args:
        info: What ``run.json`` says.
    """
    tasks, models = (_by_name(info.get(name), key) for name, key in (("tasks", "id"), ("models", "name")))
    suite, limits = info.get("suite"), info.get("limits")
    return {
        "tasks": list(tasks),
        "models": list(models),
        "epochs": info.get("epochs"),
        "seed": info.get("seed"),
        "roles": suite.get("roles") if isinstance(suite, Mapping) else None,
        "limits": {name: each for name, each in dict(limits or {}).items() if name.startswith("episode_")},
        "task": {
            label: {name: task.get(name) for name in ("env", "kwargs", "rows", "data_sha256", "rows_sha256")}
            for label, task in tasks.items()
        },
        "model": {
            label: {name: model.get(name) for name in ("agent", "options", "base_url", "perturb")}
            for label, model in models.items()
        },
    }


def code_in(info: Mapping[str, Any]) -> dict[str, dict[str, str] | None]:
    """Return the code of each task and model that ``run.json`` says, by name; None where it is not known."""
    tasks, models = _by_name(info.get("tasks"), "id"), _by_name(info.get("models"), "name")
    return {
        **{f"the task {label}": task.get("code") for label, task in tasks.items()},
        **{f"the model {label}": model.get("code") for label, model in models.items()},
    }


def differing(one: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """Return in words what differs in two nested mappings; empty for nothing."""
    first, second = (dict(_leaves(each)) for each in (one, other))
    names = [name for name in dict.fromkeys([*first, *second]) if first.get(name) != second.get(name)]
    told = [f"{name} {short(first.get(name))} and {short(second.get(name))}" for name in names[:_MOST]]
    return "; ".join(told + ([f"and {len(names) - _MOST} more"] if len(names) > _MOST else []))


def asked_differently(one: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """Return in words what two runs differ in, by what ``asked_of`` returned; empty for nothing."""
    sides = [dict(one), dict(other)]
    for kind in ("task", "model"):  # those that one side lacks are told by the lists of all
        both = [name for name in one[kind] if name in other[kind]]
        for side in sides:
            side[kind] = {name: dict(side[kind][name]) for name in both}
    for name, task in sides[0]["task"].items():
        also = sides[1]["task"][name]
        if (task["rows"], one["seed"]) != (also["rows"], other["seed"]):  # hashes of other rows say no more
            task["data_sha256"] = also["data_sha256"] = task["rows_sha256"] = also["rows_sha256"] = None
    return differing(*sides)


def short(value: Any) -> str:
    """Return a value in few characters."""
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"


def _by_name(records: Any, key: str) -> dict[str, Mapping[str, Any]]:
    given = records if isinstance(records, list) else []
    return {str(each.get(key)): each for each in given if isinstance(each, Mapping)}


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for name, part in value.items():
            yield from _leaves(part, f"{path}.{name}".strip("."))
    else:
        yield path, value
