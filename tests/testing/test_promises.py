"""check_env passes what keeps the contract, and names every promise that is broken."""

from __future__ import annotations

import os
import pickle
import random
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from broken_envs import BROKEN, BacktrackingEnv, DyingEnv, NullHangsEnv, OtherProcessEnv, RaisingEnv, UnrepeatableEnv
from reference_envs import CountingWrapper, GoodAsyncEnv, GoodEnv, PictureEnv, ReverseStringEnv, ThreadEnv

from gem_core import register
from gem_core.env.guard import Guard
from gem_core.errors import ArgumentError, GemError, UnknownEnvError
from gem_core.testing import ContractError, check_env
from gem_core.testing.conformance import promises_for
from gem_core.testing.contract import PROMISES

OF_ONE = {promise.slug for promise in promises_for(several=False)}


def broken_by(target: Any, **options: Any) -> dict[str, str]:
    with pytest.raises(ContractError) as caught:
        check_env(target, **options)
    return dict(caught.value.report.broken)


@pytest.mark.parametrize(
    "target",
    [GoodEnv, GoodAsyncEnv, ThreadEnv, GoodEnv(limit=3, max_turns=1), CountingWrapper(GoodEnv(limit=5), step=2)],
    ids=lambda target: getattr(target, "__name__", type(target).__name__),
)
def test_good_environment_keeps_every_promise(target: Any) -> None:
    """Plain, asynchronous, blocking, with arguments and wrapped: nothing is broken and nothing left out."""
    report = check_env(target)
    assert set(report.kept) == OF_ONE
    assert report.skipped == {}
    assert report.notes == ()


@pytest.mark.few(12)
@pytest.mark.parametrize("maker", BROKEN, ids=lambda maker: maker.__name__)
def test_broken_promise_is_named(maker: Any) -> None:
    """Exactly the promises that an environment breaks are named, in one line each."""
    breaks, may_break = BROKEN[maker]
    with pytest.raises(ContractError) as caught:
        check_env(maker)
    report = caught.value.report
    assert breaks <= set(report.broken) <= breaks | may_break
    lines = str(caught.value).splitlines()
    assert [line.split(":")[0].strip() for line in lines[1:] if not line.startswith(("  not", "  note"))] == [
        *report.broken
    ]


def test_a_step_that_raises_is_said_first_with_its_place() -> None:
    """One line says what raises and where in the author's file, and one what could not be tried for that reason."""
    with pytest.raises(ContractError) as caught:
        check_env(RaisingEnv)
    line = RaisingEnv.answer_to.__code__.co_firstlineno - 2  # where step converts the action
    _, raised, untried = str(caught.value).splitlines()
    assert raised.startswith("  episode: ")
    assert "step('') raised ValueError" in raised
    assert f"broken_envs.py:{line})" in raised
    assert untried.startswith("  not tried, types, ")


def test_every_promise_can_be_broken() -> None:
    """For each promise, some environment of these tests breaks it."""
    assert set().union(*(slugs for slugs, _ in BROKEN.values())) == OF_ONE


def test_every_promise_says_what_it_is_and_how_to_mend_it() -> None:
    for promise in PROMISES.values():
        assert promise.sentence.endswith(".")
        assert promise.mend.endswith(".")


def test_paper_listing_breaks_what_it_breaks() -> None:
    """The second listing of arXiv:2510.01051 runs; these are the promises that it does not keep."""
    broken = broken_by(ReverseStringEnv)
    of_steps = {"episode", "types", "hostile-actions", "valid-sample", "gymnasium"}
    assert set(broken) == {"determinism", "global-random", *of_steps}
    assert "reset() changed the state of random" in broken["global-random"]
    assert "terminated and truncated, both True" in broken["types"]
    assert "does not provide an `options`" in broken["gymnasium"]


def test_what_cannot_be_forked_is_skipped() -> None:
    """With what it holds."""

    class Locked(GoodEnv):
        def __init__(self) -> None:
            super().__init__()
            self.lock = threading.Lock()

    assert "cannot pickle '_thread.lock' object" in check_env(Locked).skipped["fork"]


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("deed", "seen"),
    [("die", "the process ended with exit code 3"), ("leave", "raised SystemExit"), ("hang", "no answer within 2 s")],
)
def test_what_goes_wrong_in_another_process_is_named(deed: str, seen: str) -> None:
    """And does not end the check."""
    broken = broken_by(OtherProcessEnv(os.getpid(), deed), step_timeout_s=2.0)
    assert set(broken) == {"process-determinism", "hostile-actions"}
    assert seen in broken["process-determinism"]


