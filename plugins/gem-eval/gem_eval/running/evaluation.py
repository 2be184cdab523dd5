"""``evaluate``: play the tasks of a suite by some models, and record the run."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any, Unpack

import gem_core as gem
from gem_core import Episode, PlanItem
from gem_core.errors import ArgumentError, EpisodeFileError, GemError
from gem_core.records import to_plain, without_secrets
from gem_core.rollouts import Agent, FinishedEpisodes, as_agent, close_agent, load_agent, load_agents, prepare_agent
from gem_eval.files import new_run_folder
from gem_eval.records import Row, Run, RunWriter, read_info
from gem_eval.running.limits import RUN_LIMITS, Limits, RunMeter, metered
from gem_eval.running.planning import Evaluation, digest, plan_evaluation
from gem_eval.running.prices import load_prices
from gem_eval.running.provenance import code_of_agent, code_of_env, host, versions
from gem_eval.running.times import times
from gem_eval.scores import Score, compute_scores
from gem_eval.settings import asked_differently, asked_of, code_in
from gem_eval.suites import Model, Suite, SuiteChanges, changed_suite, combined_suite

DEFAULT_REQUESTS = 8
LEAST_FOR_THRESHOLD = 20

Models = str | Model | Sequence[str | Model] | Mapping[str, Any]
"""A model or several, by name or as ``Model``; or agents by name, ``{name: agent}``."""


class TooManyErrorsError(GemError):
    """More episodes than allowed ended in an error; the run was stopped."""


class EvaluationOptions(SuiteChanges, total=False):
    """How a run is played: keyword arguments of ``evaluate``, which says what they mean, beside ``SuiteChanges``."""

    command: str | None
    out: str | Path | None
    limits: Limits | None
    prices: str | Path | None
    retry_errors: bool
    error_threshold: float
    max_concurrency: int | None
    step_timeout: float | None
    backend: str
    new: bool
    go_on_anyway: bool


def evaluate(
    suite: Suite | str | Path | Sequence[str],
    models: Models,
    *,
    on_episode: Callable[[Row], None] | None = None,
    **options: Unpack[EvaluationOptions],
) -> Run:
    """Play the tasks of a suite by some models, and record the run; the same call goes on with one that was stopped.

    Args:
        suite: A suite, the name of one that is built in, or a YAML file; or ids of environments.
        models: Who is evaluated.
        out: Folder of the run; None for one in ``runs/``. One that holds this run goes on.
        limits: What an episode and the run may take.
        prices: File of prices; None for the one that comes with the plugin.
        retry_errors: Play episodes again that ended in an error.
        error_threshold: Share of episodes with an error, after twenty episodes, above which the run is stopped.
        max_concurrency: Episodes at once, of all models and tasks together; None for as many requests as a model may
            be asked at once.
        step_timeout: Seconds that a step or a reset of an environment may take; None for no limit.
        backend: Where environments live; see ``make_vec``.
        new: Begin another run, also where one of the same suite and models was stopped.
        go_on_anyway: Go on with a run although the code of its environments or agents was changed.
        command: What was typed, for the record.
        on_episode: Called with the row of each episode when it has been written.
        options: Also what the suite says otherwise, for all of its tasks: ``epochs``, ``seed``, ``limit``, ``episodes``
            and so on; see ``SuiteChanges``.

    Returns:
        The run; ``compute_scores(run.rows)`` has its scores.

    Raises:
        ArgumentError: Something cannot be as it was asked for; the message says what.
        TooManyErrorsError: The share of errors is above the threshold.
    """
    session = EvaluationSession(suite, models, **options)
    for row in session.play():
        if on_episode is not None:
            on_episode(row)
    return session.run


class EvaluationSession:
    """One session of a run: what is played is fixed when it is made; see ``evaluate`` for the arguments."""

    def __init__(
        self, suite: Suite | str | Path | Sequence[str], models: Models, **options: Unpack[EvaluationOptions]
    ) -> None:
        own = EvaluationOptions.__annotations__.keys() - SuiteChanges.__annotations__.keys()
        changes: Any = {name: value for name, value in options.items() if name not in own}
        self.suite = changed_suite(as_suite(suite), changes)
        self._options = options
        self.limits = options.get("limits") or Limits()
        self._prices = load_prices(options.get("prices"))
        self._retry = options.get("retry_errors", False)
        self._given = models or self.suite.models
        self._agents, self._models = _load_models(self._given, self.suite)
        self.plan: Evaluation = plan_evaluation(self.suite, self._models)
        self._settings: dict[str, Any] = json.loads(json.dumps(self._described_run()))
        self._check_prices()
        self.path, self.goes_on = self._find_folder(options.get("out"), options.get("new", False))
        self._run: Run | None = None
        self.changed: list[str] = []
        """What was changed of the code since the session before."""
        if self.goes_on and self.already_done() < self.plan.episodes:
            self.changed = self._changes()
        if self.changed and not options.get("go_on_anyway"):
            there = f"{self.path}, where {self.already_done()} of {self.plan.episodes} episodes are there"
            raise ArgumentError(
                f"{there}, was begun with other code: {'; '.join(self.changed)}. --go-on-anyway goes on, and mixes the "
                "two; --new begins another run"
            )

    @property
    def run(self) -> Run:
        """The run as it is recorded so far."""
        if self._run is None:
            self._run = Run(self.path)
        self._run.refresh()
        return self._run

    def rows(self) -> list[Row]:
        """Return the rows so far, in the order of the plan."""
        return sorted(self.run.rows, key=lambda row: (self._place(row.key), row.epoch))

    def scores(self) -> list[Score]:
        """Return the scores so far."""
        return compute_scores(self.rows())

    def metrics(self) -> dict[str, Any]:
        """Return the scores and times so far as plain JSON."""
        return {"scores": [score.to_dict() for score in self.scores()], "times": times(self.rows())}

    def already_done(self) -> int:
        """Return how many episodes are there and stay."""
        return sum(map(self._stays, self.run.rows)) if self.goes_on else 0

    @property
    def interactive(self) -> bool:
        """Whether a person answers."""
        return any(getattr(agent, "interactive", False) for agent in self._agents.values())

    def play(self) -> Iterator[Row]:
        """Play what has not been played, and yield the row of each episode when it has been written.

        Raises:
            TooManyErrorsError: The share of errors is above the threshold.
        """
        with ExitStack() as at_end:
            if not self.goes_on:
                at_end.callback(_remove_if_empty, self.path)
            for agent in {id(agent): agent for agent in self._agents.values()}.values():
                prepare_agent(agent)  # it says at the start what would fail later
                at_end.callback(partial(close_agent, agent))
            writer = at_end.enter_context(RunWriter(self.path))
            self._run = None  # the writer may have mended what was read before
            info = self._info()
            writer.write_info(info)
            before = self.run.rows
            paid = [*before, *self.run.superseded]
            tokens = sum((row.tokens_in or 0) + (row.tokens_out or 0) for row in paid)
            meter = RunMeter(self.limits, tokens, sum(row.cost or 0.0 for row in paid))
            ended: dict[str, Any] = {"status": "stopped", "reason": "interrupted"}
            try:
                yield from self._episodes(writer, meter, before, at_end)
                limit = meter.reached()
                left = self.plan.episodes - sum(map(self._stays, self.run.rows))
                ended = {"status": "stopped", "reason": limit} if limit and left else {"status": "finished"}
            except Exception as error:
                ended["reason"] = f"{type(error).__name__}: {error}"
                raise
            finally:
                info["sessions"][-1]["ended"] = time.time()
                writer.write_info({**info, **ended})
                writer.write_metrics(self.metrics())

    def _episodes(self, writer: RunWriter, meter: RunMeter, before: list[Row], at_end: ExitStack) -> Iterator[Row]:
        threshold = self._options.get("error_threshold", 0.5)
        prices = {model.label: self._prices.find(model.agent) for model in self._models}
        agents = {name: metered(agent, meter, prices[name]) for name, agent in self._agents.items()}
        done = FinishedEpisodes()
        for row in before:
            if self._stays(row):
                item = self.plan.items[self._place(row.key)]
                done.add_start(row.key, row.epoch, item.id or "", item.seed, item.options, item.agent)
        left = self.plan.episodes - len(done)
        if not left:
            return
        slots = min(left, self._slots())
        # What stops a run that fails is the threshold alone.
        vector = gem.make_vec(
            self.plan.envs,
            slots,
            backend=self._options.get("backend", "auto"),
            seed=self.suite.seed,
            step_timeout=self._options.get("step_timeout"),
            max_faults=self.plan.episodes,
        )
        at_end.callback(vector.close)
        count = errors = 0
        for episode in gem.rollout(vector, agents, plan=self._until_limit(meter), resume=done):
            row = writer.write(episode, self._evaluation(episode, meter))
            yield row
            count, errors = count + 1, errors + (row.error is not None)
            if count >= LEAST_FOR_THRESHOLD and errors > threshold * count:
                raise TooManyErrorsError(
                    f"{errors} of {count} episodes had an error, more than the threshold of {threshold:.0%}; "
                    f"the last: {row.error}"
                )

    def _until_limit(self, meter: RunMeter) -> Iterator[PlanItem]:
        """Yield the items of the plan until the run has reached a limit."""
        for item in self.plan.items:
            if meter.reached() is not None:
                return
            yield item

    def _evaluation(self, episode: Episode, meter: RunMeter) -> dict[str, Any]:
        """Return what the record of an episode says besides the episode."""
        task, row = self.plan.row_of[int(episode.key)]
        told: dict[str, Any] = {"id": task.label, "model": episode.agent, "row": row.name, "finished": time.time()}
        taken = meter.episodes.pop(f"{episode.key}.{episode.repeat}", None)
        if taken is not None:
            told |= {
                "seconds": round(time.monotonic() - taken.started, 6),
                "model_seconds": round(taken.model_seconds, 6),
                "cost": taken.cost,
            }
        return told

    def _stays(self, row: Row) -> bool:
        """Tell whether an episode that is there is not played again."""
        if row.cut_off in RUN_LIMITS:
            return False
        return row.error is None or not self._retry

    def _place(self, key: str) -> int:
        try:
            return range(len(self.plan.items))[int(key)]
        except (ValueError, IndexError):
            raise ArgumentError(f"{self.path} holds an episode with the key {key!r}, which this run has not") from None

    def _slots(self) -> int:
        if (chosen := self._options.get("max_concurrency")) is not None:
            return chosen
        if self.interactive:
            return 1
        return max(int(getattr(agent, "max_concurrency", DEFAULT_REQUESTS)) for agent in self._agents.values())

    # The record.

    def _described(self, model: Model) -> dict[str, Any]:
        """Return what a run says of a model."""
        agent = self._agents[model.label]
        told = {
            "name": model.label,
            "agent": model.agent,
            "options": {**self.suite.sampling, **model.options},
            "base_url": getattr(agent, "base_url", None),
            "code": code_of_agent(self._given[model.agent] if isinstance(self._given, Mapping) else model.agent),
            **({"perturb": model.perturb} if model.perturb else {}),
        }
        plain: dict[str, Any] = without_secrets(to_plain(told))
        return plain

    def _described_run(self) -> dict[str, Any]:
        """Return what is played, as ``run.json`` says it."""
        return {
            "suite": without_secrets(to_plain(self.suite.model_dump(mode="json", exclude_unset=True))),
            "models": [self._described(model) for model in self._models],
            "epochs": self.suite.epochs,
            "seed": self.suite.seed,
            "episodes": self.plan.episodes,
            "tasks": [
                {
                    "id": task.label,
                    "env": task.env_id,
                    "kwargs": without_secrets(to_plain(task.kwargs)),
                    "rows": len(task.rows),
                    "rows_in_all": task.total,
                    "data_sha256": task.data_hash,
                    "rows_sha256": digest([row.name for row in task.rows])[:16],
                    "code": code_of_env(task.env_id, task.kwargs),
                }
                for task in self.plan.tasks
            ],
            "limits": {name: limit for name, limit in vars(self.limits).items() if limit is not None},
        }

    def _info(self) -> dict[str, Any]:
        """Return what ``run.json`` says."""
        info: dict[str, Any] = {
            "schema_version": 1,
            "status": "running",
            "command": self._options.get("command"),
            **self._settings,
            "prices": {"file": str(self._options.get("prices") or ""), "as_of": self._prices.as_of},
            "versions": versions(),
            "host": host(),
            "sessions": list(self.run.info.get("sessions", [])) if self.goes_on else [],
        }
        changed = {"changed": self.changed} if self.changed else {}
        info["sessions"].append({"started": time.time(), "ended": None, **changed})
        return info

    # The folder.

    def _find_folder(self, out: str | Path | None, new: bool) -> tuple[Path, bool]:
        """Return the folder of the run, and whether it holds the beginning of it."""
        asked = asked_of(self._settings)
        if out is None:
            for path in [] if new else sorted(Path("runs").glob("*/run.json"), key=_changed, reverse=True):
                found = _read_info(path.parent)
                if found is not None and not asked_differently(asked_of(found), asked):
                    if found.get("status") == "finished" and not self._retry:
                        break  # the same command after a finished run asks for another one
                    return path.parent, True
            return new_run_folder(self.suite.name), False
        path, elsewhere = Path(out), "choose another folder for --out"
        found = _read_info(path)
        if found is None:
            if path.exists() and (not path.is_dir() or any(path.iterdir())):
                raise ArgumentError(f"{path} is there already and is no run; {elsewhere}")
            return path, False
        if new:
            raise ArgumentError(f"{path} holds a run; --new begins another, so {elsewhere}")
        if differs := asked_differently(asked_of(found), asked):
            raise ArgumentError(f"{path} holds another run: {differs}; {elsewhere}")
        return path, True

    def _changes(self) -> list[str]:
        """Return what of the code was changed since: sources, and versions of GEM's distributions."""
        found = self.run.info
        before, now = code_in(found), code_in(self._settings)
        users: dict[str, list[str]] = {}
        for user, code in now.items():
            was = before.get(user)
            if code is not None and was is not None:
                for name in {**was, **code}:
                    if was.get(name) != code.get(name):
                        users.setdefault(name, []).append(user)
        changes = [f"the code of {name} ({', '.join(each)})" for name, each in users.items()]
        earlier = found.get("versions", {})
        for name, version in versions().items():
            if name.startswith("gem-") and earlier.get(name, version) != version:
                changes.append(f"{name} {earlier[name]}, which is {version} now")
        return changes

    def _check_prices(self) -> None:
        if self.limits.of_cost:
            for model in self._models:
                if self._prices.find(model.agent) is None:
                    raise ArgumentError(
                        f"there is no price for {model.agent}, so no limit of cost can hold; give a file that has it "
                        "by --prices"
                    )


