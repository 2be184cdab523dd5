"""The same seed and actions give the same trajectories in every backend, whatever the order of completion."""

from __future__ import annotations

import os
import random
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
import vector_envs
from hypothesis import given, settings
from hypothesis import strategies as st
from vector_envs import ASYNC, INLINE, KINDS, PROCESS, THREAD, Turns

import gem_core as gem
from gem_core.records.plans import PlanItem
from gem_core.registry.lookup import registry

BACKENDS = ["async", ("process", {"workers": 2}), "auto"]
TEXTS = ["", "stop", "a!", r"\boxed{3}", "é\ud800\x00", "42", "[A B C D]"]


EVERY = int(os.environ.get("GEM_EVERY_TEXTARENA", "15"))
"""How many of TextArena's many games, which are slow, are left out for each that is tried; 1 tries all."""


def registered() -> list[str]:
    """Return every deterministic environment of the plugins that are installed, and the toys."""
    found = []
    for env_id in gem.list_envs():
        record = registry().env(env_id)
        known = registry().provider(env_id) is not None or env_id.startswith("toy:")  # no other test's own
        if known and record.deterministic and set(record.requires) <= {"package:gem-games[textarena]"}:
            found.append(env_id)
    games = [env_id for env_id in found if env_id.startswith("ta:")]
    return [env_id for env_id in found if env_id not in games or games.index(env_id) % EVERY == 0]


