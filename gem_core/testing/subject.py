"""The environment under check: new instances of it, calls under a time limit, and episodes to repeat."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, cast

import cloudpickle  # type: ignore[import-untyped]  # it has no types
import gymnasium

from gem_core.api import make, spec
from gem_core.env.base import Env
from gem_core.env.guard import Guard
from gem_core.env.multi_agent import MultiAgentEnv
from gem_core.env.seeding import stable_hash
from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.errors import ArgumentError, GemError
from gem_core.making.again import Recipe
from gem_core.registry.requirements import check_requirements
from gem_core.registry.specs import EnvSpec
from gem_core.rollouts.agent import Context
from gem_core.rollouts.one_seat import SingleAgentEnv, single_agent
from gem_core.testing.calls import ProcessCalls, ThreadCalls, TookTooLongError, preserved
from gem_core.testing.comparing import play
from gem_core.testing.elsewhere import Sender, run_elsewhere
from gem_core.testing.findings import NotTriedError, place_of, shown
from gem_core.types import Observation

PlainResult = dict[str, Any]
"""What one reset or step gave, as plain data."""

CLUMSY_ACTIONS = (
    *("", "hello", "\\boxed{1}", "<answer>A</answer>"),
    *("I do not know.", "\\boxed{A B}", "```python\nprint(1)\n```", "\\boxed{[0 0]}"),
)
"""Actions of an agent that does not know the task, used if the environment cannot sample actions."""


@dataclass(frozen=True)
class Script:
    """An episode that can be played again.

    Args:
        seed: What it is reset with.
        actions: What is answered, up to the end of the episode or the limit of turns.
        ended: Whether the last action ended it.
    """

    seed: int
    actions: tuple[str, ...]
    ended: bool


@dataclass(frozen=True)
class CheckLimits:
    """How much is tried, and how long a call may take; see ``check_env``."""

    seed: int = 0
    episodes: int = 3
    max_turns: int = 40
    step_timeout_s: float = 30.0
    reset_timeout_s: float = 300.0


def random_or_hello(observation: Observation, context: Context) -> str:
    """Play another seat: a random action, or "hello" if there is none, which ``valid-sample`` reports."""
    try:
        return str(context.sample_random_action())
    except Exception:  # noqa: BLE001 - third-party code may raise anything
        return "hello"


class Subject:
    """The environment under check, as the promises use it; of several agents, one seat of it.

    Args:
        name: The environment, as it is called in the report.
        make_env: Makes another instance with the same arguments.
        limits: How much is tried.
        calls: Makes each call under a limit.
        seat: The seat that is checked, while ``random_or_hello`` plays the others; None for an environment of one
            agent.
    """

    def __init__(
        self,
        name: str,
        make_env: Callable[[], Any],
        limits: CheckLimits,
        calls: ThreadCalls | ProcessCalls,
        seat: str | None = None,
    ) -> None:
        self.name, self._make, self.limits, self.calls, self.seat = name, make_env, limits, calls, seat
        self.notes: list[str] = []
        self._instances: list[AnyEnv] = []
        self._package = ""
        """The module of the task's class."""
        self.is_deterministic = True
        """Whether its record says that a seed and the actions repeat an episode."""
        self.seats: Sequence[str] = ()
        """The seats of an environment of several agents."""
        self.seats_of_record: list[str] = []
        self.scripts_or_none: list[Script] | None = None
        self.recorded: list[list[PlainResult]] | None = None
        """Results of each script, once they are known to repeat."""

    # Instances.

    def new(self, others: Any = random_or_hello) -> AnyEnv:
        """Return another instance with the same arguments; it is closed when the promise has been tried.

        Args:
            others: The agent at the other seats.
        """
        env = self.called(f"making {self.name}", self._make)
        if not isinstance(env, Env | Wrapper):
            raise ArgumentError(f"{self.name} is a {type(env).__name__}, which does not derive from gem_core.Env")
        task = cast("Env", env.unwrapped)
        self._package = type(task).__module__
        self.is_deterministic = task.spec is None or not task.spec.nondeterministic
        if isinstance(env, MultiAgentEnv):
            record = task.spec and task.spec.record
            self.seats, self.seats_of_record = env.possible_agents, list(record.seats) if record else []
            if self.seat is None:
                return self.own(env)
            env = single_agent(env, self.seat, others)
        return self.own(unchecked(env if any(isinstance(layer, Guard) for layer in layers_of(env)) else Guard(env)))

    def bare(self) -> Env:
        """Return another instance without wrappers, as ``new`` does."""
        task = self.new().unwrapped
        if self.seat is not None:
            whole = cast("SingleAgentEnv", task).env.unwrapped
            task = single_agent(cast("MultiAgentEnv", whole), self.seat, random_or_hello)
        return cast("Env", task)

    def own(self, env: AnyEnv) -> AnyEnv:
        """Close an environment once the promise has been tried."""
        self._instances.append(env)
        return env

    def close_all(self) -> None:
        """Close the instances of the last promise; ``close-twice`` reports errors."""
        instances, self._instances = self._instances, []
        for env in instances:
            with suppress(Exception, SystemExit, TookTooLongError):
                self.close(env)

    def forget_all(self) -> None:
        """Forget the instances of a promise in which a call hangs, without closing them."""
        self._instances = []

    # Calls.

    def reset(self, env: AnyEnv, seed: int | None = None) -> Any:
        """Reset under the time limit."""
        return self.called(f"reset(seed={seed})" if seed is not None else "reset()", env.reset, seed=seed)

    def step(self, env: AnyEnv, action: str) -> Any:
        """Step under the time limit."""
        return self.calls(step_label(action), self.limits.step_timeout_s, env.step, action)

    def sample(self, env: AnyEnv) -> str:
        """Sample an action under the time limit."""
        return cast("str", self.called("sample_random_action()", env.get_wrapper_attr("sample_random_action")))

    def close(self, env: AnyEnv) -> None:
        """Close under the time limit."""
        self.called("close()", env.close)

    def called(self, label: str, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Call anything else under the time limit."""
        return self.calls(label, self.limits.reset_timeout_s, function, *args, **kwargs)

    def told(self, error: BaseException) -> str:
        """Return an exception with its text and its place in the author's file."""
        place = place_of(error, self._package)
        return f"{type(error).__name__}: {shown(str(error))}" + (f" ({place})" if place else "")

    # Episodes.

    @property
    def seeds(self) -> list[int]:
        """The seeds of the episodes that are played."""
        return [stable_hash(self.limits.seed, "check", number) for number in range(self.limits.episodes + 1)]

    @property
    def scripts(self) -> list[Script]:
        """Episodes to repeat: sampled actions, and in the last one what an agent says that does not know the task."""
        if self.scripts_or_none is None:
            raise NotTriedError("no episode could be played; see 'episode'")
        return self.scripts_or_none

    def need_episodes(self) -> None:
        """Raise ``NotTriedError`` if no episode can be played."""
        len(self.scripts)

    def record_scripts(self) -> None:
        """Play the episodes that the other promises repeat."""
        env, sampling, scripts = self.new(), self.can_sample(), []
        for seed in self.seeds:
            self.reset(env, seed)
            actions: list[str] = []
            ended = False
            while not ended and len(actions) < self.limits.max_turns:
                sampled = sampling and seed != self.seeds[-1]
                actions.append(self.sample(env) if sampled else CLUMSY_ACTIONS[len(actions) % len(CLUMSY_ACTIONS)])
                result = self.step(env, actions[-1])
                ended = bool(result[2] or result[3])
            scripts.append(Script(seed, tuple(actions), ended))
        self.scripts_or_none = scripts

    def can_sample(self) -> bool:
        """Tell whether the environment gives random actions; ``valid-sample`` says what is wrong where it does not."""
        env = self.new()
        self.reset(env, self.seeds[0])
        try:
            return isinstance(self.sample(env), str)
        except Exception:  # noqa: BLE001 - a promise of its own tries and names it
            return False

    @cached_property
    def results(self) -> list[tuple[str, Any]]:
        """Every result of the scripts as it is, with the name of its call."""
        return list(self.results_of(self.new()))

    def results_of(self, env: AnyEnv) -> Iterator[tuple[str, Any]]:
        """Play all scripts, and give each result with the name of its call."""
        for script in self.scripts:
            yield f"reset(seed={script.seed})", self.reset(env, script.seed)
            for action in script.actions:
                result = self.step(env, action)
                yield step_label(action), result
                if result[2] or result[3]:
                    break

    def play(self, env: AnyEnv, script: Script) -> Iterator[PlainResult]:
        """Play a script from its reset."""
        return self.play_from(env, script.seed, script.actions)

    def play_from(self, env: AnyEnv, seed: int | None, actions: Sequence[str]) -> Iterator[PlainResult]:
        """Reset and play some actions; without a seed, the next episode of the stream."""
        return play(lambda: self.reset(env, seed), partial(self.step, env), actions)

    def play_on(self, env: AnyEnv, actions: Sequence[str]) -> Iterator[PlainResult]:
        """Continue an episode."""
        return play(None, partial(self.step, env), actions)

    @property
    def references(self) -> list[tuple[Script, list[PlainResult]]]:
        """Every script with its results, known to be the same each time."""
        scripts = self.scripts
        self.expect_determinism()
        if self.recorded is None:
            raise NotTriedError("the same seed and actions do not repeat; see 'determinism'")
        return list(zip(scripts, self.recorded, strict=True))

    def expect_determinism(self) -> None:
        """Raise ``NotTriedError`` if the environment's record says that it is not deterministic."""
        if not self.is_deterministic:
            raise NotTriedError("its record says deterministic=False")

    # Trying a promise.

    def sightings(self, check: Callable[[Subject], Iterator[str]]) -> Iterator[str]:
        """Yield how a promise is broken; an exception breaks it too.

        Raises:
            NotTriedError: It cannot be tried, and nothing was seen before.
        """
        found = False
        try:
            for sighting in check(self):
                found = True
                yield sighting
        except NotTriedError:
            if not found:
                raise
        except (Exception, SystemExit) as error:  # noqa: BLE001 - third-party code: all that it raises breaks the promise
            yield f"{self.calls.last} raised {self.told(error)}"

    def elsewhere(self, check: Callable[[Subject], Iterator[str]]) -> Iterator[str]:
        """Yield how a promise is broken in another process, which has another hash seed and may hang or die.

        Raises:
            NotTriedError: The environment cannot be made there.
        """
        state = (self.name, self._make, self.limits, self.seat, self.scripts_or_none, self.recorded)
        try:
            packed = cloudpickle.dumps(state)
        except Exception as error:  # pickle calls methods of third-party classes
            why_not = f"{type(error).__name__}: {error}"
            raise NotTriedError(f"its arguments cannot be handed to another process: {why_not}") from error
        outcome = run_elsewhere(_check_there, packed, check)
        last_call = ""
        for what, text in outcome.messages:
            if what == "call":
                last_call = text
            elif what == "not tried":
                raise NotTriedError(text)
            else:
                yield f"{text}, in another process"
        if outcome.problem:
            yield f"{last_call}, in another process: {outcome.problem}"


def subjects_of(target: object, limits: CheckLimits, calls: ThreadCalls) -> list[Subject]:
    """Return what is checked of a target: an environment, or each seat of an environment of several agents.

    Raises:
        GemError: The target cannot be made, for a reason that the caller can mend.
    """
    notes = []
    make_env: Callable[[], Any]
    if isinstance(target, str | EnvSpec):
        record = spec(target) if isinstance(target, str) else target
        check_requirements(record, record.kwargs)  # once, and not for each of a hundred instances
        name, make_env = record.id, partial(make, dataclasses.replace(record, requires=()))
    elif isinstance(target, gymnasium.Env):
        env: Any = target
        while isinstance(env, gymnasium.Wrapper) and not isinstance(env, Wrapper):
            notes.append(f"checked inside Gymnasium's {type(env).__name__}, which has none of GEM's methods")
            env = env.env
        names = [type(layer).__name__ for layer in layers_of(env)]
        name, make_env = getattr(env, "env_id", None) or " around ".join(names), Recipe.of(env).make
    elif callable(target):
        name, make_env = getattr(target, "__name__", repr(target)), target
    else:
        raise ArgumentError(f"check_env takes an id, an environment, or a class, not {target!r}")
    whole = Subject(name, make_env, limits, calls)
    whole.notes += notes
    try:
        with preserved():
            whole.new()
            whole.close_all()
    except GemError:
        raise
    except (Exception, SystemExit, TookTooLongError):  # noqa: BLE001 - ``construct`` reports it
        return [whole]
    return [Subject(name, make_env, limits, calls, seat) for seat in whole.seats] or [whole]


def layers_of(env: AnyEnv) -> list[AnyEnv]:
    """Return an environment's wrappers and its task, outermost first."""
    layers = [env]
    while isinstance(layers[-1], gymnasium.Wrapper):
        layers.append(layers[-1].env)
    return layers


def unchecked(env: AnyEnv) -> AnyEnv:
    """Make the guard of a stack pass results unchecked, since the promises check them."""
    for layer in layers_of(env):
        if isinstance(layer, Guard):
            layer.checks_results = False
    return env


def step_label(action: str) -> str:
    """Return how a call of ``step`` is named."""
    return f"step({shown(action)})"


def _check_there(send: Sender, packed: bytes, check: Callable[[Subject], Iterator[str]]) -> None:
    """Try a promise in the other process."""
    try:
        name, make_env, limits, seat, scripts, recorded = cloudpickle.loads(packed)
        send.allow(limits.reset_timeout_s)
        make_env().close()
    except (Exception, SystemExit) as error:  # noqa: BLE001 - third-party code
        send("not tried", f"in another process it cannot be made: {type(error).__name__}: {error}")
        return
    subject = Subject(name, make_env, limits, ProcessCalls(send), seat)
    subject.scripts_or_none, subject.recorded = scripts, recorded
    try:
        for sighting in subject.sightings(check):
            send("seen", sighting)
    except NotTriedError as error:
        send("not tried", str(error))
