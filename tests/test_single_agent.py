"""``single_agent``: one seat of an environment of several agents as an environment of its own."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Callable
from typing import Any

import pytest
import toys
from hypothesis import given
from hypothesis import strategies as st
from joint_toys import AuctionEnv, CountdownEnv

import gem_core as gem
from gem_core import MultiAgentEnv, single_agent
from gem_core.background import run_sync
from gem_core.errors import ArgumentError, EnvFaultError, RequestError, ResetNeededError, UnknownAgentError
from gem_core.rollouts import Context
from gem_core.testing import check_env

BIDS = ["1", "7", "?", "4", "2"]


def scripted(observation: Any, context: Context) -> str:
    """Bid by the number of the turn, and by the seat."""
    return BIDS[(context.turn + ord(str(context.seat))) % len(BIDS)]


async def scripted_async(observation: Any, context: Any) -> str:
    """Do the same later."""
    await asyncio.sleep(0)
    return scripted(observation, context)


def play(env: Any, actions: list[str], seed: int = 3) -> list[Any]:
    """Return all results of an episode in which these actions are taken in turn."""
    results = [env.reset(seed=seed)]
    for action in actions:
        results.append(env.step(action))
        if results[-1][2] or results[-1][3]:
            break
    return results


@pytest.mark.parametrize("others", [scripted, scripted_async])
@given(
    bids=st.lists(st.sampled_from(["0", "3", "9", "quit", "?"]), min_size=1, max_size=6),
    seat=st.sampled_from("abc"),
    mode=st.sampled_from(["sequential", "parallel"]),
)
def test_the_seat_has_what_it_has_in_the_bare_game(others: Any, bids: list[str], seat: str, mode: Any) -> None:
    """Observations, rewards, flags and infos of the seat are those of the same game with all seats open."""
    env = single_agent(AuctionEnv(["a", "b", "c"], mode, 12), seat, others)
    results = play(env, bids)
    bare = AuctionEnv(["a", "b", "c"], mode, 12)
    observations, infos = bare.reset(seed=3)
    turns, own, rewards = dict.fromkeys("abc", 0), iter(bids[: len(results) - 1]), dict.fromkeys("abc", 0.0)
    expected: list[Any] = []
    while len(expected) < len(results):
        if seat in rewards and (seat in observations or seat not in bare.agents):
            info = infos[seat]
            seen = observations[seat] if seat in observations else info.pop("final_obs")
            ended = bare.terminations[seat], bare.truncations[seat]
            expected.append((seen, rewards[seat], *ended, info) if expected else (seen, info, rewards[seat]))
            if len(expected) == len(results):
                break
        actions = {}
        for agent in observations:
            actions[agent] = next(own) if agent == seat else BIDS[(turns[agent] + ord(agent)) % len(BIDS)]
            turns[agent] += 1
        observations, rewards, _, _, infos = bare.step(actions)
    *reset, early = expected[0]
    assert results[0] == tuple(reset)
    if len(expected) > 1:
        expected[1] = (expected[1][0], expected[1][1] + early, *expected[1][2:])
    assert results[1:] == expected[1:]


def test_contract_is_kept() -> None:
    """``check_env`` passes where the environment is made by its id, and the others act at random."""
    gem.register("joint:Heap-v1", CountdownEnv, seats=("first", "second"))
    check_env(single_agent("joint:Heap-v1", "second"))


def test_it_is_registered_as_any_environment() -> None:
    """By the entry point and the id of the game; wrappers go around it, and its arguments can be changed."""
    gem.register("joint:Heap-v2", CountdownEnv, seats=("first", "second"))
    gem.register("joint:Heap-v2-solo", "gem_core.rollouts:single_agent", env="joint:Heap-v2", seat="first")
    env: Any = gem.make("joint:Heap-v2-solo", wrappers="concat", seat="second", others=lambda seen: "\\boxed{1}")
    assert env.reset(seed=1) == env.spec.make().reset(seed=1)
    assert env.unwrapped.seat == "second"
    (episode,) = gem.rollout(env, toys.sampling_agent, episodes=1, seed=0)
    assert episode.id == "joint:Heap-v2-solo"
    assert episode.final_info["correct"] == (episode.episode_return == 1.0)


def test_sampling_for_the_seat_changes_nothing_for_the_others() -> None:
    """Random opponents draw from generators of their own, anew in each turn; the seat's own can be seeded."""
    env = single_agent(AuctionEnv(["a", "b", "c"], "sequential", 30), "b")

    def watch(samples: int) -> list[Any]:
        seen: list[Any] = [env.reset(seed=5)]
        for _ in range(6):
            for _ in range(samples):
                env.sample_random_action()
            seen.append(env.step("1"))
        return seen

    assert watch(0) == watch(3)
    assert len(set(env.unwrapped.env.bids[::3])) > 2  # type: ignore[attr-defined]  # those of the seat 'a'
    sampled = []
    for seed in (1, 2, 1):
        env.reset(seed=5)
        env.seed_actions(seed)
        sampled.append([env.sample_random_action() for _ in range(9)])
    assert sampled[0] == sampled[2] != sampled[1]


