"""``rollout`` with several agents: seats, records, leagues, failures, files and resuming."""

from __future__ import annotations

import asyncio
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_toys import AuctionEnv, BrokenAuctionEnv, CountdownEnv

import gem_core as gem
from gem_core import Episode, JointEpisode, League, PlanItem, Response, rollout
from gem_core.errors import AgentError, ArgumentError, ContextOverflowError, EpisodeFileError, RequestError
from gem_core.records import RunSummary
from gem_core.rollouts import Context, Seated, arollout


def random_agent(observation: Any, context: Context) -> str:
    """Answer at random."""
    return context.sample_random_action()


def take_one(observation: Any) -> str:
    """Take one from the heap."""
    return "\\boxed{1}"


@pytest.fixture(autouse=True)
def _registered() -> None:
    if not gem.list_envs("jointroll"):
        gem.register("jointroll:Countdown-v0", "joint_toys:CountdownEnv", seats=("first", "second"))


def test_mapping_fixes_the_seats() -> None:
    """Each agent acts at its seat; the joint record has the episode of each seat and who acted when."""
    (joint,) = rollout(CountdownEnv(), agents={"second": take_one, "first": random_agent}, episodes=1, seed=3)
    assert list(joint.seats) == ["first", "second"]
    assert joint.agents == {"first": "random_agent", "second": "take_one"}
    first, second = joint
    assert (first.seat, first.agent, second.seat) == ("first", "random_agent", "second")
    assert {turn.action for turn in second.transitions} == {"\\boxed{1}"}
    assert joint.order[:2] == [["first"], ["second"]]
    assert [seat for seat, _ in joint.transcript()] == [seat for acted in joint.order for seat in acted]
    assert joint.turns == first.turns + second.turns
    assert sorted(joint.returns.values()) == [-1.0, 1.0]
    assert sorted(episode.success for episode in joint) == [False, True]  # type: ignore[type-var]


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.sampled_from(["sequential", "parallel"]))
def test_records_account_for_every_reward(seed: int, mode: Any) -> None:
    """The return of each seat's episode is the environment's ``cumulative``, whoever left and whenever."""
    env = AuctionEnv(["a", "b", "c"], mode=mode, rounds=12)
    (joint,) = rollout(env, agents=random_agent, episodes=1, seed=seed)
    assert joint.returns == env.cumulative
    assert all(episode.transitions[-1].terminated for episode in joint if episode.transitions)


def test_reward_before_the_first_turn_counts() -> None:
    """What a seat is given before it acts is its ``first_reward``, also where it never acts."""

    class Ante(gem.MultiAgentEnv):
        possible_agents = ("dealer", "late", "never")

        def observe(self, agent: str) -> str:
            return agent

        def process_actions(self, actions: dict[str, str]) -> Any:
            over = "late" in actions
            return dict.fromkeys(self.agents, 1.0), dict.fromkeys(self.agents, over), {}, {}

    (joint,) = rollout(Ante(), agents=lambda observation: "go", episodes=1, seed=0)
    assert joint.returns == {"dealer": 2.0, "late": 2.0, "never": 2.0}
    assert [(episode.first_reward, episode.turns) for episode in joint] == [(0.0, 1), (1.0, 1), (2.0, 0)]
    assert [(episode.success, episode.cut_off) for episode in joint] == [(None, None)] * 3  # the task never tells
    assert "final_obs" not in joint.seats["never"].info


def test_same_episodes_for_any_number_of_slots() -> None:
    """The plan and the seed decide the episodes and who sits where."""
    agents = [Seated("one", take_one), Seated("any", random_agent)]
    expected = {joint.key: joint for joint in rollout("jointroll:Countdown-v0", agents=agents, episodes=8, seed=5)}
    for joint in rollout("jointroll:Countdown-v0", agents=agents, episodes=8, seed=5, num_envs=3):
        assert joint == expected[joint.key]
    with gem.make_vec("jointroll:Countdown-v0", 2, backend="process", seed=5) as vector:
        for joint in rollout(vector, agents=agents, episodes=8):
            assert joint == expected[joint.key]


