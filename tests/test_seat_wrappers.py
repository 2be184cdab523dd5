"""Wrappers around the seats of an environment of several agents: views, tools, limits, rewards, ends and state."""

from __future__ import annotations

import asyncio
import copy
import json
import threading
from typing import Any

import pytest
import toys
from gymnasium import wrappers as gym_wrappers
from hypothesis import given
from hypothesis import strategies as st
from joint_toys import AuctionEnv, CountdownEnv

import gem_core as gem
from gem_core.background import run_sync
from gem_core.errors import ArgumentError, ResetNeededError

NOTE = "```note\n{}\n```"
TOOLS = ("tools", {"tools": [toys.Notebook()], "tool_reward": 0.25})


class Silent(gem.Wrapper):
    """Changes nothing."""


class AsyncSilent(gem.Wrapper):
    """Changes nothing, by coroutines."""

    async def before_reset(self, seed: Any, options: Any) -> None:
        """Do nothing."""

    async def after_reset(self, result: Any) -> Any:
        """Return what came."""
        return result

    async def before_step(self, action: str) -> str:
        """Return what came."""
        return action

    async def after_step(self, action: str, result: Any) -> Any:
        """Return what came."""
        return result


class Shaped(gem.Wrapper):
    """Adds to every reward, and keeps what passed through it."""

    def __init__(self, env: Any, bonus: float = 0.0) -> None:
        super().__init__(env)
        self.bonus = bonus
        self.heard: list[tuple[str, float]] = []

    def after_step(self, action: str, result: Any) -> Any:
        """Add the bonus."""
        observation, reward, *rest = result
        self.heard.append((action, reward))
        return observation, reward + self.bonus, *rest


def auction(wrappers: Any, agents: Any = ("a", "b"), mode: str = "parallel", **kwargs: Any) -> Any:
    record = gem.EnvSpec(id="joint:Auction-v1", entry_point=AuctionEnv, seats=agents)
    return gem.make(record, wrappers=wrappers, agents=agents, mode=mode, **kwargs)


@pytest.mark.parametrize("step", ["step", "step_async"])
@pytest.mark.parametrize("wrapper", [Silent, AsyncSilent])
@given(
    bids=st.lists(st.sampled_from(["1", "7", "quit", "?"]), min_size=1, max_size=12),
    mode=st.sampled_from(["sequential", "parallel"]),
)
def test_wrappers_that_change_nothing_change_nothing(step: str, wrapper: Any, bids: list[str], mode: str) -> None:
    """Step by step, what comes out is what comes out of the bare environment."""

    def play(env: Any, step: str) -> list[Any]:
        seen = [env.reset(seed=3)]
        for bid in bids:
            if env.agents:
                actions = dict.fromkeys(env.acting, bid)
                seen.append(run_sync(env.step_async(actions)) if step == "step_async" else env.step(actions))
            seen.append(copy.deepcopy([env.agents, env.cumulative, env.terminations, env.truncations, env.acting]))
        return seen

    agents = ("a", "b", "c")
    assert play(auction([wrapper], agents, mode), step) == play(auction((), agents, mode), "step")


def test_the_whole_is_an_environment_of_several_agents() -> None:
    """It is a ``MultiAgentEnv``, and the task itself is ``unwrapped``; what each seat sees has its own space."""
    env = auction({"a": "messages"})
    assert isinstance(env, gem.MultiAgentEnv)
    assert type(env.unwrapped) is AuctionEnv
    assert env.observation_space("a") != env.observation_space("b") == env.unwrapped.observation_space("b")
    assert env.possible_agents == ["a", "b"]
    assert env.concurrency == "inline"


def test_each_seat_has_its_own_view() -> None:
    """The history of a seat holds its own turns alone; a seat without wrappers sees the newest observation."""
    env = auction({"a": "concat_with_action"}, mode="sequential")
    assert env.reset(seed=0)[0] == {"a": "You are a. Bids: none"}
    env.step({"a": "1"})
    observations, *_ = env.step({"b": "2"})
    assert observations == {"a": "You are a. Bids: none\n1\nYou are a. Bids: 1 2"}
    assert env.step({"a": "3"})[0] == {"b": "You are b. Bids: 1 2 3"}


