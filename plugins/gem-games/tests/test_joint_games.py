"""What every game of two seats promises: turns, accounting, tries, what each seat hears, state, and random actions."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gem_core as gem
from gem_core.errors import ResetNeededError
from gem_core.testing import check_env
from gem_games.joint_game import TRIES

IDS = [env_id for env_id in gem.list_envs("game") if gem.spec(env_id).seats]
SECRET = "my-secret-plan"  # no other seat may read it
HOSTILE = st.text() | st.sampled_from(
    [
        "",
        "\\boxed{}",
        "\\boxed{" * 500,
        "\\boxed{\ud800}",
        "\\boxed{\u0665}",
        "<think>\\boxed{1}",
        "<say>",
        "</say><say>",
    ]
)


def played(env: Any, seed: int, hostile: dict[int, str] | None = None) -> list[Any]:
    """Play an episode by random actions, but for some steps in which all say something else; return all it gave."""
    records: list[Any] = [env.reset(seed=seed)]
    while env.agents:
        step = len(records)
        actions = {seat: (hostile or {}).get(step) or env.sample_random_action(seat) for seat in env.acting}
        records.append(env.step(actions))
        assert set(records[-1][0]) == set(env.acting)
        assert bool(env.acting) == bool(env.agents)
        assert step < 200
    return records


@pytest.mark.parametrize("env_id", IDS)
def test_record_names_the_seats(env_id: str) -> None:
    """As the environment does, and in the line that ``gem list`` shows."""
    spec = gem.spec(env_id)
    assert spec.seats == tuple(gem.make(env_id).unwrapped.possible_agents)
    assert f"seats {', '.join(spec.seats)}" in spec.summary


@pytest.mark.parametrize("env_id", IDS)
@given(seed=st.integers(0, 1_000), hostile=st.dictionaries(st.integers(1, 12), HOSTILE, max_size=6))
def test_any_game_ends_and_adds_up(env_id: str, seed: int, hostile: dict[int, str]) -> None:
    """Whatever a seat says: what was given is the sum of each seat, observations are complete, infos plain JSON."""
    env: Any = gem.make(env_id)
    records = played(env, seed, hostile)
    given_to = dict.fromkeys(env.possible_agents, 0.0)
    for record in records:
        observations, infos = record[0], record[-1]
        for seat, info in infos.items():
            observation = observations[seat] if seat in observations else info["final_obs"]
            assert observation == info["feedback"] + info["suffix"]
            assert info == json.loads(json.dumps(info))
            assert observation.encode()
            assert ("correct" in info) == ("final_obs" in info)
        for seat, reward in (record[1] if len(record) == 5 else {}).items():
            assert str(reward) != "-0.0"
            given_to[seat] += reward
    assert given_to == env.cumulative
    assert all(info["correct"] == (given_to[seat] > 0) for seat, info in records[-1][4].items())
    if "Negotiation" not in env_id:
        assert sum(given_to.values()) == 0
    assert max(map(abs, given_to.values())) <= max(env.stake, 1)


@pytest.mark.parametrize("env_id", IDS)
def test_random_actions_are_valid_and_seeds_decide(env_id: str) -> None:
    """No sampled action is refused, and the same seed gives the same episode in another instance."""
    env, other = gem.make(env_id), gem.make(env_id)
    for seed in range(20):
        records = played(env, seed)
        assert records == played(other, seed)
        read = [info["parsed_action"] for record in records for info in record[-1].values() if "parsed_action" in info]
        assert read
        assert None not in read
    with pytest.raises(ResetNeededError, match="call reset"):
        env.sample_random_action(env.possible_agents[0])  # type: ignore[call-arg,attr-defined]


@pytest.mark.parametrize("env_id", IDS)
def test_refused_answer_is_told_to_that_seat_alone(env_id: str) -> None:
    """The same seat acts again; the other hears nothing of it, nor of what a seat thinks."""
    env: Any = gem.make(env_id)
    seen: dict[str, list[str]] = {seat: [] for seat in env.possible_agents}
    observations, _ = env.reset(seed=4)
    step = 0
    while env.agents:
        actions = {seat: f"<think>{SECRET} of {seat}</think> {env.sample_random_action(seat)}" for seat in env.acting}
        seat = env.acting[0]
        if step < 2:
            actions[seat] = f"{SECRET} of {seat} \\boxed{{{SECRET} of {seat}}}"
        observations, _, _, _, infos = env.step(actions)
        if step < 2:
            assert env.acting == (seat,)
            assert f"{SECRET} of {seat}" in observations[seat]
            assert f"Tries left: {TRIES - 1 - step}." in observations[seat]
            assert infos[seat]["parsed_action"] is None
        for each, info in infos.items():
            seen[each].append(info["feedback"] + info["suffix"])
        step += 1
    for each, texts in seen.items():
        assert not any(f"{SECRET} of {other}" in text for other in seen if other != each for text in texts)


@pytest.mark.parametrize("env_id", IDS)
def test_thinking_is_not_read(env_id: str) -> None:
    """Neither a move nor, in Negotiation, a message; a block that is never closed goes to the end."""
    env: Any = gem.make(env_id)
    env.reset(seed=0)
    seat = env.acting[0]
    for closing in ("</think>", ""):
        actions = {each: env.sample_random_action(each) for each in env.acting}
        actions[seat] = f"<think>{actions[seat]} <say>{SECRET}</say>{closing}"
        env.step(actions)
        assert env.acting == (seat,)


@pytest.mark.parametrize("env_id", IDS)
def test_third_refused_answer_in_a_row_forfeits(env_id: str) -> None:
    """That seat gets the lowest reward of the game, the other the highest, and both are told."""
    env: Any = gem.make(env_id)
    env.reset(seed=0)
    loser = env.acting[0]
    for _ in range(TRIES - 1):
        env.step(
            dict.fromkeys(env.acting, "rubbish") | {other: env.sample_random_action(other) for other in env.acting[1:]}
        )
        assert env.acting == (loser,)
    _, rewards, terminations, _, infos = env.step({loser: "rubbish"})
    (winner,) = set(env.possible_agents) - {loser}
    assert rewards == {loser: -env.stake, winner: env.stake}
    assert terminations == {loser: True, winner: True}
    assert f"You gave no valid answer in {TRIES} tries." in infos[loser]["final_obs"]
    assert f"The player {loser!r} gave no valid answer in {TRIES} tries." in infos[winner]["final_obs"]
    assert "rubbish" not in infos[winner]["final_obs"]
    assert infos[loser]["correct"] is False


@pytest.mark.few(1)
@pytest.mark.parametrize("env_id", IDS)
def test_contract_is_kept(env_id: str) -> None:
    report = check_env(env_id)
    assert {"seats", "reasoning"} <= set(report.kept)


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("refused", [{0}, {1}, {0, 1, 2}], ids=str)
def test_fork_goes_on_with_answers_that_were_refused(env_id: str, refused: set[int]) -> None:
    """At every step, a refused answer, a forfeit and a move that waits for the other seat's included."""
    env: Any = gem.make(env_id, render_mode="ansi")
    assert env.render() == "The game has not begun."
    for seed in range(3):
        env.reset(seed=seed)
        step = 0
        while env.agents:
            sibling = env.fork()
            assert sibling.render() == env.render()
            actions = {seat: env.sample_random_action(seat) for seat in env.acting}
            if step in refused:
                actions[env.acting[0]] = "rubbish"
            assert sibling.step(actions) == env.step(actions)
            step += 1
