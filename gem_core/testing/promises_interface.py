"""Promises about the interface: what calls accept and return, and how an episode ends."""

from __future__ import annotations

import inspect
import io
import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stdout
from typing import Any

import numpy as np

from gem_core.env.observations import observation_from
from gem_core.errors import ResetNeededError
from gem_core.testing.comparing import json_loss, mutable_parts, plain
from gem_core.testing.contract import promise
from gem_core.testing.findings import shown
from gem_core.testing.joint import is_joint, say, seats_of, spaces_of
from gem_core.testing.remaking import guarded
from gem_core.testing.subject import Subject

_CONCURRENCY = ("inline", "thread", "process", "async")

_IRRELEVANT_WARNINGS = (
    "No render fps was declared",  # text has no frames
    "Not able to test alternative render modes",  # an environment that was not made by id has no record
)


@promise("let the constructor take the arguments that it is given, and leave what can fail to reset.")
def construct(subject: Subject) -> Iterator[str]:
    """The environment can be made, as often as wanted."""
    subject.new()
    subject.new()
    yield from ()


@promise("mend what raises there: every text gets an observation and a reward.")
def runs(subject: Subject) -> Iterator[str]:
    """Reset and step can be called: they raise nothing, whatever is answered."""
    task = subject.new().unwrapped
    if not any(_shape_problem(subject, *call) for call in _first_calls(subject, task)):
        subject.record_scripts()
    subject.runs = True
    yield from ()


@promise(
    "return (observation, info) from reset and (observation, reward, terminated, truncated, info) from step; with "
    "several agents, a dictionary by agent of each."
)
def episode(subject: Subject) -> Iterator[str]:
    """An episode can be played: reset gives two values and each step gives five."""
    if not subject.runs:
        subject.need_episodes()
    for what, expected, result in _first_calls(subject, subject.new().unwrapped):
        problem = _shape_problem(subject, what, expected, result)
        if problem:
            yield problem
            return


def _first_calls(subject: Subject, task: Any) -> Iterator[tuple[str, int, Any]]:
    yield "reset()", 2, subject.reset(task, subject.seeds[0])
    yield "step('')", 5, subject.step(task, say(task, ""))


def _shape_problem(subject: Subject, what: str, expected: int, result: Any) -> str:
    if not isinstance(result, tuple) or len(result) != expected:
        return f"{what} returned {shown(result)}, not a tuple of {expected}"
    if not isinstance(result[-1], dict):
        return f"{what} returned the info {shown(result[-1])}, not a dictionary"
    if subject.several and not all(isinstance(part, dict) for part in result):
        return f"{what} returned {shown(result)}, not {expected} dictionaries by agent"
    if subject.several and not all(isinstance(info, dict) for info in result[-1].values()):
        return f"{what} returned the infos {shown(result[-1])}, not a dictionary for each agent"
    if subject.several and len(result) == 5 and result[2].keys() != result[3].keys():
        return f"{what} returned the terminations {shown(result[2])} and the truncations {shown(result[3])}"
    return ""


@promise(
    "return an observation of the observation space (gem_core.env.spaces.Content() for content parts), a finite float, "
    "two bools and a dictionary."
)
def types(subject: Subject) -> Iterator[str]:
    """Observations lie in the observation space, rewards are finite numbers, flags are bools and info is a dict."""
    for where, result, space in subject.results:
        for problem in problems_of(space, result):
            yield f"{where} gave {problem}"


@promise("define reset(self, seed=None, options=None), with both by position or by name.")
def reset_signature(subject: Subject) -> Iterator[str]:
    """Reset takes a seed and options, both by position and by name."""
    task = subject.new().unwrapped
    try:
        inspect.signature(task.reset).bind(0, {})
        inspect.signature(task.reset).bind(seed=0, options={})
    except TypeError as error:
        yield f"reset{inspect.signature(task.reset)} does not accept (seed, options): {error}"
        return
    subject.need_episodes()
    subject.called("reset(0)", task.reset, 0)
    subject.called("reset(0, {})", task.reset, 0, {})
    subject.called("reset(seed=0, options={})", task.reset, seed=0, options={})