def test_each_other_seat_has_a_conversation_of_its_own() -> None:
    """It reads messages with its own turns alone, under its seat, and its reasoning reaches nobody."""
    heard: dict[str, Any] = {}

    class Reader:
        reads = "messages"
        system = "Bid."

        def __call__(self, messages: Any, context: Any) -> str:
            heard[context.seat] = (messages, context.episode, context.env_id, context.turn)
            return gem.Response("7", reasoning="I am greedy")

    env = single_agent(AuctionEnv(["a", "b", "c"], "sequential", 9), "b", {"a": Reader()})
    results = play(env, ["1", "1"], seed=8)
    assert heard.keys() == {"a"}
    messages, *rest = heard["a"]
    assert rest == ["8.0", "AuctionEnv", 2]
    assert [message["role"] for message in messages] == ["system", "user", "assistant", "user", "assistant", "user"]
    assert messages[2] == {"role": "assistant", "content": "7"}
    assert "greedy" not in json.dumps([results, env.env.bids])


def test_an_opponent_is_drawn_by_the_seed_of_the_episode() -> None:
    """From the list, the same for the same seed, and each in its turn."""
    names = ["1", "2", "3"]
    env = single_agent(AuctionEnv(["a", "b"], "sequential"), "b", [lambda seen, name=name: name for name in names])
    drawn = [env.reset(seed=seed)[0] for seed in range(30)]
    assert drawn == [env.reset(seed=seed)[0] for seed in range(30)]
    assert set(drawn) == {f"You are b. Bids: {name}" for name in names}


def test_async_opponents_that_act_at_once_are_asked_side_by_side() -> None:
    """Each waits for the other; plain code waits for both on the library's loop."""
    asked: list[str] = []

    async def sociable(observation: Any, context: Any) -> str:
        asked.append(context.seat)
        while len(asked) % 2:
            await asyncio.sleep(0)
        return "1"

    env = single_agent(AuctionEnv(["a", "b", "c"], "parallel"), "b", sociable)
    assert env.concurrency == "async"
    assert single_agent(AuctionEnv(["a", "b"]), "b", scripted).concurrency == "inline"
    env.reset(seed=0)
    assert env.step("2")[0] == "You are b. Bids: 1 2 1"
    assert run_sync(env.step_async("3"))[0] == "You are b. Bids: 1 2 1 1 3 1"


def failing(error: Any) -> Callable[[Any, Any], str]:
    """Return an agent that raises in its second turn, or returns what is no text."""

    def agent(observation: Any, context: Any) -> str:
        if context.turn and isinstance(error, BaseException):
            raise error
        return error if context.turn else "5"

    return agent


def failing_async(error: Any) -> Any:
    """Return the same as a coroutine function."""

    async def agent(observation: Any, context: Any) -> str:
        return failing(error)(observation, context)

    return agent


