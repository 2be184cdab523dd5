"""``Stage``: one environment, the rows of it that are audited, and episodes played on it by any policy."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

import gem_core
from gem_core.records import to_plain
from gem_core.terminal import observation_text

MOST_TURNS = 200
"""Turns after which an episode is left; no task of ours has more."""
_SHOWN = 160
"""Characters of a response that an example shows."""

Respond = Callable[[str, Mapping[str, Any], int], str | None]
"""Called with the observation as text, its info and the number of turns taken; None breaks the episode off."""


class AuditTask(NamedTuple):
    """One task: a row of a data set, or one seed of a game."""

    name: str
    """The same in every run: the id of the environment, and the task's id, index or seed."""
    seed: int
    options: dict[str, Any]


@dataclass(frozen=True)
class AuditTurn:
    """A response, and what the environment answered."""

    response: str
    observation: str
    reward: float
    info: Mapping[str, Any]
    over: bool


@dataclass
class AuditEpisode:
    """An episode, as far as it was played."""

    row: AuditTask
    observation: str = ""
    info: Mapping[str, Any] = field(default_factory=dict)
    turns: list[AuditTurn] = field(default_factory=list)
    crash: str = ""
    """The exception that a reset or a step raised; empty for none."""

    @property
    def total(self) -> float:
        """The sum of the rewards."""
        return sum(turn.reward for turn in self.turns)

    @property
    def last_info(self) -> Mapping[str, Any]:
        """The info that came last."""
        return self.turns[-1].info if self.turns else self.info

    @property
    def error(self) -> str:
        """The error that the environment reports, which is not the agent's; empty for none."""
        error = self.last_info.get("error")
        return "" if not error else str(error.get("message", error) if isinstance(error, Mapping) else error)

    @property
    def response(self) -> str:
        """The last response."""
        return self.turns[-1].response if self.turns else ""

    @property
    def shown(self) -> str:
        """The first response, cut, and what the episode was paid."""
        response = " ".join((self.turns[0].response if self.turns else "").split())
        cut = response if len(response) <= _SHOWN else f"{response[: _SHOWN // 2]} … {response[-_SHOWN // 2 :]}"
        return f"{cut!r} got {self.total:g}"

    def solved(self, target: float | None) -> bool:
        """Tell whether the episode counts as success: the environment says so, or pays as much as for gold.

        Args:
            target: What a solution is paid; None where that is not known.
        """
        correct = self.last_info.get("correct")
        if correct is True:
            return True
        if target is None and correct is not None:
            return False
        return bool(self.turns) and self.total >= (1.0 if target is None else target) - 1e-9

    def record(self, exact: bool) -> list[str]:
        """Return what a second run of the same responses must give again, item by item.

        Args:
            exact: Whether all is compared; else the sum of the rewards, and whether the task was solved.
        """
        if not exact:
            return [_text({"return": self.total, "correct": self.last_info.get("correct")}), self.crash]
        first = [_text({"observation": self.observation, "info": self.info})]
        return [*first, *(_text(vars(turn)) for turn in self.turns), self.crash]


class Stage:
    """An environment to be audited.

    Args:
        env_id: Its id.
        kwargs: Keyword arguments for it.
        limit: Rows that are taken at most: all of a data set, or else some drawn by ``seed``.
        seed: Of the choice of rows, and of the episodes.

    Raises:
        GemError: It cannot be made.
    """

    def __init__(self, env_id: str, kwargs: Mapping[str, Any], *, limit: int, seed: int) -> None:
        self.env_id, self.kwargs = env_id, dict(kwargs)
        self.deterministic = gem_core.spec(env_id).deterministic
        self.env: Any = gem_core.make(env_id, **kwargs)
        self.env_again: Any = None
        self.count: int | None = self.env.get_wrapper_attr("num_tasks")
        if self.count is None:
            self.rows = [AuditTask(f"{env_id}/{each}", each, {}) for each in range(seed, seed + limit)]
        else:
            every = np.random.default_rng(seed).permutation(self.count) if self.count > limit else np.arange(self.count)
            chosen = sorted(every[:limit].tolist())
            self.rows = [AuditTask(f"{env_id}/{index}", seed + index, {"index": index}) for index in chosen]

    def play(
        self, row: AuditTask, respond: Respond, *, most_turns: int = MOST_TURNS, again: bool = False
    ) -> AuditEpisode:
        """Play an episode.

        Args:
            row: What it starts from.
            respond: The policy.
            most_turns: Turns after which it is left.
            again: Play it in a second instance of the environment, which lives beside the first.
        """
        if again and self.env_again is None:
            self.env_again = gem_core.make(self.env_id, **self.kwargs)
        env = self.env_again if again else self.env
        played = AuditEpisode(row)
        options = {"options": dict(row.options)} if row.options else {}
        with redirect_stdout(io.StringIO()):  # a grader may run what prints
            try:
                observation, played.info = env.reset(seed=row.seed, **options)
                played.observation = shown = observation_text(observation)
                while len(played.turns) < most_turns:
                    response = respond(shown, played.last_info, len(played.turns))
                    if response is None:
                        break
                    observation, reward, terminated, truncated, info = env.step(response)
                    shown, over = observation_text(observation), bool(terminated or truncated)
                    played.turns.append(AuditTurn(response, shown, float(reward), info, over))
                    if over:
                        break
            except (Exception, SystemExit) as error:  # noqa: BLE001 - third-party code may raise anything
                played.crash = f"{type(error).__name__}: {error}"[:300]
        return played

    def gold(self) -> str | None:
        """Return a response that solves the present state; None where none is known."""
        gold = self.env.get_wrapper_attr("gold_action")()
        return gold if isinstance(gold, str) else None

    def sample(self) -> str | None:
        """Return a random valid response; None where the environment has none."""
        with suppress(Exception):  # third-party code may raise anything
            return str(self.env.get_wrapper_attr("sample_random_action")())
        return None

    def replay(self, played: AuditEpisode) -> AuditEpisode:
        """Play the same responses again, in another instance."""
        responses = [turn.response for turn in played.turns]
        return self.play(
            played.row, lambda _o, _i, turn: responses[turn] if turn < len(responses) else None, again=True
        )

    def close(self) -> None:
        """Close the environment."""
        for env in (self.env, self.env_again):
            if env is not None:
                env.close()


def says(response: str) -> Respond:
    """Return a policy that always gives one response."""
    return lambda _observation, _info, _turn: response


def _text(value: Mapping[str, Any]) -> str:
    plain = dict(value)
    info = plain.get("info")
    if isinstance(info, Mapping) and isinstance(info.get("episode"), Mapping):
        # Seconds of the clock, as in Gymnasium.
        plain["info"] = {**info, "episode": {key: one for key, one in info["episode"].items() if key != "t"}}
    return json.dumps(to_plain(plain), sort_keys=True)