def test_strings_hash_differently_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where this process has a fixed hash seed; a class of a script needs no main guard."""
    script = (
        "from reference_envs import GoodEnv\nfrom gem_core.testing import check_env\n"
        "class MineEnv(GoodEnv):\n    def hint(self, guess): return str(hash('number'))\n"
        "check_env(MineEnv, skip={'hostile-actions': 'it takes longest'})"
    )
    monkeypatch.setenv("PYTHONHASHSEED", "1")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *sys.path]))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "  process-determinism: " in done.stderr


class EnvOfATest(GoodEnv):
    """In a module that only pytest can import by its name, with ``--import-mode=importlib``."""


def test_class_of_a_test_is_tried_there_too() -> None:
    """It is sent by value."""
    assert "process-determinism" in check_env(EnvOfATest).kept


def test_arguments_that_cannot_be_pickled_are_a_reason_to_skip() -> None:
    report = check_env(OtherProcessEnv(os.getpid(), threading.Lock()))  # type: ignore[arg-type]
    assert set(report.skipped) == {"process-determinism", "fork"}
    assert "hostile-actions" in report.kept


def test_environment_by_id_keeps_its_promises_in_another_process_too() -> None:
    """An id that only this process registered is handed over by its entry point."""
    register("check:Good-v0", GoodEnv, limit=7)
    assert set(check_env("check:Good-v0").kept) == OF_ONE


def test_nondeterministic_environment_is_not_asked_to_repeat() -> None:
    """What the record rules out is skipped with that reason; Gymnasium's checker heeds the record as well."""
    register("check:Unrepeatable-v0", UnrepeatableEnv, deterministic=False)
    report = check_env("check:Unrepeatable-v0")
    assert report.skipped["determinism"] == "its record says deterministic=False"
    assert "hostile-actions" in report.kept


@pytest.mark.parametrize(
    ("env", "action", "seen"),
    [
        (NullHangsEnv, "x00", "gave no answer within 1 s"),
        (BacktrackingEnv, "step('<python><python>", "in another process: it gave no answer within 1 s"),
        (DyingEnv, "x00", "exit code 3"),
    ],
)
def test_step_that_hangs_or_ends_the_process_is_named(env: Any, action: str, seen: str) -> None:
    """With its action; it ends that promise and not the check, even where it lets no other thread run."""
    try:
        broken = broken_by(env, step_timeout_s=1.0)
    finally:
        NullHangsEnv.released.set()
    assert list(broken) == ["hostile-actions"]
    assert action in broken["hostile-actions"]
    assert seen in broken["hostile-actions"]


def test_given_instance_is_left_alone() -> None:
    """An environment can be checked in the middle of an episode."""
    env = GoodEnv()
    env.reset(seed=3)
    other = env.fork()
    check_env(env)
    assert env.step("x") == other.step("x")


def test_global_random_state_survives_the_check() -> None:
    """The checks scramble the global generators, also for an environment that draws from them."""
    before, numpy_before = random.getstate(), np.random.get_state()[1].tolist()
    broken_by(ReverseStringEnv)
    assert random.getstate() == before
    assert np.random.get_state()[1].tolist() == numpy_before


def test_no_thread_is_left_behind() -> None:
    before = {thread for thread in threading.enumerate() if thread.name == "gem-check"}
    check_env(GoodEnv)
    assert {thread for thread in threading.enumerate() if thread.name == "gem-check"} <= before


def test_skipped_promise_keeps_its_reason() -> None:
    report = check_env(GoodEnv, skip={"hostile-actions": "costs money"})
    assert dict(report.skipped) == {"hostile-actions": "costs money"}
    assert "not tried, hostile-actions: costs money" in str(report)


def test_unknown_promise_cannot_be_skipped() -> None:
    with pytest.raises(ArgumentError, match="'determinism'"):
        check_env(GoodEnv, skip={"determinsm": "typo"})


def test_unknown_id_stays_what_it_is() -> None:
    """What cannot be made for a reason outside the environment is no broken promise."""
    with pytest.raises(UnknownEnvError):
        check_env("check:NoSuch-v0")


def test_foreign_environment_is_refused() -> None:
    with pytest.raises(ArgumentError, match=r"gem_core\.Env"):
        check_env(lambda: gymnasium.make("CartPole-v1"))


class UngradedEnv(GoodEnv):
    """It never says whether an answer was right."""

    def step(self, action: str) -> Any:
        *result, info = super().step(action)
        return *result, {key: value for key, value in info.items() if key != "correct"}


def test_an_environment_that_never_says_correct_gets_a_note() -> None:
    """Success is unknown there, which may be meant."""
    (note,) = check_env(UngradedEnv).notes
    assert note.startswith("info-keys: ")


def test_gymnasium_wrapper_outside_is_taken_off_and_noted() -> None:
    report = check_env(gymnasium.wrappers.TimeLimit(GoodEnv(), max_episode_steps=3))
    assert report.notes == ("checked inside Gymnasium's TimeLimit, which has none of GEM's methods",)


def test_gymnasium_wrapper_within_is_checked() -> None:
    """Its fork too."""
    target = CountingWrapper(gymnasium.wrappers.TransformReward(Guard(GoodEnv(limit=5)), float))
    assert "fork" in check_env(target).kept


def test_images_in_observations_and_info_are_compared() -> None:
    """Content parts with pictures keep every promise."""
    pytest.importorskip("PIL")
    assert set(check_env(PictureEnv).kept) == OF_ONE


def test_contract_error_is_an_assertion_and_survives_pickling() -> None:
    with pytest.raises(AssertionError) as caught:
        check_env(ReverseStringEnv)
    assert isinstance(caught.value, GemError)
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value)


def test_importing_the_checks_needs_no_test_library() -> None:
    code = (
        "import sys, gem_core.testing as t; t.check_env; t.hostile_actions;"
        "print([m for m in ('pytest', 'hypothesis', 'PIL') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
