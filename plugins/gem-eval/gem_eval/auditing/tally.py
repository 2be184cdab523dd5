"""``Tally``: what the policies of an audit have in common: gold answers, counting, and problems."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from gem_eval.auditing.forms import Form
from gem_eval.auditing.results import EnvAudit, Problem, Rate, lower_bound
from gem_eval.auditing.texts import holds, normal

if TYPE_CHECKING:
    from gem_eval.auditing.leaks import Look
    from gem_eval.auditing.stage import Played, Stage

CHANCE_MARGIN = 0.05
"""By how much the lower bound of a rate must exceed chance before it counts."""
_UNKNOWN_CHANCE = 0.1
SHOWN = 160
"""Characters of a response that an example shows."""

OnDone = Callable[[str], object]
"""Called with what was done, as ``"math:Sample: injection"``."""


class Tally:
    """What is known of the rows, and what was counted.

    Args:
        stage: The environment.
        found: What is filled in.
        on_done: Called after each step.
    """

    def __init__(self, stage: Stage, found: EnvAudit, on_done: OnDone) -> None:
        self.stage, self.found, self._on_done = stage, found, on_done
        self.looks: dict[str, Look] = {}
        """What each row shows."""
        self.golds: dict[str, str] = {}
        """The first gold action of each row."""
        self.targets: dict[str, float] = {}
        """What the gold actions of a row are paid, where they succeed."""
        self._crashes: list[Played] = []
        self._errors: list[Played] = []
        self._played = 0

    def chance(self) -> float:
        """Return how often an answer that knows nothing succeeds: the most frequent one, or a random one.

        Where no gold answer is known, it is the upper bound of what random actions show.
        """
        random = self.found.rates.get("random")
        if random is None or not random.episodes:
            return _UNKNOWN_CHANCE if self.found.chance is None else self.found.chance
        if not self.golds:
            return 1 - lower_bound(random.episodes - random.solved, random.episodes)
        return max(self.found.chance or 0.0, random.solved / random.episodes)

    def solves(self, played: Played) -> bool:
        """Tell whether an episode succeeded, as far as that is known of its row."""
        if played.error or played.crash:
            return False
        known = played.row.name in self.targets
        return played.solved(self.targets.get(played.row.name) if known else None)

    def lucky(self, played: Played) -> bool:
        """Tell whether a response names the gold answer of its row."""
        gold = self.golds.get(played.row.name)
        return gold is not None and holds(normal(played.response), normal(self.content(gold)))

    def count(self, rate: Rate, played: Played, *, solved: bool) -> bool:
        """Count an episode, and return whether it succeeded."""
        self._played += 1
        if played.crash or played.error:
            (self._crashes if played.crash else self._errors).append(played)
            return False
        rate.episodes += 1
        rate.solved += solved
        rate.returns += played.total
        return solved

    def note_later_turns(self, played: Played, source: str) -> None:
        """Add what an episode showed before its end, where nothing of it can be what the agent said.

        Args:
            played: The episode.
            source: Where its observations come from, as "the feedback".
        """
        look = self.looks[played.row.name]
        said = normal("\n".join(turn.response for turn in played.turns))
        if not look.gold or not holds(said, normal(look.gold)):
            later = look.later.setdefault(source, [])
            later += [turn.observation for turn in played.turns[:3] if not turn.over]
            look.infos += [turn.info for turn in played.turns[:3] if not turn.over]

    def content(self, response: str) -> str:
        """Return the answer that a response holds."""
        return Form.of_example(response).content(response)

    def report_failures(self) -> None:
        """Add a problem where episodes ended in exceptions, and one where they ended in errors."""
        for kind, failed, what in (
            ("crash", self._crashes, "ended in an exception, which no response may cause"),
            ("error", self._errors, "ended in an error of the environment"),
        ):
            if failed:
                message = f"{len(failed)} of {self._played} episodes {what}"
                examples = [f"{each.row.name}: {each.crash or each.error}" for each in failed]
                self.problem(kind, len(failed) / self._played, message, list(dict.fromkeys(examples)))

    def problem(self, kind: str, share: float, message: str, examples: Sequence[str], *, fails: bool = True) -> None:
        """Add a problem; see ``Problem``."""
        self.found.problems.append(Problem(kind, share, message, tuple(examples[:3]), fails))

    def did(self, step: str) -> None:
        """Say that a step is done."""
        self._on_done(f"{self.stage.env_id}: {step}")


def says(response: str) -> Callable[[str, Mapping[str, Any], int], str]:
    """Return a policy that always gives one response."""
    return lambda _observation, _info, _turn: response


def shown(played: Played) -> str:
    """Return the first response of an episode, cut, and what it was paid."""
    response = " ".join((played.turns[0].response if played.turns else "").split())
    cut = response if len(response) <= SHOWN else f"{response[: SHOWN // 2]} … {response[-SHOWN // 2 :]}"
    return f"{cut!r} got {played.total:g}"