def as_suite(given: Suite | str | Path | Sequence[str]) -> Suite:
    """Return a suite: as it is given, or that of names, files and ids.

    Raises:
        ArgumentError: There is no such suite.
    """
    if isinstance(given, Suite):
        return given
    return combined_suite([given] if isinstance(given, str | Path) else list(given))


def _load_models(given: Models, suite: Suite) -> tuple[dict[str, Agent], list[Model]]:
    """Return the agents by the names that scores call them, and what is known of each; variants stand behind."""
    agents: dict[str, Agent]
    if isinstance(given, Mapping):
        models = [Model(agent=name) for name in given]
        agents = {
            name: load_agent(agent, **suite.sampling) if isinstance(agent, str) else as_agent(agent)
            for name, agent in given.items()
        }
    else:
        each = [given] if isinstance(given, str | Model) else list(given)
        models = [Model(agent=model) if isinstance(model, str) else model for model in each]
        agents = {}
    if not models:
        raise ArgumentError("there is no model to evaluate: name one by --model, as openai:MODEL or MODULE:CALLABLE")
    twice = [label for label, count in Counter(model.label for model in models).items() if count > 1]
    if twice:
        raise ArgumentError(f"two models are called {twice[0]!r}: give one of them a name of its own")
    plain = [model.agent for model in models if not model.options and not agents]
    shared = load_agents(plain, **suite.sampling) if plain else {}
    for model in models:
        if model.label not in agents:
            options = {**suite.sampling, **model.options}
            agents[model.label] = load_agent(model.agent, **options) if model.options else shared[model.agent]
    for model in list(models):
        for perturb in suite.perturb:
            name, both = f"{model.label} + {perturb}", ",".join(filter(None, (model.perturb, perturb)))
            models.append(model.model_copy(update={"name": name, "perturb": both}))
            agents[name] = agents[model.label]
    return agents, models


def _remove_if_empty(path: Path) -> None:
    with suppress(OSError):
        path.rmdir()


def _read_info(path: Path) -> dict[str, Any] | None:
    """Return what a folder says of its run; None where it holds none."""
    try:
        return read_info(path)
    except EpisodeFileError:
        return None


def _changed(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0
