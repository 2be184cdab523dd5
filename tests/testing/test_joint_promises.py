"""check_env of several agents passes what keeps the contract, and names every promise that is broken."""

from __future__ import annotations

import re
import secrets
from typing import Any

import pytest
from joint_envs import BROKEN, BlueDigitsEnv, GoodJointEnv, LenientEnv, RewardsForAllEnv
from joint_toys import AuctionEnv, CountdownEnv

from gem_core import EnvSpec, MultiAgentEnv, make
from gem_core.testing import ContractError, check_env
from gem_core.testing.conformance import promises_for

SHORT = EnvSpec(id="check:Countdown-v0", entry_point=CountdownEnv, seats=("first", "second"), max_turns=3)
OF_SEVERAL = {promise.slug for promise in promises_for(several=True)}
OF_AGENTS = {promise.slug for promise in promises_for(several=True) if promise.of == "several"}
HOSTILE = "hostile-actions"


def broken_by(target: Any) -> dict[str, str]:
    """Return what is broken; hostile actions take longest, and are tried where they should be broken."""
    tried = HOSTILE in BROKEN[target][0]
    with pytest.raises(ContractError) as caught:
        check_env(target, skip={} if tried else {HOSTILE: "it takes longest"})
    return dict(caught.value.report.broken)


@pytest.mark.few(4)
@pytest.mark.parametrize(
    "target",
    [
        GoodJointEnv,
        GoodJointEnv(limit=5, mode="parallel"),
        CountdownEnv,
        AuctionEnv(["a", "b", "c"]),
        AuctionEnv(["a", "b"], mode="parallel", rounds=7),
        SHORT,
        make(SHORT),
        make(SHORT, wrappers={"second": "concat,episode_stats"}),
    ],
    ids=["class", "parallel", "two", "three", "rounds", "record", "made", "wrapped"],
)
def test_good_environment_keeps_every_promise(target: Any) -> None:
    """By turns and all at once, with agents that leave, by its record, wrapped: nothing is broken or left out."""
    report = check_env(target)
    assert set(report.kept) == OF_SEVERAL
    assert report.skipped == {}
    # An auction has no right answer, and does not say so.
    assert [note.partition(":")[0] for note in report.notes] == ["info-keys"] * report.name.startswith("Auction")


class InterruptedEnv(GoodJointEnv):
    """In every other episode all are truncated before the second one acts."""

    def process_actions(self, actions: dict[str, str]) -> Any:
        rewards, terminations, truncations, infos = super().process_actions(actions)
        return rewards, terminations, truncations | dict.fromkeys(self.agents, self.secret % 2 == 0), infos


def test_episodes_that_are_truncated_before_an_agent_acts() -> None:
    """Another episode is begun in order to try that agent."""
    report = check_env(InterruptedEnv)
    assert HOSTILE in report.kept


def name_of(target: Any) -> str:
    return str(getattr(target, "__name__", "record"))


@pytest.mark.few(6)
@pytest.mark.parametrize("target", BROKEN, ids=name_of)
def test_broken_promise_is_named(target: Any) -> None:
    """Exactly the promises that an environment breaks are named, those of all environments too."""
    breaks, may_break = BROKEN[target]
    assert breaks <= set(broken_by(target)) <= breaks | may_break


def test_every_promise_about_agents_can_be_broken() -> None:
    """For each promise about agents alone, some environment of these tests breaks it."""
    assert set().union(*(slugs for slugs, _ in BROKEN.values())) >= OF_AGENTS


def test_what_was_seen_names_the_agent() -> None:
    """Of whom, after which actions, and what was expected instead."""
    assert re.match(
        r"step\({'red': '\\\\boxed{\d+}'}\) gave rewards of 'blue', 'green', 'red', not of 'green'",
        broken_by(RewardsForAllEnv)["turns"],
    )
    assert broken_by(LenientEnv) == {"refused-actions": "step took no action of 'red', where it needs those of 'red'"}
    seen = broken_by(BlueDigitsEnv)["hostile-actions"]
    assert re.match(r"step\({'blue': '.*}\) raised ValueError: .* \(.*joint_envs\.py:\d+\)", seen)


def test_agent_that_never_acts_is_noted() -> None:
    """It cannot be tried what it would say; the rest is."""

    class Quiet(GoodJointEnv):
        def begin_episode(self, options: Any) -> Any:
            self.agents = ["red", "green"]
            return super().begin_episode(options)

        def told(self) -> dict[str, Any]:
            return {agent: told for agent, told in super().told().items() if agent != "blue"}

    assert check_env(Quiet).notes == ("hostile-actions: 'blue' was not tried, since it never came to act",)


def test_missing_random_actions_are_named() -> None:
    """As with one agent."""

    class Bare(MultiAgentEnv):
        possible_agents = ("a", "b")

        def observe(self, agent: str) -> str:
            return f"You are {agent}."

        def process_actions(self, actions: dict[str, str]) -> Any:
            return {}, {agent: True for agent in actions}, {}, {}

    with pytest.raises(ContractError) as caught:
        check_env(Bare)
    assert set(caught.value.report.broken) == {"valid-sample"}


def test_who_acts_may_differ_where_the_record_says_so() -> None:
    """Actions of one episode are given to whoever acts in another."""

    class Shuffled(GoodJointEnv):
        def process_actions(self, actions: dict[str, str]) -> Any:
            self.agent_selector.override(secrets.choice(self.agents))
            return super().process_actions(actions)

    record = EnvSpec(id="check:Shuffled-v0", entry_point=Shuffled, seats=Shuffled.possible_agents, deterministic=False)
    report = check_env(record, skip={HOSTILE: "it takes longest"})
    assert report.skipped["determinism"] == "its record says deterministic=False"
