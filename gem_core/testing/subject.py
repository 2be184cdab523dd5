"""The environment under check: new instances of it, calls under a time limit, and episodes to repeat."""

from __future__ import annotations

import dataclasses
import io
import os
import pickle
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import cache, cached_property, partial
from types import FunctionType
from typing import Any, cast

import cloudpickle  # type: ignore[import-untyped]  # it has no types
import gymnasium

from gem_core.api import make, spec
from gem_core.env.base import Env
from gem_core.env.seeding import stable_hash
from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.errors import ArgumentError
from gem_core.making.again import Recipe
from gem_core.registry.requirements import check_requirements
from gem_core.registry.specs import EnvSpec
from gem_core.testing.comparing import play
from gem_core.testing.findings import NotTriedError, place_of, shown
from gem_core.testing.interpreter import CallError, Sender, sent_by
from gem_core.testing.isolation import ProcessWatch, Watch
from gem_core.testing.joint import SeenByOne, fitted, guarded, is_joint, layers_of, responses, say, split, step_label
from gem_core.types import Action

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
    actions: tuple[Action, ...]
    ended: bool


@dataclass(frozen=True)
class CheckLimits:
    """How much is tried, and how long a call may take; see ``check_env``."""

    seed: int = 0
    episodes: int = 3
    max_turns: int = 40
    step_timeout_s: float = 30.0
    reset_timeout_s: float = 300.0


