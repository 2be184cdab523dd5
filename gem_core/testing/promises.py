"""What every environment promises: results, ends of episodes, randomness, and answers to any text.

The order is that in which they are tried: later ones use what earlier ones found. In an environment of several agents,
each is tried at each seat.
"""

from __future__ import annotations

import inspect
import io
import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from typing import Any, cast

import numpy as np

from gem_core.env.base import Env
from gem_core.env.guard import Guard
from gem_core.env.observations import observation_from
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import EnvFaultError, NotSupportedError, ResetNeededError, SamplingNotSupported, StateNotSupported
from gem_core.records.plain_json import to_plain
from gem_core.rollouts.agent import Context
from gem_core.testing.calls import global_random_state, scramble
from gem_core.testing.comparing import differences, json_loss
from gem_core.testing.findings import NotTriedError, shown
from gem_core.testing.hostile import hostile_actions
from gem_core.testing.subject import PlainResult, Script, Subject, random_or_hello, step_label, unchecked
from gem_core.types import Observation, Response

PromiseCheck = Callable[[Subject], Iterator[str]]
"""Tries one promise and yields each violation; raises ``NotTriedError`` if it cannot be tried."""


@dataclass(frozen=True)
class Promise:
    """One sentence of the environment contract.

    Args:
        slug: Its short, stable name.
        sentence: What is promised.
        mend: How an author can fix an environment that breaks it.
        check: The function that tries it.
    """

    slug: str
    sentence: str
    mend: str
    check: PromiseCheck


PROMISES: dict[str, Promise] = {}
"""Every promise by its slug, in the order in which they are tried."""

OF_ONE, OF_SEVERAL = ("gymnasium",), ("seats", "reasoning")
"""Slugs of the promises that only environments of one agent make, or only those of several."""


def promise(check: PromiseCheck) -> PromiseCheck:
    """Register a check: its name is the slug; its docstring has the sentence, and then how to mend what is broken."""
    slug = check.__name__.rstrip("_").replace("_", "-")
    sentence, _, mend = inspect.cleandoc(check.__doc__ or "").partition("\n\n")
    PROMISES[slug] = Promise(slug, sentence, " ".join(mend.split()), check)
    return check


# Episodes and their results.


@promise
def construct(subject: Subject) -> Iterator[str]:
    """The environment can be made, as often as wanted.

    Let the constructor take the arguments that it is given, and leave what can fail to reset.
    """
    subject.new()
    subject.new()
    yield from ()


@promise
def episode(subject: Subject) -> Iterator[str]:
    """An episode can be played: reset gives two values and each step gives five, whatever is answered.

    Define reset(self, seed=None, options=None), return (observation, info) from it and (observation, reward,
    terminated, truncated, info) from step, with several agents a dictionary by agent of each, and raise nothing.
    """
    task = subject.bare()
    for what, expected in (("reset()", 2), ("step('')", 5)):
        try:
            result = subject.reset(task, subject.seeds[0]) if expected == 2 else subject.step(task, "")
        except EnvFaultError as error:
            if subject.seat is None or error.__cause__ is not None:
                raise
            subject.notes.append(f"the seat {subject.seat!r} was not tried: {error}")
            raise NotTriedError(str(error)) from error
        if not isinstance(result, tuple) or len(result) != expected or not isinstance(result[-1], dict):
            yield f"{what} returned {shown(result)}, not a tuple of {expected} that ends with a dictionary"
            return
    subject.record_scripts()
    subject.called("reset(seed=0, options={})", task.reset, seed=0, options={})


@promise
def seats(subject: Subject) -> Iterator[str]:
    """The possible agents have names that differ, and they are the seats of the record.

    Set possible_agents in the class or the constructor, and write the same names into the record as seats.
    """
    names = list(subject.seats)
    if not all(isinstance(name, str) and name for name in names) or len(set(names)) < len(names):
        yield f"possible_agents is {shown(names)}"
    if subject.seats_of_record not in ([], names):
        yield f"possible_agents is {shown(names)}, and the seats of the record are {shown(subject.seats_of_record)}"


