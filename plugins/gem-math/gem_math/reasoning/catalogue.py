"""Rows and scores of reasoning-gym, in the process that runs it."""

from __future__ import annotations

import base64
import copy
import dataclasses
import pickle
import random
from functools import lru_cache
from typing import Any

import numpy as np
import reasoning_gym

from gem_math.reasoning import mending
from gem_math.reasoning.parameters import WrongError, configuration

_MADE_BY_SEED = frozenset({"acre", "gsm_symbolic", "list_functions"})
"""Tasks that draw from their seed when the data set is made; in the others every row has its own generator."""

Spec = dict[str, Any]


def load() -> None:
    """Mend the library before it is asked."""
    mending.mend()


def guard() -> None:
    """Generators and scorers may do what they like; no answer runs as code."""


def handle(request: dict[str, Any]) -> dict[str, Any]:
    """Do what a request says.

    Args:
        request: ``do`` names it: ``check`` whether ``spec``, which is pickled, can be made; ``row`` of number ``row``
            of the data set with ``seed``; ``score`` of ``answer`` to ``entry``, which ``row`` returned.
    """
    spec: Spec = pickle.loads(request["spec"])
    parts: list[Spec] = spec.get("parts") or [spec]
    try:
        if request["do"] == "check":
            _check(spec, parts)
            return {}
        if request["do"] == "row":
            return _row(spec, parts, request["seed"], request["row"])
        place, entry = pickle.loads(base64.b64decode(request["entry"]))  # by way of its own parent
        return _score(_dataset(parts[place], None), entry, request["answer"])
    except WrongError as error:
        return {"wrong": str(error)}


def _check(spec: Spec, parts: list[Spec]) -> None:
    for part in parts:
        try:
            configuration(part)
        except WrongError as error:
            raise WrongError(f"{part['task']}: {error}" if part is not spec else str(error)) from error


def _row(spec: Spec, parts: list[Spec], seed: int, row: int) -> dict[str, Any]:
    place = 0
    if "parts" in spec:  # drawn as reasoning_gym.composite does
        weights = [part["weight"] for part in parts]
        place = random.Random(seed + row).choices(range(len(parts)), weights=weights, k=1)[0]
        seed += place + 1
    dataset = _dataset(parts[place], seed)
    mending.give_problems(dataset)
    _start_global_generators(seed + row)
    entry = dict(dataset[row])
    answer = entry["answer"]
    return {
        "question": str(entry["question"]),
        "answer": answer if answer is None else str(answer),
        "source": parts[place]["task"],
        "entry": base64.b64encode(pickle.dumps((place, entry))).decode("ascii"),
    }


def _dataset(spec: Spec, seed: int | None) -> Any:
    """Return the data set of a seed; None for whichever is there."""
    bound = spec["task"] in _MADE_BY_SEED and seed is not None
    dataset = _made(pickle.dumps(spec), seed if bound else None)
    if bound or seed is None or dataset.seed == seed:
        return dataset
    # Made anew it would read its files again.
    sibling = copy.copy(dataset)
    sibling.seed = seed
    sibling.config = dataclasses.replace(dataset.config, seed=seed)
    return sibling


@lru_cache(maxsize=300)
def _made(pickled: bytes, seed: int | None) -> Any:
    spec = pickle.loads(pickled)
    config = dataclasses.replace(configuration(spec), seed=seed or 0)
    _start_global_generators(seed or 0)
    try:
        dataset = reasoning_gym.factory.DATASETS[spec["task"]][0](config=config)
    except AssertionError as error:
        raise WrongError(f"reasoning-gym refuses the parameters {spec.get('parameters')!r}: {error}") from error
    mending.own_problems(dataset)
    return dataset


def _score(dataset: Any, entry: Any, answer: str | None) -> dict[str, Any]:
    gold = entry["answer"]
    record = pickle.dumps(entry)  # some scorers write into it
    try:
        return {"score": float(dataset.score_answer(answer, entry))}
    except Exception as error:  # noqa: BLE001 - scorers raise anything on answers that they do not expect
        failure = f"{type(error).__name__}: {error}"[:300]
    try:
        dataset.score_answer(gold if answer != gold else None, pickle.loads(record))
    except Exception:  # noqa: BLE001 - as above
        return {"raised": failure}
    return {"refused": failure}


def _start_global_generators(number: int) -> None:
    """Start what ``list_functions``, ``pool_matrix`` and some of the programs of ``codeio`` draw from."""
    # This process is the library's own, and starting them anew is three times as fast as setting their state.
    random.seed(number)  # noqa: TID251
    np.random.seed(number % 2**32)  # noqa: TID251
