"""Scores of a run, for each environment and in total."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from gem_core.records.episode import Episode
from gem_core.records.joint import Record
from gem_core.records.uncertainty import Range, shared_range, standard_error


@dataclass
class EnvSummary:
    """Counts and sums over the episodes of one environment; with several agents, for one agent at one seat.

    Episodes with an error count apart, and in nothing else but the tokens, which were spent on them all the same.

    Args:
        id: The environment; ``"all"`` for the sum of several.
        episodes: Number of episodes without an error.
        errors: Number of episodes with one.
        judged: Number of episodes of which it is known whether they succeeded. One that was cut off did not, unless its
            task never tells.
        successes: Number of solved episodes.
        cut_off_by_turns: Number of episodes that a limit of turns or the environment cut off.
        cut_off_by_tokens: Number of those whose context overflowed, or whose last response stopped at its token limit.
        cut_off_by_limits: Number of episodes that another limit cut off, as of time or of cost.
        total_return: Sum of the returns.
        turns: Sum of the turns.
        prompt_tokens: Tokens that the model read, as its server counts them; None if no response says.
        completion_tokens: Tokens that it wrote.
        earlier_turns: Those of the turns that were taken before this session of the run.
        seat: Name of the seat; None for one agent, and for the sum of an agent's seats.
        agent: Name of the agent at the seat; None for one agent.
    """

    id: str
    episodes: int = 0
    errors: int = 0
    judged: int = 0
    successes: int = 0
    cut_off_by_turns: int = 0
    cut_off_by_tokens: int = 0
    cut_off_by_limits: int = 0
    total_return: float = 0.0
    turns: int = 0
    prompt_tokens: int | None = None
    completion_tokens: int | None = None
    earlier_turns: int = 0
    seat: str | None = None
    agent: str | None = None
    _verdicts: int = field(default=0, repr=False)
    _silent: int = field(default=0, repr=False)
    _cut_off: int = field(default=0, repr=False)
    _returns: list[float] = field(default_factory=list, repr=False)
    _ranges: set[Range | None] = field(default_factory=set, repr=False)
    _pays_success: bool = field(default=True, repr=False)

    @property
    def label(self) -> str:
        """Name in a table: the environment, and the seat with its agent."""
        seat = "" if self.seat is None else f"{self.seat}="
        return self.id if self.agent is None else f"{self.id} {seat}{self.agent}"

    def add(self, episode: Episode) -> None:
        """Count an episode."""
        for turn in episode.transitions:
            if turn.action.usage is not None:
                self.prompt_tokens = _plus(self.prompt_tokens, turn.action.usage.get("prompt_tokens"))
                self.completion_tokens = _plus(self.completion_tokens, turn.action.usage.get("completion_tokens"))
        if episode.error is not None:
            self.errors += 1
            return
        self.episodes += 1
        self.cut_off_by_turns += episode.cut_off == "turns"
        self.cut_off_by_tokens += episode.cut_off == "tokens"
        self.cut_off_by_limits += episode.cut_off not in (None, "turns", "tokens")
        self.turns += episode.turns
        self.total_return += episode.episode_return
        self._returns.append(episode.episode_return)
        self._ranges.add(episode.return_range)
        self._pays_success &= episode.success is not None and episode.episode_return == episode.success
        if episode.success is None:
            self._silent += 1
        elif episode.final_info.get("correct") is None:
            self._cut_off += 1
        else:
            self._verdicts += 1
            self.successes += episode.success
        # Episodes ended without a verdict, and none had one: this task never tells.
        never_tells = self._silent and not self._verdicts
        self.judged = self._verdicts + (0 if never_tells else self._cut_off)

    def turns_per_second(self, seconds: float) -> float | None:
        """Return the turns per second of this session of the run; None if it took no time."""
        return (self.turns - self.earlier_turns) / seconds if seconds > 0 else None

    @property
    def success_rate(self) -> float | None:
        """Share of the judged episodes that were solved; None if none was judged."""
        return self.successes / self.judged if self.judged else None

    @property
    def success_standard_error(self) -> float | None:
        """Standard error of the success rate, after Wilson; None if none was judged. See ``standard_error``."""
        if not self.judged:
            return None
        rate = self.successes / self.judged
        return standard_error(self.judged, rate, self.judged * rate * (1 - rate), (0.0, 1.0))

    @property
    def mean_return(self) -> float | None:
        """Mean return; None without episodes."""
        return self.total_return / self.episodes if self.episodes else None

    @property
    def return_standard_error(self) -> float | None:
        """Standard error of the mean return; None if the sample does not tell. See ``standard_error``.

        Returns that are 1 for success and else 0 have that of the success rate.
        """
        mean = self.mean_return
        if mean is None:
            return None
        if self._pays_success:
            return self.success_standard_error
        squares = sum((each - mean) ** 2 for each in self._returns)
        within = shared_range(self._ranges, min(self._returns), max(self._returns))
        return standard_error(self.episodes, mean, squares, within)

    @property
    def mean_turns(self) -> float | None:
        """Mean number of turns; None without episodes."""
        return self.turns / self.episodes if self.episodes else None

    def to_dict(self, seconds: float) -> dict[str, Any]:
        """Return the counts and what follows from them as plain JSON.

        Args:
            seconds: Duration of the run, for turns per second.
        """
        return {
            **{name: value for name, value in asdict(self).items() if not name.startswith("_")},
            "success_rate": self.success_rate,
            "success_standard_error": self.success_standard_error,
            "mean_return": self.mean_return,
            "return_standard_error": self.return_standard_error,
            "mean_turns": self.mean_turns,
            "turns_per_second": self.turns_per_second(seconds),
        }


class RunSummary:
    """The summaries of a run's environments, in the order in which they are named.

    ``episodes`` is the number of episodes, those with an error included, and ``errors`` that of those; one of several
    agents counts once.
    """

    def __init__(self, ids: list[str]) -> None:
        self.total = EnvSummary("all")
        self.by_env = {env_id: EnvSummary(env_id) for env_id in ids}
        self.by_seat: dict[tuple[str, str, str], EnvSummary] = {}
        """The summary of an agent at a seat, by environment, seat and agent."""
        self.by_agent: dict[tuple[str, str], EnvSummary] = {}
        """The summary of an agent at all its seats, by environment and agent."""
        self.episodes = 0
        self.errors = 0
        self.first_error: str | None = None
        self.first_frames: list[str] = []
        """Where the first error passed through the author's code."""

    def add(self, episode: Record) -> None:
        """Count an episode; of several agents, that of each seat in a row of its own."""
        self.episodes += 1
        if episode.error is not None:
            self.errors += 1
            if self.first_error is None:
                self.first_error = f"{episode.id}, seed {episode.seed}: {episode.error.get('message', episode.error)}"
                self.first_frames = list(map(str, episode.error.get("frames") or ()))
        row = self.by_env.setdefault(episode.id, EnvSummary(episode.id))
        if isinstance(episode, Episode):
            self._add(episode, row)
            return
        for seat, each in episode.seats.items():
            agent = str(each.agent)
            own = EnvSummary(episode.id, seat=seat, agent=agent)
            self._add(each, self.by_seat.setdefault((episode.id, seat, agent), own))
            self.by_agent.setdefault((episode.id, agent), EnvSummary(episode.id, agent=agent)).add(each)
        if not episode.seats:  # its reset failed
            self._add(Episode(episode.id, episode.seed, "", {"error": episode.error}), row)

    def _add(self, episode: Episode, row: EnvSummary) -> None:
        others = self.total.judged - row.judged
        row.add(episode)
        self.total.add(episode)
        self.total.judged = others + row.judged  # a task without verdicts says nothing about another

    def begin_session(self) -> None:
        """Mark the episodes counted so far as run earlier: they do not count for turns per second."""
        for row in (self.total, *self.by_env.values(), *self.by_seat.values(), *self.by_agent.values()):
            row.earlier_turns = row.turns

    def rows(self) -> list[EnvSummary]:
        """Return a summary for each environment, and one for all if there are several and each is for one agent.

        If several agents act, there is one for each agent at each seat, and one for each of several agents that
        changed seats; none mixes the two sides of a game.
        """
        seated = {row.id for row in self.by_seat.values()}
        alone = [row for row in self.by_env.values() if row.episodes or row.errors or row.id not in seated]
        rows = [*alone, *(row for env_id in self.by_env for row in self._rows_of_seats(env_id))]
        return [*rows, self.total] if len(rows) > 1 and not self.by_seat else rows

    def _rows_of_seats(self, env_id: str) -> list[EnvSummary]:
        # By seat in the environment's order, and by agent in that of the alphabet: agents come as episodes finish.
        seated = [row for row in self.by_seat.values() if row.id == env_id]
        seats = list(dict.fromkeys(row.seat for row in seated))
        rows = sorted(seated, key=lambda row: (seats.index(row.seat), str(row.agent)))
        agents = sorted((row for row in self.by_agent.values() if row.id == env_id), key=lambda row: str(row.agent))
        return [*rows, *agents] if 1 < len(agents) < len(rows) else rows

    def to_dict(self, seconds: float) -> dict[str, Any]:
        """Return all rows as plain JSON.

        Args:
            seconds: Duration of the run, for turns per second.
        """
        return {
            "seconds": round(seconds, 6),
            "episodes": self.episodes,
            "errors": self.errors,
            "environments": [row.to_dict(seconds) for row in self.rows()],
        }


def _plus(total: int | None, count: object) -> int | None:
    """Add what a server reported, if it is a count."""
    return (total or 0) + count if type(count) is int else total