@promise
def types(subject: Subject) -> Iterator[str]:
    """Observations lie in their space, rewards are finite, flags are bools and never both set, info is a dict.

    Return an observation of the observation space (gem_core.env.spaces.Content() for content parts), a finite float,
    two bools of which one is False, and a dictionary.
    """
    space = subject.new().observation_space
    for where, result in subject.results:
        for problem in _problems_of(space, result):
            yield f"{where} gave {problem}"


def _problems_of(space: Any, result: Any) -> Iterator[str]:
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


@promise
def spaces(subject: Subject) -> Iterator[str]:
    """Two instances have equal spaces, and every string is an action.

    Give every instance spaces that are equal by value, such as gem_core.env.spaces.Text().
    """
    one, other = subject.new(), subject.new()
    for first, second in (
        (one.observation_space, other.observation_space),
        (one.action_space, other.action_space),
    ):
        if first != second:
            yield f"a space is {shown(first)} and, of another instance, {shown(second)}, which are not equal"
    for text in ("", "hello", "é\n🙂\x00\ud800"):
        if not one.action_space.contains(text):
            yield f"the action space {shown(one.action_space)} does not contain {shown(text)}"


def _is_error(value: object) -> bool:
    names = ("kind", "message")
    return value is None or (isinstance(value, Mapping) and {str} == {type(value.get(name)) for name in names})


def _are_mappings(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(item, Mapping) for item in value)


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
"""The keys of info that mean the same everywhere, and whether a value has their form."""


@promise
def info(subject: Subject) -> Iterator[str]:
    """Info is plain JSON, images apart, its shared keys have their form, and an error ends the episode as truncated.

    Put only strings, finite numbers, bools, None, lists and dictionaries with string keys into info, and give the keys
    with one meaning everywhere the form that docs/environments.md names.
    """
    over = told = False
    for where, result in subject.results:
        found = result[-1]
        if (loss := json_loss(found)) is not None:
            yield f"info of {where}: {loss}"
        over, told = over or bool(len(result) == 5 and result[2]), told or "correct" in found
        for key, accepted in _FORMS.items():
            if key in found and not accepted(found[key]):
                yield f"info[{key!r}] of {where} is {shown(found[key])}"
        if found.get("error") is not None and len(result) == 5 and not result[3]:
            yield f"{where} has info['error'] and is not truncated"
    if over and not told:
        subject.notes.append(
            "info: none says 'correct', so success stays unknown and has no rate. Say it at the end, or None from "
            "reset on if no answer is right"
        )


@promise
def suffix(subject: Subject) -> Iterator[str]:
    """Where info holds feedback and suffix, the observation is the first followed by the second.

    Return feedback + suffix as the observation, or leave both keys out.
    """
    # The task alone: a view of the history changes observations and leaves the keys.
    for where, result in subject.results_of(unchecked(Guard(subject.bare()))):
        given = [result[-1][key] for key in ("feedback", "suffix") if key in result[-1]]
        if len(given) == 1:
            yield f"info of {where} has only one of 'feedback' and 'suffix'"
        elif given and to_plain(observation_from(*given)) != to_plain(result[0]):
            yield f"{where}: the observation is {shown(result[0])}, feedback and suffix are {shown(given)}"


@promise
def fresh_objects(subject: Subject) -> Iterator[str]:
    """What a call returned is not changed by later calls.

    Build a new dictionary and a new list for every result.
    """
    kept = [(where, list(result), to_plain(result)) for where, result in subject.results_of(subject.new())]
    for where, result, before in kept:
        if to_plain(result) != before:
            yield f"what {where} returned was changed by later calls: {shown(before)}, then {shown(to_plain(result))}"


_THINKING = ("<think>{0}</think>{1}", "{0}</think>{1}", "{1}<think>{0}")
"""How a response shows what was thought: in a block, in one that the prompt opened, and in one that is never closed."""


