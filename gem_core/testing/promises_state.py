"""A promise about state: a fork goes on as the first one does, and neither changes the other."""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast

from gem_core.env.base import Env
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import StateNotSupported
from gem_core.testing.comparing import differences
from gem_core.testing.contract import promise
from gem_core.testing.findings import NotTriedError, shown
from gem_core.testing.remaking import unchecked
from gem_core.testing.subject import PlainResult, Script, Subject


@promise("keep the state of an episode in self; override __deepcopy__ for what copy.deepcopy does not copy.")
def fork(subject: Subject) -> Iterator[str]:
    """A fork in the middle of an episode goes on identically, and what it plays changes nothing in the first one."""
    sampling = subject.can_sample()
    for number, (script, expected) in enumerate(subject.references):
        between = subject.scripts[number - 1]
        for steps in subject.cuts(script):
            env = subject.new()
            before = list(subject.play_from(env, script.seed, script.actions[:steps]))
            if sampling:
                subject.sample(env)
            other = _forked(subject, env)
            if other is env or type(other) is not type(env):
                yield f"fork() gave {shown(other)} for a {type(env).__name__}"
                return
            where = f"with seed {script.seed}, forked after {steps} steps"
            drawn = subject.sample(other) if sampling else None
            theirs = _play_rest(subject, other, script, steps)
            for _ in subject.play(other, between):
                pass
            if sampling and subject.sample(env) != drawn:
                yield f"{where}, the two sample different actions"
            mine = _play_rest(subject, env, script, steps)
            yield from differences(f"{where}, it differs", expected[steps + 1 :], theirs[:-1], steps + 1)
            what = f"what a fork played changed the first one: {where}, that differs"
            yield from differences(what, expected, [*before, *mine[:-1]])
            yield from differences(f"{where}, the next episode differs", mine[-1:], theirs[-1:])


def _play_rest(subject: Subject, env: AnyEnv, script: Script, steps: int) -> list[PlainResult]:
    """Play the rest of a script, and begin the next episode of the stream."""
    rest = list(subject.play_on(env, script.actions[steps:]))
    return [*rest, *subject.play_from(env, None, ())]


def _forked(subject: Subject, env: AnyEnv) -> AnyEnv:
    try:
        return subject.own(unchecked(subject.called("fork()", cast("Env", env).fork)))
    except StateNotSupported as error:
        raise NotTriedError(str(error)) from error
