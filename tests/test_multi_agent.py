"""``MultiAgentEnv`` and ``AgentSelector``: turns, accounting, agents that join and leave, errors and state."""

from __future__ import annotations

import inspect
import textwrap
from typing import Any

import pytest
from joint_toys import AuctionEnv, CountdownEnv

import gem_core as gem
from gem_core import AgentSelector, MultiAgentEnv, extract_last_boxed_answer
from gem_core.errors import ArgumentError, ResetNeededError
from gem_core.making.again import Recipe


def test_loop_of_the_paper_runs() -> None:
    """The loop of the paper's section on several agents plays an episode to its end."""

    def act(agent: str, observation: str) -> str:
        return env.sample_random_action(agent)

    env = CountdownEnv()
    observations, infos = env.reset(seed=0)
    terminations = env.terminations
    while not all(terminations.values()):
        actions = {agent: act(agent, observation) for agent, observation in observations.items()}
        observations, rewards, terminations, truncations, infos = env.step(actions)  # noqa: RUF059 - as in the paper
    assert rewards.keys() == terminations.keys() == {"first", "second"}
    assert sum(rewards.values()) == 0.0
    assert env.agents == []


def test_five_dictionaries_are_taken() -> None:
    """An environment whose ``process_actions`` returns what ``step`` does runs as well."""

    class Team(MultiAgentEnv):
        def __init__(self) -> None:
            super().__init__()
            self.possible_agents = ["researcher", "reviewer"]
            self.agent_selector = AgentSelector(self.possible_agents, mode="parallel")

        def observe(self, agent: str) -> str:
            return f"You are the {agent}."

        def process_actions(self, actions: dict[str, str]) -> Any:
            observations = {agent: self.observe(agent) for agent in self.agents}
            done = dict.fromkeys(self.agents, "done" in actions.values())
            return observations, dict.fromkeys(actions, 1.0), done, dict.fromkeys(actions, False), {}

    env = Team()
    assert env.reset(seed=1)[0] == {"researcher": "You are the researcher.", "reviewer": "You are the reviewer."}
    observations, rewards, terminations, _, _ = env.step({"researcher": "on it", "reviewer": "done"})
    assert observations == {}
    assert rewards == {"researcher": 1.0, "reviewer": 1.0}
    assert all(terminations.values())


def test_reward_is_given_when_the_agent_acts_again() -> None:
    """What an agent earns while others act is one reward, with its next observation; ``cumulative`` has it at once."""
    env = AuctionEnv(["a", "b", "c"], mode="sequential")
    env.reset(seed=0)
    _, rewards, _, _, infos = env.step({"a": "1"})
    assert rewards == {"b": 0.0}
    assert infos.keys() == {"b"}
    assert env.step({"b": "5"})[1] == {"c": -1.0}
    assert env.cumulative == {"a": -4.0, "b": 5.0, "c": -1.0}
    assert env.step({"c": "2"})[1] == {"a": -4.0}


def test_agent_that_leaves_is_told_at_once() -> None:
    """One that ended has its last observation and reward in that step, and is no longer asked."""
    env = AuctionEnv(["a", "b", "c"], mode="parallel")
    env.reset(seed=0)
    observations, rewards, terminations, _, infos = env.step({"a": "3", "b": "quit", "c": "1"})
    assert observations.keys() == {"a", "c"}
    assert rewards.keys() == {"a", "b", "c"}
    assert terminations == {"a": False, "b": True, "c": False}
    assert infos["b"]["final_obs"] == env.observe("b")
    assert env.agents == ["a", "c"]


def test_agent_joins_and_cannot_return() -> None:
    """A possible agent joins in the middle; one that has taken part cannot join again."""

    class Door(MultiAgentEnv):
        possible_agents = ("host", "guest")

        def begin_episode(self, options: Any) -> dict[str, Any]:
            self.agents = ["host"]
            return {"host": {"system": "You are the host."}}

        def observe(self, agent: str) -> str:
            return agent

        def process_actions(self, actions: dict[str, str]) -> Any:
            if "open" in actions.values():
                self.add_agent("guest")
            return {}, {"guest": "bye" in actions.values()} if "guest" in self.agents else {}, {}, {}

    env = Door()
    assert env.reset(seed=3) == ({"host": "host"}, {"host": {"seed": 3, "system": "You are the host."}})
    assert env.step({"host": "open"})[0] == {"host": "host"}  # who joins comes last
    assert env.step({"host": "wait"})[0] == {"guest": "guest"}
    env.step({"guest": "bye"})
    with pytest.raises(ArgumentError, match="'guest'"):
        env.step({"host": "open"})