@promise
def reasoning(subject: Subject) -> Iterator[str]:
    """What an agent thinks reaches nobody else: no observation and no info of another seat shows it.

    Show others what you extract of a response, with gem_core.parsing.without_thinking where all of it is said.
    """
    for form in _THINKING:

        def thinking(observation: Observation, context: Context, form: str = form) -> Response:
            text = form.format("thought71236", random_or_hello(observation, context))
            return Response(text, reasoning="thought71236")

        for where, result in subject.results_of(subject.new(thinking)):
            if "thought71236" in repr(to_plain(result)).lower():
                yield f"{where} showed what another seat thought, in the form {form}"
                return


# Ends.


@promise
def step_after_end(subject: Subject) -> Iterator[str]:
    """A step before the first reset or after the end raises ResetNeededError, and reset begins anew.

    Let the guard that gem_core.make puts around the task refuse it, and no wrapper catch that.
    """
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
            yield f"step('hello') {when} returned {shown(subject.step(env, 'hello'))}"
    if script is not None:
        subject.reset(env, script.seed)
        subject.step(env, script.actions[0])


@promise
def close_twice(subject: Subject) -> Iterator[str]:
    """Close works right after construction, in the midst of an episode, and a second time.

    Make close() do nothing when there is nothing left to free.
    """
    env = subject.new()
    subject.close(env)
    subject.close(env)
    env = subject.new()
    subject.reset(env, subject.scripts[0].seed)
    subject.step(env, subject.scripts[0].actions[0])
    subject.close(env)
    subject.close(env)
    yield from ()


@promise
def concurrency(subject: Subject) -> Iterator[str]:
    """Concurrency is "inline", "thread", "process" or "async".

    Set the class attribute concurrency to one of these.
    """
    declared = getattr(subject.bare(), "concurrency", None)
    if declared not in ("inline", "thread", "process", "async"):
        yield f"concurrency is {shown(declared)}"


@promise
def gymnasium(subject: Subject) -> Iterator[str]:
    """Gymnasium's own checker passes on the task without wrappers.

    See https://gymnasium.farama.org/api/env/ for what Gymnasium expects.
    """
    subject.need_episodes()
    from gymnasium.utils.env_checker import check_env as gymnasium_check

    task = subject.bare()
    task.action_space.seed(subject.limits.seed)
    # It renders in every mode, and "human" prints; it warns of what text does not have.
    with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        try:
            subject.called("gymnasium's check_env", gymnasium_check, task)
        except Exception as error:  # noqa: BLE001 - whatever it raises is its verdict
            yield subject.told(error)


# Randomness.


@promise
def determinism(subject: Subject) -> Iterator[str]:
    """The same seed and actions give the same episode, in a new and in a used instance, whatever the global state.

    Draw only from self.np_random, and make everything of an episode anew in reset.
    """
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


@promise
def process_determinism(subject: Subject) -> Iterator[str]:
    """Another process, in which strings hash differently, plays the same episode.

    Do not depend on hash(), the order of a set, the process id or the environment's variables.
    """
    yield from subject.elsewhere(_repeats) if subject.references else ()


def _repeats(subject: Subject) -> Iterator[str]:
    for script, expected in subject.references:
        yield from differences(
            f"with seed {script.seed}, it differs", expected, list(subject.play(subject.new(), script))
        )


@promise
def interleaving(subject: Subject) -> Iterator[str]:
    """Other instances that play at the same time change nothing.

    Keep the state of an episode in self, never in the class or the module.
    """
    references = subject.references
    players = [subject.play(subject.new(), script) for script, _ in references]
    rounds = list(zip_longest(*players))
    for (script, expected), found in zip(references, zip(*rounds, strict=True), strict=True):
        what = f"with seed {script.seed}, beside {len(players) - 1} others, it differs"
        yield from differences(what, expected, [record for record in found if record is not None])


