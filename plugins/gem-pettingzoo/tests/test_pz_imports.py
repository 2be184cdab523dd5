"""``from_pettingzoo``: round trips, reading and legality, forfeits, agents that die, states and refusals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st
from joint_toys import AuctionEnv, CountdownEnv
from pettingzoo import AECEnv, ParallelEnv  # type: ignore[import-untyped]

from gem_core import MultiAgentEnv
from gem_core.errors import ArgumentError, SamplingNotSupported
from gem_core.making.again import Recipe
from gem_pettingzoo import from_pettingzoo, to_aec, to_parallel
from gem_pettingzoo.texts import describe_observation


class FadingEnv(AECEnv):  # type: ignore[misc]  # PettingZoo has no types
    """Agents that die one by one in the middle, each earning in the turns of the others.

    An action of 0 to 2 is given to all others as a reward; who gives 0 dies. With one left both are cut off.
    Observations say how often the agent has acted; infos allow 1 and 2 only in an agent's first turn.
    """

    metadata: dict[str, Any] = {"name": "fading_v0"}  # noqa: RUF012 - PettingZoo's form
    possible_agents = ("p_0", "p_1", "p_2")

    def observation_space(self, agent: str) -> Any:
        """Return a count."""
        return spaces.Discrete(100)

    def action_space(self, agent: str) -> Any:
        """Return what may be given."""
        return spaces.Discrete(3)

    def observe(self, agent: str) -> Any:
        """Return how often it has acted."""
        return np.array(self.acted[agent])

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Begin with the agent that the seed chooses."""
        self.agents = list(self.possible_agents)
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self.acted = dict.fromkeys(self.agents, 0)
        self.infos: dict[str, Any] = {agent: {"action_mask": np.array([0, 1, 1], np.int8)} for agent in self.agents}
        self.agent_selection = self.agents[(seed or 0) % 3]
        self._skip_agent_selection = None

    def step(self, action: Any) -> None:
        """Give to the others."""
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            self._was_dead_step(action)
            return
        self._cumulative_rewards[agent] = 0.0
        self.acted[agent] += 1
        self.infos[agent] = {}
        self.rewards = {each: 0.0 if each == agent else float(action) for each in self.agents}
        self._accumulate_rewards()
        order = self.agents[self.agents.index(agent) + 1 :] + self.agents[: self.agents.index(agent)]
        self.terminations[agent] = action == 0
        if action == 0 and len(order) == 1:
            self.truncations = dict.fromkeys(self.agents, True)
        self.agent_selection = order[0]
        self._deads_step_first()


