"""``audit``: whether gold answers succeed, exploits fail, and rows are sound, for each of some environments."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gem_core
from gem_core.errors import ArgumentError, GemError
from gem_eval.auditing.canary import Canary
from gem_eval.auditing.exploits import MOST_REPEATS, Exploits
from gem_eval.auditing.forms import BOXED, RAW, TAGGED, Form, finish_of, form_of_words
from gem_eval.auditing.leaks import Look, find_leaks
from gem_eval.auditing.policies import GUESSES, plain_call
from gem_eval.auditing.results import KINDS, EnvAudit, Rate, lower_bound
from gem_eval.auditing.rows import Asked, check_contamination, check_rows, questions_of, rows_of
from gem_eval.auditing.stage import Played, Row, Stage
from gem_eval.auditing.tally import CHANCE_MARGIN, OnDone, Tally, says, shown
from gem_eval.auditing.texts import normal

_ROWS_WITH_TOOLS = 10
"""Rows in which each tool is called."""


def audit(
    ids: str | Iterable[str],
    *,
    limit: int = 50,
    seed: int = 0,
    kwargs: Mapping[str, Any] | None = None,
    against: Sequence[str] = (),
    on_done: OnDone | None = None,
) -> list[EnvAudit]:
    """Check environments before money is spent on them.

    Args:
        ids: One id, or several. Environments for several agents are refused: who wins there makes another lose.
        limit: Rows of each environment that are played at most; rows of a data set are all read.
        seed: Of the choice of rows, and of the episodes.
        kwargs: Keyword arguments for all of the environments.
        against: Ids of environments, or files of rows, whose questions must not stand in the environments.
        on_done: Called after each step.

    Returns:
        What was found of each environment, in their order.

    Raises:
        ArgumentError: An environment of several agents, a limit below 1, or an ``against`` that cannot be read.
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
    columns = [str((kwargs or {}).get("question_key") or "question")]
    others = [(each, questions_of(each, columns)) for each in against]
    return [_audited(spec.id, kwargs or {}, limit, seed, others, on_done or (lambda _: None)) for spec in specs]


def _audited(
    env_id: str,
    kwargs: Mapping[str, Any],
    limit: int,
    seed: int,
    others: Sequence[tuple[str, list[str]]],
    on_done: OnDone,
) -> EnvAudit:
    found = EnvAudit(env_id)
    try:
        stage = Stage(env_id, kwargs, limit=limit, seed=seed)
    except Exception as error:  # noqa: BLE001 - third-party code may raise anything
        named = "" if isinstance(error, GemError) else f"{type(error).__name__}: "
        found.failure = named + " ".join(str(error).split())
        return found
    canary = Canary()
    try:
        _Audit(stage, canary, found, on_done).run(others)
    finally:
        canary.close()
        stage.close()
    return found