class Subject:
    """The environment under check, as the promises use it."""

    def __init__(self, target: object, limits: CheckLimits, watch: Watch | None = None) -> None:
        self.limits = limits
        self.watch = watch or Watch()
        self.notes: list[str] = []
        self.name, self._make = self._maker(target)
        self._instances: list[AnyEnv] = []
        self.several = False
        """Whether several agents act in it."""
        self.package = ""
        """The module of the task's class."""
        self.recorded_scripts: list[Script] | None = None
        self.recorded: list[list[PlainResult]] | None = None
        """Results of each script, once they are known to repeat."""

    # Instances.

    def new(self) -> AnyEnv:
        """Return another instance with the same arguments; it is closed when the promise has been tried."""
        env = self.called(f"making {self.name}", self._make)
        if not isinstance(env, Env | Wrapper):
            raise ArgumentError(f"{self.name} is a {type(env).__name__}, which does not derive from gem_core.Env")
        self.package, self.several = type(env.unwrapped).__module__, is_joint(env)
        return self.own(guarded(env))

    def own(self, env: AnyEnv) -> AnyEnv:
        """Close an environment once the promise has been tried."""
        self._instances.append(env)
        return env

    def close_all(self) -> None:
        """Close the instances of the last promise; ``close-twice`` reports errors."""
        instances, self._instances = self._instances, []
        for env in instances:
            with suppress(Exception, SystemExit):
                self.close(env)

    def forget_all(self) -> None:
        """Forget the instances of a promise whose thread hangs, without closing them."""
        self._instances = []

    # Calls.

    def reset(self, env: AnyEnv, seed: int | None = None) -> Any:
        """Reset under the time limit."""
        return self.called(f"reset(seed={seed})" if seed is not None else "reset()", env.reset, seed=seed)

    def step(self, env: AnyEnv, action: Action) -> Any:
        """Step under the time limit."""
        step = cast("Callable[[Action], Any]", env.step)
        return self.watch.call(step_label(action), self.limits.step_timeout_s, step, action)

    def step_fitted(self, env: AnyEnv, action: Action) -> Any:
        """Step with an action of a script, also where others act in this episode than in that of the script."""
        return self.step(env, fitted(env, action))

    def sample(self, env: AnyEnv) -> Action:
        """Sample an action under the time limit."""
        return cast("Action", self.called("sample_random_action()", env.get_wrapper_attr("sample_random_action")))

    def close(self, env: AnyEnv) -> None:
        """Close under the time limit."""
        self.called("close()", env.close)

    def called(self, label: str, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Call anything else under the time limit."""
        return self.watch.call(label, self.limits.reset_timeout_s, function, *args, **kwargs)

    def told(self, error: BaseException) -> str:
        """Return an exception with its text and its place in the author's file."""
        place = place_of(error, self.package)
        return f"{type(error).__name__}: {shown(str(error))}" + (f" ({place})" if place else "")

    # Episodes.

    @property
    def seeds(self) -> list[int]:
        """The seeds of the episodes that are played."""
        return [stable_hash(self.limits.seed, "check", number) for number in range(self.limits.episodes + 1)]

    @property
    def scripts(self) -> list[Script]:
        """Episodes to repeat: sampled actions, and in the last one what an agent says that does not know the task."""
        if self.recorded_scripts is None:
            raise NotTriedError("no episode could be played; see 'episode'")
        return self.recorded_scripts

    def need_episodes(self) -> None:
        """Raise ``NotTriedError`` if no episode can be played."""
        len(self.scripts)

    def record_scripts(self) -> None:
        """Play the episodes that the other promises repeat."""
        env, sampling, scripts = self.new(), self.can_sample(), []
        for seed in self.seeds:
            self.reset(env, seed)
            actions: list[Action] = []
            ended = False
            while not ended and len(actions) < self.limits.max_turns:
                clumsy = CLUMSY_ACTIONS[len(actions) % len(CLUMSY_ACTIONS)]
                sampled = sampling and seed != self.seeds[-1]
                actions.append(self.sample(env) if sampled else say(env, clumsy))
                result = self.step(env, actions[-1])
                ended = bool(result[2] or result[3])
            scripts.append(Script(seed, tuple(actions), ended))
        self.recorded_scripts = scripts

    def can_sample(self) -> bool:
        """Tell whether the environment gives random actions; ``valid-sample`` says what is wrong where it does not."""
        env = self.new()
        self.reset(env, self.seeds[0])
        try:
            return all(isinstance(text, str) for text in responses(self.sample(env)).values())
        except Exception:  # noqa: BLE001 - a promise of its own tries and names it
            return False

    @cached_property
    def results(self) -> list[SeenByOne]:
        """Every result of the scripts as it is, as each agent got it."""
        return list(self.results_of(self.new()))

    def results_of(self, env: AnyEnv) -> Iterator[SeenByOne]:
        """Play all scripts, and give each result as each agent got it."""
        for where, result in self.calls_of(env):
            yield from split(env, where, result)

    def calls_of(self, env: AnyEnv) -> Iterator[tuple[str, Any]]:
        """Play all scripts, and give each result with the name of its call."""
        for script in self.scripts:
            yield f"reset(seed={script.seed})", self.reset(env, script.seed)
            for action in script.actions:
                result = self.step_fitted(env, action)
                yield step_label(action), result
                if result[2] or result[3]:
                    break

    def play(self, env: AnyEnv, script: Script) -> Iterator[PlainResult]:
        """Play a script from its reset."""
        return self.play_from(env, script.seed, script.actions)

    def play_from(self, env: AnyEnv, seed: int | None, actions: Sequence[Action]) -> Iterator[PlainResult]:
        """Reset and play some actions; without a seed, the next episode of the stream."""
        return play(lambda: self.reset(env, seed), partial(self.step_fitted, env), actions)

    def play_on(self, env: AnyEnv, actions: Sequence[Action]) -> Iterator[PlainResult]:
        """Continue an episode."""
        return play(None, partial(self.step_fitted, env), actions)

    @property
    def references(self) -> list[tuple[Script, list[PlainResult]]]:
        """Every script with its results, known to be the same each time."""
        self.need_episodes()
        self.expect_determinism()
        if self.recorded is None:
            raise NotTriedError("the same seed and actions do not repeat; see 'determinism'")
        return list(zip(self.scripts, self.recorded, strict=True))

    def expect_determinism(self) -> None:
        """Raise ``NotTriedError`` if the environment's record says that it is not deterministic."""
        made_from = self.new().unwrapped.spec
        if made_from is not None and made_from.nondeterministic:
            raise NotTriedError("its record says deterministic=False")

    def cuts(self, script: Script) -> list[int]:
        """Return the numbers of actions after which to fork: none, half, and all but the last."""
        last = len(script.actions) - 1
        return sorted({0, last // 2, max(last, 0)})

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
            yield f"{self.watch.last_call} raised {self.told(error)}"

    def elsewhere(self, check: Callable[[Subject], Iterator[str]]) -> Iterator[str]:
        """Yield how a promise is broken in another process, which has another hash seed and may hang or die.

        Raises:
            NotTriedError: The environment cannot be made there.
        """
        buffer = io.BytesIO()
        try:
            _Packer(buffer).dump((self._make, self.limits, self.name, self.recorded_scripts, self.recorded))
        except Exception as error:  # pickle calls methods of third-party classes
            why_not = f"{type(error).__name__}: {error}"
            raise NotTriedError(f"its arguments cannot be handed to another process: {why_not}") from error
        last_call = ""
        try:
            with closing(sent_by(_check_there, buffer.getvalue(), check)) as answers:
                for what, text in answers:
                    if what == "call":
                        last_call = text
                    elif what == "note":
                        self.notes.append(text)
                    elif what == "not tried":
                        raise NotTriedError(text)
                    else:
                        yield f"{text}, in another process"
        except CallError as error:
            yield f"{last_call}, in another process: {error}"

    def _maker(self, target: object) -> tuple[str, Callable[[], Any]]:
        if isinstance(target, str | EnvSpec):
            record = spec(target) if isinstance(target, str) else target
            check_requirements(record, record.kwargs)  # once, and not for each of a hundred instances
            return record.id, partial(make, dataclasses.replace(record, requires=()))
        if isinstance(target, gymnasium.Env):
            env = target
            while isinstance(env, gymnasium.Wrapper) and not isinstance(env, Wrapper):
                self.notes.append(f"checked inside Gymnasium's {type(env).__name__}, which has none of GEM's methods")
                env = env.env
            names = [type(layer).__name__ for layer in layers_of(env)]
            return getattr(env, "env_id", None) or " around ".join(names), Recipe.of(env).make
        if callable(target):
            return getattr(target, "__name__", repr(target)), target
        raise ArgumentError(f"check_env takes an id, an environment, or a class, not {target!r}")


class _Packer(cloudpickle.Pickler):  # type: ignore[misc]  # as above
    """Pickles the modules of tests by value, too: pytest gives them names that cannot be imported without pytest."""

    def reducer_override(self, obj: Any) -> Any:
        module = sys.modules.get(getattr(obj, "__module__", None) or "")
        if isinstance(obj, type | FunctionType) and module is not None and not _is_found(module):
            cloudpickle.register_pickle_by_value(module)
        return super().reducer_override(obj)


@cache
def _is_found(module: Any) -> bool:
    """Tell whether an import of its name, in an interpreter that has not imported it, leads to the file of a module."""
    package = module.__name__.rpartition(".")[0]
    path = getattr(sys.modules.get(package), "__path__", ()) if package else None
    for finder in sys.meta_path:
        found = finder.find_spec(module.__name__, path)
        if found is not None:
            return not found.has_location or os.path.realpath(found.origin or "") == os.path.realpath(module.__file__)
    return False


def _check_there(send: Sender, packed: bytes, check: Callable[[Subject], Iterator[str]]) -> None:
    """Try a promise in the other process."""
    try:
        make_env, limits, name, scripts, recorded = pickle.loads(packed)
        send.allow(limits.reset_timeout_s)
        make_env().close()
    except (Exception, SystemExit) as error:  # noqa: BLE001 - third-party code
        send(("not tried", f"in another process it cannot be made: {type(error).__name__}: {error}"))
        return
    subject = Subject(make_env, limits, ProcessWatch(send))
    subject.name, subject.recorded_scripts, subject.recorded = name, scripts, recorded
    try:
        for sighting in subject.sightings(check):
            send(("seen", sighting))
    except NotTriedError as error:
        send(("not tried", str(error)))
    for note in subject.notes:
        send(("note", note))
