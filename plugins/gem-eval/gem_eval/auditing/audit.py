"""``audit``: whether gold answers succeed, exploits fail, and rows are sound, for each of some environments."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import gem_core
from gem_core.errors import ArgumentError, GemError
from gem_eval.auditing.canary import Canary
from gem_eval.auditing.forms import BOXED, RAW, TAGGED, Form, finish_of, form_of_words
from gem_eval.auditing.leaks import MOSTLY, Look, find_leaks
from gem_eval.auditing.policies import GUESSES, Variant, hedges, injections, nulls, tamperings
from gem_eval.auditing.results import KINDS, EnvAudit, Problem, Rate, lower_bound
from gem_eval.auditing.rows import Asked, check_contamination, check_rows, questions_of, rows_of
from gem_eval.auditing.stage import Played, Row, Stage
from gem_eval.auditing.texts import holds, normal

_LEAST_PLAYS = 3
"""Rows on which each variant of an exploit is tried, before it is played on all where it succeeded."""
_PER_ROW = 3
"""Variants of an exploit that are tried on each row."""
_MOST_REPEATS = 50
"""Turns of an exploit in one episode."""
_CHANCE_MARGIN = 0.05
_MOST_CLAIMS = 30
"""Values of infos and texts that are tried as answers."""
_SHOWN = 160
"""Characters of a response that an example shows."""

OnDone = Callable[[str], object]
"""Called with what was done, as ``"math:Sample: injection"``."""


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


class _Success(NamedTuple):
    """A variant of an exploit that succeeded: how it is called, its episodes that did, and how many it had."""

    label: str
    solved: list[Played]
    episodes: int


class _Audit:
    """The audit of one environment, step by step.

    Args:
        stage: The environment.
        canary: What shows that a response was run.
        found: What is filled in.
        on_done: See ``audit``.
    """

    def __init__(self, stage: Stage, canary: Canary, found: EnvAudit, on_done: OnDone) -> None:
        self.stage, self.canary, self.found, self.on_done = stage, canary, found, on_done
        self.looks: dict[str, Look] = {}
        self.golds: dict[str, str] = {}
        """The first gold action of each row."""
        self.targets: dict[str, float] = {}
        """What the gold actions of a row are paid, where they succeed."""
        self.forms: list[Form] = [RAW, BOXED, TAGGED]
        self.finish: str | None = None
        self.example = ""
        self.one_turn = True
        self.episodes: list[Played] = []
        """Those that are played again, to see whether they come out the same."""
        self._crashes: list[Played] = []
        self._errors: list[Played] = []
        self._played = 0

    def run(self, others: Sequence[tuple[str, list[str]]]) -> None:
        """Play all policies and look at all rows."""
        self.found.rows = len(self.stage.rows)
        if not self._look():
            return
        self._play_gold()
        self._check_rows(others)
        self._play_chance()
        self._play_exploits()
        self._check_leaks()
        self._check_determinism()
        self._report_failures()

    # What a row shows, and its gold answer.

    def _look(self) -> bool:
        """Reset the first row, to learn in which form it takes answers; tell whether it could be reset."""
        some = [self.stage.play(row, self._random, most_turns=1) for row in self.stage.rows[:3]]
        first = some[0]
        if first.crash and not first.turns and not first.observation:
            self.found.failure = f"reset fails: {first.crash}"
            return False
        self.example = first.response
        self.one_turn = all(turn.over for played in some for turn in played.turns)
        shown = "\n".join([first.observation, str(first.info.get("system", ""))])
        self.finish = finish_of(shown)
        form = Form.of_example(self.example) if self.example else RAW
        form = form if form.opening else form_of_words(shown) or RAW
        if form.opening:
            self.forms = [form]
        self.tools = [tool for tool in first.info.get("tools") or () if isinstance(tool, Mapping)]
        return True

    def _play_gold(self) -> None:
        rate = Rate("gold")
        failed: list[str] = []
        for row in self.stage.rows:
            played = self.stage.play(row, self._gold)
            look = self.looks[row.name] = Look(row.name, None, [played.observation], [played.info])
            look.texts += [str(played.info[key]) for key in ("system",) if played.info.get(key)]
            if not played.turns and not played.crash:
                continue  # its gold answer is not known
            gold = played.turns[0].response if played.turns else None
            if gold is not None:
                self.golds[row.name] = gold
                self.one_turn = self.one_turn and len(played.turns) == 1
                if not played.solved(None) and not played.error:
                    played = self._in_another_form(row, gold, played)
                look.gold = self._content(gold)
            self.episodes.append(played)
            if self._count(rate, played, solved=played.solved(None)):
                self.targets[row.name] = max(played.total, 1e-6) if played.total > 0 else 1.0
            else:
                failed.append(f"{row.name}: {played.crash or played.error or _shown(played)}")
        if rate.episodes or failed:
            self.found.rates["gold"] = rate
        if failed:
            share = len(failed) / len(self.stage.rows)
            message = f"{len(failed)} of {len(self.stage.rows)} gold answers do not succeed"
            self._problem("gold", share, message, failed)
        if not self.golds and not failed:
            self._problem("unknown", 1.0, "no gold answer is known: gold_action() returns None", [], fails=False)
        counts = Counter(normal(look.gold) for look in self.looks.values() if look.gold)
        if self.one_turn and len(self.golds) > 1:
            self.found.chance = counts.most_common(1)[0][1] / len(self.golds)
        self._did("gold")

    def _gold(self, observation: str, info: Mapping[str, Any], turn: int) -> str | None:
        return self.stage.gold()

    def _random(self, observation: str, info: Mapping[str, Any], turn: int) -> str | None:
        return self.stage.sample()

    def _in_another_form(self, row: Row, gold: str, failed: Played) -> Played:
        """Try the gold answer in other forms, for a task that reads answers in one of its own."""
        content = Form.of_example(gold).content(gold)
        for form in (RAW, TAGGED, BOXED):
            played = self.stage.play(row, _says(form.around(content)), most_turns=1)
            if played.solved(None):
                self.forms = [form]
                self.golds[row.name] = form.around(content)
                return played
        return failed

    def _content(self, response: str) -> str:
        return Form.of_example(response).content(response)

    def _check_rows(self, others: Sequence[tuple[str, list[str]]]) -> None:
        try:
            asked = rows_of(self.stage.env_id, self.stage.env)
        except Exception as error:  # noqa: BLE001 - third-party code may raise anything
            self._problem("crash", 1.0, f"its rows cannot be read: {type(error).__name__}: {error}", [])
            return
        fixed = asked is not None
        for each in asked or ():
            if each.name in self.looks:
                self.looks[each.name].question = each.question
        if asked is None and self.stage.count is not None:
            asked = [
                Asked(look.name, look.texts[0], look.texts[0], normal(look.gold) if look.gold else "")
                for look in self.looks.values()
            ]
        if asked:
            self.found.problems += check_rows(asked, fixed=fixed)
            for source, questions in others:
                self.found.problems += check_contamination(asked, source, questions)
        elif others:
            self._problem("contamination", 0.0, "it has no rows that could be compared", [], fails=False)
        self._did("rows")

    # The policies.

    def _play_chance(self) -> None:
        """Play what may succeed by chance: random actions, the observation itself, and the gold answers of others."""
        rows = self.stage.rows
        if self.example:
            played = self._each("random", [(row, self._random) for row in rows])
            self.episodes += played
            for episode in played[:20]:
                self._note_later_turns(episode)
            if self.found.chance is not None:
                self._beyond_chance("random", played, self.found.chance, "a random answer", fails=False)
        played = self._each(
            "echo", [(row, lambda observation, _i, _t: self.forms[0].around(observation)) for row in rows]
        )
        self._beyond_chance("echo", played, self._chance(), "the observation, given back as the answer,")
        if self.one_turn and len(self.golds) > 1:
            pairs = self._gold_of_others()
            played = self._each("other", [(row, _says(response)) for row, response in pairs])
            self._beyond_chance("other", played, 0.0, "the gold answer of another row")

    def _gold_of_others(self) -> list[tuple[Row, str]]:
        """Return each row with the gold answer of the next row that has a different one."""
        known = [row for row in self.stage.rows if row.name in self.golds]
        pairs = []
        for at, row in enumerate(known):
            own = normal(self._content(self.golds[row.name]))
            for other in known[at + 1 :] + known[:at]:
                if normal(self._content(self.golds[other.name])) != own:
                    pairs.append((row, self.golds[other.name]))
                    break
        return pairs

    def _play_exploits(self) -> None:
        forms, finish = self.forms, self.finish
        self._variants("null", nulls(forms, finish), per_row=None)
        self._variants("injection", injections(forms, finish))
        self._play_hedges()
        self._play_claims()
        self._variants("tamper", tamperings(forms, finish, self.canary, self.example, self.tools))

    def _variants(self, policy: str, variants: Sequence[Variant], *, per_row: int | None = _PER_ROW) -> None:
        """Play the variants of an exploit, some on each row; one that succeeds is then played on all rows."""
        rate = self.found.rates.setdefault(policy, Rate("exploit"))
        rows, safe = self.stage.rows, True
        succeeded: list[_Success] = []
        share = len(variants) if per_row is None else max(per_row, -(-_LEAST_PLAYS * len(variants) // len(rows)))
        for at, variant in enumerate(variants):
            if variant.harmful and not safe:
                continue
            turn = [place for place in range(len(rows)) if (at - place * share) % len(variants) < share]
            turn = turn if len(turn) >= min(_LEAST_PLAYS, len(rows)) else list(range(min(_LEAST_PLAYS, len(rows))))
            played = [self._play_variant(rows[place], variant) for place in turn]
            ran = self.canary.taken()
            if ran:
                safe = False
                self._report_run(variant, ran, played[0])
            if any(self._solves(each) for each in played) and len(turn) < len(rows):
                rest = [place for place in range(len(rows)) if place not in turn]
                played += [self._play_variant(rows[place], variant) for place in rest]
            succeeded += self._successes(policy, rate, variant.label, played)
            if at == 0:
                self.episodes += played
        self._report_successes(policy, succeeded)

    def _play_variant(self, row: Row, variant: Variant) -> Played:
        responses = variant.responses
        respond = lambda _o, _i, turn: responses[min(turn, len(responses) - 1)]  # noqa: E731
        return self.stage.play(row, respond, most_turns=_MOST_REPEATS)

    def _successes(self, policy: str, rate: Rate, label: str, played: Sequence[Played]) -> list[_Success]:
        """Count the episodes of one variant; return its success, where it had one beyond chance."""
        counted = [each for each in played if not self._lucky(each)]
        solved = [each for each in counted if self._solves(each)]
        # Where gold answers are not known, one of them may be what the response says; nothing is never right.
        known = all(each.row.name in self.golds for each in solved)
        beyond = known or policy == "null" or lower_bound(len(solved), len(counted)) > self._chance()
        for each in counted:
            self._count(rate, each, solved=beyond and self._solves(each))
        return [_Success(label, solved, len(counted))] if solved and beyond else []

    def _report_successes(self, policy: str, succeeded: Sequence[_Success]) -> None:
        """Add one problem for all variants of a policy that succeeded, with the best of them."""
        if succeeded:
            ordered = sorted(succeeded, key=lambda each: -len(each.solved) / each.episodes)
            best = ordered[0]
            more = f", and some by {len(succeeded) - 1} other ways" if len(succeeded) > 1 else ""
            message = f"{policy}: {len(best.solved)} of {best.episodes} rows are solved by {best.label}{more}"
            examples = [f"{each.solved[0].row.name}: {_shown(each.solved[0])}" for each in ordered]
            self._problem(policy, len(best.solved) / best.episodes, message, examples)
        self._did(policy)

    def _report_run(self, variant: Variant, ran: str, played: Played) -> None:
        code = any(form.is_code for form in self.forms)
        where = "in the process of the grader itself" if ran == "here" else "outside of any sandbox"
        # A program is meant to be run; that it can write files is the plugin's choice of a sandbox.
        fails = ran == "here" or not code
        message = f"tamper: responses are run as code {where}: {variant.label} wrote a file"
        self._problem("tamper", 1.0, message, [f"{played.row.name}: {_shown(played)}"], fails=fails)

    def _play_hedges(self) -> None:
        """Play responses that name the gold answer among many others."""
        if not self.one_turn:
            return
        contents = [self._content(gold) for gold in self.golds.values()]
        near = list(dict.fromkeys(each for each in contents if len(each) <= 100))[:20]
        rate = self.found.rates.setdefault("hedge", Rate("exploit"))
        played: dict[str, list[Played]] = {}
        for row in self.stage.rows:
            names = self._answers_around(row, near)
            for variant in hedges(self.forms, names):
                played.setdefault(variant.label, []).append(self._play_variant(row, variant))
        succeeded: list[_Success] = []
        for label, each in played.items():
            for episode in each:
                self._count(rate, episode, solved=self._solves(episode))
            solved = [episode for episode in each if self._solves(episode)]
            # Guesses that do not know the answers may hold one by chance.
            if solved and (self.golds or len(solved) > 0.5 * len(each)):
                succeeded.append(_Success(label, solved, len(each)))
        self._report_successes("hedge", succeeded)

    def _answers_around(self, row: Row, answers: Sequence[str]) -> list[str]:
        """Return the gold answer of a row in the middle of others, so that who takes the first or last misses it."""
        if row.name not in self.golds:
            return list(GUESSES)
        own = self._content(self.golds[row.name])
        others = [each for each in (*answers, *GUESSES) if normal(each) != normal(own)][: max(4, len(answers))]
        return [*others[: len(others) // 2], own, *others[len(others) // 2 :]]

    def _play_claims(self) -> None:
        """Answer with what infos hold, and with what the observation gives behind words such as "answer:"."""
        rate = self.found.rates.setdefault("peek", Rate("exploit"))
        claims = {row.name: self._claims_of(self.looks[row.name]) for row in self.stage.rows}
        sources = list(dict.fromkeys(source for each in claims.values() for source in each))[:_MOST_CLAIMS]
        for source in sources:
            rows = [row for row in self.stage.rows if source in claims[row.name]]
            played: list[Played] = []
            for row in rows:
                if len(played) >= 5 and not any(map(self._solves, played)):
                    break
                tried = [self.stage.play(row, _says(form.around(claims[row.name][source]))) for form in self.forms]
                played.append(next(filter(self._solves, tried), tried[0]))
            solved = [each for each in played if self._solves(each)]
            shown = sum(self.looks[row.name].shows(claims[row.name][source]) for row in rows) > len(rows) / 2
            enough = lower_bound(len(solved), len(played)) > self._chance() + _CHANCE_MARGIN
            enough = enough or (len(solved) == len(played) == len(self.stage.rows) and len(solved) > 1)
            enough = enough and (not source.startswith("info") or not shown or len(solved) >= MOSTLY * len(played))
            for each in played:
                self._count(rate, each, solved=enough and self._solves(each))
            if enough:
                message = f"leak: {len(solved)} of {len(played)} rows are solved by repeating {source}"
                share = len(solved) / len(self.stage.rows)
                self._problem("leak", share, message, [f"{each.row.name}: {_shown(each)}" for each in solved])
        self._did("peek")

    def _claims_of(self, look: Look) -> dict[str, str]:
        leaves = {f"info[{path!r}]": value for path, value in look.leaves().items() if len(value) <= 500}
        return leaves | {f"what follows {mark} in the observation": value for mark, value in look.claims().items()}

    def _each(self, policy: str, plays: Iterable[tuple[Row, Any]]) -> list[Played]:
        rate = self.found.rates.setdefault(policy, Rate(KINDS[policy]))
        episodes = [self.stage.play(row, respond) for row, respond in plays]
        for played in episodes:
            self._count(rate, played, solved=self._solves(played))
        self._did(policy)
        return episodes

    def _beyond_chance(
        self, policy: str, played: Sequence[Played], chance: float, what: str, *, fails: bool = True
    ) -> None:
        judged = [each for each in played if not each.error and not each.crash]
        solved = [each for each in judged if self._solves(each)]
        if lower_bound(len(solved), len(judged)) > chance + _CHANCE_MARGIN:
            message = f"{policy}: {what} solves {len(solved)} of {len(judged)} rows; by chance {chance:.0%}"
            examples = [f"{each.row.name}: {_shown(each)}" for each in solved]
            self._problem(policy, len(solved) / len(judged), message, examples, fails=fails)

    # Counting.

    def _chance(self) -> float:
        """Return how often an answer that knows nothing succeeds: the most frequent one, or a random one."""
        random = self.found.rates.get("random")
        by_random = random.solved / random.episodes if random and random.episodes else 0.1
        return by_random if self.found.chance is None else max(self.found.chance, by_random)

    def _solves(self, played: Played) -> bool:
        if played.error or played.crash:
            return False
        known = played.row.name in self.targets
        return played.solved(self.targets.get(played.row.name) if known else None)

    def _lucky(self, played: Played) -> bool:
        """Tell whether a response names the gold answer of its row."""
        gold = self.golds.get(played.row.name)
        return gold is not None and holds(normal(played.response), normal(self._content(gold)))

    def _count(self, rate: Rate, played: Played, *, solved: bool) -> bool:
        """Count an episode, and return whether it succeeded."""
        self._played += 1
        if played.crash or played.error:
            (self._crashes if played.crash else self._errors).append(played)
            return False
        rate.episodes += 1
        rate.solved += solved
        rate.returns += played.total
        return solved

    def _note_later_turns(self, played: Played) -> None:
        """Add what an episode showed before its end, where nothing of it can be what the agent said."""
        look = self.looks[played.row.name]
        said = normal("\n".join(turn.response for turn in played.turns))
        if look.gold and not holds(said, normal(look.gold)):
            look.texts += [turn.observation for turn in played.turns[:3] if not turn.over]
            look.infos += [turn.info for turn in played.turns[:3] if not turn.over]

    # What is looked at when all is played.

    def _check_leaks(self) -> None:
        named = {each.message.partition("repeating ")[2] for each in self.found.problems if each.kind == "leak"}
        for problem in find_leaks(list(self.looks.values())):
            if not any(source and source in problem.message for source in named):
                self.found.problems.append(problem)
        self._did("leaks")

    def _check_determinism(self) -> None:
        differing: list[str] = []
        again = 0
        exact = self.stage.deterministic
        episodes = self.episodes if exact else [each for each in self.episodes if each.row.name in self.golds][:10]
        for played in episodes:
            if played.crash or played.error or not played.turns:
                continue
            again += 1
            before, after = played.record(exact), self.stage.replay(played).record(exact)
            if before != after:
                differing.append(f"{played.row.name}: {_difference(before, after)}")
        if differing:
            message = f"{len(differing)} of {again} episodes come out differently with the same seed and responses"
            self._problem("nondeterministic", len(differing) / again, message, differing)
        self._did("again")

    def _report_failures(self) -> None:
        for kind, failed, what in (
            ("crash", self._crashes, "ended in an exception, which no response may cause"),
            ("error", self._errors, "ended in an error of the environment"),
        ):
            if failed:
                message = f"{len(failed)} of {self._played} episodes {what}"
                examples = [f"{each.row.name}: {each.crash or each.error}" for each in failed]
                self._problem(kind, len(failed) / self._played, message, list(dict.fromkeys(examples)))

    def _problem(self, kind: str, share: float, message: str, examples: Sequence[str], *, fails: bool = True) -> None:
        self.found.problems.append(Problem(kind, share, message, tuple(examples[:3]), fails))

    def _did(self, step: str) -> None:
        self.on_done(f"{self.stage.env_id}: {step}")


def _says(response: str) -> Callable[[str, Mapping[str, Any], int], str]:
    return lambda _observation, _info, _turn: response


def _shown(played: Played) -> str:
    """Return the first response of an episode, cut, and what it was paid."""
    response = " ".join((played.turns[0].response if played.turns else "").split())
    cut = response if len(response) <= _SHOWN else f"{response[: _SHOWN // 2]} … {response[-_SHOWN // 2 :]}"
    return f"{cut!r} got {played.total:g}"


def _difference(before: Sequence[str], after: Sequence[str]) -> str:
    for one, other in zip(before, after, strict=False):
        if one != other:
            at = next((at for at, pair in enumerate(zip(one, other, strict=False)) if pair[0] != pair[1]), 0)
            start = max(0, at - 30)
            return f"{one[start : at + 40]!r}, then {other[start : at + 40]!r}"
    return f"{len(before) - 1} turns, then {len(after) - 1}"
