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
import pytest
from broken_envs import (
    BROKEN,
    BacktrackingEnv,
    Bids,
    DyingEnv,
    NullHangsEnv,
    OtherProcessEnv,
    RaisingEnv,
    UnrepeatableEnv,
)
from joint_toys import AuctionEnv, CountdownEnv
from reference_envs import GoodAsyncEnv, GoodEnv, PictureEnv, ThreadEnv

from gem_core import EnvSpec, make, register
from gem_core.env.guard import Guard
from gem_core.errors import ArgumentError
from gem_core.testing import ContractError, check_env
from gem_core.testing.promises import OF_ONE, OF_SEVERAL, PROMISES
from gem_core.wrappers.episode_stats import EpisodeStats

ALL = set(PROMISES)
SHORT = EnvSpec(id="check:Countdown-v0", entry_point=CountdownEnv, seats=("first", "second"), max_turns=3)
register("check:Good-v0", GoodEnv, limit=7)


def broken_by(target: Any, **options: Any) -> dict[str, str]:
    with pytest.raises(ContractError) as caught:
        check_env(target, **options)
    return dict(caught.value.report.broken)


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


def test_what_cannot_be_forked_is_skipped() -> None:
    """With what it holds."""

    class Locked(GoodEnv):
        def __init__(self) -> None:
            super().__init__()
            self.lock = threading.Lock()

    assert "cannot pickle '_thread.lock' object" in check_env(Locked).skipped["fork"]


@pytest.mark.parametrize(
    "target",
    [
        "check:Good-v0",
        GoodAsyncEnv,
        ThreadEnv,
        PictureEnv,
        EpisodeStats(gymnasium.wrappers.TransformReward(Guard(GoodEnv(limit=5)), float)),
    ],
    ids=lambda target: getattr(target, "__name__", str(target)[:20]),
)
def test_good_environment_keeps_every_promise(target: Any) -> None:
    """By id, asynchronous, blocking, with images, and wrapped: nothing is broken and nothing left out."""
    random_state = random.getstate()
    report = check_env(target)
    assert set(report.kept) == ALL - {*OF_SEVERAL}
    assert (report.skipped, report.notes) == ({}, ())
    assert random.getstate() == random_state


@pytest.mark.parametrize(
    "target",
    [Bids, AuctionEnv(["a", "b"], mode="parallel", rounds=7), make(SHORT, wrappers={"second": "concat,episode_stats"})],
    ids=["in turn", "at once", "wrapped"],
)
def test_good_environment_of_several_agents_keeps_every_promise(target: Any) -> None:
    """At each seat. An auction has no right answer, and does not say so."""
    report = check_env(target)
    assert set(report.kept) == ALL - {*OF_ONE}
    assert report.skipped == {}
    assert all(note.startswith("info: ") for note in report.notes)


@pytest.mark.few(12)
@pytest.mark.parametrize("maker", BROKEN, ids=lambda maker: getattr(maker, "__name__", "record"))
def test_broken_promise_is_named(maker: Any) -> None:
    """Exactly the promises that an environment breaks are named, in one line each."""
    breaks, may_break = BROKEN[maker]
    with pytest.raises(ContractError) as caught:
        check_env(maker, skip={} if "hostile-actions" in breaks else {"hostile-actions": "it takes longest"})
    broken = caught.value.report.broken
    assert breaks <= set(broken) <= breaks | may_break
    lines = str(caught.value).splitlines()[1:]
    assert [line.split(":")[0].strip() for line in lines if not line.startswith(("  not", "  note"))] == [*broken]
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def test_every_promise_can_be_broken() -> None:
    """For each promise, some environment of these tests breaks it, and the text says how to mend it."""
    assert set().union(*(slugs for slugs, _ in BROKEN.values())) == ALL
    for promise in PROMISES.values():
        assert promise.sentence.endswith(".")
        assert promise.mend.endswith(".")


def test_seat_that_never_acts_is_noted() -> None:
    """The others are tried."""

    class Quiet(Bids):
        def begin_episode(self, options: Any) -> None:
            super().begin_episode(options)
            self.agents = ["red", "green"]

    (note,) = (note for note in check_env(Quiet).notes if not note.startswith("info: "))
    assert note.startswith("the seat 'blue' was not tried: ")


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


def test_unknown_promise_cannot_be_skipped() -> None:
    with pytest.raises(ArgumentError, match="'determinism'"):
        check_env(GoodEnv, skip={"determinsm": "typo"})


def test_foreign_environment_is_refused() -> None:
    with pytest.raises(ArgumentError, match=r"gem_core\.Env"):
        check_env(lambda: gymnasium.make("CartPole-v1"))


def test_gymnasium_wrapper_outside_is_taken_off_and_noted() -> None:
    report = check_env(gymnasium.wrappers.TimeLimit(GoodEnv(), max_episode_steps=3))
    assert report.notes == ("checked inside Gymnasium's TimeLimit, which has none of GEM's methods",)


def test_importing_the_checks_needs_no_test_library() -> None:
    code = (
        "import sys, gem_core.testing as t; t.check_env; t.hostile_actions;"
        "print([m for m in ('pytest', 'hypothesis', 'PIL') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
