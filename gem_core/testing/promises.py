"""What every environment promises: results, ends of episodes, randomness, and answers to any text.

The order is that in which they are tried: later ones use what earlier ones found.
"""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stdout, suppress
from functools import partial
from itertools import zip_longest
from typing import Any, cast

import numpy as np

from gem_core.env.base import Env
from gem_core.env.observations import observation_from
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import NotSupportedError, ResetNeededError, SamplingNotSupported, StateNotSupported
from gem_core.testing.comparing import differences, json_loss, plain
from gem_core.testing.contract import promise
from gem_core.testing.findings import NotTriedError, shown
from gem_core.testing.hostile import hostile_actions
from gem_core.testing.isolation import global_random_state, scramble
from gem_core.testing.joint import (
    approach,
    guarded,
    is_joint,
    responses,
    say,
    say_as,
    seats_of,
    spaces_of,
    split,
    step_label,
    unchecked,
)
from gem_core.testing.subject import PlainResult, Script, Subject
from gem_core.types import Action

# Episodes and their results.


@promise("let the constructor take the arguments that it is given, and leave what can fail to reset.")
def construct(subject: Subject) -> Iterator[str]:
    """The environment can be made, as often as wanted."""
    subject.new()
    subject.new()
    yield from ()


@promise(
    "define reset(self, seed=None, options=None), return (observation, info) from it and (observation, reward, "
    "terminated, truncated, info) from step, with several agents a dictionary by agent of each, and raise nothing."
)
def episode(subject: Subject) -> Iterator[str]:
    """An episode can be played: reset gives two values and each step gives five, whatever is answered."""
    task = subject.new().unwrapped
    for what, expected in (("reset()", 2), ("step('')", 5)):
        result = subject.reset(task, subject.seeds[0]) if expected == 2 else subject.step(task, say(task, ""))
        infos = result[-1] if isinstance(result, tuple) and result else None
        if not isinstance(infos, dict) or len(result) != expected:
            yield f"{what} returned {shown(result)}, not a tuple of {expected} that ends with a dictionary"
            return
        if subject.several and not all(isinstance(part, dict) for part in (*result, *infos.values())):
            yield f"{what} returned {shown(result)}, not {expected} dictionaries by agent, of infos the last"
            return
        if subject.several and expected == 5 and result[2].keys() != result[3].keys():
            yield f"{what} returned the terminations {shown(result[2])} and the truncations {shown(result[3])}"
            return
    subject.record_scripts()
    subject.called("reset(seed=0, options={})", task.reset, seed=0, options={})


@promise(
    "return an observation of the observation space (gem_core.env.spaces.Content() for content parts), a finite float, "
    "two bools of which one is False, and a dictionary."
)
def types(subject: Subject) -> Iterator[str]:
    """Observations lie in their space, rewards are finite, flags are bools and never both set, info is a dict."""
    for where, result, space in subject.results:
        for problem in problems_of(space, result):
            yield f"{where} gave {problem}"


def problems_of(space: Any, result: Any) -> Iterator[str]:
    """Tell what is wrong with the types of what one agent got from a reset or a step."""
    observation, *middle, info = result
    if not space.contains(observation):
        yield f"the observation {shown(observation)}, which is not in {shown(space)}"
    if not isinstance(info, dict):
        yield f"the info {shown(info)}, which is not a dictionary"
    if not middle:
        return
    reward, *flags = middle
    is_number = isinstance(reward, int | float | np.integer | np.floating) and not isinstance(reward, bool)
    if not is_number or not math.isfinite(reward):
        yield f"the reward {shown(reward)}, which is not a finite number"
    for name, flag in zip(("terminated", "truncated"), flags, strict=True):
        if not isinstance(flag, bool):
            yield f"{name} = {shown(flag)}, which is a {type(flag).__module__}.{type(flag).__qualname__} and not a bool"
    if all(flags):
        yield "terminated and truncated, both True"


