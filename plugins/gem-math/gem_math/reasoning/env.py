"""``ReasoningGymEnv``: a row of a task of ReasoningGym, decided by its own scorer."""

from __future__ import annotations

import math
import pickle
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, ClassVar

from gem_core.data import chosen_index
from gem_core.env import Env
from gem_core.errors import ArgumentError, EnvFaultError
from gem_core.parsing import extract_last_boxed_answer, extract_last_tagged_answer
from gem_core.suggestions import did_you_mean
from gem_core.types import TERMINAL_STATE, Concurrency, Info, ResetResult, StepResult
from gem_math.reasoning.library import EndedError, LibraryError, ask
from gem_math.reasoning.listing import TASKS

PROMPT = "{question}\n\nWrite your final answer between <answer> and </answer>."

MOST_ROWS = 2**30
"""Rows that a data set has in all its epochs."""

LONGEST_ANSWER = 1_000_000
"""Characters; the longest right answer that was seen, of ``tower_of_hanoi`` at its highest level, has 262,126."""

_GENERATION_S = 120.0
_SAMPLED = 16
"""Rows whose answers are random actions."""
_ENTRY_KEYS = ("task", "weight", "level", "levels")


class ReasoningGymEnv(Env):
    r"""Asks a row of a task of ReasoningGym; the reward is what the task's own scorer gives the answer.

    The answer is the last ``\boxed{}``, or else the last ``<answer>``; a response with neither counts as no answer,
    which a few scorers give 0.01 for. ``info["correct"]`` says whether the score is 1.

    Row ``i`` of the first epoch is ``reasoning_gym.create_dataset(task, size=size, seed=seed)[i]``. Epoch ``e`` has the
    seed ``seed + e * size``, so that no row's own seed comes twice. ``reset`` draws a row of any epoch;
    ``reset(options={"index": i})`` takes row ``i % size`` of epoch ``i // size``.

    An answer that makes the scorer raise, or take over ``time_limit_s``, has the reward 0; ``info["reason"]`` says
    which.

    Args:
        task: Name of the task, or ``"composite"`` for a mixture.
        size: Rows of an epoch.
        seed: Of the first epoch, from 0 to 2**31 - 1.
        epochs: How many of them ``reset`` draws from; None for all.
        level: Level of the task's curriculum, from 0; attributes with fewer levels take their highest.
        levels: Level of some attributes of the curriculum, by name; over ``level``.
        prompt_template: Text of the first observation; ``{question}`` stands for the question.
        time_limit_s: Seconds of the processor's time that the scorer may take.
        **parameters: The task's own, over what the levels say. ``difficulty`` is ``level`` where a task has no
            parameter of that name. For a mixture ``datasets``: names, or pairs of a name and a mapping of ``weight``,
            ``level``, ``levels`` and parameters; without, all tasks alike.

    Raises:
        ArgumentError: A parameter, level or value that the task does not take; the message names those it does.

    Source: the tasks and scorers of reasoning-gym 0.1.25, https://github.com/open-thought/reasoning-gym.
    """

    concurrency: ClassVar[Concurrency] = "thread"
    endless_tasks = True
    return_range = (0.0, 1.0)

    def __init__(
        self,
        task: str,
        *,
        size: int = 500,
        seed: int = 42,
        epochs: int | None = None,
        level: int | None = None,
        levels: Mapping[str, int] | None = None,
        prompt_template: str = PROMPT,
        time_limit_s: float = 5.0,
        **parameters: Any,
    ) -> None:
        super().__init__()
        _check_range("size", size, 1, 10**6)
        _check_range("seed", seed, 0, 2**31 - 1)
        if epochs is not None:
            _check_range("epochs", epochs, 1, MOST_ROWS // size)
        if not isinstance(time_limit_s, int | float) or not 0 < time_limit_s < math.inf:
            raise ArgumentError(f"time_limit_s must be a positive number of seconds, not {time_limit_s!r}")
        self.task, self.size, self.seed = task, size, seed
        self.num_tasks = size
        self.prompt_template = prompt_template
        self.time_limit_s = float(time_limit_s)
        self._rows = MOST_ROWS // size * size if epochs is None else size * epochs
        spec = _specification(task, size, level, levels, parameters)
        try:
            self._spec = pickle.dumps(spec)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise ArgumentError(f"rg:{task}: parameters must be plain data ({error})") from error
        self._index = 0
        _asked(self._name, {"do": "check", "spec": self._spec})

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Ask a row.

        Args:
            seed: See ``Env.reset``.
            options: ``{"index": i}`` takes row ``i``, from 0; those of later epochs follow on those of the first.

        Raises:
            ArgumentError: An option that does not exist, or an index that is out of range.
            EnvFaultError: reasoning-gym does not come up with the row.
        """
        super().reset(seed=seed)
        self._index = chosen_index(options, MOST_ROWS) if options else int(self.np_random.integers(self._rows))
        row = self.present_row()
        return self.prompt_template.replace("{question}", row["question"]), self._about()

    def step(self, action: str) -> StepResult:
        """Score the response; the task is over."""
        answer = extract_last_boxed_answer(action)
        if answer is None:
            answer = extract_last_tagged_answer(action)
        info = self._about() | {"parsed_action": answer}
        if answer is not None and len(answer) > LONGEST_ANSWER:
            return self._refused(info, f"an answer has at most {LONGEST_ANSWER} characters")
        row = self.present_row()
        request = {"do": "score", "spec": self._spec, "entry": row["entry"], "answer": answer}
        try:
            verdict = ask(request, self.time_limit_s)
        except EndedError as error:
            return self._refused(info, f"the scorer was ended: {error}")
        except LibraryError as error:
            return self._failed(info, str(error))
        if "refused" in verdict:
            return self._refused(info, f"the scorer raised {verdict['refused']}")
        if "score" not in verdict:
            return self._failed(info, f"the scorer raises on any answer: {verdict.get('raised', verdict)}")
        score = float(verdict["score"])
        score = min(max(score, 0.0), 1.0) if score == score else 0.0
        info |= {"correct": score == 1.0}
        return TERMINAL_STATE, score, True, False, info

    def sample_random_action(self) -> str:
        """Return the answer of another row, which is rarely right; an empty one for tasks without answers."""
        other = int(self.action_random.integers(min(self.size, _SAMPLED)))
        return _response(_row(self._name, self._spec, self.seed, other)["answer"] or "")

    def gold_action(self) -> str | None:
        """Return the row's own answer as a response; None for tasks that bring none."""
        answer = self.present_row()["answer"]
        return None if answer is None else _response(answer)

    @property
    def _name(self) -> str:
        return self.env_id or f"rg:{self.task}"

    def _refused(self, info: Info, reason: str) -> StepResult:
        return TERMINAL_STATE, 0.0, True, False, info | {"correct": False, "reason": reason}

    def _failed(self, info: Info, message: str) -> StepResult:
        return TERMINAL_STATE, 0.0, False, True, info | {"error": {"kind": "grading", "message": message}}

    def _about(self) -> Info:
        epoch, row = divmod(self._index, self.size)
        info: Info = {"task_id": f"{self.seed + epoch * self.size}-{row}", "index": self._index, "epoch": epoch}
        return info | {"source": self.present_row()["source"]}

    def present_row(self) -> dict[str, Any]:
        """Return the row that is asked: question, answer, and what the library keeps beside them."""
        epoch, row = divmod(self._index, self.size)
        return _row(self._name, self._spec, self.seed + epoch * self.size, row)


@lru_cache(maxsize=512)  # the members of a group start from the same row
def _row(name: str, spec: bytes, seed: int, row: int) -> dict[str, Any]:
    return _asked(name, {"do": "row", "spec": spec, "seed": seed, "row": row})


def _asked(name: str, request: dict[str, Any]) -> dict[str, Any]:
    try:
        answer = ask(request, _GENERATION_S)
    except EndedError as error:
        raise EnvFaultError(f"{name}: no row was made with these parameters: {error}; give it easier ones") from error
    if "wrong" in answer:
        raise ArgumentError(f"{name}: {answer['wrong']}")
    if "raised" in answer:
        raise EnvFaultError(f"{name}: reasoning-gym raised {answer['raised']}; give it other parameters")
    return answer


def _response(answer: str) -> str:
    """Return a response that gives an answer, which stays as it is."""
    plain = not set(answer) & set("{}\\\n") and answer == answer.strip()
    return f"\\boxed{{{answer}}}" if plain else f"<answer>{answer}</answer>"


def _check_range(name: str, value: Any, least: int, most: int) -> None:
    if type(value) is not int or not least <= value <= most:
        raise ArgumentError(f"{name} must be a whole number from {least} to {most}, not {value!r}")


def _specification(
    task: str, size: int, level: Any, levels: Mapping[str, Any] | None, parameters: Mapping[str, Any]
) -> dict[str, Any]:
    """Return what reasoning-gym is asked for."""
    if task != "composite":
        return _part(task, size, {"level": level, "levels": levels, **parameters})
    entries = parameters.get("datasets")
    wrong = [name for name in parameters if name != "datasets"]
    if wrong or level is not None or levels:
        raise ArgumentError(
            f"rg:composite has no {wrong[0] if wrong else 'level'!r} of its own; give it to the tasks, as in "
            'datasets=[("leg_counting", {"level": 2})]'
        )
    if entries is None:
        entries = list(TASKS)
    if isinstance(entries, str | Mapping) or not hasattr(entries, "__iter__") or not list(entries):
        raise ArgumentError(f"datasets must be a list of names, or of names with their options, not {entries!r:.100}")
    return {"task": task, "parts": [_mixed(entry, size) for entry in entries]}


def _mixed(entry: Any, size: int) -> dict[str, Any]:
    """Return the part of a mixture that an entry of ``datasets`` describes."""
    name, options = entry, {}
    if isinstance(entry, Mapping):  # as in reasoning-gym's own configuration
        options = {key: value for key, value in entry.items() if key not in ("name", "config")}
        name, options = entry.get("name"), options | dict(entry.get("config") or {})
    elif isinstance(entry, list | tuple) and len(entry) == 2:
        name, options = entry[0], dict(entry[1])
    wrong = [key for key in ("size", "seed") if key in options]
    if wrong:
        raise ArgumentError(f"{wrong[0]!r} is set for the whole of rg:composite, not for {name!r}")
    weight = options.pop("weight", 1.0)
    if isinstance(weight, bool) or not isinstance(weight, int | float) or not 0 < weight < math.inf:
        raise ArgumentError(f"the weight of {name!r} must be a positive number, not {weight!r}")
    return _part(name, size, options) | {"weight": float(weight)}


def _part(task: Any, size: int, options: Mapping[str, Any]) -> dict[str, Any]:
    name = str(task).removeprefix("rg:")
    if name not in TASKS:
        raise ArgumentError(f"reasoning-gym has no task {task!r}.{did_you_mean(name, TASKS)} See 'gem list rg'")
    parameters = {key: value for key, value in options.items() if key not in _ENTRY_KEYS}
    levels = options.get("levels")
    if levels is not None and not isinstance(levels, Mapping):
        raise ArgumentError(f"levels must map names of attributes to levels, not {levels!r:.100}")
    return {
        "task": name,
        "size": size,
        "level": options.get("level"),
        "levels": dict(levels or {}),
        "parameters": parameters,
    }
