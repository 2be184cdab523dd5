"""``Suite``: what a YAML file of a suite may say, and where suites are found."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from gem_core.errors import ArgumentError
from gem_core.suggestions import did_you_mean

_FOLDER = Path(__file__).parent
_MOST_BYTES = 1_000_000
_NO_WORD = re.compile(r"[^\w.]+")


def _choice(given: Any) -> Any:
    """Return ``[name, options]`` for ``"search"``, ``{"search": {"top_k": 2}}`` and ``["search", {"top_k": 2}]``."""
    if isinstance(given, str):
        return (given, {})
    if isinstance(given, Mapping) and len(given) == 1:
        ((name, options),) = given.items()
        return (name, options or {})
    return given


Choice = Annotated[tuple[str, dict[str, Any]], BeforeValidator(_choice)]


Name = Annotated[str, Field(pattern=r"^[^\x00-\x1f\x7f]+$", max_length=200)]
"""What scores call something: on one line of a table."""


class _Form(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class TaskSettings(_Form):
    """What may be said of a task, or of all tasks of a suite.

    Args:
        kwargs: Keyword arguments of the environment.
        tools: Names of tools, each with or without options, as ``[python, search: {top_k: 2}]``.
        wrappers: Wrappers around the tools, innermost first, in the same form.
        max_turns: Turns after which an episode is cut off.
        max_tool_uses: Tool calls in an episode; ``none`` for no limit.
        limit: So many rows at most.
        sample_ids: Only rows with these values of ``task_id``.
        shuffle: Seed of a random order of the rows; without it they are taken in order.
        where: A condition on the columns of a row, as ``level == 5 and subject != 'Geometry'``.
        episodes: Number of rows, each a seed of its own, where an environment has no rows.
    """

    kwargs: dict[str, Any] = {}
    tools: tuple[Choice, ...] = ()
    wrappers: tuple[Choice, ...] = ()
    max_turns: Annotated[int, Field(ge=1)] | None = None
    max_tool_uses: Annotated[int, Field(ge=0)] | Literal["none"] | None = None
    limit: Annotated[int, Field(ge=1)] | None = None
    sample_ids: tuple[str, ...] | None = None
    shuffle: Annotated[int, Field(ge=0)] | None = None
    where: str | None = None
    episodes: Annotated[int, Field(ge=1)] = 10


class SuiteTask(TaskSettings):
    """A task of a suite.

    Args:
        id: Id of an environment, or a glob such as ``game:*-easy``.
        name: What scores call it; by default its id. Two tasks of one id need names.
    """

    id: str
    name: Name | None = None

    @property
    def label(self) -> str:
        """What scores call it."""
        return self.name or self.id


class Model(_Form):
    """A model that is evaluated.

    Args:
        agent: Name of an agent, as ``openai:gpt-5-mini`` or ``my_module:my_agent``.
        name: What scores call it; by default the agent's, and what it is perturbed by.
        options: Keyword arguments of the agent, as ``{temperature: 0.7}``, over those of the run.
        perturb: Wrappers that disturb it, as ``typos,tool_429:rate=0.5``: put around each task, inside any view.
    """

    agent: str
    name: Name | None = None
    options: dict[str, Any] = {}
    perturb: str = ""

    @property
    def label(self) -> str:
        """What scores call it."""
        return self.name or (f"{self.agent} + {self.perturb}" if self.perturb else self.agent)


ModelChoice = Annotated[Model, BeforeValidator(lambda given: {"agent": given} if isinstance(given, str) else given)]


class Suite(_Form):
    """Which tasks are evaluated, and how.

    Args:
        name: Name of the suite.
        description: One line for listings.
        tasks: The tasks.
        defaults: What holds for every task that says nothing else.
        models: The models, where the command names none.
        roles: Who plays other parts, as ``{user: openai:gpt-5-mini, judge: openai:gpt-5}``: given to those environments
            that have a keyword of that name.
        sampling: Keyword arguments of the models, as ``{temperature: 0.7}``.
        epochs: How often each row is played.
        seed: Seed of the run.
        perturb: What each model is also perturbed by, one variant of it each; see ``Model``.
    """

    name: Annotated[str, Field(pattern=r"^[\w.-]+$")] = "suite"
    description: str = ""
    tasks: Annotated[tuple[SuiteTask, ...], Field(min_length=1)]
    defaults: TaskSettings = TaskSettings()
    models: tuple[ModelChoice, ...] = ()
    roles: dict[str, str] = {}
    sampling: dict[str, Any] = {}
    epochs: Annotated[int, Field(ge=1)] = 1
    seed: Annotated[int, Field(ge=0)] = 0
    perturb: tuple[str, ...] = ()

    def with_defaults(self) -> list[SuiteTask]:
        """Return the tasks with what the suite says of all of them; keyword arguments are joined."""
        given = self.defaults.model_dump(exclude_unset=True)
        return [
            SuiteTask.model_validate(
                {**given, **task.model_dump(exclude_unset=True), "kwargs": {**self.defaults.kwargs, **task.kwargs}}
            )
            for task in self.tasks
        ]


class SuiteChanges(TypedDict, total=False):
    """What may be said in place of what a suite says.

    ``epochs``, ``seed`` and ``perturb`` are the run's, all others are those of a task, and hold for all tasks.

    ``kwargs``, ``roles`` and ``sampling`` are joined with those of the suite.
    """

    epochs: int
    seed: int
    perturb: Sequence[str]
    roles: Mapping[str, str]
    sampling: Mapping[str, Any]
    kwargs: Mapping[str, Any]
    tools: Sequence[Any]
    wrappers: Sequence[Any]
    max_turns: int | None
    max_tool_uses: int | Literal["none"] | None
    limit: int | None
    sample_ids: Sequence[str] | None
    shuffle: int | None
    where: str | None
    episodes: int


def changed_suite(suite: Suite, changes: SuiteChanges) -> Suite:
    """Return a suite with changes that hold for all of its tasks.

    Raises:
        ArgumentError: There is no such setting, or its value cannot be.
    """
    if not changes:
        return suite
    given: dict[str, Any] = dict(changes)
    of_run = {name: given.pop(name) for name in ("epochs", "seed", "perturb") if name in given}
    joined = {name: {**getattr(suite, name), **given.pop(name, {})} for name in ("roles", "sampling")}
    kwargs = given.pop("kwargs", {})
    try:
        tasks = tuple(
            SuiteTask.model_validate(
                {**task.model_dump(exclude_unset=True), **given, "kwargs": {**task.kwargs, **kwargs}}
            )
            for task in suite.with_defaults()
        )
        own = {name: getattr(suite, name) for name in suite.model_fields_set - {"defaults"}}
        return Suite.model_validate({**own, **of_run, **joined, "tasks": tasks})
    except ValidationError as error:
        first = error.errors()[0]
        raise ArgumentError(f"{first['loc'][0]}: {first['msg']}.{_hint(first)}") from None


def builtin_suites() -> dict[str, Path]:
    """Return the files of the suites that are built in, by name."""
    return {path.stem: path for path in sorted(_FOLDER.glob("*.yaml"), key=lambda path: path.stem)}


def load_suite(name_or_file: str | Path) -> Suite:
    """Return a suite that is built in, or that of a YAML file.

    Raises:
        ArgumentError: There is no such suite, or it says what no suite may; the message names the place.
    """
    found = builtin_suites()
    path = found.get(str(name_or_file)) or Path(name_or_file)
    try:
        text = path.read_bytes()
    except (OSError, ValueError) as error:
        if path.suffix in {".yaml", ".yml"}:
            reason = error.strerror if isinstance(error, OSError) else error
            raise ArgumentError(f"cannot read the suite {path}: {reason}") from error
        hint = did_you_mean(str(name_or_file), found)
        raise ArgumentError(
            f"no suite {str(name_or_file)!r}.{hint} Built in: {', '.join(found)}; or give a YAML file, or ids"
        ) from error
    if len(text) > _MOST_BYTES:
        raise ArgumentError(f"{path} is no suite: it has {len(text):,} bytes")
    return parse_suite(text, str(path), default_name=path.stem)


def combined_suite(targets: Sequence[str | Path]) -> Suite:
    """Return one suite of several: of names of suites, YAML files, ids of environments, globs and folders of tasks.

    Raises:
        ArgumentError: There is nothing in it, or the suites differ in what holds for a whole run.
    """
    if not targets:
        raise ArgumentError("there is nothing to evaluate: give a suite or ids of environments; 'gem eval --list'")
    if len(targets) == 1 and not _is_task(targets[0]):
        return load_suite(targets[0])
    tasks: list[SuiteTask] = []
    shared: dict[str, Any] = {}
    for target in targets:
        if _is_task(target):
            tasks.append(SuiteTask(id=str(target)))
            continue
        suite = load_suite(target)
        tasks += suite.with_defaults()
        for name in ("models", "roles", "sampling", "epochs", "seed", "perturb"):
            value = getattr(suite, name)
            if name in suite.model_fields_set and shared.setdefault(name, value) != value:
                raise ArgumentError(f"the suites differ in {name}, which holds for a whole run: evaluate them apart")
    name = "-".join(
        _NO_WORD.sub("-", Path(target).stem if not _is_task(target) else str(target)) for target in targets[:3]
    )
    return Suite(name=name.strip("-")[:60] or "suite", tasks=tuple(tasks), **shared)


def _is_task(target: str | Path) -> bool:
    """Tell whether a target is an id, a glob, a folder, or a file of an environment, not a suite."""
    path = Path(target)
    is_yaml = path.suffix in {".yaml", ".yml"}
    return path.is_dir() or (not is_yaml and (path.is_file() or any(each in str(target) for each in ":*?[")))


def parse_suite(text: bytes, origin: str, *, default_name: str) -> Suite:
    """Return the suite that a YAML text describes; see ``load_suite``."""
    try:
        content = yaml.safe_load(text)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise ArgumentError(f"{origin} is no YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, dict):
        raise ArgumentError(f"{origin} is no suite: it must be a mapping with 'tasks', not {type(content).__name__}")
    try:
        return Suite.model_validate({"name": default_name, **content})
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        more = f" ({error.error_count() - 1} more)" if error.error_count() > 1 else ""
        raise ArgumentError(f"{origin}: {place}: {first['msg']}.{_hint(first)}{more}") from None


def _hint(error: Any) -> str:
    """Return what a misspelt key may have meant."""
    if error["type"] != "extra_forbidden":
        return ""
    inside = error["loc"][:-1]
    form: type[BaseModel] = {0: Suite}.get(len(inside), SuiteTask)
    return did_you_mean(str(error["loc"][-1]), list(form.model_fields))
