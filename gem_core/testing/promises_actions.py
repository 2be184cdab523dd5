"""Promises about actions: sampled ones are valid, and hostile ones do no harm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gem_core.env.wrapper import AnyEnv
from gem_core.errors import SamplingNotSupported
from gem_core.testing.comparing import differences, json_loss
from gem_core.testing.contract import promise
from gem_core.testing.findings import NotTriedError, shown
from gem_core.testing.hostile import hostile_actions
from gem_core.testing.interpreter import CallError, InterpreterLostError
from gem_core.testing.joint import (
    SeenByOne,
    approach,
    changed,
    responses,
    say_as,
    seats_of,
    spaces_of,
    split,
    step_label,
)
from gem_core.testing.promises_interface import problems_of
from gem_core.testing.subject import Subject
from gem_core.types import Response


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


@promise("read the action as a str, with isinstance where its type is asked for.")
def response(subject: Subject) -> Iterator[str]:
    """A Response and a plain str of the same text do the same."""
    for script, expected in subject.references:
        actions = tuple(changed(action, _as_response) for action in script.actions)
        found = list(subject.play_from(subject.new(), script.seed, actions))
        yield from differences(f"with seed {script.seed}, answers of type Response differ", expected, found)


@promise("treat what cannot be read as a wrong answer: an observation, a reward, no exception, in bounded time.")
def hostile_actions_(subject: Subject) -> Iterator[str]:
    """Any string at all gives an observation and a reward in bounded time, and the episode goes on."""
    script = subject.scripts[0]
    env = subject.new()
    actions = hostile_actions(seed=subject.limits.seed)
    seats = [seat for seat in seats_of(env) if _gets_its_turn(subject, env, seat)]
    fatal = _fatal_action(subject, env, seats, actions)
    if fatal is not None:
        yield fatal
        return
    over = True
    for number, text in enumerate(actions):
        for seat in seats:
            if not _approach(subject, env, seat, over=over, seed=number):
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
            for seen in split(env, step_label(action), result):
                yield from _hostile_problems(seen)
    # After hostile actions, the next episode must be the same as ever.
    after = list(subject.play(env, script))
    if subject.recorded is not None:
        what = f"with seed {script.seed}, the episode after all of them differs"
        yield from differences(what, subject.recorded[0], after)


def _hostile_problems(seen: SeenByOne) -> Iterator[str]:
    for problem in problems_of(seen.space, seen.result):
        yield f"{seen.where} gave {problem}"
    info = seen.result[-1]
    loss = json_loss(info)
    if loss is not None:
        yield f"{seen.where} gave an info that JSON cannot keep: {loss}"
    elif info.get("error") is not None:
        yield f"{seen.where} gave the error {shown(info['error'])}; what an action causes is the agent's"


def _gets_its_turn(subject: Subject, env: AnyEnv, seat: str) -> bool:
    """Tell whether an agent comes to act, and note where it does not."""
    if _approach(subject, env, seat, over=True, seed=subject.limits.seed):
        return True
    subject.notes.append(f"hostile-actions: {seat!r} was not tried, since it never came to act")
    return False


def _approach(subject: Subject, env: AnyEnv, seat: str, *, over: bool, seed: int) -> bool:
    label = f"playing until {seat!r} acts" if seat else "reset()"
    return bool(subject.called(label, approach, env, seat, over=over, seed=seed))


def _fatal_action(subject: Subject, env: AnyEnv, seats: Sequence[str], actions: Sequence[str]) -> str | None:
    """Find the action that ends or hangs a whole process, in another process.

    A time limit here does not hold against a regular expression, which lets no other thread run. What blocks on input
    and output does let them run, and can be slow to reset: it is not tried twice.
    """
    if getattr(env.unwrapped, "concurrency", None) in ("thread", "async"):
        return None
    label = "reset()"
    over = True
    try:
        with subject.elsewhere() as other:
            for number, text in enumerate(actions):
                for seat in seats:
                    if not other.approach(seat, over=over, seed=number):
                        over = True
                        continue
                    label = step_label({seat: text} if seat else text)
                    try:
                        over = other.step_hostile(seat, subject.limits.seed, number)
                    except InterpreterLostError:
                        raise
                    except CallError:  # tried here too, and named then
                        over = True
                    label = "reset()" if over else label
    except NotTriedError:
        return None
    except CallError as error:
        return f"{label}, tried in another process: {error}"
    return None


def _as_response(text: str) -> Response:
    return Response(text, finish_reason="stop", model="none", token_ids=[1, 2], logprobs=[-0.1, -0.2])