class GuessesEnv(ParallelEnv):  # type: ignore[misc]  # PettingZoo has no types
    """Agents that write two numbers at once, and earn their sum; who writes a negative one leaves with what it has."""

    metadata: dict[str, Any] = {"name": "guesses_v0"}  # noqa: RUF012 - PettingZoo's form
    possible_agents = ("g_0", "g_1")

    def __init__(self) -> None:
        self.spaces = {agent: spaces.Box(-5, 5, (2,), np.float32) for agent in self.possible_agents}

    def observation_space(self, agent: str) -> Any:
        """Return what is observed."""
        return spaces.Dict({"last": self.spaces[agent], "round": spaces.Discrete(9)})

    def action_space(self, agent: str) -> Any:
        """Return two numbers."""
        return self.spaces[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Begin."""
        self.agents, self.round = list(self.possible_agents), 0
        zeros = {agent: {"last": np.zeros(2, np.float32), "round": 0} for agent in self.agents}
        return zeros, {agent: {} for agent in self.agents}

    def step(self, actions: Any) -> Any:
        """Add."""
        self.round += 1
        terminations = {agent: bool((action < 0).any()) for agent, action in actions.items()}
        self.agents = [agent for agent in self.agents if not terminations[agent]]
        observations = {agent: {"last": action, "round": self.round} for agent, action in actions.items()}
        rewards = {agent: action.sum() for agent, action in actions.items()}
        return observations, rewards, terminations, dict.fromkeys(actions, False), {agent: {} for agent in actions}


Trace = list[tuple[Any, ...]]


def played(env: MultiAgentEnv, seed: int, responses: Sequence[str]) -> Trace:
    """Return all that an episode gives for these responses, in turn, until it is over or they are used up."""
    trace: Trace = [env.reset(seed=seed)]
    left = list(responses)
    while env.agents and len(left) >= len(env.acting):
        trace.append(env.step({agent: left.pop(0) for agent in env.acting}))
    return trace


def auction(mode: str) -> Callable[[], AuctionEnv]:
    return lambda: AuctionEnv(["a", "b", "c"], mode=mode, rounds=12)


RESPONSES = st.lists(st.sampled_from(["0", "3", "7", "quit", "\\boxed{1}", "\\boxed{2}", "?"]), max_size=30)


@given(st.integers(0, 1000), RESPONSES, st.sampled_from([CountdownEnv, auction("sequential")]))
def test_round_trip_by_turns_is_the_same_episode(seed: int, responses: list[str], make: Callable[[], Any]) -> None:
    """An environment of turns that went through ``AECEnv`` and back gives the same as itself, to the letter."""
    assert played(from_pettingzoo(to_aec(make())), seed, responses) == played(make(), seed, responses)


@given(st.integers(0, 1000), RESPONSES)
def test_round_trip_at_once_is_the_same_episode(seed: int, responses: list[str]) -> None:
    """And one of all at once through ``ParallelEnv``, which only adds who acts."""
    there_and_back = played(from_pettingzoo(to_parallel(auction("parallel")())), seed, responses)
    for _, *_, infos in there_and_back:
        for info in infos.values():
            assert isinstance(info.pop("acting"), bool)
    assert there_and_back == played(auction("parallel")(), seed, responses)


@given(st.lists(st.integers(0, 2), max_size=40), st.integers(0, 2))
def test_agents_that_die_have_all_their_rewards(gifts: list[int], seed: int) -> None:
    """Rewards and ends are those of PettingZoo's own loop, for each turn and in sum, until the last are cut off."""
    bare, ours = FadingEnv(), from_pettingzoo(FadingEnv)
    numbers = iter(gifts + [0] * 9)
    chosen: list[int] = []
    wanted: dict[str, list[float]] = {agent: [] for agent in bare.possible_agents}
    ends: dict[str, tuple[bool, bool]] = {}
    bare.reset(seed=seed)
    for agent in bare.agent_iter():
        _, reward, terminated, truncated, info = bare.last()
        wanted[agent].append(reward)
        ends[agent] = (terminated, truncated)
        if not (terminated or truncated):
            chosen.append(max(next(numbers), int("action_mask" in info)))
        bare.step(None if terminated or truncated else chosen[-1])
    got: dict[str, list[float]] = {agent: [] for agent in bare.possible_agents}
    trace = played(ours, seed, [f"\\boxed{{{number}}}" for number in chosen])
    got[next(iter(trace[0][0]))].append(0.0)
    for _, rewards, *_ in trace[1:]:
        for agent, reward in rewards.items():
            got[agent].append(reward)
    assert got == wanted
    assert ours.agents == []
    assert {agent: (ours.terminations[agent], ours.truncations[agent]) for agent in ends} == ends
    assert ours.cumulative == {agent: sum(rewards) for agent, rewards in wanted.items()}


def test_default_view_tells_the_legal_actions() -> None:
    """The observation as text, and what may be answered by the mask; the mask in an info is plain JSON."""
    env = from_pettingzoo(FadingEnv, action_names=("none", "one", "two"))
    observations, infos = env.reset(seed=1)
    assert observations == {"p_1": "0\nAnswer with one of one, two in a box, as \\boxed{one}."}
    assert infos == {"p_1": {"seed": 1, "action_mask": [0, 1, 1]}}
    assert env.sample_random_action("p_1") in ("\\boxed{one}", "\\boxed{two}")
    assert env.step({"p_1": "Let it be \\boxed{Two}."})[0].keys() == {"p_2"}
    assert env.moves == [{"p_1": 2}]


@pytest.mark.parametrize(
    "response", ["", "2", "\\boxed{}", "\\boxed{0}", "\\boxed{3}", "\\boxed{-1}", "\\boxed{9e9}", "<think>\\boxed{1}"]
)
def test_response_without_a_legal_action_is_told_to_its_agent_alone(response: str) -> None:
    """It acts again, twice; the game is as it was."""
    env = from_pettingzoo(FadingEnv)
    env.reset(seed=0)
    for left in (2, 1):
        observations, rewards, *_, infos = env.step({"p_0": response})
        assert observations == {
            "p_0": f"Your last response has no legal action. You forfeit after {left} more without one.\n"
            "0\nAnswer with one of 1, 2 in a box, as \\boxed{1}."
        }
        assert rewards == {"p_0": 0.0}
        assert infos == {"p_0": {"parsed_action": None}}
    assert env.step({"p_0": "\\boxed{2}"})[0] == {"p_1": "0\nAnswer with one of 1, 2 in a box, as \\boxed{1}."}


def test_agent_that_gives_no_legal_action_forfeits() -> None:
    """After its last try the episode is over for all, and only that agent loses by it."""
    env = from_pettingzoo(FadingEnv, retries=1, illegal_reward=-3.0)
    env.reset(seed=0)
    env.step({"p_0": "\\boxed{2}"})
    env.step({"p_1": "?"})
    observations, rewards, terminations, _, infos = env.step({"p_1": "?"})
    assert observations == {}
    assert rewards == {"p_0": 0.0, "p_1": -3.0, "p_2": 2.0}
    assert all(terminations.values())
    assert infos["p_1"]["final_obs"] == "You forfeit for want of a legal action; the episode is over.\n0"
    assert infos["p_2"]["final_obs"] == "p_1 forfeits for want of a legal action; the episode is over.\n0"


def test_others_wait_for_who_tries_again() -> None:
    """Of those who act at once only the one that failed is asked again; the step is then played with all actions."""
    env = from_pettingzoo(GuessesEnv)
    observations, _ = env.reset(seed=0)
    assert observations["g_0"] == (
        "last: [0. 0.]\nround: 0\nAnswer with 2 numbers inside \\boxed{}, with blanks between them; "
        "the array is of Box(-5.0, 5.0, (2,), float32)."
    )
    observations, rewards, *_ = env.step({"g_0": "\\boxed{[1.5, 2]}", "g_1": "\\boxed{1 6}"})
    assert rewards == {"g_1": 0.0}
    assert observations["g_1"].startswith("Your last response has no legal action.")
    observations, rewards, terminations, *_ = env.step({"g_1": "\\boxed{1 -2}"})
    assert rewards == {"g_0": 3.5, "g_1": -1.0}
    assert terminations == {"g_0": False, "g_1": True}
    assert observations["g_0"].startswith("last: [1.5 2. ]\nround: 1\n")


@pytest.mark.parametrize(
    "answer", ["1", "1 2 3", "nan 1", "inf 1", "1e400 1", "one two", "[" * 100_000, "1 " * 100_000]
)
def test_malformed_array_is_no_action(answer: str) -> None:
    """Wrong numbers of numbers, and what is none, are refused, however long."""
    env = from_pettingzoo(GuessesEnv)
    env.reset(seed=0)
    assert env.read("g_0", f"\\boxed{{{answer}}}") is None


@pytest.mark.parametrize(
    ("space", "answer", "action"),
    [
        (spaces.MultiDiscrete([3, 4]), "2 3", [2, 3]),
        (spaces.MultiDiscrete([3, 4]), "2.5 3", None),
        (spaces.MultiBinary(2), "1, 0", [1, 0]),
        (spaces.Box(-np.inf, np.inf, (1,), np.float32), "1e300", None),
        (spaces.Discrete(3, start=-1), "-1", -1),
    ],
)
def test_actions_of_other_spaces_are_read(
    space: Any, answer: str, action: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each in its own form; sampled actions are among them."""
    monkeypatch.setattr(FadingEnv, "action_space", lambda self, agent: space)
    env = from_pettingzoo(FadingEnv)
    found = env.read("p_0", f"\\boxed{{{answer}}}")
    assert (found if found is None else np.asarray(found).tolist()) == action
    env.possible_agents = ["p_0"]
    monkeypatch.setattr(FadingEnv, "possible_agents", ("p_0",))
    monkeypatch.setattr(FadingEnv, "reset", _reset_without_mask(FadingEnv.reset))
    env.reset(seed=0)
    assert space.contains(env.read("p_0", env.sample_random_action("p_0")))


def _reset_without_mask(reset: Any) -> Any:
    def patched(self: Any, seed: int | None = None, options: Any = None) -> None:
        reset(self, 0, options)
        self.infos = {agent: {} for agent in self.agents}

    return patched


def test_boards_are_shown_whole() -> None:
    """Also inside of tuples; numpy leaves out the middle of more than 1,000 numbers."""
    board = np.zeros((8, 8, 111), dtype=np.int8)
    for observation in (board, {"observation": board}, {"board": (board, 1)}):
        text = str(describe_observation(observation))
        assert "..." not in text
        assert text.count("0") == board.size


def test_functions_of_the_caller_describe_and_read() -> None:
    """They take the place of the default view; random actions then cannot be made up."""
    env = from_pettingzoo(
        FadingEnv,
        describe=lambda agent, observation, info: f"{agent} acted {observation} times. Give with +, or ++.",
        read=lambda agent, response: response.count("+") or None,
    )
    assert env.reset(seed=2)[0] == {"p_2": "p_2 acted 0 times. Give with +, or ++."}
    assert env.step({"p_2": "++"})[1] == {"p_0": 2.0}
    assert env.step({"p_0": "+++"})[0]["p_0"].startswith("Your last response has no legal action.")
    with pytest.raises(SamplingNotSupported, match=r"^actions cannot be sampled where a function reads them"):
        env.sample_random_action("p_0")


def test_environment_is_not_shared() -> None:
    """Made of an environment in place of a function, it cannot be made again; nor is anything else taken for one."""
    with pytest.raises(ArgumentError, match="give from_pettingzoo a function"):
        Recipe.of(from_pettingzoo(FadingEnv())).make()
    with pytest.raises(ArgumentError, match=r"^from_pettingzoo takes an AECEnv or a ParallelEnv, not CountdownEnv"):
        from_pettingzoo(CountdownEnv)


def test_actions_without_a_text_form_need_a_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    """A space of dictionaries, or names that are too few, is refused at once."""
    with pytest.raises(ArgumentError, match=r"^action_names has 2 names, and the actions are Discrete\(3\)$"):
        from_pettingzoo(FadingEnv, action_names=("a", "b"))
    monkeypatch.setattr(FadingEnv, "action_space", lambda self, agent: spaces.Dict({}))
    with pytest.raises(ArgumentError, match=r"^there is no text form for actions of Dict\(\); give read=, a function"):
        from_pettingzoo(FadingEnv)
    assert from_pettingzoo(FadingEnv, read=lambda agent, response: {})