def test_list_of_agents_changes_seats() -> None:
    """Agents of a list begin equally often, and ``rotation`` of an item decides where it is given."""
    agents = [Seated("x", take_one), Seated("y", take_one)]
    seen = Counter(joint.agents["first"] for joint in rollout(CountdownEnv(), agents=agents, episodes=10, seed=0))
    assert seen == {"x": 5, "y": 5}
    plan = [PlanItem(rotation=1), PlanItem(rotation=1, repeat=2)]
    assert {joint.agents["first"] for joint in rollout(CountdownEnv(), agents=agents, plan=plan, seed=0)} == {"y"}
    by_seat = {"first": agents[0], "second": agents[1]}
    assert [joint.agents["first"] for joint in rollout(CountdownEnv(), agents=by_seat, plan=plan[:1], seed=0)] == ["y"]


def test_agents_change_seats_in_each_environment_of_a_plan() -> None:
    """Environments and arguments that a plan takes in turn leave no agent at one seat."""
    if not gem.list_envs("jointroll:Auction-v0"):
        gem.register("jointroll:Auction-v0", AuctionEnv, agents=["first", "second"], rounds=2)
    kinds = [
        PlanItem("jointroll:Countdown-v0"),
        PlanItem("jointroll:Auction-v0", kwargs={"rounds": 3}),
        PlanItem("jointroll:Auction-v0"),
        PlanItem("jointroll:Auction-v0", kwargs={"rounds": 4}),
    ]
    agents, ids = [Seated("x", take_one), Seated("y", take_one)], ["jointroll:Countdown-v0", "jointroll:Auction-v0"]
    seen = Counter(
        (joint.id, joint.kwargs.get("rounds"), joint.agents["first"])
        for joint in rollout(ids, agents=agents, plan=kinds * 4, seed=0)
    )
    assert set(seen.values()) == {2}


def test_league_draws_opponents_for_each_item() -> None:
    """The learner changes seats; opponents follow the weights, are the same in a group and for the same run seed."""

    def opponents(run_seed: int) -> list[str]:
        league = League(take_one, {"weak": random_agent, "never": random_agent}, weights={"never": 0}, latest=3)
        league.add("step-100", take_one, weight=4)
        plan = [PlanItem(repeat=2) for _ in range(100)]
        met: list[str] = []
        for joint in rollout(CountdownEnv(), agents=league, plan=plan, seed=run_seed):
            assert joint.agents["first" if int(joint.key) % 2 == 0 else "second"] == "learner"
            met.append(joint.agents["second" if int(joint.key) % 2 == 0 else "first"])
        assert met[::2] == met[1::2]
        return met[::2]

    drawn = opponents(1)
    assert drawn == opponents(1)
    assert drawn != opponents(2)
    counts = Counter(drawn)
    assert counts.keys() == {"weak", "latest", "step-100"}
    assert counts["weak"] < counts["latest"] + counts["step-100"]


@pytest.mark.parametrize(
    ("options", "told"),
    [({"weights": {"b": 1}}, "'b'.*'a'"), ({"weights": {"a": -1}}, "'a'.*-1"), ({"weights": {"a": 0}}, "above 0")],
)
def test_league_refuses_unusable_weights(options: dict[str, Any], told: str) -> None:
    """A weight that is negative or of nobody is an error, and so is a pool that nobody can be drawn from."""
    with pytest.raises(ArgumentError, match=told):
        League(take_one, {"a": take_one}, latest=0, **options)
    league = League(take_one, {"a": take_one}, latest=0)
    with pytest.raises(ArgumentError, match="above 0"):
        league.add("a", take_one, weight=0)


def test_asynchronous_agents_are_asked_side_by_side() -> None:
    """Agents of all seats and slots are under way at once: each waits until all have been asked."""

    class Meeting:
        max_concurrency = 6

        def __init__(self) -> None:
            self.asked, self.all_there = 0, asyncio.Event()

        async def __call__(self, observation: Any, context: Context) -> str:
            self.asked += 1
            if self.asked == 6:
                self.all_there.set()
            await self.all_there.wait()
            return "quit"

    async def run() -> list[JointEpisode]:
        gem.register("jointroll:Auction-v0", AuctionEnv, agents=["a", "b", "c"], mode="parallel")
        agents = dict.fromkeys(["a", "b", "c"], Meeting())
        found = arollout("jointroll:Auction-v0", agents=agents, episodes=2, num_envs=2, seed=0)
        return [joint async for joint in found]

    assert len(asyncio.run(asyncio.wait_for(run(), 60))) == 2