@promise("give every instance spaces that are equal by value, such as gem_core.env.spaces.Text().")
def spaces(subject: Subject) -> Iterator[str]:
    """Two instances have equal spaces, and every string is an action."""
    one, other = subject.new(), subject.new()
    for seat in seats_of(one):
        of = f" of {seat!r}" if is_joint(one) else ""
        for first, second in zip(spaces_of(one, seat), spaces_of(other, seat), strict=True):
            if first != second:
                yield f"a space{of} is {shown(first)} and, of another instance, {shown(second)}, which are not equal"
        action_space = spaces_of(one, seat)[1]
        for text in ("", "hello", "é\n🙂\x00\ud800"):
            if not action_space.contains(text):
                yield f"the action space{of} {shown(action_space)} does not contain {shown(text)}"


@promise("put only strings, finite numbers, bools, None, lists and dictionaries with string keys into info.")
def info_json(subject: Subject) -> Iterator[str]:
    """Info is plain JSON, images apart: writing and reading it gives an equal object."""
    for where, result, _ in subject.results:
        loss = json_loss(result[-1])
        if loss is not None:
            yield f"info of {where}: {loss}"


def _is_error(value: object) -> bool:
    return value is None or (isinstance(value, Mapping) and {str} == {type(value.get(key)) for key in _OF_ERRORS})


def _are_mappings(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(item, Mapping) for item in value)


_OF_ERRORS = ("kind", "message")
_FORMS: dict[str, Callable[[Any], bool]] = {
    "seed": lambda value: isinstance(value, int) and not isinstance(value, bool),
    "task_id": lambda value: isinstance(value, str | int) and not isinstance(value, bool),
    "feedback": lambda value: isinstance(value, str | list),
    "suffix": lambda value: isinstance(value, str | list),
    "correct": lambda value: value is None or isinstance(value, bool),
    "tools": _are_mappings,
    "messages": lambda value: _are_mappings(value) and all("role" in message for message in value),
    "system": lambda value: isinstance(value, str),
    "episode": lambda value: isinstance(value, Mapping) and {"r", "l"} <= set(value),
    "error": _is_error,
}


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
        given = [result[-1][key] for key in ("feedback", "suffix") if key in result[-1]]
        if len(given) == 1:
            yield f"info of {where} has only one of 'feedback' and 'suffix'"
        elif given and plain(observation_from(*given)) != plain(result[0]):
            yield f"{where}: the observation is {shown(result[0])}, feedback and suffix are {shown(given)}"


@promise("build a new dictionary and a new list for every result.")
def fresh_objects(subject: Subject) -> Iterator[str]:
    """What a call returned is not changed by later calls."""
    kept = [(where, list(result), plain(result)) for where, result in subject.calls_of(subject.new())]
    for where, result, before in kept:
        if plain(result) != before:
            yield f"what {where} returned was changed by later calls: {shown(before)}, then {shown(plain(result))}"


# Ends.


@promise(
    "let the guard that gem_core.make puts around the task, or MultiAgentEnv, refuse it, and no wrapper catch that."
)
def step_after_end(subject: Subject) -> Iterator[str]:
    """A step before the first reset or after the end raises ResetNeededError, and reset begins anew."""
    env = subject.new()
    script = next((script for script in subject.scripts if script.ended), None)
    for when in ("before the first reset", "after the end", "once more after the end"):
        if when == "after the end":
            if script is None:
                subject.notes.append(f"step-after-end: no episode ended within {subject.limits.max_turns} turns")
                return
            for _ in subject.play(env, script):
                pass
        with suppress(ResetNeededError):
            yield f"step('hello') {when} returned {shown(subject.step(env, say(env, 'hello')))}"
    if script is not None:
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
    if declared not in ("inline", "thread", "process", "async"):
        yield f"concurrency is {shown(declared)}"


@promise("see https://gymnasium.farama.org/api/env/ for what Gymnasium expects.", of="one")
def gymnasium(subject: Subject) -> Iterator[str]:
    """Gymnasium's own checker passes on the task without wrappers."""
    subject.need_episodes()
    from gymnasium.utils.env_checker import check_env as gymnasium_check

    task = subject.new().unwrapped
    task.action_space.seed(subject.limits.seed)
    # It renders in every mode, and "human" prints; it warns of what text does not have.
    with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        try:
            subject.called("gymnasium's check_env", gymnasium_check, task)
        except Exception as error:  # noqa: BLE001 - whatever it raises is its verdict
            yield subject.told(error)


# Randomness.


