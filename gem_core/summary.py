"""What a run amounts to, for each environment and in all."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from gem_core.episodes import Episode


@dataclass
class EnvSummary:
    """Counts and sums over the episodes of one environment.

    Episodes with an error count apart, and in nothing else but the tokens, which were spent on them all the same.

    Args:
        id: The environment; ``"all"`` for the sum of several.
        episodes: Number of episodes without an error.
        errors: Number of episodes with one.
        judged: Number of episodes of which it is known whether they succeeded.
        successes: Number of those that did.
        total_return: Sum of their returns.
        turns: Sum of their turns.
        prompt_tokens: Tokens that the model read, as its server counts them; None where no response says.
        completion_tokens: Tokens that it wrote.
        earlier_turns: Those of the turns that were taken before this session of the run.
    """

    id: str
    episodes: int = 0
    errors: int = 0
    judged: int = 0
    successes: int = 0
    total_return: float = 0.0
    turns: int = 0
    prompt_tokens: int | None = None
    completion_tokens: int | None = None
    earlier_turns: int = 0

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
        self.total_return += episode.episode_return
        self.turns += episode.turns
        if episode.success is not None:
            self.judged += 1
            self.successes += episode.success

    def turns_per_second(self, seconds: float) -> float | None:
        """Return how fast this session of the run was; None where it took no time."""
        return (self.turns - self.earlier_turns) / seconds if seconds > 0 else None

    @property
    def success_rate(self) -> float | None:
        """Share of judged episodes that succeeded; None where none was judged."""
        return self.successes / self.judged if self.judged else None

    @property
    def mean_return(self) -> float | None:
        """Mean return; None without episodes."""
        return self.total_return / self.episodes if self.episodes else None

    @property
    def mean_turns(self) -> float | None:
        """Mean number of turns; None without episodes."""
        return self.turns / self.episodes if self.episodes else None


class RunSummary:
    """The summaries of a run's environments, in the order in which they are named."""

    def __init__(self, ids: list[str]) -> None:
        self.total = EnvSummary("all")
        self.by_env = {env_id: EnvSummary(env_id) for env_id in ids}
        self.first_error: str | None = None

    def add(self, episode: Episode) -> None:
        """Count an episode."""
        self.by_env.setdefault(episode.id, EnvSummary(episode.id)).add(episode)
        self.total.add(episode)
        if episode.error is not None and self.first_error is None:
            self.first_error = f"{episode.id}, seed {episode.seed}: {episode.error.get('message', episode.error)}"

    def begin_session(self) -> None:
        """Note that what was counted so far was run before; it has no part in how fast the run is."""
        for row in (self.total, *self.by_env.values()):
            row.earlier_turns = row.turns

    def rows(self) -> list[EnvSummary]:
        """Return a summary for each environment, and one for all where there are several."""
        rows = list(self.by_env.values())
        return [*rows, self.total] if len(rows) > 1 else rows

    def to_dict(self, seconds: float) -> dict[str, Any]:
        """Return all rows as plain JSON.

        Args:
            seconds: Duration of the run, for turns per second.
        """
        return {
            "seconds": round(seconds, 6),
            "environments": [
                {
                    **asdict(row),
                    "success_rate": row.success_rate,
                    "mean_return": row.mean_return,
                    "mean_turns": row.mean_turns,
                    "turns_per_second": row.turns_per_second(seconds),
                }
                for row in self.rows()
            ],
        }


def _plus(total: int | None, count: object) -> int | None:
    """Add what a server reported, if it is a count."""
    return (total or 0) + count if type(count) is int else total