def test_seats_have_conversations_of_their_own() -> None:
    """The messages of a seat hold its own responses; what another thought or wrote is not among them."""
    seen: dict[str, Any] = {}

    def thinker(observation: Any, context: Context) -> Response:
        seen[str(context.seat)] = context.messages
        return Response(f"<think>plan of {context.seat}</think> \\boxed{{1}}", reasoning=f"secret of {context.seat}")

    (joint,) = rollout(CountdownEnv(), agents=thinker, episodes=1, seed=1)
    for seat, other in (("first", "second"), ("second", "first")):
        assert f"plan of {seat}" in str(seen[seat])
        assert f"of {other}" not in str(seen[seat])
        assert f"of {other}" not in str(joint.seats[seat].to_dict())


def failing_at(turn: int, error: Exception) -> Any:
    """Return an agent that raises an error in a turn."""

    def agent(observation: Any, context: Context) -> str:
        if context.turn == turn:
            raise error
        return "\\boxed{1}"

    return agent


def test_agent_without_an_answer_ends_the_episode_for_all() -> None:
    """The failing seat has the error; the other is left out of scores too, and the whole is run again on resuming."""
    failing = failing_at(1, RequestError("no route"))
    (joint,) = rollout(CountdownEnv(), agents={"first": failing, "second": take_one}, episodes=1, seed=0)
    assert joint.error == {"kind": "agent", "message": "no route"}
    assert joint.seats["first"].error == joint.error
    assert joint.seats["second"].error == {"kind": "opponent", "message": "the agent at 'first' has no answer"}


def test_a_seat_that_had_ended_keeps_its_result_when_another_has_no_answer() -> None:
    """It had finished before."""
    failing = failing_at(1, RequestError("no route"))
    agents = {"a": lambda observation: "quit", "b": failing, "c": lambda observation: "1"}
    (joint,) = rollout(AuctionEnv(["a", "b", "c"]), agents=agents, episodes=1, seed=0)
    assert [episode.error and episode.error["kind"] for episode in joint] == [None, "agent", "opponent"]


def test_questions_of_an_episode_that_is_over_are_cancelled() -> None:
    """An agent that would never answer holds no place among the open questions once another seat has failed."""
    cancelled = []

    async def hanging(observation: Any, context: Context) -> str:
        try:
            await asyncio.Event().wait()
        finally:
            cancelled.append(context.episode)
        return ""

    async def down(observation: Any) -> str:
        raise RequestError("no route")

    env = AuctionEnv(["a", "b"], mode="parallel")
    joints = rollout(env, agents={"a": hanging, "b": down}, episodes=3, seed=0, max_requests=2)
    assert [joint.error for joint in joints] == [{"kind": "agent", "message": "no route"}] * 3
    assert cancelled == ["0.0", "1.0", "2.0"]


def test_context_overflow_counts_for_its_own_seat_alone() -> None:
    """A history that is too long for one model is scored for it, and left out for the others."""
    failing = failing_at(1, ContextOverflowError("too long"))
    (joint,) = rollout(CountdownEnv(), agents={"first": failing, "second": take_one}, episodes=1, seed=0)
    assert joint.error is None
    assert joint.seats["first"].cut_off == "tokens"
    assert joint.seats["second"].error is not None


def test_environment_that_fails_is_an_error_of_all_seats() -> None:
    """Whoever had a turn open when the environment failed has the error as its last turn."""
    agents = {"a": lambda observation: "3", "b": lambda observation: "boom"}
    (joint,) = rollout(BrokenAuctionEnv(), agents=agents, episodes=1, seed=0)
    assert joint.error is not None
    assert joint.error["message"] == "step raised ValueError: boom"
    assert [(episode.turns, episode.error) for episode in joint] == [(1, joint.error), (1, joint.error)]


