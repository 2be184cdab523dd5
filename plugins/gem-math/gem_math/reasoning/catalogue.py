"""``Catalogue``: rows and scores of reasoning-gym, in the process that runs it."""

from __future__ import annotations

import base64
import copy
import dataclasses
import json
import pickle
import random
from collections import OrderedDict
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any

import numpy as np
import reasoning_gym

from gem_math.reasoning import mending
from gem_math.reasoning.answers import example
from gem_math.reasoning.parameters import WrongError, configuration

_MADE_BY_SEED = frozenset({"acre", "gsm_symbolic", "list_functions"})
"""Tasks that draw from their seed when the data set is made; in the others every row has its own generator."""

_MOST_DATASETS = 300
_MOST_SAMPLES = 16


def load() -> Callable[[dict[str, Any]], dict[str, Any]]:
    """Return what answers requests in a process of the pool."""
    return Catalogue().handle


def library_version() -> str:
    """Return the version of reasoning-gym."""
    return version(reasoning_gym.__name__)


class Catalogue:
    """Data sets by what they were asked for."""

    def __init__(self) -> None:
        mending.mend()
        self._datasets: OrderedDict[str, Any] = OrderedDict()
        self._samples: OrderedDict[str, list[str | None]] = OrderedDict()

    def handle(self, request: dict[str, Any]) -> dict[str, Any]:
        """Do what a request says.

        Args:
            request: ``do`` names it: ``check`` whether ``spec`` can be made; ``row`` of number ``row`` of the data set
                with ``seed``; ``score`` of ``answer`` to ``entry``, which ``row`` returned; ``sample``, an answer that
                is well-formed.
        """
        spec = request["spec"]
        try:
            if request["do"] == "check":
                self._check(spec)
                return {}
            if request["do"] == "row":
                return self._row(spec, request["seed"], request["row"])
            if request["do"] == "score":
                return self._score(spec, *_unpacked(request["entry"]), request["answer"])
            return {"sample": self._sample(spec, *_unpacked(request["entry"]), request["seed"], request["draw"])}
        except WrongError as error:
            return {"wrong": str(error)}

    def _check(self, spec: Mapping[str, Any]) -> None:
        for part in spec.get("parts") or [spec]:
            try:
                configuration(part)
            except WrongError as error:
                raise WrongError(f"{part['task']}: {error}" if part is not spec else str(error)) from error

    def _row(self, spec: Mapping[str, Any], seed: int, row: int) -> dict[str, Any]:
        place, part, own_seed = _part(spec, seed, row)
        entry = self._entry(part, own_seed, row)
        answer = entry["answer"]
        return {
            "question": str(entry["question"]),
            "answer": answer if answer is None else str(answer),
            "source": part["task"],
            "entry": base64.b64encode(pickle.dumps((place, entry))).decode("ascii"),
        }

    def _entry(self, part: Mapping[str, Any], seed: int, row: int) -> dict[str, Any]:
        dataset = self._dataset(part, seed)
        mending.give_problems(dataset)
        _start_global_generators(seed + row)
        return dict(dataset[row])

    def _dataset(self, spec: Mapping[str, Any], seed: int | None) -> Any:
        """Return the data set of a seed; None for whichever is there."""
        key = json.dumps(spec, sort_keys=True)
        bound = spec["task"] in _MADE_BY_SEED and seed is not None
        if bound:
            key = f"{key} {seed}"
        dataset = self._datasets.get(key)
        if dataset is None:
            dataset = self._made(spec, seed or 0)
            self._datasets[key] = dataset
            if len(self._datasets) > _MOST_DATASETS:
                self._datasets.popitem(last=False)
        else:
            self._datasets.move_to_end(key)
        if bound or seed is None or dataset.seed == seed:
            return dataset
        # Made anew it would read its files again.
        sibling = copy.copy(dataset)
        sibling.seed = seed
        sibling.config = dataclasses.replace(dataset.config, seed=seed)
        return sibling

    def _made(self, spec: Mapping[str, Any], seed: int) -> Any:
        config = dataclasses.replace(configuration(spec), seed=seed)
        _start_global_generators(seed)
        try:
            dataset = reasoning_gym.factory.DATASETS[spec["task"]][0](config=config)
        except AssertionError as error:
            raise WrongError(f"reasoning-gym refuses the parameters {spec.get('parameters')!r}: {error}") from error
        mending.own_problems(dataset)
        return dataset

    def _score(self, spec: Mapping[str, Any], place: int, entry: Any, answer: str | None) -> dict[str, Any]:
        dataset = self._dataset(_parts(spec)[place], None)
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

    def _sample(self, spec: Mapping[str, Any], place: int, entry: Any, seed: int, draw: int) -> str:
        part = _parts(spec)[place]
        if entry["answer"] is None:
            return example(part["task"], entry, random.Random(draw))
        key = f"{json.dumps(part, sort_keys=True)} {seed}"
        if key not in self._samples:
            self._samples[key] = [None] * min(_MOST_SAMPLES, part["size"])
            if len(self._samples) > _MOST_DATASETS:
                self._samples.popitem(last=False)
        known = self._samples[key]
        row = draw % len(known)
        answer = known[row]
        if answer is None:
            answer = known[row] = str(self._entry(part, seed, row)["answer"])
        return answer


def _unpacked(entry: str) -> tuple[int, Any]:
    """Return the place among the parts and the entry; the bytes come from this program, by way of its own parent."""
    place, row = pickle.loads(base64.b64decode(entry))
    return place, row


def _parts(spec: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return list(spec.get("parts") or [spec])


def _part(spec: Mapping[str, Any], seed: int, row: int) -> tuple[int, Mapping[str, Any], int]:
    """Return which part of a mixture a row is of, as ``reasoning_gym.composite`` draws it, and its seed there."""
    parts = spec.get("parts")
    if not parts:
        return 0, spec, seed
    weights = [part["weight"] for part in parts]
    place = random.Random(seed + row).choices(range(len(parts)), weights=weights, k=1)[0]
    return place, parts[place], seed + place + 1


def _start_global_generators(number: int) -> None:
    """Start what ``list_functions``, ``pool_matrix`` and some of the programs of ``codeio`` draw from."""
    # This process is the library's own, and starting them anew is three times as fast as setting their state.
    random.seed(number)  # noqa: TID251
    np.random.seed(number % 2**32)  # noqa: TID251