def test_missing_and_unwanted_actions_are_refused() -> None:
    """An action that is missing, of another agent or no text is an error that says who acts, and changes nothing."""
    env = AuctionEnv(["a", "b"], mode="sequential")
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match="'a' is missing"):
        env.step({})
    with pytest.raises(ArgumentError, match="'b' is not wanted: 'a'"):
        env.step({"a": "1", "b": "1"})
    with pytest.raises(ArgumentError, match="of 'a'"):
        env.step({"a": 1})  # type: ignore[dict-item]
    with pytest.raises(ArgumentError, match="of 'a', not '1'"):
        env.step("1")  # type: ignore[arg-type]
    assert env.acting == ("a",)


def test_step_outside_an_episode_is_refused() -> None:
    """A step before the first reset and after the end is an error."""
    env = CountdownEnv()
    with pytest.raises(ResetNeededError, match=r"^CountdownEnv: "):
        env.step({"first": "1"})


@pytest.mark.parametrize(
    ("verdict", "message"),
    [
        (None, "process_actions.* not None"),
        (({"b": 1.0}, {}, {}, {}), "process_actions.*'b'"),
        (({"a": float("nan")}, {}, {}, {}), "reward of 'a'.*nan"),
        (({}, {}, {}, {"a": 1}), "infos .*'a': 1"),
    ],
)
def test_malformed_verdict_is_refused(verdict: Any, message: str) -> None:
    """A mistake of the author is an error that names it."""

    class X(MultiAgentEnv):
        possible_agents = ("a",)

        def observe(self, agent: str) -> str:
            return ""

        def process_actions(self, actions: dict[str, str]) -> Any:
            return verdict

    env = X()
    env.reset(seed=0)
    with pytest.raises((TypeError, ValueError), match=f"^X: .*{message}"):
        env.step({"a": "1"})


@pytest.mark.parametrize(
    ("agents", "told", "message"),
    [
        ([], None, r"agents, not \[\]"),
        (["c"], None, "agents, not .*'c'"),
        (["a"], ("observation", {}), "begin_episode .*'observation'"),
        (["a"], {"b": {"role": "spy"}}, "begin_episode.*'b'"),
    ],
)
def test_malformed_beginning_is_refused(agents: list[str], told: Any, message: str) -> None:
    """A mistake of the author in ``begin_episode`` is an error that names it."""

    class X(MultiAgentEnv):
        possible_agents = ("a", "b")

        def begin_episode(self, options: dict[str, Any] | None) -> Any:
            self.agents = agents
            return told

        def observe(self, agent: str) -> str:
            return ""

    with pytest.raises((TypeError, ValueError), match=f"^X: .*{message}"):
        X().reset(seed=0)


def test_agents_may_be_a_part_of_a_tuple() -> None:
    """Those who begin are taken in any sequence, and leave and join as always."""

    class Part(AuctionEnv):
        def begin_episode(self, options: dict[str, Any] | None) -> None:
            super().begin_episode(options)
            self.agents = ("a", "b")  # type: ignore[assignment]

    env = Part(["a", "b", "c"])
    env.reset(seed=0)
    env.add_agent("c")
    env.step({"a": "quit"})
    assert env.agents == ["b", "c"]


def test_private_names_of_an_author_are_free() -> None:
    """A subclass may call its own attributes and methods what it likes."""

    class Mine(AuctionEnv):
        def begin_episode(self, options: Any) -> None:
            super().begin_episode(options)
            self._turns = self._steps = self._name = self._news = self._unpaid = "mine"
            self._result = self._checked = self._enter = self._go_on = "mine"

    mine, plain = Mine(["a", "b"]), AuctionEnv(["a", "b"])
    assert mine.reset(seed=1) == plain.reset(seed=1)
    for agent, bid in (("a", "3"), ("b", "4"), ("a", "quit")):
        assert mine.step({agent: bid}) == plain.step({agent: bid})