@pytest.mark.parametrize(
    ("kind", "error", "message"),
    [
        (failing, SystemExit("bye"), "SystemExit: bye"),
        (failing, None, "AgentError.*NoneType"),
        (failing_async, RequestError("no answer"), "RequestError: no answer"),
        (failing_async, asyncio.CancelledError(), "AgentError.*cancel"),
    ],
)
def test_a_failing_opponent_is_an_error_and_no_loss(kind: Any, error: Any, message: str) -> None:
    """The episode is truncated, with what the seat has earned; the next one begins anew."""
    env = single_agent(AuctionEnv(["a", "b"], "sequential"), "b", kind(error))
    env.reset(seed=0)
    observation, reward, terminated, truncated, info = env.step("3")
    assert info["error"]["kind"] == "opponent"
    assert re.search(message, info["error"]["message"])
    assert (observation, reward, terminated, truncated) == ("You are b. Bids: 5 3", -2.0, False, True)
    with pytest.raises(ResetNeededError):
        env.step("1")
    assert env.reset(seed=0)[0] == "You are b. Bids: 5"


@pytest.mark.parametrize(
    ("mode", "shown"),
    [("parallel", "You are b. Bids: 5 1"), ("sequential", "You are b. Bids: 5\n1\nYou are b. Bids: 5 1")],
)
def test_wrappers_of_the_seat_hear_of_the_end(mode: str, shown: str) -> None:
    """A view shows what a response came to; one that no response led to is the bare observation."""
    gem.register(f"joint:Auction-v8-{mode}", AuctionEnv, agents=["a", "b"], mode=mode)
    joint: Any = gem.make(f"joint:Auction-v8-{mode}", wrappers={"b": "concat_with_action"})
    env = single_agent(joint, "b", lambda seen, context: None if context.turn else "5")
    env.reset(seed=0)
    result = env.step("1")
    while not result[3]:
        result = env.step("2")
    assert result[4]["error"]["kind"] == "opponent"
    assert result[0] == shown


def test_an_opponent_that_fails_in_reset_raises() -> None:
    """The caller sees the cause."""

    def broken(observation: Any) -> str:
        raise RequestError("no answer")

    beside = single_agent(AuctionEnv(["a", "b", "c"], "parallel"), "b", {"a": scripted_async, "c": broken})
    beside.reset(seed=0)
    assert "no answer" in beside.step("1")[4]["error"]["message"]  # and no coroutine is left over
    env = single_agent(AuctionEnv(["a", "b"], "sequential"), "b", broken)
    with pytest.raises(EnvFaultError, match=r"'a'.*no answer") as caught:
        env.reset(seed=0)
    assert isinstance(caught.value.__cause__, RequestError)


def test_a_fault_at_another_seat_is_an_error_of_the_episode() -> None:
    """As when the tool of an opponent is gone."""

    class Broken(toys.Notebook):
        def call(self, arguments: Any, session: Any) -> gem.ToolResult:
            return gem.ToolResult("gone", fault="the server is gone")

    gem.register("joint:Auction-v5", AuctionEnv, agents=["a", "b"])
    joint: Any = gem.make("joint:Auction-v5", wrappers={"a": [Broken()]})
    call = "```note\nx\n```"
    env = single_agent(joint, "b", lambda seen, context: call if context.turn else "5")
    env.reset(seed=0)
    *_, truncated, info = env.step("3")
    assert truncated
    assert info["error"] == {"kind": "opponent", "message": "'a': the server is gone"}
    with pytest.raises(EnvFaultError, match="the server is gone"):
        single_agent(joint, "b", lambda seen: call).reset(seed=0)


class Lonely(MultiAgentEnv):
    """One agent talks to itself; the other is never asked, or only after some turns."""

    possible_agents = ("talker", "listener")

    def __init__(self, turns: int | None = None, over: int | None = None) -> None:
        super().__init__()
        self.turns, self.over, self.said = turns, over, 0

    def begin_episode(self, options: Any) -> None:
        self.said = 0

    def observe(self, agent: str) -> str:
        return f"{agent}: {self.said}"

    def process_actions(self, actions: dict[str, str]) -> Any:
        self.said += 1
        self.agent_selector.override("talker" if self.said != self.turns else "listener")
        over = self.said == self.over and (self.turns is None or self.np_random_seed % 3 > 0)
        return {"listener": 1.0}, dict.fromkeys(self.agents, over), {}, {}

    def sample_random_action(self, agent: str) -> str:  # type: ignore[override]  # an agent has to be named
        return "hm"