def test_a_tool_answers_its_seat_while_the_others_wait() -> None:
    """The seat acts again alone; the response that was held goes to the task together with its next one."""
    env = auction([TOOLS, "concat"], rounds=2)
    env.reset(seed=0)
    observations, rewards, terminations, truncations, infos = env.step({"a": NOTE.format("first"), "b": "5"})
    assert observations.keys() == rewards.keys() == infos.keys() == {"a"}
    assert "first" in observations["a"]
    assert infos["a"]["tool"]["name"] == "note"
    assert not any([*terminations.values(), *truncations.values()])
    assert (env.acting, env.agents) == (("a",), ["a", "b"])
    with pytest.raises(ArgumentError, match="'b' is not wanted: 'a'"):
        env.step({"a": "1", "b": "1"})
    assert env.step({"a": NOTE.format("second")})[0].keys() == {"a"}
    _, rewards, terminations, _, infos = env.step({"a": "3"})
    assert env.unwrapped.bids == ["3", "5"]
    assert rewards == {"a": -2.0, "b": 2.0}  # the task's alone: what the tool earned has been given
    assert all(terminations.values())
    assert env.cumulative == {"a": -1.5, "b": 2.0}
    assert "first" in infos["a"]["final_obs"]
    assert "Bids: 3 5" in infos["a"]["final_obs"]


@given(
    st.lists(st.sampled_from(["1", "7", "quit", NOTE.format("x")]), max_size=20),
    st.sampled_from(["sequential", "parallel"]),
)
def test_given_rewards_add_up(actions: list[str], mode: str) -> None:
    """What ``step`` gave each agent, tools and shaping included, is its ``cumulative`` at the end."""
    env = auction([TOOLS, (Shaped, {"bonus": 0.5})], ("a", "b", "c"), mode)
    env.reset(seed=0)
    total = dict.fromkeys("abc", 0.0)
    for action in [*actions, *["quit"] * 9]:
        if env.agents:
            for agent, reward in env.step(dict.fromkeys(env.acting, action))[1].items():
                total[agent] += reward
    assert not env.agents
    assert total == env.cumulative


def test_a_seat_that_acts_late_begins_late() -> None:
    """Its first observation is its reset, with the words on tools; a reward before that passes its wrappers by."""
    env = auction([TOOLS, (Shaped, {"bonus": 0.5})], mode="sequential")
    assert "You may use tools" in env.reset(seed=0)[0]["a"]
    observations, rewards, _, _, infos = env.step({"a": "4"})
    assert observations["b"].startswith("You are b. Bids: 4\nYou may use tools")
    assert rewards == {"b": -4.0}
    assert infos["b"]["tools"][0]["function"]["name"] == "note"


def test_an_agent_that_ends_has_its_last_observation_through_its_wrappers() -> None:
    """Also where it ends while another acts; statistics count its own turns."""
    env = auction("concat,episode_stats", mode="sequential", rounds=2)
    env.reset(seed=0)
    env.step({"a": "1"})
    _, rewards, _, _, infos = env.step({"b": "2"})
    assert infos["a"]["final_obs"] == "You are a. Bids: none\nYou are a. Bids: 1 2"
    assert infos["a"]["episode"]["r"] == rewards["a"] == -1.0
    assert (infos["a"]["episode"]["l"], infos["b"]["episode"]["l"]) == (1, 1)


def test_a_seat_that_its_wrapper_ends_ends_the_episode() -> None:
    """All others are truncated, with the rewards that they have not been given."""
    env = auction({"a": [("turn_limit", {"max_turns": 1})], "b": "concat"}, ("a", "b", "c"), mode="sequential")
    env.reset(seed=0)
    env.step({"a": "1"})
    env.step({"b": "5"})
    observations, rewards, terminations, truncations, infos = env.step({"c": "2"})
    assert observations == {}
    assert rewards == {"a": -4.0, "b": 3.0, "c": 2.0}  # c had its -1 with its first observation
    assert env.cumulative == {"a": -4.0, "b": 3.0, "c": 1.0}
    assert infos["b"]["final_obs"] == "You are b. Bids: 1\nYou are b. Bids: 1 5 2"
    assert (list(terminations.values()), list(truncations.values())) == ([False] * 3, [True] * 3)
    assert (env.agents, env.acting) == ([], ())
    with pytest.raises(ResetNeededError, match=r"^joint:Auction-v1: "):
        env.step({"a": "1"})