def test_turn_limit_truncates_all() -> None:
    """``max_turns`` of the record counts steps, or ``max_steps`` of the class, and truncates everyone who is left."""

    class Brief(AuctionEnv):
        max_steps = 1

    brief = Brief(["a", "b"])
    brief.reset(seed=0)
    assert brief.step({"a": "1"})[3] == {"a": True, "b": True}
    gem.register("joint:Auction-v0", AuctionEnv, agents=["a", "b"], mode="parallel", seats=("a", "b"))
    spec = gem.spec("joint:Auction-v0")
    assert spec.seats == ("a", "b")
    made: Any = gem.make(gem.EnvSpec(id="joint:Short-v0", entry_point=AuctionEnv, kwargs={**spec.kwargs}, max_turns=2))
    env: Any
    for env in made, Recipe.of(made).make():
        env.reset(seed=0)
        env.step({"a": "1", "b": "2"})
        _, _, terminations, truncations, _ = env.step({"a": "1", "b": "2"})
        assert terminations == {"a": False, "b": False}
        assert truncations == {"a": True, "b": True}
        assert env.agents == []


def test_a_fork_goes_on_in_the_middle_of_an_episode() -> None:
    """With the same results, turns and rewards."""
    env = AuctionEnv(["a", "b", "c"])
    env.reset(seed=5)
    env.agent_selector.override("c")
    env.step({"a": "4"})
    other = env.fork()
    for action in ("1", "quit", "7"):
        acting = env.acting
        assert acting == other.acting
        assert env.step(dict.fromkeys(acting, action)) == other.step(dict.fromkeys(acting, action))


def test_selector_rotates_and_overrides() -> None:
    """Turns go round; an override and a new order change them in the middle."""
    selector = AgentSelector(["a", "b", "c"])
    assert [selector.next() for _ in range(4)] == [["a"], ["b"], ["c"], ["a"]]
    selector.override("a", "b")
    assert [selector.next() for _ in range(3)] == [["a", "b"], ["b"], ["c"]]
    selector.order = ["a", "c", "b"]
    assert [selector.next() for _ in range(3)] == [["a"], ["c"], ["b"]]
    selector.remove("a")
    assert [selector.next() for _ in range(3)] == [["c"], ["b"], ["c"]]
    selector = AgentSelector(["a", "b"], mode="parallel")
    assert selector.next() == ["a", "b"]
    selector.remove("a")
    assert selector.next() == ["b"]
    with pytest.raises(ArgumentError, match=r"'aec'"):
        AgentSelector(mode="aec")  # type: ignore[arg-type]


def test_selector_of_a_class_is_each_environments_own() -> None:
    """Environments of one class do not take each other's turns."""

    class Shared(AuctionEnv):
        agent_selector = AgentSelector()

        def __init__(self, agents: Any) -> None:
            MultiAgentEnv.__init__(self)
            self.possible_agents, self.rounds, self.bids = agents, None, []

    one, other = Shared(["a", "b", "c"]), Shared(["a", "b"])
    one.reset(seed=0)
    other.reset(seed=0)
    one.step({"a": "1"})
    assert (one.acting, other.acting) == (("b",), ("a",))


def test_own_selector_decides() -> None:
    """A subclass of the selector decides who acts, and a wrong choice is an error that names it."""

    class Twice(AgentSelector):
        def choose(self) -> list[str]:
            return self.order[:1] if len(self.selected) == 2 else self.order[:2]

    env = AuctionEnv(["a", "b", "c"])
    env.agent_selector = Twice()
    assert env.reset(seed=0)[0].keys() == {"a", "b"}
    assert env.step({"a": "1", "b": "1"})[0].keys() == {"a"}
    env.agent_selector.override("nobody")
    with pytest.raises(RuntimeError, match="'nobody'"):
        env.step({"a": "1"})


def test_documented_example_runs() -> None:
    """The example in the docstring of ``MultiAgentEnv`` plays as it says."""
    documentation = inspect.getdoc(MultiAgentEnv) or ""
    code = textwrap.dedent("    class Guess" + documentation.split("class Guess", 1)[1].split("\n\nIt draws", 1)[0])
    names: dict[str, Any] = {
        "MultiAgentEnv": MultiAgentEnv,
        "extract_last_boxed_answer": extract_last_boxed_answer,
    }
    exec(code, names)
    env = names["Guess"]()
    assert env.reset(seed=0)[0] == {"chooser": "Choose a word."}
    assert env.step({"chooser": "\\boxed{tea}"})[0] == {"guesser": "It has 3 letters. Which is it?"}
    assert env.step({"guesser": "\\boxed{tea}"})[1] == {"chooser": -1.0, "guesser": 1.0}
