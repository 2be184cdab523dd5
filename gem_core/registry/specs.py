"""The records that plugins offer: names, summaries and entry points.

They are plain data, frozen, and checked on arrival, so that listing a thousand of them imports nothing.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, get_args

from gem_core.errors import RegistrationError

EntryPoint = str | Callable[..., Any]
"""``"package.module:Name"``, or the callable itself."""

CallBeginning = Literal["calls", "texts", "anything"]
"""Texts that begin with the opening of a call format: calls alone, other texts as well, or anything without a mark."""

_ENV_ID = re.compile(r"(?P<namespace>[A-Za-z0-9][\w.-]*):(?P<name>[A-Za-z0-9][\w.-]*)", re.ASCII)
_NAME = re.compile(r"[a-z0-9][a-z0-9_.-]*", re.ASCII)
_FILE_NAME = re.compile(r"[\w.-]+", re.ASCII)
_ENTRY_POINT = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*(\.[A-Za-z_]\w*)*", re.ASCII)


@dataclass(frozen=True, kw_only=True)
class EnvSpec:
    """An environment that can be made by id.

    Args:
        id: ``namespace:Name[-vN][-variant]``, as in ``game:Mastermind-v0-easy``. The version goes up whenever
            rewards, prompts or data change in a way that changes scores.
        entry_point: ``"package.module:Class"``, or a callable that returns an environment.
        kwargs: Keyword arguments for the entry point; ``make`` may override each.
        summary: One line for listings.
        tags: Words to search by.
        max_turns: Turns after which an episode is truncated. An environment that takes a keyword of this name is given
            it, so that it can announce its limit; around any other, ``make`` puts a ``TurnLimit``.
        requires: Requirements to run it: ``"network"``, ``"hub"``, ``"key:NAME"``, ``"package:NAME"`` or
            ``"package:NAME[EXTRA]"``, ``"command:NAME"``, ``"argument:NAME"`` (of ``make``), or ``"never:REASON"``
            if it cannot run at all; plugins offer more words, such as ``"docker"`` (see ``RequirementSpec``).
        deterministic: Whether a seed and the actions fix the whole episode.
        folder_markers: Names of files, as ``("task.toml",)``, that make a folder this environment's own: ``gem run``,
            ``gem play`` and ``gem info`` then take the folder, or one that holds such folders, in place of the id.
        folder_keyword: The keyword argument that takes the folder.
        seats: Names of the agents of a ``MultiAgentEnv``, its ``possible_agents``; empty for one agent.

    Raises:
        RegistrationError: A field has a wrong form; the message says which and what was expected.
    """

    instance_of: ClassVar[str | None] = None
    subclass_of: ClassVar[str | None] = "gymnasium:Env"
    """See ``NamedSpec``."""

    id: str
    entry_point: EntryPoint
    kwargs: Mapping[str, Any] = field(default_factory=dict, hash=False)
    summary: str = ""
    tags: tuple[str, ...] = ()
    max_turns: int | None = None
    requires: tuple[str, ...] = ()
    deterministic: bool = True
    folder_markers: tuple[str, ...] = ()
    folder_keyword: str = "path"
    seats: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.id, str) or not _ENV_ID.fullmatch(self.id):
            raise RegistrationError(f"environment id {self.id!r} must look like 'namespace:Name-v0', in ASCII")
        _check_entry_point(self.id, self.entry_point)
        is_mapping = isinstance(self.kwargs, Mapping) and all(isinstance(key, str) for key in self.kwargs)
        is_limit = self.max_turns is None or (type(self.max_turns) is int and self.max_turns > 0)
        _require(is_mapping, self, "kwargs", "map keyword names to values")
        _require(is_limit, self, "max_turns", "be a positive whole number")
        _require(isinstance(self.deterministic, bool), self, "deterministic", "be True or False")
        object.__setattr__(self, "kwargs", dict(self.kwargs))
        for name in ("tags", "requires", "seats", "folder_markers"):
            words = getattr(self, name)
            is_words = isinstance(words, tuple | list) and all(isinstance(word, str) for word in words)
            _require(is_words, self, name, "be a tuple of strings")
            object.__setattr__(self, name, tuple(words))
        _require(all(map(_FILE_NAME.fullmatch, self.folder_markers)), self, "folder_markers", "be names of files")
        is_name = isinstance(self.folder_keyword, str) and self.folder_keyword.isidentifier()
        _require(is_name, self, "folder_keyword", "name an argument")
        _check_summary(self.id, self.summary)

    @property
    def namespace(self) -> str:
        """The part before the colon."""
        return self.id.partition(":")[0]

    @property
    def name(self) -> str:
        """The part after the colon."""
        return self.id.partition(":")[2]

    @property
    def turn_limit(self) -> int | None:
        """Turns after which an episode is over, by the task's own keyword or by ``max_turns``; None if unlimited."""
        limits = [limit for limit in (self.kwargs.get("max_turns"), self.max_turns) if isinstance(limit, int)]
        return min(limits, default=None)


