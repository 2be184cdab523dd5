"""What an audit found: rates of policies, and problems with examples."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Literal

from scipy.stats import binom, binomtest  # type: ignore[import-untyped]

Kind = Literal["gold", "chance", "exploit"]
KINDS: dict[str, Kind] = {
    "gold": "gold",
    "random": "chance",
    "echo": "chance",
    "other": "chance",
    "null": "exploit",
    "injection": "exploit",
    "hedge": "exploit",
    "peek": "exploit",
    "tamper": "exploit",
}
"""The policies, and what is right for each: gold always succeeds, exploits never do beyond chance."""

CHANCE_MARGIN = 0.05
"""By how much the lower bound of a rate must exceed chance before it counts."""


@dataclass
class Rate:
    """How often the episodes of a policy succeeded.

    Args:
        kind: What is right for it.
        episodes: Episodes that were judged; those with an error are left out.
        solved: Those that succeeded, not counting those that chance explains, as where the response names the gold
            answer of its row.
    """

    kind: Kind
    episodes: int = 0
    solved: int = 0

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON."""
        rate = self.solved / self.episodes if self.episodes else None
        return {"kind": self.kind, "solved": self.solved, "episodes": self.episodes, "rate": rate}


@dataclass(frozen=True)
class Problem:
    """A defect of an environment.

    Args:
        kind: Its name in one word, as ``"gold"`` or ``"duplicates"``.
        share: Of the rows or episodes that show it, from 0 to 1; compared with the threshold.
        message: What is wrong, in a sentence.
        examples: Rows with what was found there.
        fails: Whether it counts for the exit code; else it is a note, to be looked at.
    """

    kind: str
    share: float
    message: str
    examples: tuple[str, ...] = ()
    fails: bool = True


@dataclass
class EnvAudit:
    """What was found of one environment.

    Args:
        id: Its id.
        rows: Rows that were played.
        chance: How often the most frequent gold answer is right; None where answers are not known.
        rates: By policy; one that cannot be played here is missing.
        problems: What is wrong, and notes.
        failure: Why it was not audited; empty where it was.
    """

    id: str
    rows: int = 0
    chance: float | None = None
    rates: dict[str, Rate] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    failure: str = ""

    def fails(self, threshold: float = 0.0) -> bool:
        """Tell whether a problem goes beyond a threshold, or the audit itself failed."""
        return bool(self.failure) or any(each.fails and each.share > threshold for each in self.problems)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON."""
        policies = {name: rate.to_dict() for name, rate in self.rates.items()}
        problems = [dataclasses.asdict(problem) for problem in self.problems]
        told = {"id": self.id, "rows": self.rows, "chance": self.chance}
        return {**told, "policies": policies, "problems": problems, "failure": self.failure}


def lower_bound(solved: int, count: int) -> float:
    """Return the lower end of Wilson's interval of 99 % for a rate; 0 for none.

    Source: E. B. Wilson, JASA 22 (1927), 209-212.
    """
    return float(binomtest(solved, count).proportion_ci(0.99, method="wilson").low) if count else 0.0


def tail(hits: int, count: int, chance: float) -> float:
    """Return the probability of at least ``hits`` successes in ``count`` trials of a chance."""
    return float(binom.sf(hits - 1, count, chance))