@promise("draw only from self.np_random, and make everything of an episode anew in reset.")
def determinism(subject: Subject) -> Iterator[str]:
    """The same seed and actions give the same episode, in a new and in a used instance, whatever the global state."""
    subject.expect_determinism()
    references: list[list[PlainResult]] = []
    seen: list[str] = []
    used = subject.new()
    for script in subject.scripts:
        scramble(1)
        expected = list(subject.play(subject.new(), script))
        for number, (kind, env) in enumerate((("a new", subject.new()), ("a used", used)), 2):
            scramble(number)
            found = list(subject.play(env, script))
            seen += differences(f"with seed {script.seed}, {kind} instance differs", expected, found)
        references.append(expected)
    # The used one has now played other episodes before this one.
    first = subject.scripts[0]
    what = f"with seed {first.seed}, an instance that played other episodes differs"
    seen += differences(what, references[0], list(subject.play(used, first)))
    if not seen:
        subject.recorded = references
    yield from seen


@promise("do not depend on hash(), the order of a set, the process id or the environment's variables.")
def process_determinism(subject: Subject) -> Iterator[str]:
    """Another process, in which strings hash differently, plays the same episode."""
    yield from subject.elsewhere(_repeats) if subject.references else ()


def _repeats(subject: Subject) -> Iterator[str]:
    for script, expected in subject.references:
        yield from differences(
            f"with seed {script.seed}, it differs", expected, list(subject.play(subject.new(), script))
        )


@promise("keep the state of an episode in self, never in the class or the module.")
def interleaving(subject: Subject) -> Iterator[str]:
    """Other instances that play at the same time change nothing."""
    references = subject.references
    players = [subject.play(subject.new(), script) for script, _ in references]
    rounds = list(zip_longest(*players))
    for (script, expected), found in zip(references, zip(*rounds, strict=True), strict=True):
        what = f"with seed {script.seed}, beside {len(players) - 1} others, it differs"
        yield from differences(what, expected, [record for record in found if record is not None])


@promise("draw from self.np_random; fence in a library that insists on global state, and put its state back.")
def global_random(subject: Subject) -> Iterator[str]:
    """The global random state is left untouched by every call."""
    script = subject.scripts[0]
    before = global_random_state()
    env = subject.new()
    calls: list[tuple[str, Callable[[], object]]] = [("the constructor", lambda: None)]
    calls.append(("reset()", partial(subject.reset, env, script.seed)))
    for action in script.actions:
        calls.append(("sample_random_action()", partial(subject.sample, env)))
        calls.append((step_label(action), partial(subject.step_fitted, env, action)))
    calls.append(("close()", partial(subject.close, env)))
    for label, call in calls:
        with suppress(NotSupportedError, ResetNeededError):  # the end may come earlier if it is not deterministic
            call()
        after = global_random_state()
        names = [name for name in before if before[name] != after[name]]
        if names:
            yield f"{label} changed the state of {' and '.join(names)}"
        before = after


@promise("call super().reset(seed=seed) first, and decide each episode only by what it then draws from self.np_random.")
def seed_stream(subject: Subject) -> Iterator[str]:
    """reset(seed) starts a stream, reset() draws its next episode, and info["seed"] replays each alone."""
    script, later = subject.scripts[0], subject.scripts[-1].actions
    env = subject.new()
    parts = [(script.seed, script.actions), (None, later), (None, later)]
    stream = [list(subject.play_from(env, seed, actions)) for seed, actions in parts]
    seeds = [episode[0]["info"].get("seed") for episode in stream]
    again = [subject.reset(env, seed)[1].get("seed") for seed, _ in parts]
    if seeds[0] != script.seed or seeds != again or len(set(map(str, seeds))) < len(seeds):
        yield f"the stream of seed {script.seed} has in info the seeds {seeds}, and a second time {again}"
        return
    unseeded = [subject.reset(subject.new())[1].get("seed") for _ in range(2)]
    if unseeded[0] == unseeded[1]:
        yield f"two new instances that were reset without a seed both began with {unseeded[0]}"
    if subject.references:
        for number, (seed, found) in enumerate(zip(seeds, stream, strict=True), 1):
            what = f"reset(seed={seed}) does not replay episode {number} of the stream: it differs"
            replayed = subject.play_from(subject.new(), seed, parts[number - 1][1])
            yield from differences(what, found, list(replayed))