@promise
def global_random(subject: Subject) -> Iterator[str]:
    """The global random state is left untouched by every call.

    Draw from self.np_random; fence in a library that insists on global state, and put its state back.
    """
    script = subject.scripts[0]
    before = global_random_state()
    env = subject.new()
    calls: list[tuple[str, Callable[[], object]]] = [("the constructor", lambda: None)]
    calls.append(("reset()", partial(subject.reset, env, script.seed)))
    for action in script.actions:
        calls.append(("sample_random_action()", partial(subject.sample, env)))
        calls.append((step_label(action), partial(subject.step, env, action)))
    calls.append(("close()", partial(subject.close, env)))
    for label, call in calls:
        with suppress(NotSupportedError, ResetNeededError):  # the end may come earlier if it is not deterministic
            call()
        after = global_random_state()
        names = [name for name in before if before[name] != after[name]]
        if names:
            yield f"{label} changed the state of {' and '.join(names)}"
        before = after


@promise
def seed_stream(subject: Subject) -> Iterator[str]:
    """reset(seed) starts a stream, reset() draws its next episode, and info["seed"] replays each alone.

    Call super().reset(seed=seed) first, and decide each episode only by what it then draws from self.np_random.
    """
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


@promise
def fork(subject: Subject) -> Iterator[str]:
    """A fork in the middle of an episode goes on identically, and what it plays changes nothing in the first one.

    Keep the state of an episode in self; override __deepcopy__ for what copy.deepcopy does not copy.
    """
    references, sampling = subject.references, subject.can_sample()
    for number, (script, expected) in enumerate(references):
        between = subject.scripts[number - 1]
        last = max(len(script.actions) - 1, 0)
        for steps in sorted({0, last // 2, last}):
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


@promise
def valid_sample(subject: Subject) -> Iterator[str]:
    """A random action can be sampled at every turn, and is a valid one.

    Override sample_random_action, and return text that the task understands in its present state.
    """
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
            if not isinstance(action, str) or not env.action_space.contains(action):
                yield f"sample_random_action() returned {shown(action)}, which is no action"
                return
            result = subject.step(env, action)
            if result[-1].get("parsed_action", "") is None:
                yield f"a sampled action was not understood: {step_label(action)} gave info['parsed_action'] = None"
            if result[2] or result[3]:
                break


@promise
def action_sampling(subject: Subject) -> Iterator[str]:
    """Sampling actions changes nothing of the episode, and the same seed samples the same actions.

    Draw sampled actions from self.action_random, and change nothing else.
    """
    subject.need_episodes()
    if not subject.can_sample():
        raise NotTriedError("it gives no random actions; see 'valid-sample'")
    samples: list[list[str]] = []
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


@promise
def hostile_actions_(subject: Subject) -> Iterator[str]:
    """Any string at all gives an observation and a reward in bounded time, and the episode goes on.

    Treat what cannot be read as a wrong answer: an observation, a reward, no exception, in bounded time.
    """
    subject.need_episodes()
    # A time limit here does not hold against a regular expression, which lets no other thread run, and a crash would
    # take the check along. What blocks on input and output may need what only this process has.
    if getattr(subject.bare(), "concurrency", None) not in ("thread", "async"):
        try:
            yield from subject.elsewhere(_answers_hostile_text)
        except NotTriedError:
            pass
        else:
            return
    yield from _answers_hostile_text(subject)


def _answers_hostile_text(subject: Subject) -> Iterator[str]:
    env, over = subject.new(), True
    for number, text in enumerate(hostile_actions(seed=subject.limits.seed)):
        if over:
            subject.reset(env, number)
        try:
            result = subject.step(env, text)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - third-party code, and no error is allowed
            yield f"{step_label(text)} raised {subject.told(error)}"
            env, over = subject.new(), True
            continue
        over = bool(result[2] or result[3])
        for problem in _problems_of(env.observation_space, result):
            yield f"{step_label(text)} gave {problem}"
        if (loss := json_loss(result[-1])) is not None:
            yield f"{step_label(text)} gave an info that JSON cannot keep: {loss}"
        elif result[-1].get("error") is not None:
            error_told = shown(result[-1]["error"])
            yield f"{step_label(text)} gave the error {error_told}; what an action causes is the agent's"
    # After hostile actions, the next episode must be the same as ever.
    if subject.recorded is not None:
        alone, after = (list(subject.play(each, subject.scripts[0])) for each in (subject.new(), env))
        yield from differences("the episode after all of them differs", alone, after)
