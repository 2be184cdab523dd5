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
            if not isinstance(action, str) or not env.action_space.contains(action):
                yield f"sample_random_action() returned {shown(action)}, which is no action"
                return
            result = subject.step(env, action)
            if result[-1].get("parsed_action", "") is None:
                yield f"the sampled {shown(action)} was not understood: info['parsed_action'] is None"
            if result[2] or result[3]:
                break


@promise("read the action as a str, with isinstance where its type is asked for.")
def response(subject: Subject) -> Iterator[str]:
    """A Response and a plain str of the same text do the same."""
    for script, expected in subject.references:
        actions = tuple(
            Response(action, finish_reason="stop", model="none", token_ids=[1, 2], logprobs=[-0.1, -0.2])
            for action in script.actions
        )
        found = list(subject.play_from(subject.new(), script.seed, actions))
        yield from differences(f"with seed {script.seed}, answers of type Response differ", expected, found)


@promise("treat what cannot be read as a wrong answer: an observation, a reward, no exception, in bounded time.")
def hostile_actions_(subject: Subject) -> Iterator[str]:
    """Any string at all gives an observation and a reward in bounded time, and the episode goes on."""
    script = subject.scripts[0]
    env = subject.new()
    actions = hostile_actions(seed=subject.limits.seed)
    fatal = _fatal_action(subject, env, actions)
    if fatal is not None:
        yield fatal
        return
    subject.reset(env, subject.limits.seed)
    for number, action in enumerate(actions):
        try:
            result = subject.step(env, action)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - third-party code, and no error is allowed
            yield f"step({shown(action)}) raised {subject.told(error)}"
            env = subject.new()
            subject.reset(env, number)
            continue
        for problem in problems_of(env, result):
            yield f"step({shown(action)}) gave {problem}"
        info = result[-1]
        loss = json_loss(info)
        if loss is not None:
            yield f"step({shown(action)}) gave an info that JSON cannot keep: {loss}"
        elif info.get("error") is not None:
            yield f"step({shown(action)}) gave the error {shown(info['error'])}; what an action causes is the agent's"
        if result[2] or result[3]:
            subject.reset(env, number)
    # After hostile actions, the next episode must be the same as ever.
    after = list(subject.play(env, script))
    if subject.recorded is not None:
        what = f"with seed {script.seed}, the episode after all of them differs"
        yield from differences(what, subject.recorded[0], after)


def _fatal_action(subject: Subject, env: AnyEnv, actions: Sequence[str]) -> str | None:
    """Find the action that ends or hangs a whole process, in another process.

    A time limit here does not hold against a regular expression, which lets no other thread run. What blocks on input
    and output does let them run, and can be slow to reset: it is not tried twice.
    """
    if getattr(env.unwrapped, "concurrency", None) in ("thread", "async"):
        return None
    label = "reset()"
    try:
        with subject.elsewhere() as other:
            other.reset(subject.limits.seed)
            for number, action in enumerate(actions):
                label = f"step({shown(action)})"
                try:
                    over = other.step_hostile(subject.limits.seed, number)
                except InterpreterLostError:
                    raise
                except CallError:  # tried here too, and named then
                    over = True
                if over:
                    label = "reset()"
                    other.reset(number)
    except NotTriedError:
        return None
    except CallError as error:
        return f"{label}, tried in another process: {error}"
    return None