# State.


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


# Actions.


@promise("override sample_random_action, and return text that the task understands in its present state.")
def valid_sample(subject: Subject) -> Iterator[str]:
    """A random action can be sampled at every turn, and is a valid one."""
    subject.need_episodes()
    env = subject.new()
    for seed in subject.seeds[:-1]:
        subject.reset(env, seed)
        for _ in range(subject.limits.max_turns):
            try:
                action = subject.sample(env)
            except SamplingNotSupported as error:
                yield f"SamplingNotSupported: {error}"
                return
            for seat, text in responses(action).items():
                if not isinstance(text, str) or not spaces_of(env, seat)[1].contains(text):
                    of = f" of {seat!r}" if seat else ""
                    yield f"sample_random_action(){of} returned {shown(text)}, which is no action"
                    return
            result = subject.step(env, action)
            for where, seen, _ in split(env, step_label(action), result):
                # One of several agents may be told of its action later, when it acts again.
                if seen[-1].get("parsed_action", "") is None:
                    yield f"a sampled action was not understood: {where} gave info['parsed_action'] = None"
            if result[2] or result[3]:
                break


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
        samples.append([])
        for record in subject.play(env, script):
            found.append(record)
            if len(found) <= len(script.actions):
                samples[-1] += [subject.sample(env) for _ in range(len(found) % 3 + 1)]
        what = f"with seed {script.seed}, the episode in which actions are sampled differs"
        yield from differences(what, expected, found)
    if samples[0] != samples[1]:
        yield f"the same seed sampled {shown(samples[0][:5])}, and a second time {shown(samples[1][:5])}"


@promise("treat what cannot be read as a wrong answer: an observation, a reward, no exception, in bounded time.")
def hostile_actions_(subject: Subject) -> Iterator[str]:
    """Any string at all gives an observation and a reward in bounded time, and the episode goes on."""
    subject.need_episodes()
    # A time limit here does not hold against a regular expression, which lets no other thread run, and a crash would
    # take the check along. What blocks on input and output may need what only this process has.
    if getattr(subject.new().unwrapped, "concurrency", None) not in ("thread", "async"):
        try:
            yield from subject.elsewhere(_answers_hostile_text)
        except NotTriedError:
            pass
        else:
            return
    yield from _answers_hostile_text(subject)


def _answers_hostile_text(subject: Subject) -> Iterator[str]:
    env = subject.new()

    def comes_to_act(seat: str, *, over: bool, seed: int) -> bool:
        label = f"playing until {seat!r} acts" if seat else "reset()"
        return bool(subject.called(label, approach, env, seat, over=over, seed=seed))

    over, seats = True, []
    for seat in seats_of(env):
        if comes_to_act(seat, over=True, seed=subject.limits.seed):
            seats.append(seat)
        else:
            subject.notes.append(f"hostile-actions: {seat!r} was not tried, since it never came to act")
    for number, text in enumerate(hostile_actions(seed=subject.limits.seed)):
        for seat in seats:
            if not comes_to_act(seat, over=over, seed=number):
                over = True
                continue
            action = say_as(env, seat, text)
            try:
                result = subject.step(env, action)
            except (Exception, SystemExit) as error:  # noqa: BLE001 - third-party code, and no error is allowed
                yield f"{step_label(action)} raised {subject.told(error)}"
                env, over = subject.new(), True
                continue
            over = bool(result[2] or result[3])
            for where, seen, space in split(env, step_label(action), result):
                yield from (f"{where} gave {problem}" for problem in _hostile_problems(space, seen))
    # After hostile actions, the next episode must be the same as ever.
    if subject.recorded is not None:
        alone, after = (list(subject.play(each, subject.scripts[0])) for each in (subject.new(), env))
        yield from differences("the episode after all of them differs", alone, after)


def _hostile_problems(space: Any, result: Any) -> Iterator[str]:
    yield from problems_of(space, result)
    info = result[-1]
    loss = json_loss(info)
    if loss is not None:
        yield f"an info that JSON cannot keep: {loss}"
    elif info.get("error") is not None:
        yield f"the error {shown(info['error'])}; what an action causes is the agent's"