def test_error_at_one_seat_leaves_out_those_that_it_cut_off() -> None:
    """A fault at one seat is no loss of another; a seat that had ended, or won, keeps what it has."""

    class Faulty(gem.MultiAgentEnv):
        possible_agents = ("early", "faulty", "other", "winner")

        def observe(self, agent: str) -> str:
            return agent

        def process_actions(self, actions: dict[str, str]) -> Any:
            if "early" in actions:
                return {"early": 1.0, "winner": 1.0}, {"early": True, "winner": True}, {}, {}
            cut_off = {"faulty": True, "other": True}
            return {}, {}, cut_off, {"faulty": {"error": {"kind": "tool", "message": "gone"}}}

    (joint,) = rollout(Faulty(), agents=take_one, episodes=1, seed=0)
    assert joint.error == {"kind": "tool", "message": "gone"}
    assert joint.seats["other"].error == {"kind": "opponent", "message": "an error at 'faulty'"}
    assert joint.seats["early"].error is joint.seats["winner"].error is None


def test_seat_that_ended_before_it_acted_has_no_turn() -> None:
    """A failure later in the episode adds nothing to it."""

    class Early(BrokenAuctionEnv):
        def process_actions(self, actions: dict[str, str]) -> Any:
            super().process_actions(actions)
            return {}, {"b": True}, {}, {}

    answers = iter(["1", "boom"])
    (joint,) = rollout(Early(), agents=lambda observation: next(answers), episodes=1, seed=0)
    assert joint.error is not None
    assert [(episode.turns, episode.error is None) for episode in joint] == [(2, False), (0, True)]


class ClosedAgent:
    """Counts how often it was closed."""

    closed = 0

    def __call__(self, observation: Any) -> str:
        """Take one."""
        return "\\boxed{1}"

    async def aclose(self) -> None:
        """Count."""
        type(self).closed += 1


def test_agents_named_in_a_league_are_closed_after_each_run() -> None:
    """Those that were added while it ran, too; the learner that was given stays open."""
    before = ClosedAgent.closed
    league = League(ClosedAgent(), {"old": f"{__name__}:ClosedAgent"})
    for number, _ in enumerate(rollout(CountdownEnv(), agents=league, episodes=2, seed=1)):
        if number == 0:
            league.add("new", f"{__name__}:ClosedAgent")
    assert ClosedAgent.closed == before + 2
    list(rollout(CountdownEnv(), agents=league, episodes=1, seed=1))
    assert ClosedAgent.closed == before + 4


@pytest.mark.parametrize("many", [lambda name: name, lambda name: [name, name], lambda name: {"second": name}])
def test_agents_given_by_name_are_closed(many: Any) -> None:
    """What the run made is closed at its end; an agent that was given stays open."""
    agents = many(f"{__name__}:ClosedAgent")
    before, made = ClosedAgent.closed, len(agents) if isinstance(agents, list) else 1
    if isinstance(agents, dict):
        agents["first"] = ClosedAgent()

    async def run() -> None:
        async for _ in arollout(CountdownEnv(), agents=agents, episodes=1, seed=0):
            pass

    list(rollout(CountdownEnv(), agents=agents, episodes=1, seed=0))
    asyncio.run(run())
    assert ClosedAgent.closed == before + 2 * made


@pytest.mark.parametrize(
    ("agents", "told"),
    [
        ({"first": take_one}, "'first', 'second'.*'first'"),
        ([take_one] * 3, "'first', 'second'.*3"),
        ({}, "no agent"),
        ([1, 2], "callable"),
    ],
)
def test_agents_that_do_not_fit_the_seats_are_refused(agents: Any, told: str) -> None:
    """The error names the seats."""
    with pytest.raises((ArgumentError, AgentError), match=told):
        list(rollout(CountdownEnv(), agents=agents, episodes=1))


def test_one_agent_goes_with_one_seat_and_several_with_several() -> None:
    """The error says which argument is meant."""
    with pytest.raises(ArgumentError, match="'first', 'second': give agents="):
        list(rollout(CountdownEnv(), take_one, episodes=1))
    with pytest.raises(ArgumentError, match="give agent, not agents"):
        list(rollout("toy:Countdown-v0", agents=take_one, episodes=1))
    with pytest.raises(ArgumentError, match="give either"):
        list(rollout(CountdownEnv(), None, episodes=1))