@dataclass(frozen=True, kw_only=True)
class NamedSpec:
    """A record with a short name: what all kinds but environments share.

    Args:
        name: Lower case letters, digits and ``_.-``.
        entry_point: ``"package.module:Name"``, or a callable.
        summary: One line for listings.
    """

    kind: ClassVar[str] = "record"
    instance_of: ClassVar[str | None] = None
    """The class of the entry point's object, as ``"package.module:Class"``; None for any callable."""
    subclass_of: ClassVar[str | None] = None
    """The base class of the entry point, if that is a class."""

    name: str
    entry_point: EntryPoint
    summary: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not _NAME.fullmatch(self.name):
            raise RegistrationError(f"{self.kind} name {self.name!r} must be lower case ASCII, as in 'python'")
        _check_entry_point(f"{self.kind} {self.name}", self.entry_point)
        _check_summary(self.name, self.summary)


@dataclass(frozen=True, kw_only=True)
class ToolSpec(NamedSpec):
    """A tool: the entry point returns a ``Tool``, or a sequence of them, when it is called with the tool's options.

    Args:
        status: A function that ``gem doctor`` calls to learn the tool's state on this machine, such as the level of a
            sandbox. It takes no arguments, and returns a line of text or a mapping of facts to plain values. Its module
            should load quickly, and its result must hold no secrets.
    """

    kind: ClassVar[str] = "tool"
    subclass_of: ClassVar[str | None] = "gem_core.tools.tool:Tool"

    status: EntryPoint | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.status is not None:
            _check_entry_point(f"tool {self.name}", self.status, "status")


@dataclass(frozen=True, kw_only=True)
class WrapperSpec(NamedSpec):
    """A wrapper: the entry point is called with an environment and the wrapper's options."""

    kind: ClassVar[str] = "wrapper"
    subclass_of: ClassVar[str | None] = "gymnasium:Wrapper"


@dataclass(frozen=True, kw_only=True)
class CallFormatSpec(NamedSpec):
    r"""A form in which models write calls of tools: the entry point is a reader, asked where a call may begin.

    It is called as ``read(opening, tools)`` and returns the ``ToolCall`` that begins there, with its place in the text
    and with an ``error`` if it cannot be read; or None for text that is no call. ``opening`` is the match of
    ``opening``, whose ``string`` is the response with what is thought and answered blanked out; ``tools`` are the tools
    by name. Of the calls that all readers find, the first that is complete is executed. A reader needs time in
    proportion to the text, whatever it is.

    Args:
        opening: Regular expression of how a call begins, as in ``r"\[TOOL_CALLS\]"``. The reader is imported when a
            response has one, and tried at the first twenty.
        begins: ``"calls"`` if nothing but a call begins so, ``"texts"`` if other text does as well, and ``"anything"``
            if the call has no mark of its own, such as bare JSON: no call beside a final answer.
    """

    kind: ClassVar[str] = "call format"

    opening: str
    begins: CallBeginning = "calls"

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            re.compile(self.opening)
        except (TypeError, re.error) as error:
            raise RegistrationError(
                f"call format {self.name}: opening {self.opening!r} is no pattern: {error}"
            ) from None
        if self.begins not in get_args(CallBeginning):
            allowed = ", ".join(get_args(CallBeginning))
            raise RegistrationError(f"call format {self.name}: begins must be one of {allowed}, not {self.begins!r}")


@dataclass(frozen=True, kw_only=True)
class VectorBackendSpec(NamedSpec):
    """A vector backend: the entry point takes a ``VectorSetup`` and options by keyword, and returns a ``VectorEnv``."""

    kind: ClassVar[str] = "vector backend"


@dataclass(frozen=True, kw_only=True)
class AgentSpec(NamedSpec):
    """A built-in agent: the entry point returns an agent when it is called.

    It gets the text after the colon of ``--agent name:argument`` as its one positional argument, if there is any,
    and the options that were given, as ``--temperature``, by keyword.
    """

    kind: ClassVar[str] = "agent"


@dataclass(frozen=True, kw_only=True)
class CommandSpec(NamedSpec):
    """A subcommand of ``gem``: the entry point is a ``click.Command``."""

    kind: ClassVar[str] = "command"
    instance_of: ClassVar[str | None] = "click:Command"


@dataclass(frozen=True, kw_only=True)
class RequirementSpec(NamedSpec):
    """A word for ``EnvSpec.requires``: the entry point is a probe, which tells whether this machine meets it.

    It is called as ``probe(argument, closely=False)`` and returns a ``RequirementStatus``. ``argument`` is what stands
    behind the colon, as in ``"gpu:24GB"``, or empty. ``make`` asks each time, so that the answer must come at once;
    ``gem doctor`` asks with ``closely=True``, also where no environment needs it, and waits two seconds or so.

    A word means the same wherever it is offered: several plugins may offer it, and the first by name is asked.
    """

    kind: ClassVar[str] = "requirement"


def _require(is_right: bool, record: EnvSpec, name: str, rule: str) -> None:
    if not is_right:
        raise RegistrationError(f"{record.id}: {name} must {rule}, not {getattr(record, name)!r}")


def _check_entry_point(owner: str, entry_point: object, what: str = "entry_point") -> None:
    if callable(entry_point) or (isinstance(entry_point, str) and _ENTRY_POINT.fullmatch(entry_point)):
        return
    raise RegistrationError(f"{owner}: {what} must be 'package.module:Name' or a callable, not {entry_point!r}")


def _check_summary(owner: str, summary: object) -> None:
    if not isinstance(summary, str) or "\n" in summary:
        raise RegistrationError(f"{owner}: summary must be one line of text, not {summary!r}")
