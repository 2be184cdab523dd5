"""``audit``: whether gold answers succeed, exploits fail, and rows are sound, for each of some environments."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import gem_core
from gem_core.errors import ArgumentError, GemError
from gem_eval.auditing.canary import Canary
from gem_eval.auditing.exploits import MOST_REPEATS, play_exploits
from gem_eval.auditing.forms import BOXED, RAW, TAGGED, Form, content_of, finish_of, form_of_words
from gem_eval.auditing.leaks import RowView, find_leaks
from gem_eval.auditing.policies import GUESSES, plain_call
from gem_eval.auditing.results import CHANCE_MARGIN, KINDS, EnvAudit, Problem, Rate, lower_bound
from gem_eval.auditing.rows import Asked, check_rows, rows_of
from gem_eval.auditing.stage import AuditEpisode, AuditTask, Respond, Stage, says
from gem_eval.auditing.texts import holds, normal

_UNKNOWN_CHANCE = 0.1
_ROWS_WITH_TOOLS = 10
"""Rows in which each tool is called."""

OnDone = Callable[[str], object]
"""Called with what was done, as ``"math:Sample: injection"``."""


def audit(
    ids: str | Iterable[str],
    *,
    limit: int = 50,
    seed: int = 0,
    kwargs: Mapping[str, Any] | None = None,
    on_done: OnDone | None = None,
) -> list[EnvAudit]:
    """Check environments before money is spent on them.

    Args:
        ids: One id, or several. Environments for several agents are refused: who wins there makes another lose.
        limit: Rows of each environment that are played at most; rows of a data set are all read.
        seed: Of the choice of rows, and of the episodes.
        kwargs: Keyword arguments for all of the environments.
        on_done: Called after each step.

    Returns:
        What was found of each environment, in their order.

    Raises:
        ArgumentError: An environment of several agents or a limit below 1.
        UnknownEnvError: No such id.
    """
    if limit < 1:
        raise ArgumentError(f"limit must be a whole number from 1 up, not {limit!r}")
    specs = [gem_core.spec(env_id) for env_id in ([ids] if isinstance(ids, str) else ids)]
    for spec in specs:
        if spec.seats:
            raise ArgumentError(
                f"{spec.id} is for several agents, where one's success is another's failure; an audit takes "
                "environments of one agent, as tau:Sample-solo"
            )
    found = []
    for spec in specs:
        try:
            stage = Stage(spec.id, kwargs or {}, limit=limit, seed=seed)
        except Exception as error:  # noqa: BLE001 - third-party code may raise anything
            named = "" if isinstance(error, GemError) else f"{type(error).__name__}: "
            found.append(EnvAudit(spec.id, failure=named + " ".join(str(error).split())))
            continue
        canary = Canary()
        try:
            found.append(Audit(stage, canary, on_done or (lambda step: None)).run())
        finally:
            canary.close()
            stage.close()
    return found


class Audit:
    """The audit of one environment: what is known of its rows, and what was counted.

    Args:
        stage: The environment.
        canary: What shows that a response was run.
        on_done: See ``audit``.
    """

    def __init__(self, stage: Stage, canary: Canary, on_done: OnDone) -> None:
        self.stage, self.canary, self._on_done = stage, canary, on_done
        self.found = EnvAudit(stage.env_id, len(stage.rows))
        self.forms: list[Form] = [RAW, BOXED, TAGGED]
        """In which the environment reads answers."""
        self.finish: str | None = None
        """By which an agent says that it is done; None without such a word."""
        self.example = ""
        """A valid response; empty if none is known."""
        self.tools: list[Mapping[str, Any]] = []
        self.one_turn = True
        """Whether episodes have one turn."""
        self.views: dict[str, RowView] = {}
        self.golds: dict[str, str] = {}
        """The first gold action of each row."""
        self._targets: dict[str, float] = {}
        """What the gold actions of a row are paid, where they succeed."""
        self.repeated: list[AuditEpisode] = []
        """Episodes that are played again, to see whether they come out the same."""
        self._failed: dict[str, list[str]] = {"crash": [], "error": []}
        self._played = 0

    def run(self) -> EnvAudit:
        """Play all policies and look at all rows; return what was found."""
        if self._look():
            self._play_gold()
            self._check_rows()
            self._play_chance()
            self._play_constants()
            self._call_tools()
            play_exploits(self)
            self._check_leaks()
            self._check_determinism()
            self._report_failures()
        return self.found

    # What all policies need.

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

    def rate(self, policy: str) -> Rate:
        """Return the rate of a policy."""
        return self.found.rates.setdefault(policy, Rate(KINDS[policy]))

    def solves(self, played: AuditEpisode) -> bool:
        """Tell whether an episode succeeded, as far as that is known of its row."""
        return not played.error and not played.crash and played.solved(self._targets.get(played.row.name))

    def names_gold(self, played: AuditEpisode) -> bool:
        """Tell whether a response names the gold answer of its row."""
        gold = self.golds.get(played.row.name)
        return gold is not None and holds(normal(played.response), normal(content_of(gold)))

    def count(self, rate: Rate, played: AuditEpisode, *, solved: bool) -> bool:
        """Count an episode, and return whether it succeeded."""
        self._played += 1
        if played.crash or played.error:
            kind = "crash" if played.crash else "error"
            self._failed[kind].append(f"{played.row.name}: {played.crash or played.error}")
            return False
        rate.episodes += 1
        rate.solved += solved
        return solved

    def problem(
        self, kind: str, share: float, message: str, examples: Sequence[AuditEpisode | str] = (), *, fails: bool = True
    ) -> None:
        """Add a problem; see ``Problem``."""
        told = tuple(each if isinstance(each, str) else f"{each.row.name}: {each.shown}" for each in examples[:3])
        self.found.problems.append(Problem(kind, share, message, told, fails))

    def done(self, step: str) -> None:
        """Say that a step is done."""
        self._on_done(f"{self.stage.env_id}: {step}")

    # What a row shows, and its gold answer.

    def _look(self) -> bool:
        """Try a random action in the first rows, to learn the form of an answer; tell whether a row could be reset."""
        some = [self.stage.play(row, self._random, most_turns=1) for row in self.stage.rows[:3]]
        first = some[0]
        if first.crash and not first.turns and not first.observation:
            self.found.failure = f"reset fails: {first.crash}"
            return False
        self.example = first.response
        self.one_turn = all(turn.over for played in some for turn in played.turns)
        text = "\n".join([first.observation, str(first.info.get("system", ""))])
        self.finish = finish_of(text)
        form = Form.of_example(self.example) if self.example else RAW
        form = form if form.opening else form_of_words(text) or RAW
        if form.opening:
            self.forms = [form]
        self.tools = [tool for tool in first.info.get("tools") or () if isinstance(tool, Mapping)]
        return True

    def _play_gold(self) -> None:
        rate = Rate("gold")
        failed: list[str] = []
        for row in self.stage.rows:
            played = self.stage.play(row, lambda _observation, _info, _turn: self.stage.gold())
            texts = [played.observation, str(played.info.get("system") or "")]
            view = self.views[row.name] = RowView(row.name, None, texts, [played.info])
            if not played.turns and not played.crash:
                continue  # its gold answer is not known
            if played.turns:
                gold = self.golds[row.name] = played.turns[0].response
                self.one_turn = self.one_turn and len(played.turns) == 1
                if not played.solved(None) and not played.error:
                    played = self._in_another_form(row, gold, played)
                view.gold, view.whole = content_of(gold), len(played.turns) == 1
            self.repeated.append(played)
            if self.count(rate, played, solved=played.solved(None)):
                self._targets[row.name] = max(played.total, 1e-6) if played.total > 0 else 1.0
            else:
                failed.append(f"{row.name}: {played.crash or played.error or played.shown}")
        if rate.episodes or failed:
            self.found.rates["gold"] = rate
        if failed:
            message = f"{len(failed)} of {len(self.stage.rows)} gold answers do not succeed"
            self.problem("gold", len(failed) / len(self.stage.rows), message, failed)
        if not self.golds and not failed:
            self.problem("unknown", 1.0, "no gold answer is known: gold_action() returns None", fails=False)
        counts = Counter(normal(view.gold) for view in self.views.values() if view.gold)
        if self.one_turn and len(self.golds) > 1:
            self.found.chance = counts.most_common(1)[0][1] / len(self.golds)
        self.done("gold")

    def _random(self, observation: str, info: Mapping[str, Any], turn: int) -> str | None:
        return self.stage.sample()

    def _in_another_form(self, row: AuditTask, gold: str, failed: AuditEpisode) -> AuditEpisode:
        """Try the gold answer in other forms, for a task that reads answers in one of its own."""
        for form in (RAW, TAGGED, BOXED):
            response = form.around(content_of(gold))
            played = self.stage.play(row, says(response), most_turns=1)
            if played.solved(None):
                self.forms, self.golds[row.name] = [form], response
                return played
        return failed

    def _check_rows(self) -> None:
        try:
            asked = rows_of(self.stage.env_id, self.stage.env)
        except Exception as error:  # noqa: BLE001 - third-party code may raise anything
            self.problem("crash", 1.0, f"its rows cannot be read: {type(error).__name__}: {error}")
            return
        fixed = asked is not None
        for each in asked or ():
            if each.name in self.views:
                self.views[each.name].question = each.question
        if asked is None and self.stage.count is not None:
            asked = [
                Asked(view.name, view.texts[0], view.texts[0], normal(view.gold) if view.gold else "")
                for view in self.views.values()
            ]
        if asked:
            self.found.problems += check_rows(asked, fixed=fixed)
        self.done("rows")

    # What may succeed by chance.

    def _play_chance(self) -> None:
        """Play random actions, the observation itself, and the gold answers of other rows."""
        rows = self.stage.rows
        if self.example:
            played = self._each("random", [(row, self._random) for row in rows])
            self.repeated += played
            for episode in played[:20]:
                self._note_later_turns(episode, "the feedback")
            # Of a few questions all may be solved by luck, or by who draws answers well.
            everywhere = _everywhere([self.solves(each) for each in played])
            if everywhere or self.found.chance is not None:
                chance = min(self.found.chance or 0.0, 0.5)
                self._beyond_chance("random", played, chance, "a random answer", fails=everywhere)
        played = self._each("echo", [(row, lambda shown, _info, _turn: self.forms[0].around(shown)) for row in rows])
        self._beyond_chance("echo", played, self.chance(), "the observation, given back as the answer,")
        if self.one_turn and len(self.golds) > 1:
            played = self._each("other", [(row, says(response)) for row, response in self._gold_of_others()])
            self._beyond_chance("other", played, 0.0, "the gold answer of another row")

    def _play_constants(self) -> None:
        """Play responses that are the same in each row; none of them may be right everywhere."""
        text_forms = [form for form in self.forms if not form.is_code and not form.is_shell]
        constants = [form.around(guess) for guess in GUESSES for form in text_forms]
        for response in [*([self.example] if self.example else []), *constants]:
            solved: list[AuditEpisode] = []
            for row in self.stage.rows:
                played = self.stage.play(row, says(response), most_turns=MOST_REPEATS)
                self.count(Rate("chance"), played, solved=False)
                if not self.solves(played):
                    break
                solved.append(played)
            if len(solved) == len(self.stage.rows) and _everywhere([True] * len(solved)):
                self.problem("constant", 1.0, f"constant: one response solves all of {len(solved)} rows", solved)
                break
        self.done("constant")

    def _call_tools(self) -> None:
        """Call each tool once, and note what it returns."""
        for row in self.stage.rows[:_ROWS_WITH_TOOLS]:
            for tool in self.views[row.name].infos[0].get("tools") or ():
                name, call = plain_call(tool)
                played = self.stage.play(row, says(call), most_turns=1)
                self.count(Rate("chance"), played, solved=False)
                self._note_later_turns(played, f"the tool {name!r}")
        self.done("tools")

    def _note_later_turns(self, played: AuditEpisode, source: str) -> None:
        """Add what an episode showed before its end, if it cannot be what the agent said.

        Args:
            played: The episode.
            source: Where its observations come from, as "the feedback".
        """
        view = self.views[played.row.name]
        said = normal("\n".join(turn.response for turn in played.turns))
        if not view.gold or not holds(said, normal(view.gold)):
            before_end = [turn for turn in played.turns[:3] if not turn.over]
            view.later.setdefault(source, []).extend(turn.observation for turn in before_end)
            view.infos += [turn.info for turn in before_end]

    def _gold_of_others(self) -> list[tuple[AuditTask, str]]:
        """Return each row with the gold answer of the next row that has a different one."""
        known = [row for row in self.stage.rows if row.name in self.golds]
        plain = {row.name: normal(content_of(self.golds[row.name])) for row in known}
        pairs = []
        for at, row in enumerate(known):
            different = (each for each in known[at + 1 :] + known[:at] if plain[each.name] != plain[row.name])
            pairs += [(row, self.golds[other.name]) for other in different][:1]
        return pairs

    def _each(self, policy: str, plays: Iterable[tuple[AuditTask, Respond]]) -> list[AuditEpisode]:
        episodes = [self.stage.play(row, respond) for row, respond in plays]
        for played in episodes:
            self.count(self.rate(policy), played, solved=self.solves(played))
        self.done(policy)
        return episodes

    def _beyond_chance(
        self, policy: str, played: Sequence[AuditEpisode], chance: float, what: str, *, fails: bool = True
    ) -> None:
        judged = [each for each in played if not each.error and not each.crash]
        solved = [each for each in judged if self.solves(each)]
        if lower_bound(len(solved), len(judged)) > chance + CHANCE_MARGIN:
            message = f"{policy}: {what} solves {len(solved)} of {len(judged)} rows; by chance {chance:.0%}"
            self.problem(policy, len(solved) / len(judged), message, solved, fails=fails)

    # What is looked at when all is played.

    def _check_leaks(self) -> None:
        named = [each.message.partition("repeating ")[2] for each in self.found.problems if each.kind == "leak"]
        for problem in find_leaks(list(self.views.values())):
            if not any(source and source in problem.message for source in named):
                self.found.problems.append(problem)
        self.done("leaks")

    def _check_determinism(self) -> None:
        exact = self.stage.deterministic
        episodes = self.repeated if exact else [each for each in self.repeated if each.row.name in self.golds][:10]
        episodes = [played for played in episodes if not played.crash and not played.error and played.turns]
        differing: list[str] = []
        for played in episodes:
            before, after = played.record(exact), self.stage.replay(played).record(exact)
            if before != after:
                differing.append(f"{played.row.name}: {_difference(before, after)}")
        if differing:
            message = (
                f"{len(differing)} of {len(episodes)} episodes come out differently with the same seed and responses"
            )
            self.problem("nondeterministic", len(differing) / len(episodes), message, differing)
        self.done("again")

    def _report_failures(self) -> None:
        """Add a problem where episodes ended in exceptions, and one where they ended in errors."""
        reasons = {
            "crash": "ended in an exception, which no response may cause",
            "error": "ended in an error of the environment",
        }
        for kind, failed in self._failed.items():
            if failed:
                message = f"{len(failed)} of {self._played} episodes {reasons[kind]}"
                self.problem(kind, len(failed) / self._played, message, list(dict.fromkeys(failed)))


def _everywhere(solved: Sequence[bool]) -> bool:
    """Tell whether all episodes are solved, and are enough for more than half of all to be."""
    return all(solved) and lower_bound(len(solved), len(solved)) > 0.5


def _difference(before: Sequence[str], after: Sequence[str]) -> str:
    for one, other in zip(before, after, strict=False):
        if one != other:
            at = next((at for at, pair in enumerate(zip(one, other, strict=False)) if pair[0] != pair[1]), 0)
            start = max(0, at - 30)
            return f"{one[start : at + 40]!r}, then {other[start : at + 40]!r}"
    return f"{len(before) - 1} turns, then {len(after) - 1}"