def test_others_without_end_are_an_error() -> None:
    """In reset it raises; in a step it is an error of the episode, and the limit is an argument."""
    with pytest.raises(EnvFaultError, match="300 turns"):
        single_agent(Lonely(), "listener").reset(seed=0)
    env = single_agent(Lonely(turns=7), "listener", max_other_turns=7)
    assert env.reset(seed=0)[0] == "listener: 7"
    _, reward, terminated, truncated, info = env.step("hello")
    assert (reward, terminated, truncated) == (15.0, False, True)
    assert "7 turns" in info["error"]["message"]


def test_a_game_that_is_over_before_the_seat_acts_is_dealt_again() -> None:
    """By the seed of the episode, which is what ``info`` names; after ten such games it is a fault."""
    env = single_agent(Lonely(turns=3, over=2), "listener")
    dealt = [env.reset(seed=seed) for seed in range(6)]
    assert [info["seed"] for _, info in dealt] == list(range(6))
    assert all(observation == "listener: 3" for observation, _ in dealt)
    with pytest.raises(EnvFaultError, match="10 games in a row"):
        single_agent(Lonely(over=2), "listener").reset(seed=0)


def test_the_episode_is_over_when_the_seat_has_ended() -> None:
    """Whatever the others would still do; what it earned before it first acted is in its first reward."""
    env = single_agent(AuctionEnv(["a", "b", "c"], "sequential"), "c", lambda seen: "4")
    assert env.reset(seed=0)[0] == "You are c. Bids: 4 4"
    observation, reward, terminated, truncated, info = env.step("quit")
    assert (observation, reward, terminated, truncated) == ("You are c. Bids: 4 4 0", -4.0, True, False)
    assert "error" not in info


def test_tools_of_seats_and_around_the_result() -> None:
    """A tool inside answers the seat while the others wait; one around the result does the same."""
    call = "```note\nmine\n```"
    gem.register("joint:Auction-v6", AuctionEnv, agents=["a", "b"], mode="parallel")
    inside = single_agent(gem.make("joint:Auction-v6", wrappers={"b": [toys.Notebook()]}), "b", scripted)  # type: ignore[arg-type]
    around = gem.ToolEnv(single_agent("joint:Auction-v6", "b", scripted), [toys.Notebook()])
    assert play(inside, [call, "2"]) == play(around, [call, "2"])
    assert "mine" in play(inside, [call])[1][0]


def test_fork_goes_on_in_the_middle_of_an_episode() -> None:
    """What the others have said and how many random actions were drawn is part of it."""

    class Counting:
        reads = "messages"

        def __call__(self, messages: Any, context: Any) -> str:
            return str((len(messages) + context.turn) % 10)

    others = {"a": Counting()}
    env = single_agent(AuctionEnv(["a", "b", "c"], "sequential"), "b", others)
    play(env, ["1", "2"], seed=4)
    other = env.fork()
    sibling = other.fork()
    results = [[each.step(action) for action in ("3", "4", "5")] for each in (env, other, sibling)]
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize(
    ("seat", "options", "told"),
    [
        ("an", {}, "Did you mean 'ann'"),
        ("ann", {"others": {"ann": "random"}}, "'ann'"),
        ("ann", {"others": []}, "no agent"),
        ("ann", {"others": "randm"}, "Did you mean 'random'"),
        ("ann", {"rounds": 3}, "rounds"),
        ("ann", {"max_other_turns": 0}, "max_other_turns.*0"),
    ],
)
def test_wrong_arguments_are_refused(seat: str, options: dict[str, Any], told: str) -> None:
    """With what there is instead."""
    with pytest.raises((ArgumentError, UnknownAgentError), match=told):
        single_agent(AuctionEnv(["ann", "bob"]), seat, **options)


def test_an_environment_of_one_agent_is_refused() -> None:
    with pytest.raises(ArgumentError, match="toy:Echo-v0"):
        single_agent("toy:Echo-v0", "ann")