@promise("give every instance spaces that are equal by value, such as gem_core.env.spaces.Text().")
def spaces(subject: Subject) -> Iterator[str]:
    """Two instances have equal spaces, and every string is an action."""
    one, other = subject.new(), subject.new()
    for seat in seats_of(one):
        of = f" of {seat!r}" if is_joint(one) else ""
        names = ("observation_space", "action_space")
        for name, first, second in zip(names, spaces_of(one, seat), spaces_of(other, seat), strict=True):
            if first != second:
                yield f"{name}{of} is {shown(first)} and, of another instance, {shown(second)}, which are not equal"
        action_space = spaces_of(one, seat)[1]
        refused = [text for text in ("", "hello", "é\n🙂\x00\ud800") if not action_space.contains(text)]
        if refused:
            yield f"the action space{of} {shown(action_space)} does not contain {shown(refused[0])}"


@promise("set terminated when the task itself is over, and truncated only when it is cut off from outside.")
def end_flags(subject: Subject) -> Iterator[str]:
    """An episode ends either because the task is over or because it was cut off, never both at once."""
    for where, result, _ in subject.results:
        if len(result) == 5 and result[2] and result[3]:
            yield f"{where} gave terminated and truncated, both True"


@promise("put only strings, finite numbers, bools, None, lists and dictionaries with string keys into info.")
def info_json(subject: Subject) -> Iterator[str]:
    """Info is plain JSON, images apart: writing and reading it gives an equal object."""
    for where, result, _ in subject.results:
        loss = json_loss(result[-1])
        if loss is not None:
            yield f"info of {where}: {loss}"


@promise("give the keys with one meaning everywhere the form that DESIGN.md names, section 3.")
def info_keys(subject: Subject) -> Iterator[str]:
    """The keys of info that mean the same everywhere have their form, and an error ends the episode as truncated."""
    over = told = False
    for where, result, _ in subject.results:
        info = result[-1]
        if not isinstance(info, Mapping):
            continue
        over, told = over or bool(len(result) == 5 and result[2]), told or "correct" in info
        for key, accepted in _FORMS.items():
            if key in info and not accepted(info[key]):
                yield f"info[{key!r}] of {where} is {shown(info[key])}"
        if info.get("error") is not None and len(result) == 5 and not result[3]:
            yield f"{where} has info['error'] and is not truncated"
    if over and not told:
        subject.notes.append(
            "info-keys: no info says 'correct', so success stays unknown and has no rate. Say it at the end, or "
            "None from reset on if no answer is right"
        )


@promise("return feedback + suffix as the observation, or leave both keys out.")
def suffix(subject: Subject) -> Iterator[str]:
    """Where info holds feedback and suffix, the observation is the first followed by the second."""
    # The task alone: a view of the history changes observations and leaves the keys.
    for where, result, _ in subject.results_of(guarded(subject.new().unwrapped)):
        observation, info = result[0], result[-1]
        if "feedback" not in info and "suffix" not in info:
            continue
        missing = [key for key in ("feedback", "suffix") if key not in info]
        if missing:
            yield f"info of {where} has no {missing[0]!r} beside the other"
        elif plain(observation_from(info["feedback"], info["suffix"])) != plain(observation):
            yield (
                f"{where}: the observation is {shown(observation)}, "
                f"feedback {shown(info['feedback'])} and suffix {shown(info['suffix'])}"
            )


@promise("build a new dictionary and a new list for every result, also for what never changes.")
def fresh_objects(subject: Subject) -> Iterator[str]:
    """Every call returns objects of its own, so that what a caller keeps is not changed by later calls."""
    seen: dict[int, tuple[str, Any]] = {}
    kept: list[tuple[str, Any, Any]] = []
    for where, result in subject.calls_of(subject.new()):
        given = list(result)
        kept.append((where, given, plain(given)))
        own: dict[int, tuple[str, Any]] = {}
        for part in mutable_parts(result):
            if id(part) in seen:
                yield f"{where} returned the same object as {seen[id(part)][0]}: {shown(part)}"
            own[id(part)] = where, part
        seen |= own
    for where, given, before in kept:
        if plain(given) != before:
            yield f"what {where} returned was changed by later calls: {shown(before)}, then {shown(plain(given))}"


