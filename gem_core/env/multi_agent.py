"""``MultiAgentEnv``: the base class of environments in which several agents act, and its contract."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn

from gem_core.env.agent_selector import AgentSelector
from gem_core.env.base import Env
from gem_core.env.results import checked_reward
from gem_core.env.spaces import Text
from gem_core.errors import ArgumentError, ResetNeededError, SamplingNotSupported, StateError
from gem_core.suggestions import did_you_mean
from gem_core.types import Info, Observation

if TYPE_CHECKING:
    from gymnasium import spaces

JointResetResult = tuple[dict[str, Observation], dict[str, Info]]
"""``(observations, infos)`` of those who act first."""

JointStepResult = tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Info]]
"""``(observations, rewards, terminations, truncations, infos)``; see ``MultiAgentEnv.step``."""

Verdict = tuple[Mapping[str, float], Mapping[str, bool], Mapping[str, bool], Mapping[str, Info]]
"""``(rewards, terminations, truncations, infos)``; an agent that is left out gets 0.0, False, False and no news."""


class MultiAgentEnv(Env):
    r"""A task for several agents, each with observations, rewards and infos of its own.

    Who acts now has an observation; each of them, and nobody else, has to give an action::

        observations, infos = env.reset(seed=0)
        while env.agents:
            actions = {agent: act(agent, observation) for agent, observation in observations.items()}
            observations, rewards, terminations, truncations, infos = env.step(actions)

    A subclass says what an agent sees and what actions do; turns, rewards and the ends of agents are kept here::

        class Guess(MultiAgentEnv):
            possible_agents = ("chooser", "guesser")

            def begin_episode(self, options):
                self.word, self.said = "", ""

            def observe(self, agent):
                return "Choose a word." if agent == "chooser" else f"It has {len(self.word)} letters. Which is it?"

            def process_actions(self, actions):
                if "chooser" in actions:
                    self.word = extract_last_boxed_answer(actions["chooser"]) or ""
                    return {}, {}, {}, {}
                right = extract_last_boxed_answer(actions["guesser"]) == self.word
                over = dict.fromkeys(self.agents, True)
                return {"guesser": float(right), "chooser": -float(right)}, over, {}, {}

    It draws all randomness from ``np_random``, and may override ``sample_random_action``, ``render`` and ``close``, and
    ``_get_state`` with ``_set_state``. ``agent_selector`` decides whose turn it is. What an agent *says* to another is
    what the environment extracts of its response and shows in ``observe``; the response itself reaches nobody.

    Agents leave when they are terminated or truncated, and never come back; others of ``possible_agents`` may join by
    ``add_agent``. One that ended has its last observation in ``infos[agent]["final_obs"]``.

    A response is untrusted text of a model: one that cannot be read is an observation for that agent, never an error.
    """

    possible_agents: Sequence[str] = ()
    """Every agent that may take part, in the order of their turns."""

    agents: list[str]
    """Those who take part now; empty when the episode is over."""

    max_steps: int | None = None
    """Number of steps after which all agents are truncated; None for no limit. A record's ``max_turns`` goes first."""

    cumulative: dict[str, float]
    """The sum of each agent's rewards in this episode, those included that ``step`` has not returned yet."""

    terminations: dict[str, bool]
    """Whether the task is over for each agent that has taken part in this episode."""

    truncations: dict[str, bool]
    """Whether each agent that has taken part in this episode was cut off."""

    _in_episode = False
    _unpaid: dict[str, float]
    _news: dict[str, Info]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Refuse a selector of the class, which all its environments would share."""
        super().__init_subclass__(**kwargs)
        if isinstance(vars(cls).get("agent_selector"), AgentSelector):
            raise TypeError(
                f"{cls.__name__} sets agent_selector in the class, where all its environments would share it; "
                "set self.agent_selector in __init__"
            )

    @cached_property
    def agent_selector(self) -> AgentSelector:
        """Who acts next: one after another in the order of ``possible_agents``, unless a subclass sets its own."""
        return AgentSelector()

    # What a subclass writes.

    def begin_episode(self, options: dict[str, Any] | None) -> Mapping[str, Info] | None:
        """Set up an episode; ``np_random`` is seeded, and all possible agents take part.

        It may set ``self.agents`` to some of them, and change the turns by ``agent_selector``.

        Args:
            options: What the caller of ``reset`` chose.

        Returns:
            Infos for some agents, each given with its first observation; or None.
        """
        return None

    def observe(self, agent: str) -> Observation:
        """Return what an agent sees now; called when it is to act, and when it has ended."""
        raise NotImplementedError(f"{type(self).__name__} must define observe(self, agent)")

    def process_actions(self, actions: dict[str, str]) -> Verdict:
        """Carry out the responses of those who acted.

        Returns:
            ``(rewards, terminations, truncations, infos)``, each for those agents for which there is something to say.
            The five values of ``step`` are taken as well; observations are then those of ``observe`` all the same.
        """
        raise NotImplementedError(f"{type(self).__name__} must define process_actions(self, actions)")

    def sample_random_action(self, agent: str) -> str:  # type: ignore[override]  # an agent has to be named
        """Return a valid response of an agent that acts now, drawn from ``action_random``.

        Raises:
            SamplingNotSupported: The environment cannot sample actions.
        """
        raise SamplingNotSupported(
            f"{type(self).__name__} does not say what a valid action is; override sample_random_action(self, agent)"
        )

    def observation_space(self, agent: str) -> spaces.Space[Any]:  # type: ignore[override]  # as in PettingZoo
        """Return the space of an agent's observations: text, unless a subclass says otherwise."""
        return Text()

    def action_space(self, agent: str) -> spaces.Space[Any]:  # type: ignore[override]  # as in PettingZoo
        """Return the space of an agent's actions: any text."""
        return Text()

    def add_agent(self, agent: str) -> None:
        """Let another of ``possible_agents`` join the episode, last in the order of turns.

        Raises:
            ArgumentError: It is no possible agent, or has taken part already.
        """
        if agent not in self.possible_agents:
            raise ArgumentError(f"{agent!r} is not among the possible agents {self._named(self.possible_agents)}")
        if agent in self.terminations:
            raise ArgumentError(f"{agent!r} has taken part in this episode already, and cannot join it again")
        self.agents.append(agent)
        self._enter(agent)
        self.agent_selector.add(agent)

    # What is kept here.

    def reset(  # type: ignore[override]  # dictionaries by agent
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> JointResetResult:
        """Begin an episode; see ``Env.reset``.

        Returns:
            The observations of those who act first, and their infos.
        """
        self._in_episode = False
        super().reset(seed=seed)
        possible = list(self.possible_agents)
        if not possible or len(set(possible)) < len(possible):
            raise TypeError(f"{self._name} must set possible_agents to names that differ, not {possible!r}")
        self.agents = possible.copy()
        self.agent_selector.reset(possible)
        self._steps = 0
        self.cumulative, self._unpaid = {}, {}
        self.terminations, self.truncations, self._news = {}, {}, {}
        told = self._checked_beginning(self.begin_episode(options))
        self.agents = list(dict.fromkeys(self.agents))  # a part of possible_agents may be a tuple
        for agent in possible:
            if agent not in self.agents:
                self.agent_selector.remove(agent)
        for agent in self.agents:
            self._enter(agent)
        self._inform(told)
        self._in_episode = True
        acting = self._next_to_act()
        return self._observations(acting), {agent: self._infos_of(agent) for agent in acting}

    def step(self, actions: Mapping[str, str]) -> JointStepResult:  # type: ignore[override]
        """Answer the responses of all who act now.

        Args:
            actions: ``{agent: response}`` for each agent that has an observation, and for no other.

        Returns:
            ``(observations, rewards, terminations, truncations, infos)``. ``observations`` are of those who act next;
            ``rewards`` and ``infos`` of those, and of those who ended in this step. A reward is all that the agent
            earned since it acted last. ``terminations`` and ``truncations`` are of every agent that has taken part.

        Raises:
            ArgumentError: An action is missing, is of an agent that does not act now, or is no text.
            ResetNeededError: The episode is over or has not begun.
        """
        self._check_actions(actions)
        result = self.process_actions(dict(actions))
        rewards, terminations, truncations, told = self._checked(result)
        self._steps += 1
        for agent, reward in rewards.items():
            self._unpaid[agent] += reward
            self.cumulative[agent] += reward
        self._inform(told)
        return self._result(self._take_out(terminations, truncations, cut_off=self._is_out_of_steps()))

    def truncate_all(self) -> JointStepResult:
        """End the episode from outside: all who take part are truncated.

        Returns:
            What ``step`` would, with the rewards that nobody has been given.

        Raises:
            ResetNeededError: The episode is over or has not begun.
        """
        self._check_in_episode()
        return self._result(self._take_out({}, {}, cut_off=True))

    @property
    def acting(self) -> tuple[str, ...]:
        """Who has to act now; nobody outside an episode."""
        return tuple(self.agent_selector.selected) if self._in_episode else ()

    def get_state(self) -> dict[str, Any]:
        """Return all that decides how the episode goes on; see ``Env.get_state``."""
        state = super().get_state()
        kept = {name: copy.deepcopy(value) for name, value in vars(self).items() if name in _KEPT}
        return {**state, "turns": kept, "selector": self.agent_selector.get_state()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore a state that ``get_state`` of an instance of this environment returned; see ``Env.set_state``."""
        super().set_state(state)
        try:
            self.agent_selector.set_state(state["selector"])
            vars(self).update({name: copy.deepcopy(state["turns"][name]) for name in _KEPT if name in state["turns"]})
        except (LookupError, TypeError, AttributeError) as error:
            raise StateError(
                f"the state of {self._name!r} is damaged ({type(error).__name__}: {error}); "
                "call reset(), or give a state that get_state() returned"
            ) from error

    @property
    def _name(self) -> str:
        return self.env_id or type(self).__name__

    def _enter(self, agent: str) -> None:
        self.cumulative[agent] = self._unpaid[agent] = 0.0
        self.terminations[agent] = self.truncations[agent] = False
        self._news[agent] = {"seed": self._np_random_seed}

    def _result(self, ended: list[str]) -> JointStepResult:
        """Return the result of a step in which some agents ended."""
        acting = self._next_to_act() if self.agents else []
        self._in_episode = bool(self.agents)
        for agent in ended:
            self._news[agent]["final_obs"] = self._observation(agent)
        rewards, infos = {}, {}
        for agent in (*acting, *ended):
            rewards[agent], self._unpaid[agent] = self._unpaid[agent], 0.0
            infos[agent] = self._infos_of(agent)
        return self._observations(acting), rewards, dict(self.terminations), dict(self.truncations), infos

    def _is_out_of_steps(self) -> bool:
        record = None if self.spec is None else self.spec.record
        limit = self.max_steps if record is None or record.max_turns is None else record.max_turns
        return limit is not None and self._steps >= limit

    def _check_in_episode(self) -> None:
        if not self.acting:
            raise ResetNeededError(
                f"{self._name}: the episode is over or has not begun; call reset() before the next step()"
            )

    def _check_actions(self, actions: Mapping[str, str]) -> None:
        self._check_in_episode()
        acting = self.acting
        if not isinstance(actions, _MAPPING):
            raise ArgumentError(f"actions are {{agent: response}}, here of {self._named(acting)}, not {actions!r:.100}")
        for agent in acting:
            if agent not in actions:
                raise ArgumentError(f"the action of {agent!r} is missing; {self._who_acts()}")
        for agent, action in actions.items():
            if agent not in acting:
                raise ArgumentError(f"there is an action of {agent!r}, which does not act now; {self._who_acts()}")
            if not isinstance(action, str):
                raise ArgumentError(
                    f"an action is a str or a Response, and that of {agent!r} is {action!r:.100} of type "
                    f"{type(action).__name__}"
                )

    def _who_acts(self) -> str:
        return f"{self._named(self.acting)} {'acts' if len(self.acting) == 1 else 'act'} now"

    def _checked_beginning(self, told: Any) -> Mapping[str, Info]:
        """Return the infos of ``begin_episode``, if they and ``agents`` are well-formed.

        Raises:
            TypeError: It returned something else.
            ValueError: Nobody takes part, or somebody who is no possible agent; or an info is for nobody who does.
        """
        if not self.agents or not set(self.agents) <= set(self.possible_agents):
            raise ValueError(
                f"{self._name}: begin_episode must leave some of {self._named(self.possible_agents)} in self.agents, "
                f"not {self.agents!r:.200}"
            )
        if told is None:
            return {}
        if not isinstance(told, Mapping) or not all(isinstance(info, dict) for info in told.values()):
            self._refuse(f"begin_episode must return {{agent: info}} or None, not {told!r:.200}")
        for agent in told:
            if agent not in self.agents:
                raise ValueError(
                    f"{self._name}: begin_episode has an info for {agent!r}, and {self._named(self.agents)} take part"
                )
        return told

    def _checked(self, result: object) -> tuple[dict[str, float], dict[str, bool], dict[str, bool], dict[str, Info]]:
        """Return what ``process_actions`` returned, if it is well-formed.

        Raises:
            TypeError: It is not four or five dictionaries, or a value has a wrong type.
            ValueError: A reward is not finite, or is for an agent that does not take part.
        """
        parts = result[-4:] if isinstance(result, tuple) and len(result) in (4, 5) else ()
        if not parts or not all([isinstance(part, _MAPPING) for part in parts]):
            self._refuse(
                f"process_actions must return (rewards, terminations, truncations, infos), not {result!r:.200}"
            )
        rewards, terminations, truncations, infos = parts
        for agent in {**rewards, **terminations, **truncations, **infos}:
            if agent not in self.agents:
                raise ValueError(
                    f"{self._name}: process_actions names {agent!r}, and {self._named(self.agents)} take part"
                )
        for agent, info in infos.items():
            if not isinstance(info, dict):
                self._refuse(f"the info of {agent!r} must be a dictionary, not {type(info).__name__}")
        return (
            {
                agent: checked_reward(reward, f"{self._name}: the reward of {agent!r}")
                for agent, reward in rewards.items()
            },
            {agent: bool(flag) for agent, flag in terminations.items()},
            {agent: bool(flag) for agent, flag in truncations.items()},
            dict(infos),
        )

    def _refuse(self, problem: str) -> NoReturn:
        raise TypeError(f"{self._name}: {problem}")

    def _inform(self, told: Mapping[str, Info]) -> None:
        for agent, info in told.items():
            self._news[agent].update(info)

    def _take_out(
        self, terminations: Mapping[str, bool], truncations: Mapping[str, bool], *, cut_off: bool
    ) -> list[str]:
        """Take those who ended out of the episode, and return them."""
        ended = []
        for agent in list(self.agents):
            terminated = terminations.get(agent, False)
            truncated = truncations.get(agent, False) or (cut_off and not terminated)
            if terminated or truncated:
                self.terminations[agent], self.truncations[agent] = terminated, truncated
                self.agents.remove(agent)
                self.agent_selector.remove(agent)
                ended.append(agent)
        return ended

    def _next_to_act(self) -> list[str]:
        acting = self.agent_selector.next()
        wrong = [agent for agent in acting if agent not in self.agents]
        if wrong or not acting:
            raise RuntimeError(
                f"{self._name}: the agent_selector chose {self._named(wrong) or 'nobody'} to act next, and "
                f"{self._named(self.agents)} take part"
            )
        return acting

    def _observations(self, agents: Iterable[str]) -> dict[str, Observation]:
        return {agent: self._observation(agent) for agent in agents}

    def _observation(self, agent: str) -> Observation:
        observation = self.observe(agent)
        if not isinstance(observation, str | list):
            self._refuse(f"an observation must be text or a list, and that of {agent!r} is {observation!r:.100}")
        return observation

    def _infos_of(self, agent: str) -> Info:
        news, self._news[agent] = self._news[agent], {}
        return news

    @staticmethod
    def _named(agents: Iterable[str]) -> str:
        return ", ".join(map(repr, agents))


def check_seats(named: Iterable[str], seats: Sequence[str]) -> None:
    """Raise an error for a name that is no seat.

    Args:
        named: What is checked.
        seats: The ``possible_agents`` of an environment.

    Raises:
        ArgumentError: Names the seats that there are.
    """
    for name in named:
        if name not in seats:
            hint = did_you_mean(str(name), seats)
            raise ArgumentError(f"there is no seat {name!r}.{hint} The seats are: {', '.join(map(repr, seats))}")


_KEPT = ("agents", "cumulative", "terminations", "truncations", "_unpaid", "_news", "_steps", "_in_episode")
"""Attributes that are part of the state."""

_MAPPING = dict, Mapping
"""Most are dictionaries, which is soon seen; to ask the abstract class of each takes longer than all else here."""
