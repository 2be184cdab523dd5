"""``MultiAgentEnv``: the base class of environments in which several agents act, and its contract."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from gem_core.env.agent_selector import AgentSelector
from gem_core.env.base import Env
from gem_core.env.checks import (
    Verdict,
    check_actions,
    checked_beginning,
    checked_observation,
    checked_verdict,
    named,
    reset_needed,
)
from gem_core.env.spaces import Text
from gem_core.errors import ArgumentError, SamplingNotSupported
from gem_core.types import Info, Observation, StepResult

if TYPE_CHECKING:
    from gymnasium import spaces

JointResetResult = tuple[dict[str, Observation], dict[str, Info]]
"""``(observations, infos)`` of those who act first."""

JointStepResult = tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Info]]
"""``(observations, rewards, terminations, truncations, infos)``; see ``MultiAgentEnv.step``."""


def result_of(joint: JointStepResult, agent: str) -> StepResult:
    """Return what a step gave one agent, as a step of one agent would: ``final_obs`` is the observation."""
    observations, rewards, terminations, truncations, infos = joint
    info = {name: value for name, value in infos[agent].items() if name != "final_obs"}
    observation = observations[agent] if agent in observations else infos[agent]["final_obs"]
    return observation, rewards[agent], terminations[agent], truncations[agent], info


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
    ``__deepcopy__`` as any ``Env``. ``agent_selector`` decides whose turn it is. What an agent *says* to another is
    what the environment extracts of its response and shows in ``observe``; the response itself reaches nobody.

    Agents leave when they are terminated or truncated, and never come back; others of ``possible_agents`` may join by
    ``add_agent``. One that ended has its last observation in ``infos[agent]["final_obs"]``.

    A response is untrusted text of a model: one that cannot be read is an observation for that agent, never an error.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - as in Gymnasium
    """List ``"ansi"`` and ``"human"`` where ``render`` returns a text; in the mode ``"human"`` it is printed here."""

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

    agent_selector: AgentSelector = AgentSelector()
    """Who acts next: one after another in the order of ``possible_agents``, unless a subclass sets its own.

    Each environment has a copy of its class's.
    """

    __live = False
    __steps: int
    __unpaid: dict[str, float]
    """Rewards that ``step`` has not returned yet."""
    __news: dict[str, Info]
    """Infos that ``step`` has not returned yet."""

    # What a subclass writes.

    def begin_episode(self, options: dict[str, Any] | None) -> Mapping[str, Info] | None:
        """Set up an episode; ``np_random`` is seeded, and all possible agents take part.

        It may set ``self.agents`` to some of them, and change the turns by ``agent_selector``.

        Args:
            options: The options of ``reset``.

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
            The five values of ``step`` are accepted as well; ``observe`` still gives the observations.
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

    def gold_action(self, agent: str) -> str | None:  # type: ignore[override]  # an agent has to be named
        """Return a response of an agent that acts now, by which its task is solved; see ``Env.gold_action``."""
        return None

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
            raise ArgumentError(f"{agent!r} is not among the possible agents {named(self.possible_agents)}")
        if agent in self.terminations:
            raise ArgumentError(f"{agent!r} has taken part in this episode already, and cannot join it again")
        self.agents.append(agent)
        self.__enter(agent)
        self.agent_selector.add(agent)

    # What is kept here. Names with two underscores are out of the way of a subclass's own.

    def reset(  # type: ignore[override]  # dictionaries by agent
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> JointResetResult:
        """Begin an episode; see ``Env.reset``.

        Returns:
            The observations of those who act first, and their infos.
        """
        self.__live, self.__steps, self.__unpaid, self.__news = False, 0, {}, {}
        super().reset(seed=seed)
        possible = list(self.possible_agents)
        name = self.env_id or type(self).__name__
        if not possible or len(set(possible)) < len(possible):
            raise TypeError(f"{name} must set possible_agents to names that differ, not {possible!r}")
        if "agent_selector" not in vars(self):
            self.agent_selector = copy.copy(self.agent_selector)
        self.agents = possible.copy()
        self.agent_selector.reset(possible)
        self.cumulative, self.terminations, self.truncations = {}, {}, {}
        told = self.begin_episode(options)
        told = checked_beginning(name, possible, self.agents, told)
        self.agents = list(dict.fromkeys(self.agents))  # a part of possible_agents may be a tuple
        for agent in possible:
            if agent not in self.agents:
                self.agent_selector.remove(agent)
        for agent in self.agents:
            self.__enter(agent)
        observations, _, _, _, infos = self.__go_on(told, [])
        return observations, infos

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
        name = self.env_id or type(self).__name__
        if not self.acting:
            raise reset_needed(self)
        check_actions(self.acting, actions)
        result = self.process_actions(dict(actions))
        rewards, terminations, truncations, told = checked_verdict(name, self.agents, result)
        self.__steps += 1
        for agent, reward in rewards.items():
            self.__unpaid[agent] += reward
            self.cumulative[agent] += reward
        record = None if self.spec is None else self.spec.record
        limit = self.max_steps if record is None or record.max_turns is None else record.max_turns
        out_of_steps = limit is not None and self.__steps >= limit
        return self.__go_on(told, self.__take_out(terminations, truncations, cut_off=out_of_steps))

    def truncate_all(self) -> JointStepResult:
        """End the episode from outside: all who take part are truncated.

        Returns:
            What ``step`` would, with the rewards that nobody has been given.

        Raises:
            ResetNeededError: The episode is over or has not begun.
        """
        if not self.acting:
            raise reset_needed(self)
        return self.__go_on({}, self.__take_out({}, {}, cut_off=True))

    @property
    def acting(self) -> tuple[str, ...]:
        """Who has to act now; nobody outside an episode."""
        return tuple(self.agent_selector.selected) if self.__live else ()

    def __enter(self, agent: str) -> None:
        self.cumulative[agent] = self.__unpaid[agent] = 0.0
        self.terminations[agent] = self.truncations[agent] = False
        self.__news[agent] = {"seed": self.np_random_seed}

    def __take_out(
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

    def __go_on(self, told: Mapping[str, Info], ended: list[str]) -> JointStepResult:
        """Choose who acts next; return what they and those who ended are given."""
        name = self.env_id or type(self).__name__
        for agent, info in told.items():
            self.__news[agent].update(info)
        acting = self.agent_selector.next() if self.agents else []
        wrong = [agent for agent in acting if agent not in self.agents]
        if wrong or (self.agents and not acting):
            raise RuntimeError(
                f"{name}: the agent_selector chose {named(wrong) or 'nobody'} to act next, and "
                f"{named(self.agents)} take part"
            )
        self.__live = bool(self.agents)
        for agent in ended:
            self.__news[agent]["final_obs"] = checked_observation(name, agent, self.observe(agent))
        rewards, infos = {}, {}
        for agent in (*acting, *ended):
            rewards[agent], self.__unpaid[agent] = self.__unpaid[agent], 0.0
            infos[agent], self.__news[agent] = self.__news[agent], {}
        observations = {agent: checked_observation(name, agent, self.observe(agent)) for agent in acting}
        if self.render_mode == "human" and isinstance(drawing := self.render(), str):
            from gem_core.terminal import Terminal

            Terminal().show_drawing(drawing)
        return observations, rewards, dict(self.terminations), dict(self.truncations), infos