def plain(value: Any) -> Any:
    """Return a result in a form that can be compared, without the durations in it."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        return {name: plain(part) for name, part in value.items() if name != "t"}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    return value


def chosen(vector: gem.VectorEnv, slot: int, chance: random.Random, agent: str | None = None) -> str:
    """Return a sampled action, where the environment has one, else a text."""
    try:
        return vector.sample_random_action(slot, agent) if chance.random() < 0.7 else chance.choice(TEXTS)
    except gem.errors.SamplingNotSupported:
        return chance.choice(TEXTS)


def trajectory(vector: gem.VectorEnv, turns: int) -> list[Any]:
    """Reset and step all slots; return all that was given."""
    chance = random.Random(7)
    observations, infos = vector.reset()
    kept = [plain((observations, infos))]
    for _ in range(turns):
        actions: list[Any] = []
        for slot, observation in enumerate(observations):
            if vector.start_of(slot) is None:
                actions.append("")
            elif isinstance(observation, dict):
                actions.append({agent: chosen(vector, slot, chance, agent) for agent in observation})
            else:
                actions.append(chosen(vector, slot, chance))
        step = vector.step(actions)
        observations = step.observations
        kept.append((actions, plain(step)))
    return kept


def assert_same_everywhere(ids: str | list[str], count: int, turns: int, **options: Any) -> None:
    """Compare every backend with ``sync``."""
    with gem.make_vec(ids, count, backend="sync", seed=11, **options) as vector:
        expected = trajectory(vector, turns)
    for backend in BACKENDS:
        with gem.make_vec(ids, count, backend=backend, seed=11, **options) as vector:
            found = trajectory(vector, turns)
        for turn, (one, other) in enumerate(zip(found, expected, strict=True)):
            assert one == other, (backend, turn)


def batches(ids: list[str], size: int) -> Iterable[list[str]]:
    return [ids[begin : begin + size] for begin in range(0, len(ids), size)]


@pytest.mark.thorough
@pytest.mark.parametrize("ids", batches(registered(), 40), ids=lambda ids: f"{ids[0]}…")
def test_every_registered_environment_gives_the_same_in_every_backend(ids: list[str]) -> None:
    """Observations, rewards, flags and infos, slot by slot, in one batch of many ids."""
    assert_same_everywhere(ids, len(ids), 12)


@pytest.mark.few(1)
@pytest.mark.parametrize("autoreset", ["same_step", "next_step"])
def test_every_registered_environment_gives_the_same_under_a_plan(autoreset: str) -> None:
    """Also where a slot goes from one environment to the next, until it is idle."""
    ids = registered()
    plan = [PlanItem(id=ids[key % len(ids)], repeat=1 + key % 2) for key in range(min(60, 2 * len(ids)))]
    assert_same_everywhere(ids[:4], 5, 40, plan=plan, autoreset=autoreset)


def test_wrapped_environments_give_the_same() -> None:
    """Wrappers go along to where their environments live."""
    wrappers = ["concat", "episode_stats", ("turn_limit", {"max_turns": 3})]
    assert_same_everywhere(["toy:Countdown-v0", "toy:Sums-v0", *KINDS], 8, 10, wrappers=wrappers)


@settings(max_examples=3)
@given(st.data())
def test_a_step_is_the_same_whatever_the_order_of_completion(data: st.DataObject) -> None:
    """All four kinds in one batch, with a plan and unequal lengths; the steps finish in an order that is drawn."""
    count = 8
    lengths = data.draw(st.lists(st.integers(1, 4), min_size=12, max_size=12))
    plan = [PlanItem(options={"length": length}) for length in lengths]
    orders = data.draw(st.lists(st.permutations(range(count)), min_size=6, max_size=6))
    seed = data.draw(st.integers(0, 2**53))
    with (
        gem.make_vec(list(KINDS), count, backend="sync", seed=seed, plan=plan) as here,
        gem.make_vec(list(KINDS), count, backend=("auto", {"workers": 1}), seed=seed, plan=plan) as there,
    ):
        assert plain(here.reset()) == plain(there.reset())
        for turn, order in enumerate(orders):
            actions = [f"{slot}@order {turn}" for slot in range(count)]
            expected = plain(here.step(actions))
            # Those that live elsewhere, or run in place, finish when they like.
            free = {slot for slot in range(count) if there.ids[slot] in (THREAD, ASYNC) and there.start_of(slot)}
            vector_envs.TURNS["order"] = Turns([slot for slot in order if slot in free])
            try:
                assert plain(there.step(actions)) == expected
            finally:
                vector_envs.TURNS.clear()


def test_resets_that_fail_draw_in_the_same_order() -> None:
    """Which slot gets which item does not depend on where a reset failed."""
    plan = [PlanItem(options={"fault": "raise"} if key in (1, 4, 5, 6) else None) for key in range(14)]
    kept = []
    for home in ("sync", "async", "auto"):
        with gem.make_vec([THREAD, PROCESS, ASYNC], 3, backend=home, seed=4, plan=plan) as vector:
            kept.append([plain(vector.reset()), *(plain(vector.step([f"a{turn}"] * 3)) for turn in range(16))])
    assert kept[0] == kept[1] == kept[2]


def received(vector: gem.VectorEnv) -> dict[tuple[str, int], list[Any]]:
    """Drive all slots by ``send`` and ``recv``; return what each episode was, by its key."""
    episodes: dict[tuple[str, int], list[Any]] = {}
    observations, infos = vector.reset()
    running: dict[int, tuple[str, int]] = {}

    def begin(slot: int, observation: Any, info: dict[str, Any]) -> None:
        draw = vector.start_of(slot)
        if draw is None:
            running.pop(slot, None)
            return
        running[slot] = draw.key, draw.repeat
        own = {name: value for name, value in info.items() if not name.startswith("final_")}
        episodes[draw.key, draw.repeat] = [observation, plain(own)]

    for slot in range(vector.num_envs):
        begin(slot, observations[slot], infos[slot])
    ready = dict(running)
    while running:
        vector.send({slot: f"{key[0]}.{len(episodes[key])}" for slot, key in ready.items()})
        came = vector.recv()
        ready = {}
        for slot, observation, *values, info in zip(*came, strict=True):
            last = values[1] or values[2]
            final = (info["final_obs"], info["final_info"]) if last else (observation, info)
            episodes[running[slot]].append(plain([*values, *final]))
            if last:
                begin(slot, observation, info)
        ready = {slot: running[slot] for slot in came.slots if slot in running}
    return episodes


def test_send_and_recv_give_the_same_episodes() -> None:
    """By key, since slots draw as they come."""
    plan = [PlanItem(repeat=1 + key % 3) for key in range(20)]
    results = []
    for number, backend in enumerate(["sync", *BACKENDS]):
        with gem.make_vec(INLINE, 3 + number, backend=backend, seed=9, plan=plan) as vector:
            results.append(received(vector))
    assert len(results[0]) == sum(item.repeat for item in plan)
    assert all(result == results[0] for result in results)


def test_arguments_that_come_with_an_id_are_there_when_its_backend_is_chosen() -> None:
    """Also where a function makes the environment, which says what it needs only once it is made."""

    def of_folder(*, folder: str) -> gem.Env:
        assert folder == "here"
        return gem.make(INLINE)

    gem.register("vt:OfFolder-v0", of_folder, requires=("argument:folder",))
    with gem.make_vec([("vt:OfFolder-v0", {"folder": "here"})], 2) as vector:
        assert vector.num_envs == 2
