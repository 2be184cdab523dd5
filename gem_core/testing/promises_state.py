"""Promises about state: what is saved restores the episode elsewhere, and siblings are independent."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator, Mapping
from typing import Any, cast

from gem_core.env.base import Env
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import StateNotSupported
from gem_core.testing.comparing import difference, differences, json_loss, plain
from gem_core.testing.contract import promise
from gem_core.testing.findings import NotTriedError, shown
from gem_core.testing.remaking import unchecked
from gem_core.testing.subject import PlainResult, Script, Subject


@promise("return copies of strings, numbers, lists and dictionaries with string keys from _get_state.")
def state_json(subject: Subject) -> Iterator[str]:
    """A state is plain data that JSON keeps exactly, and that later steps leave as it is."""
    for script in subject.scripts:
        env = subject.new()
        kept: list[tuple[Mapping[str, Any], object]] = []
        for _ in subject.play(env, script):
            state = subject.saved(env)
            loss = json_loss(state)
            if loss is not None:
                yield f"in the state after {len(kept)} steps, {loss}"
            kept.append((state, copy.deepcopy(plain(state))))
        for steps, (state, before) in enumerate(kept):
            where = difference(before, plain(state))
            if where is not None:
                yield f"the state after {steps} steps was changed by later ones, at{where}"


@promise("put all that decides the rest of the episode into _get_state, and copy it in _set_state.")
def state_instance(subject: Subject) -> Iterator[str]:
    """Another instance goes on from a saved state as the first one does, as often as wanted."""
    subject.need_episodes()
    sampling = subject.can_sample()
    for script, expected in subject.references:
        for steps in subject.cuts(script):
            original = subject.new()
            _advance(subject, original, script, steps)
            if sampling:
                subject.sample(original)
            state = _through_json(subject.saved(original))
            samples = [subject.sample(original)] if sampling else []
            mine = _play_rest(subject, original, script, steps)
            busy = subject.new()
            subject.reset(busy, script.seed + 1)
            for kind, other in (("new", subject.new()), ("busy", busy), ("third", subject.new())):
                subject.called("set_state(state)", cast("Env", other).set_state, state)
                samples += [subject.sample(other)] if sampling else []
                theirs = _play_rest(subject, other, script, steps)
                what = f"with seed {script.seed}, restored after {steps} steps, a {kind} one differs"
                yield from differences(what, mine, theirs, steps + 1)
                yield from differences(what, expected[steps + 1 :], theirs[: len(expected) - steps - 1], steps + 1)
            if any(sample != samples[0] for sample in samples):
                yield f"with seed {script.seed}, after {steps} steps, restored ones sample other actions: {samples}"


@promise("let spawn call the constructor with the same arguments, and share nothing that changes.")
def spawn(subject: Subject) -> Iterator[str]:
    """Spawn gives an independent sibling that plays the same episodes, and with same_state goes on from here."""
    env = subject.new()
    try:
        sibling = _spawn(subject, env)
    except StateNotSupported as error:
        raise NotTriedError(str(error)) from error
    if sibling is env or type(sibling) is not type(env):
        yield f"spawn() gave {shown(sibling)} for a {type(env).__name__}"
        return
    if cast("Env", sibling).env_id != cast("Env", env).env_id:
        yield f"the sibling's env_id is {shown(cast('Env', sibling).env_id)}, not {shown(cast('Env', env).env_id)}"
    for number, (script, expected) in enumerate(subject.references):
        yield from _sibling_problems(subject, script, expected, between=subject.scripts[number - 1])


def _sibling_problems(subject: Subject, script: Script, expected: list[PlainResult], between: Script) -> Iterator[str]:
    """Spawn in the middle of a script, and let the sibling play ``between`` before the first one goes on."""
    steps = len(script.actions) // 2
    env = subject.new()
    before = _advance(subject, env, script, steps)
    sibling = _spawn(subject, env)
    try:
        twin = _spawn(subject, env, same_state=True)
    except StateNotSupported:
        twin = None
    seed = script.seed
    yield from differences(f"with seed {seed}, the sibling differs", expected, list(subject.play(sibling, script)))
    for _ in subject.play(sibling, between):
        pass
    found = [*before, *subject.play_on(env, script.actions[steps:])]
    what = f"what a sibling played changed the first one: with seed {seed}, it differs"
    yield from differences(what, expected, found)
    if twin is not None:
        what = f"with seed {seed}, spawn(same_state=True) after {steps} steps differs"
        found = list(subject.play_on(twin, script.actions[steps:]))
        yield from differences(what, expected[steps + 1 :], found, steps + 1)


def _advance(subject: Subject, env: AnyEnv, script: Script, steps: int) -> list[PlainResult]:
    """Play the first ``steps`` actions of a script."""
    return list(subject.play_from(env, script.seed, script.actions[:steps]))


def _play_rest(subject: Subject, env: AnyEnv, script: Script, steps: int) -> list[PlainResult]:
    """Play the rest of a script, and begin the next episode of the stream."""
    rest = list(subject.play_on(env, script.actions[steps:]))
    return [*rest, *subject.play_from(env, None, ())]


def _through_json(state: Mapping[str, Any]) -> Mapping[str, Any]:
    """Send a state through JSON; one that JSON cannot keep is copied, since ``state-json`` names that."""
    return copy.deepcopy(state) if json_loss(state) else cast("Mapping[str, Any]", json.loads(json.dumps(state)))


def _spawn(subject: Subject, env: AnyEnv, **options: bool) -> AnyEnv:
    return subject.own(unchecked(subject.called("spawn()", cast("Env", env).spawn, **options)))