def test_records_survive_a_file(tmp_path: Path) -> None:
    """A joint record is one line, read back the same; ``read_episodes`` yields the episode of each seat."""
    path = tmp_path / "joint.jsonl"
    played = list(rollout(CountdownEnv(), agents=random_agent, episodes=3, seed=2))
    assert gem.write_episodes(path, played) == 3
    assert list(gem.read_records(path)) == played
    assert [(episode.seat, episode.episode_return) for episode in gem.read_episodes(path)] == [
        (episode.seat, episode.episode_return) for joint in played for episode in joint
    ]
    assert path.read_text().count('"kwargs"') == 3
    assert all(isinstance(episode, Episode) for episode in gem.read_episodes(path))


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"order": [["first"], ["nobody"]]}, "the order names a seat without an episode"),
        ({"seats": {"first": {"first_reward": "much"}}}, "first_reward is 'much'"),
    ],
)
def test_damaged_record_is_refused(change: dict[str, Any], problem: str) -> None:
    """What somebody changed in a file is found when it is read, not when it is used."""
    (joint,) = rollout(CountdownEnv(), agents=take_one, episodes=1, seed=0)
    record = joint.to_dict()
    for seat, fields in change.pop("seats", {}).items():
        record["seats"][seat].update(fields)
    with pytest.raises(EpisodeFileError, match=problem):
        JointEpisode.from_dict({**record, **change})


def test_records_name_the_wrappers_of_each_seat(tmp_path: Path) -> None:
    """The joint record has the wrappers of all seats, and the episode of a seat its own; both survive a file."""
    env = gem.make("jointroll:Countdown-v0", wrappers={"second": "concat"})
    (joint,) = rollout(env, agents=random_agent, episodes=1, seed=2)
    gem.write_episodes(tmp_path / "joint.jsonl", [joint])
    for record in (joint, *gem.read_records(tmp_path / "joint.jsonl")):
        assert isinstance(record, JointEpisode)
        assert record.wrappers == {"second": [["concat", {}]]}
        assert [episode.wrappers for episode in record] == [[], [["concat", {}]]]


def test_resumed_run_plays_what_is_left(tmp_path: Path) -> None:
    """A run that was stopped goes on with the same episodes and agents."""
    agents = [Seated("one", take_one), Seated("any", random_agent)]
    whole = list(rollout("jointroll:Countdown-v0", agents=agents, episodes=6, seed=9))
    path = tmp_path / "half.jsonl"
    gem.write_episodes(path, whole[:2])
    rest = list(rollout("jointroll:Countdown-v0", agents=agents, episodes=6, resume=path))
    assert sorted(rest, key=lambda joint: joint.key) == sorted(whole[2:], key=lambda joint: joint.key)


def test_summary_has_a_row_for_each_seat_and_agent() -> None:
    """Scores are counted by agent and seat, and for each agent that changed seats; no total mixes the sides."""
    summary = RunSummary(["CountdownEnv"])
    agents = [Seated("one", take_one), Seated("any", random_agent)]
    for joint in rollout(CountdownEnv(), agents=agents, episodes=4, seed=2):
        summary.add(joint)
    assert (summary.episodes, summary.errors) == (4, 0)
    assert [(row.label, row.episodes) for row in summary.rows()] == [
        ("CountdownEnv first=any", 2),
        ("CountdownEnv first=one", 2),
        ("CountdownEnv second=any", 2),
        ("CountdownEnv second=one", 2),
        ("CountdownEnv any", 4),
        ("CountdownEnv one", 4),
    ]
    assert sum(row.total_return for row in summary.rows()) == 0.0


def test_summary_counts_an_error_of_several_seats_once() -> None:
    """One seat without an answer is one error of the run; a history that is too long for a model is none."""
    summary = RunSummary([])
    for error in (RequestError("no route"), ContextOverflowError("too long")):
        agents = {"first": failing_at(1, error), "second": take_one}
        for joint in rollout(CountdownEnv(), agents=agents, episodes=1, seed=0):
            summary.add(joint)
        assert (summary.errors, summary.first_error) == (1, f"CountdownEnv, seed {joint.seed}: no route")
