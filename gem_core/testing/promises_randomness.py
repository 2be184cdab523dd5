"""Promises about randomness: the same seed and actions give the same episode, whatever happens around it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from itertools import zip_longest
from typing import Any, cast

from gem_core.background import run_sync
from gem_core.env.wrapper import AnyEnv, reset_async, step_async
from gem_core.errors import NotSupportedError
from gem_core.testing.comparing import differences, play
from gem_core.testing.contract import promise
from gem_core.testing.findings import NotTriedError, shown
from gem_core.testing.interpreter import CallError
from gem_core.testing.isolation import global_random_state, scramble
from gem_core.testing.joint import fitted, step_label
from gem_core.testing.subject import PlainResult, Script, Subject
from gem_core.types import Action

_FROM_NP_RANDOM = "draw only from self.np_random, and make everything of an episode anew in reset."


@promise(_FROM_NP_RANDOM)
def determinism(subject: Subject) -> Iterator[str]:
    """The same seed and actions give the same episode, in a new and in a used instance, whatever the global state."""
    subject.expect_determinism()
    references: list[list[PlainResult]] = []
    seen: list[str] = []
    used = subject.new()
    for script in subject.scripts:
        scramble(1)
        expected = list(subject.play(subject.new(), script))
        for number, kind in enumerate(("a new", "a used"), 2):
            scramble(number)
            env = subject.new() if kind == "a new" else used
            found = subject.play(env, script)
            seen += differences(f"with seed {script.seed}, {kind} instance differs", expected, list(found))
        references.append(expected)
    # The used one has now played other episodes before this one.
    first = subject.scripts[0]
    what = f"with seed {first.seed}, an instance that played other episodes differs"
    seen += differences(what, references[0], list(subject.play(used, first)))
    if not seen:
        subject.recorded = references
    yield from seen


@promise("keep the state of an episode in self, never in the class or the module.")
def interleaving(subject: Subject) -> Iterator[str]:
    """Other instances that play at the same time change nothing."""
    references = subject.references
    players = [subject.play(subject.new(), script) for script, _ in references]
    rounds = list(zip_longest(*players))
    for (script, expected), found in zip(references, zip(*rounds, strict=True), strict=True):
        what = f"with seed {script.seed}, beside {len(players) - 1} others, it differs"
        yield from differences(what, expected, [record for record in found if record is not None])


@promise("derive from AsyncEnv to write coroutines, and otherwise leave reset_async and step_async alone.")
def coroutines(subject: Subject) -> Iterator[str]:
    """Coroutines give what plain calls give."""
    env = subject.new()

    def reset_in_loop(seed: int) -> Any:
        return subject.called("reset_async()", run_sync, reset_async(env, seed))

    def step_in_loop(action: Any) -> Any:
        label = step_label(action).replace("step", "step_async", 1)
        return subject.called(label, run_sync, step_async(env, cast("str", fitted(env, action))))

    for script, expected in subject.references:
        found = list(play(partial(reset_in_loop, script.seed), step_in_loop, script.actions))
        yield from differences(f"with seed {script.seed}, reset_async and step_async differ", expected, found)


@promise("do not depend on hash(), the order of a set, the process id or the environment's variables.")
def process_determinism(subject: Subject) -> Iterator[str]:
    """Another process, in which strings hash differently, plays the same episode."""
    for script, expected in subject.references:
        try:
            with subject.elsewhere() as env:
                found = [env.reset(script.seed), *env.play(script.actions)]
        except CallError as error:
            yield f"with seed {script.seed}, {error}"
            return
        yield from differences(f"with seed {script.seed}, the other process differs", expected, found)


@promise("draw from self.np_random; fence in a library that insists on global state, and put its state back.")
def global_random(subject: Subject) -> Iterator[str]:
    """The global random state is left untouched by every call."""
    made: list[AnyEnv] = []
    yield from _touching("the constructor", lambda: made.append(subject.new()))
    env = made[0]
    over = False

    def step(action: Action) -> None:
        nonlocal over
        result = subject.step_fitted(env, action)
        over = bool(result[2] or result[3])

    for script in (subject.scripts[0], subject.scripts[-1]):
        yield from _touching("reset()", partial(subject.reset, env, script.seed))
        for action in script.actions:
            yield from _touching("sample_random_action()", partial(subject.sample, env))
            yield from _touching("get_state()", partial(subject.saved, env))
            yield from _touching(step_label(action), partial(step, action))
            if over:
                break
    yield from _touching("close()", partial(subject.close, env))


@promise("call super().reset(seed=seed) first, and decide each episode only by what it then draws from self.np_random.")
def seed_stream(subject: Subject) -> Iterator[str]:
    """reset(seed) starts a stream, reset() draws its next episode, and info["seed"] replays each alone."""
    script, later = subject.scripts[0], subject.scripts[-1].actions
    env = subject.new()
    streams = [_stream(subject, env, script, later), _stream(subject, env, script, later)]
    seeds, again = ([episode[0]["info"].get("seed") for episode in stream] for stream in streams)
    if seeds[0] != script.seed:
        yield f"info['seed'] after reset(seed={script.seed}) is {shown(seeds[0])}"
        return
    if seeds != again or len(set(map(str, seeds))) < len(seeds):
        yield f"the stream of seed {script.seed} has the episodes {seeds}, and a second time {again}"
        return
    unseeded = [subject.reset(subject.new())[1].get("seed") for _ in range(2)]
    if unseeded[0] == unseeded[1]:
        yield f"two new instances that were reset without a seed both began with {unseeded[0]}"
    if not subject.references:
        return
    for number, (seed, first, second) in enumerate(zip(seeds, *streams, strict=True), 1):
        yield from differences(f"episode {number} of the stream differs from itself", first, second)
        replayed = subject.play_from(subject.new(), seed, script.actions if number == 1 else later)
        what = f"reset(seed={seed}) does not replay episode {number} of the stream: it differs"
        yield from differences(what, first, list(replayed))


@promise("draw sampled actions from self.action_random, and change nothing else.")
def action_sampling(subject: Subject) -> Iterator[str]:
    """Sampling actions changes nothing of the episode, and the same seed samples the same actions."""
    subject.need_episodes()
    if not subject.can_sample():
        raise NotTriedError("it gives no random actions; see 'valid-sample'")
    samples: list[list[Action]] = []
    for script, expected in [subject.references[0], *subject.references]:
        env = subject.new()
        found: list[PlainResult] = []
        drawn: list[Action] = []
        for index, record in enumerate(subject.play(env, script)):
            found.append(record)
            if index < len(script.actions):
                drawn += [subject.sample(env) for _ in range(index % 3 + 1)]
        what = f"with seed {script.seed}, the episode in which actions are sampled differs"
        yield from differences(what, expected, found)
        samples.append(drawn)
    if samples[0] != samples[1]:
        seed = subject.scripts[0].seed
        yield f"seed {seed} sampled {shown(samples[0][:5])}, and a second time {shown(samples[1][:5])}"


def _stream(subject: Subject, env: AnyEnv, script: Script, later: tuple[Action, ...]) -> list[list[PlainResult]]:
    """Play an episode from a seed and the two that follow it in its stream."""
    return [list(subject.play(env, script)), *(list(subject.play_from(env, None, later)) for _ in range(2))]


def _touching(label: str, call: Callable[[], object]) -> Iterator[str]:
    before = global_random_state()
    with suppress(NotSupportedError, NotTriedError):
        call()
    after = global_random_state()
    names = [name for name in before if before[name] != after[name]]
    if names:
        yield f"{label} changed the state of {' and '.join(names)}"