def test_seats_that_end_by_the_task_and_by_a_wrapper_in_one_step() -> None:
    """One quits the task in the step in which another is out of turns: each ends for its own reason, and is paid."""
    env = auction({"b": [("turn_limit", {"max_turns": 1})]}, ("a", "b", "c"))
    env.reset(seed=0)
    _, rewards, terminations, truncations, _ = env.step({"a": "quit", "b": "5", "c": "3"})
    assert rewards == env.cumulative == {"a": -5.0, "b": 2.0, "c": 3.0}
    assert terminations == {"a": True, "b": False, "c": False}
    assert truncations == {"a": False, "b": True, "c": True}
    assert env.agents == []


def test_a_failed_tool_ends_the_episode() -> None:
    """A fault of the machinery is in the info of its seat; a response that was held is not carried out."""

    class Broken(toys.Notebook):
        def call(self, arguments: Any, session: Any) -> gem.ToolResult:
            return gem.ToolResult("gone", fault="the server is gone")

    env = auction([Broken()])
    env.reset(seed=0)
    _, rewards, _, truncations, infos = env.step({"a": NOTE.format("x"), "b": "5"})
    assert truncations == {"a": True, "b": True}
    assert rewards == {"a": 0.0, "b": 0.0}
    assert infos["a"]["error"] == {"kind": "tool", "message": "the server is gone"}
    assert infos["b"]["final_obs"].startswith("You are b. Bids: none")
    assert "error" not in infos["b"]
    assert env.reset(seed=1)[0].keys() == {"a", "b"}


def test_tools_of_two_seats_work_side_by_side() -> None:
    """In an event loop, calls of seats that act at once do not wait for each other; plain code waits on the loop."""
    meeting = threading.Barrier(2, timeout=30)

    class Meeting(toys.Notebook):
        concurrency = "thread"  # type: ignore[assignment]  # of this tool

        def call(self, arguments: Any, session: Any) -> gem.ToolResult:
            meeting.wait()
            return gem.ToolResult("met")

    env = auction([Meeting()])
    assert env.concurrency == "thread"
    env.reset(seed=0)
    observations, *_ = run_sync(env.step_async(dict.fromkeys("ab", NOTE.format("x"))))
    assert all("met" in observation for observation in observations.values())
    env = auction([toys.AsyncNotebook()])
    assert env.concurrency == "async"
    env.reset(seed=0)
    assert "hello" in env.step(dict.fromkeys("ab", NOTE.format("hello")))[0]["b"]


def test_plain_steps_work_where_an_event_loop_runs() -> None:
    """As in a notebook: the step blocks that loop, and coroutines of the seats' tools run on the library's."""

    async def play() -> Any:
        env = auction([toys.AsyncNotebook(), "concat"])
        env.reset(seed=0)
        return env.step(dict.fromkeys("ab", NOTE.format("hello")))[0]

    assert all("hello" in observation for observation in asyncio.run(play()).values())


class OwnStep(gem.Wrapper):
    """Overrides ``step`` itself."""

    def step(self, action: str) -> Any:
        """Shout."""
        return self.env.step(action.upper())


@pytest.mark.parametrize("wrapper", [OwnStep, gym_wrappers.RecordEpisodeStatistics])
def test_wrappers_that_are_no_hooks_are_refused(wrapper: Any) -> None:
    """The error says what to do instead."""
    with pytest.raises(ArgumentError, match=rf"^{wrapper.__name__} .*gem_core\.single_agent"):
        auction([wrapper])


def test_a_wrapper_around_the_whole_is_refused() -> None:
    """The error says how it gets around a seat."""
    with pytest.raises(ArgumentError, match=r"^Silent .* make\(id, wrappers={'a': \[Silent\]}\)"):
        Silent(auction(()))


