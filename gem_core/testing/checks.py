"""``check_agent``, ``check_backend``, ``check_command`` and ``check_wrapper``, on a small task."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping
from typing import Any, cast

import click
from click.testing import CliRunner

from gem_core.api import make_vec
from gem_core.cli import cli
from gem_core.env.wrapper import AnyEnv, Wrapper, reset_async, step_async
from gem_core.errors import ClosedError
from gem_core.records.episode import Episode
from gem_core.records.plain_json import to_plain
from gem_core.rollouts.agent import Agent, as_agent, load_agent
from gem_core.rollouts.drivers import rollout
from gem_core.testing.comparing import play
from gem_core.testing.env_check import Report, check_env
from gem_core.testing.findings import Findings
from gem_core.testing.small_task import SMALL_TASK, SmallTask, register_small_task


def check_agent(agent: str | Agent, **options: Any) -> list[str]:
    """Try what an agent promises: that it answers every observation with text, for many episodes at once.

    Args:
        agent: The name that it is registered by, as ``--agent`` takes it, or the agent.
        **options: Options of a named agent.

    Returns:
        The promises that were kept, in one sentence each.

    Raises:
        CheckError: Promises are broken; the message names each, with what was seen.
        UnknownAgentError: There is no agent of this name.
    """
    register_small_task()
    findings = Findings(f"agent {agent if isinstance(agent, str) else type(agent).__name__!r}")
    made = load_agent(agent, **options) if isinstance(agent, str) else as_agent(agent)
    episodes: list[Episode] = []

    def played() -> None:
        with make_vec(SMALL_TASK, 4, seed=1) as vector:
            episodes.extend(rollout(vector, made, episodes=8))

    findings.attempt("It plays eight episodes, four at once, and prepares and closes as often as it is asked.", played)
    errors = [episode.error for episode in episodes if episode.error]
    findings.expect("It answers every observation with text.", not errors, "; ".join(map(str, errors[:1])))
    findings.expect("It comes to the end of every episode.", len(episodes) in (0, 8), f"{len(episodes)} of 8")
    return findings.result()


def check_backend(backend: str | tuple[str, Mapping[str, Any]]) -> list[str]:
    """Try what a vector backend promises, on a small task in three slots.

    Args:
        backend: The name that it is registered by, or (name, {option: value}).

    Returns:
        The promises that were kept, in one sentence each.

    Raises:
        CheckError: Promises are broken; the message names each, with what was seen.
        UnknownBackendError: There is no backend of this name.
    """
    register_small_task()
    findings = Findings(f"backend {backend!r}")
    vector, model = (make_vec(SMALL_TASK, 3, backend=each, seed=1) for each in (backend, "sync"))
    rounds = [["say 3", "hello", "say 7"], ["", "say 1", "say 1"], ["a", "b", "c"], ["say 5"] * 3]

    def played(vector: Any, rounds: list[list[str]]) -> list[Any]:
        seen: list[Any] = [to_plain(each) for each in vector.reset(seed=1)]
        for actions in rounds:
            step = vector.step(actions)
            flags = (step.rewards.tolist(), step.terminated.tolist(), step.truncated.tolist())
            seen += [to_plain(step.observations), *flags, to_plain(step.infos)]
        return seen

    try:
        for promise, actions in (
            ("The same seed and actions give what backend 'sync' gives.", rounds),
            ("An environment that fails costs its own episode, and is replaced.", [["hello", "break", ""], *rounds]),
        ):
            findings.expect_equal(promise, played(vector, actions), played(model, actions))
        samples = [vector.sample_random_action(slot) for slot in range(3)]
        findings.expect("It gives random actions.", all(each.startswith("say ") for each in samples), samples)
        described = [vector.describe(slot)["id"] for slot in range(3)]
        findings.expect("It says what stands in a slot.", described == [SMALL_TASK] * 3, described)
        vector.reset(seed=2)
        vector.send({0: "a", 2: "b"})
        received: list[int] = []
        while len(received) < 2:
            received += vector.recv(1).slots
        findings.expect("What was sent is received.", sorted(received) == [0, 2], repr(received))
        vector.send(["a"] * 3)
    finally:
        model.close()
        findings.attempt("It can be closed while something is under way.", vector.close)
    findings.attempt("It can be closed once more.", vector.close)
    with contextlib.suppress(ClosedError):
        vector.reset()
        findings.expect("What is closed stays closed.", False, "reset() after close() began an episode")
    return findings.result()


def check_command(name: str) -> list[str]:
    """Try what a subcommand of ``gem`` promises: it is found, says what it does, and refuses what it does not know.

    Args:
        name: The name that it is registered by.

    Returns:
        The promises that were kept, in one sentence each.

    Raises:
        CheckError: Promises are broken; the message names each, with what was seen.
        RegistrationError: Two plugins offer it.
    """
    findings = Findings(f"command {name!r}")
    found = cli.get_command(click.Context(cli), name)
    if not findings.expect("It is registered.", found is not None, "no plugin offers it"):
        findings.result()
    command = cast("click.Command", found)
    findings.expect("It has a help text.", bool(command.help or command.get_short_help_str()), "no docstring")
    for promise, option, code in (
        ("With --help it says how it is called, and exits with 0.", "--help", 0),
        ("An option that there is not is refused with exit code 2.", "--no-such-option-of-anybody", 2),
    ):
        called = CliRunner().invoke(command, [option])
        findings.expect(promise, called.exit_code == code, f"exit code {called.exit_code}, {called.exception!r}")
    return findings.result()


def check_wrapper(make_wrapper: Callable[[AnyEnv], AnyEnv], *, skip: Mapping[str, str] | None = None) -> Report:
    """Try everything that a wrapper promises, around a small task of three turns.

    Args:
        make_wrapper: The class, or a function, that puts the wrapper around an environment.
        skip: Promises of ``check_env`` that are not to be tried, each by its slug, with the reason.

    Returns:
        What ``check_env`` says of the two together.

    Raises:
        CheckError: It hides the task, or its asynchronous methods say something else than its plain ones.
        ContractError: Around the task, the contract of environments is broken.
    """
    wrapped = make_wrapper(SmallTask())
    findings = Findings(f"wrapper {type(wrapped).__name__}")
    actions = ("say 3", "hello", "say 7")
    with contextlib.closing(wrapped):
        promise = "It derives from gem_core.Wrapper."
        if not findings.expect(promise, isinstance(wrapped, Wrapper), f"a {type(wrapped).__name__}"):
            findings.result()
        findings.expect("'unwrapped' is the task.", isinstance(wrapped.unwrapped, SmallTask), repr(wrapped.unwrapped))
        shown = getattr(wrapped, "answer", None)
        findings.expect("Attributes of the task are read through it.", shown == SmallTask.answer, repr(shown))
        expected = list(play(lambda: wrapped.reset(seed=1), wrapped.step, actions))
        with asyncio.Runner() as loop:
            found = play(
                lambda: loop.run(reset_async(wrapped, 1)),
                lambda action: loop.run(step_async(wrapped, action)),
                actions,
            )
            findings.expect_equal("Its coroutines give what its plain methods give.", list(found), expected)
        findings.result()
        return check_env(wrapped, skip=skip)