class _Audit:
    """The audit of one environment, step by step.

    Args:
        stage: The environment.
        canary: What shows that a response was run.
        found: What is filled in.
        on_done: See ``audit``.
    """

    def __init__(self, stage: Stage, canary: Canary, found: EnvAudit, on_done: OnDone) -> None:
        self.stage, self.canary = stage, canary
        self.tally = Tally(stage, found, on_done)
        self.forms: list[Form] = [RAW, BOXED, TAGGED]
        self.finish: str | None = None
        self.example = ""
        self.one_turn = True
        self.episodes: list[Played] = []
        """Those that are played again, to see whether they come out the same."""

    def run(self, others: Sequence[tuple[str, list[str]]]) -> None:
        """Play all policies and look at all rows."""
        self.tally.found.rows = len(self.stage.rows)
        if not self._look():
            return
        self._play_gold()
        self._check_rows(others)
        self._play_chance()
        self._play_constants()
        self._call_tools()
        exploits = Exploits(
            self.tally, self.canary, self.forms, self.finish, self.example, self.tools, one_turn=self.one_turn
        )
        exploits.play()
        self.episodes += exploits.episodes
        self._check_leaks()
        self._check_determinism()
        self.tally.report_failures()

    # What a row shows, and its gold answer.

    def _look(self) -> bool:
        """Try a random action in the first rows, to learn the form of an answer; tell whether a row could be reset."""
        some = [self.stage.play(row, self._random, most_turns=1) for row in self.stage.rows[:3]]
        first = some[0]
        if first.crash and not first.turns and not first.observation:
            self.tally.found.failure = f"reset fails: {first.crash}"
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
            played = self.stage.play(row, self._gold)
            look = self.tally.looks[row.name] = Look(row.name, None, [played.observation], [played.info])
            look.texts.append(str(played.info.get("system") or ""))
            if not played.turns and not played.crash:
                continue  # its gold answer is not known
            gold = played.turns[0].response if played.turns else None
            if gold is not None:
                self.tally.golds[row.name] = gold
                self.one_turn = self.one_turn and len(played.turns) == 1
                if not played.solved(None) and not played.error:
                    played = self._in_another_form(row, gold, played)
                look.gold = self.tally.content(gold)
                look.whole = len(played.turns) == 1
            self.episodes.append(played)
            if self.tally.count(rate, played, solved=played.solved(None)):
                self.tally.targets[row.name] = max(played.total, 1e-6) if played.total > 0 else 1.0
            else:
                failed.append(f"{row.name}: {played.crash or played.error or shown(played)}")
        if rate.episodes or failed:
            self.tally.found.rates["gold"] = rate
        if failed:
            share = len(failed) / len(self.stage.rows)
            message = f"{len(failed)} of {len(self.stage.rows)} gold answers do not succeed"
            self.tally.problem("gold", share, message, failed)
        if not self.tally.golds and not failed:
            self.tally.problem("unknown", 1.0, "no gold answer is known: gold_action() returns None", [], fails=False)
        counts = Counter(normal(look.gold) for look in self.tally.looks.values() if look.gold)
        if self.one_turn and len(self.tally.golds) > 1:
            self.tally.found.chance = counts.most_common(1)[0][1] / len(self.tally.golds)
        self.tally.did("gold")

    def _gold(self, observation: str, info: Mapping[str, Any], turn: int) -> str | None:
        return self.stage.gold()

    def _random(self, observation: str, info: Mapping[str, Any], turn: int) -> str | None:
        return self.stage.sample()

    def _in_another_form(self, row: Row, gold: str, failed: Played) -> Played:
        """Try the gold answer in other forms, for a task that reads answers in one of its own."""
        content = Form.of_example(gold).content(gold)
        for form in (RAW, TAGGED, BOXED):
            played = self.stage.play(row, says(form.around(content)), most_turns=1)
            if played.solved(None):
                self.forms = [form]
                self.tally.golds[row.name] = form.around(content)
                return played
        return failed

    def _check_rows(self, others: Sequence[tuple[str, list[str]]]) -> None:
        try:
            asked = rows_of(self.stage.env_id, self.stage.env)
        except Exception as error:  # noqa: BLE001 - third-party code may raise anything
            self.tally.problem("crash", 1.0, f"its rows cannot be read: {type(error).__name__}: {error}", [])
            return
        fixed = asked is not None
        for each in asked or ():
            if each.name in self.tally.looks:
                self.tally.looks[each.name].question = each.question
        if asked is None and self.stage.count is not None:
            asked = [
                Asked(look.name, look.texts[0], look.texts[0], normal(look.gold) if look.gold else "")
                for look in self.tally.looks.values()
            ]
        if asked:
            self.tally.found.problems += check_rows(asked, fixed=fixed)
            for source, questions in others:
                self.tally.found.problems += check_contamination(asked, source, questions)
        elif others:
            self.tally.problem("contamination", 0.0, "it has no rows that could be compared", [], fails=False)
        self.tally.did("rows")

    # The policies.

    def _play_chance(self) -> None:
        """Play what may succeed by chance: random actions, the observation itself, and the gold answers of others."""
        rows = self.stage.rows
        if self.example:
            played = self._each("random", [(row, self._random) for row in rows])
            self.episodes += played
            for episode in played[:20]:
                self.tally.note_later_turns(episode, "the feedback")
            # Of a few questions all may be solved by luck, or by who draws answers well.
            everywhere = _everywhere([self.tally.solves(each) for each in played])
            if everywhere or self.tally.found.chance is not None:
                chance = self.tally.found.chance or 0.0
                self._beyond_chance("random", played, min(chance, 0.5), "a random answer", fails=everywhere)
        played = self._each(
            "echo", [(row, lambda observation, _i, _t: self.forms[0].around(observation)) for row in rows]
        )
        self._beyond_chance("echo", played, self.tally.chance(), "the observation, given back as the answer,")
        if self.one_turn and len(self.tally.golds) > 1:
            pairs = self._gold_of_others()
            played = self._each("other", [(row, says(response)) for row, response in pairs])
            self._beyond_chance("other", played, 0.0, "the gold answer of another row")

    def _play_constants(self) -> None:
        """Play responses that are the same in each row; none of them may be right everywhere."""
        text_forms = [form for form in self.forms if not form.is_code and not form.is_shell]
        constants = [form.around(guess) for guess in GUESSES for form in text_forms]
        for response in [*([self.example] if self.example else []), *constants]:
            solved: list[Played] = []
            for row in self.stage.rows:
                played = self.stage.play(row, says(response), most_turns=MOST_REPEATS)
                self.tally.count(Rate("chance"), played, solved=False)
                if not self.tally.solves(played):
                    break
                solved.append(played)
            if len(solved) == len(self.stage.rows) and _everywhere([True] * len(solved)):
                message = f"constant: one response solves all of {len(solved)} rows"
                self.tally.problem("constant", 1.0, message, [f"{each.row.name}: {shown(each)}" for each in solved])
                break
        self.tally.did("constant")

    def _call_tools(self) -> None:
        """Call each tool once, and note what it returns."""
        for row in self.stage.rows[:_ROWS_WITH_TOOLS]:
            for tool in self.tally.looks[row.name].infos[0].get("tools") or ():
                name, call = plain_call(tool)
                played = self.stage.play(row, says(call), most_turns=1)
                self.tally.count(Rate("chance"), played, solved=False)
                self.tally.note_later_turns(played, f"the tool {name!r}")
        self.tally.did("tools")

    def _gold_of_others(self) -> list[tuple[Row, str]]:
        """Return each row with the gold answer of the next row that has a different one."""
        known = [row for row in self.stage.rows if row.name in self.tally.golds]
        pairs = []
        for at, row in enumerate(known):
            own = normal(self.tally.content(self.tally.golds[row.name]))
            for other in known[at + 1 :] + known[:at]:
                if normal(self.tally.content(self.tally.golds[other.name])) != own:
                    pairs.append((row, self.tally.golds[other.name]))
                    break
        return pairs

    def _each(self, policy: str, plays: Iterable[tuple[Row, Any]]) -> list[Played]:
        rate = self.tally.found.rates.setdefault(policy, Rate(KINDS[policy]))
        episodes = [self.stage.play(row, respond) for row, respond in plays]
        for played in episodes:
            self.tally.count(rate, played, solved=self.tally.solves(played))
        self.tally.did(policy)
        return episodes

    def _beyond_chance(
        self, policy: str, played: Sequence[Played], chance: float, what: str, *, fails: bool = True
    ) -> None:
        judged = [each for each in played if not each.error and not each.crash]
        solved = [each for each in judged if self.tally.solves(each)]
        if lower_bound(len(solved), len(judged)) > chance + CHANCE_MARGIN:
            message = f"{policy}: {what} solves {len(solved)} of {len(judged)} rows; by chance {chance:.0%}"
            examples = [f"{each.row.name}: {shown(each)}" for each in solved]
            self.tally.problem(policy, len(solved) / len(judged), message, examples, fails=fails)

    # What is looked at when all is played.

    def _check_leaks(self) -> None:
        named = {each.message.partition("repeating ")[2] for each in self.tally.found.problems if each.kind == "leak"}
        for problem in find_leaks(list(self.tally.looks.values())):
            if not any(source and source in problem.message for source in named):
                self.tally.found.problems.append(problem)
        self.tally.did("leaks")

    def _check_determinism(self) -> None:
        differing: list[str] = []
        again = 0
        exact = self.stage.deterministic
        episodes = (
            self.episodes if exact else [each for each in self.episodes if each.row.name in self.tally.golds][:10]
        )
        for played in episodes:
            if played.crash or played.error or not played.turns:
                continue
            again += 1
            before, after = played.record(exact), self.stage.replay(played).record(exact)
            if before != after:
                differing.append(f"{played.row.name}: {_difference(before, after)}")
        if differing:
            message = f"{len(differing)} of {again} episodes come out differently with the same seed and responses"
            self.tally.problem("nondeterministic", len(differing) / again, message, differing)
        self.tally.did("again")


def _everywhere(solved: Sequence[bool]) -> bool:
    """Tell whether all episodes are solved, and are enough for more than half of all to be."""
    return bool(solved) and all(solved) and lower_bound(len(solved), len(solved)) > 0.5


def _difference(before: Sequence[str], after: Sequence[str]) -> str:
    for one, other in zip(before, after, strict=False):
        if one != other:
            at = next((at for at, pair in enumerate(zip(one, other, strict=False)) if pair[0] != pair[1]), 0)
            start = max(0, at - 30)
            return f"{one[start : at + 40]!r}, then {other[start : at + 40]!r}"
    return f"{len(before) - 1} turns, then {len(after) - 1}"