def test_unknown_seats_are_refused() -> None:
    """By name; and wrappers by seat want seats."""
    with pytest.raises(ArgumentError, match=r"'frist'.*'first'"):
        gem.make(gem.EnvSpec(id="joint:Heap-v0", entry_point=CountdownEnv), wrappers={"frist": "concat"})
    gem.register("joint:Auction-v2", AuctionEnv, agents=["a", "b"], seats=("a", "b"))
    with pytest.raises(ArgumentError, match=r"'c'.* 'a', 'b'"):
        gem.make_vec("joint:Auction-v2", wrappers={"c": "concat"}).reset(seed=1)
    with pytest.raises(ArgumentError, match=r"^wrapper 'concat': .* 'max_truns'"):
        gem.make_vec("joint:Auction-v2", wrappers={"a": [("concat", {"max_truns": 1})]}).reset(seed=1)
    with pytest.raises(ArgumentError, match=r"'a'.* several agents"):
        gem.make("toy:Echo-v0", wrappers={"a": "concat"})


def test_fork_goes_on_while_a_response_is_held() -> None:
    """With the held response and what each wrapper remembers; a fork of the fork too."""
    env = auction({"a": [TOOLS, "concat_with_action"], "b": "messages"})
    env.reset(seed=2)
    call = gem.Response(NOTE.format("mine"), tool_calls=None, finish_reason="stop")
    env.step({"a": call, "b": gem.Response("7", reasoning="hm", finish_reason="stop")})
    other = env.fork()
    sibling = other.fork()
    for each in (other, sibling):
        assert each.acting == ("a",)
    results = [each.step({"a": "2"}) for each in (env, other, sibling)]
    assert results[0] == results[1] == results[2]
    assert env.unwrapped.bids == ["2", "7"]


def test_specification_keeps_the_wrappers_of_each_seat() -> None:
    """One list where they are the same, else by seat; it makes the same again, through JSON and with more around."""
    same = auction("concat,episode_stats")
    assert same.spec.wrappers == (("concat", {}), ("episode_stats", {}))
    env = auction({"b": [("concat", {"max_turns": 2})]})
    assert env.spec.wrappers == {"b": (("concat", {"max_turns": 2}),)}
    assert env.spec.recorded()["wrappers"] == {"b": [["concat", {"max_turns": 2}]]}
    more = gem.make(env.spec, wrappers="episode_stats")
    assert more.spec.wrappers == {  # type: ignore[union-attr]
        "a": (("episode_stats", {}),),
        "b": (("concat", {"max_turns": 2}), ("episode_stats", {})),
    }
    gem.register("joint:Auction-v3", AuctionEnv, agents=["a", "b"])
    made: Any = gem.make("joint:Auction-v3", wrappers={"a": "concat"})
    recorded = json.loads(json.dumps(made.spec.recorded()))
    again = gem.make(recorded["id"], wrappers=recorded["wrappers"], **recorded["kwargs"])
    assert again.spec == made.spec


def test_closing_closes_the_sessions_of_every_seat() -> None:
    """And the environment."""
    tool = toys.Notebook()
    env = auction([tool])
    env.reset(seed=0)
    env.step(dict.fromkeys("ab", NOTE.format("x")))
    env.close()
    assert (tool.opened, tool.closed) == (2, 2)


@pytest.mark.parametrize("backend", ["sync", "async"])
def test_rollouts_go_through_the_wrappers(backend: str) -> None:
    """A tool's step is a turn of its seat alone, and every reward is in the records."""

    def agent(observation: Any, context: Any) -> str:
        return NOTE.format("x") if context.seat == "a" and context.turn % 2 == 0 else "3"

    gem.register(f"joint:Auction-v4-{backend}", AuctionEnv, agents=["a", "b"], mode="parallel", rounds=4)
    around: Any = {"a": [TOOLS, "concat_with_action"], "b": "episode_stats"}
    with gem.make_vec(f"joint:Auction-v4-{backend}", 2, backend=backend, wrappers=around, seed=1) as vec:
        for joint in gem.rollout(vec, agents=agent, episodes=3, seed=1):
            assert joint.order == [["a", "b"], ["a"], ["a", "b"], ["a"]]
            assert joint.returns == {"a": 0.5, "b": 0.0}
            assert joint.seats["a"].tools == ["note"]
            assert joint.seats["b"].final_info["episode"]["l"] == 2
            assert joint.error is None