@promise(
    "let the guard that gem_core.make puts around the task, or MultiAgentEnv, refuse it, and no wrapper catch that."
)
def step_after_end(subject: Subject) -> Iterator[str]:
    """A step before the first reset or after the end raises ResetNeededError, and reset begins anew."""
    env = subject.new()
    yield from _stepping(subject, env, "before the first reset")
    script = next((script for script in subject.scripts if script.ended), None)
    if script is None:
        subject.notes.append(f"step-after-end: no episode ended within {subject.limits.max_turns} turns")
        return
    for _ in subject.play(env, script):
        pass
    yield from _stepping(subject, env, "after the end")
    yield from _stepping(subject, env, "once more after the end")
    subject.reset(env, script.seed)
    subject.step_fitted(env, script.actions[0])


@promise("make close() do nothing when there is nothing left to free.")
def close_twice(subject: Subject) -> Iterator[str]:
    """Close works right after construction, in the midst of an episode, and a second time."""
    env = subject.new()
    subject.close(env)
    subject.close(env)
    env = subject.new()
    subject.reset(env, subject.scripts[0].seed)
    subject.step_fitted(env, subject.scripts[0].actions[0])
    subject.close(env)
    subject.close(env)
    yield from ()


@promise("set the class attribute concurrency to one of these.")
def concurrency(subject: Subject) -> Iterator[str]:
    """Concurrency is "inline", "thread", "process" or "async"."""
    declared = getattr(subject.new().unwrapped, "concurrency", None)
    if declared not in _CONCURRENCY:
        yield f"concurrency is {shown(declared)}"


@promise("see https://gymnasium.farama.org/api/env/ for what Gymnasium expects.", of="one")
def gymnasium(subject: Subject) -> Iterator[str]:
    """Gymnasium's own checker passes on the task without wrappers."""
    subject.need_episodes()
    from gymnasium.utils.env_checker import check_env as gymnasium_check

    task = subject.new().unwrapped
    task.action_space.seed(subject.limits.seed)
    # It renders in every mode, and "human" prints.
    with warnings.catch_warnings(record=True) as caught, redirect_stdout(io.StringIO()):
        warnings.simplefilter("always")
        try:
            subject.called("gymnasium's check_env", gymnasium_check, task)
        except Exception as error:  # noqa: BLE001 - whatever it raises is its verdict
            yield subject.told(error)
    for warning in caught:
        text = str(warning.message).replace("\x1b[33m", "").replace("\x1b[0m", "").removeprefix("WARN: ")
        if not text.startswith(_IRRELEVANT_WARNINGS):
            subject.notes.append(f"gymnasium: {text}")


def problems_of(space: Any, result: Any) -> Iterator[str]:
    """Tell what is wrong with the types of what one agent got from a reset or a step."""
    observation, *middle, info = result
    if not space.contains(observation):
        yield f"the observation {shown(observation)}, which is not in {shown(space)}"
    if not isinstance(info, dict):
        yield f"the info {shown(info)}, which is not a dictionary"
    if not middle:
        return
    reward, terminated, truncated = middle
    is_number = isinstance(reward, int | float | np.integer | np.floating) and not isinstance(reward, bool)
    if not is_number or not math.isfinite(reward):
        yield f"the reward {shown(reward)}, which is not a finite number"
    for name, flag in (("terminated", terminated), ("truncated", truncated)):
        if not isinstance(flag, bool):
            yield f"{name} = {shown(flag)}, which is a {type(flag).__module__}.{type(flag).__qualname__} and not a bool"


def _stepping(subject: Subject, env: Any, when: str) -> Iterator[str]:
    try:
        result = subject.step(env, say(env, "hello"))
    except ResetNeededError:
        return
    yield f"step('hello') {when} returned {shown(result)}"


def _is_observation(value: object) -> bool:
    return isinstance(value, str | list)


def _is_list_of_mappings(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(item, Mapping) for item in value)


def _is_error(value: object) -> bool:
    return value is None or (
        isinstance(value, Mapping) and isinstance(value.get("kind"), str) and isinstance(value.get("message"), str)
    )


_FORMS: dict[str, Callable[[Any], bool]] = {
    "seed": lambda value: isinstance(value, int) and not isinstance(value, bool),
    "task_id": lambda value: isinstance(value, str | int) and not isinstance(value, bool),
    "feedback": _is_observation,
    "suffix": _is_observation,
    "correct": lambda value: value is None or isinstance(value, bool),
    "tools": _is_list_of_mappings,
    "messages": lambda value: _is_list_of_mappings(value) and all("role" in message for message in value),
    "system": lambda value: isinstance(value, str),
    "episode": lambda value: isinstance(value, Mapping) and {"r", "l"} <= set(value),
    "error": _is_error,
}
