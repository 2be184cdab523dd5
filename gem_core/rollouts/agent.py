"""The protocol of an agent, and functions that make one from a callable or find it by name."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Awaitable, Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Self

from gem_core.arguments import check_arguments, signature_of
from gem_core.background import run_or_schedule, run_sync
from gem_core.errors import AgentError, ArgumentError, EntryPointError, UnknownAgentError
from gem_core.records.episode import Transition
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.lookup import registry
from gem_core.types import Info, Observation, Response


@dataclass
class Context:
    """The second argument of an agent: what it may know besides the observation.

    Args:
        episode: Id of the episode in its run: the item's place in the plan and the repeat, as ``"12.0"``.
        env_id: Id of the environment.
        group: Name that episodes with one start share; None outside groups.
        turn: Number of turns taken so far.
        info: The info that came with the observation.
        tools: Schemas of the tools, as the OpenAI chat API takes them.
        transitions: The turns so far, oldest first.
        deadline: Time on ``time.monotonic()`` by which the answer is wanted; None for none.
        system: System text: the agent's own, or else the task's; None for none.
        draw_action: Function that ``sample_random_action`` calls.
        read_messages: Function that ``messages`` calls.
        seat: Name of the agent's seat among several; None if it is the only agent.
        read_observation: Function that ``observation`` calls.
        view: Name of the view that the agent is sent; None for none.
    """

    episode: str
    env_id: str
    group: str | None
    turn: int
    info: Info
    tools: list[dict[str, Any]]
    transitions: list[Transition]
    deadline: float | None = None
    system: str | None = None
    draw_action: Callable[[], str] = field(default=lambda: "", repr=False)
    read_messages: Callable[[], list[dict[str, Any]]] = field(default=list, repr=False)
    seat: str | None = None
    read_observation: Callable[[], Observation] = field(default=str, repr=False)
    view: str | None = None

    @property
    def messages(self) -> list[dict[str, Any]]:
        """The conversation so far as chat messages, whatever the view; the agent may change the list.

        The system text comes first, if there is one; tool calls and their results have their ids. A later list begins
        with the earlier one.
        """
        return self.read_messages()

    @property
    def observation(self) -> Observation:
        """The last observation of the environment, whatever part of it the agent is sent."""
        return self.read_observation()

    @property
    def responses(self) -> list[Response]:
        """The earlier responses as they were sampled, so that their text need not be tokenized again."""
        return [transition.action for transition in self.transitions]

    def sample_random_action(self) -> str:
        """Return a valid action, drawn by the environment from a generator of the episode's own."""
        return self.draw_action()


Answer = str | Awaitable[str]
Agent = Callable[[Observation, Context], Answer]
"""Returns a response; plain or a coroutine function. One agent serves many episodes at once.

It raises ``RequestError`` if it fails and only that episode is lost, as when a server does not answer, and
``ContextOverflowError`` if the history is too long for its model. It may have:

- ``prepare()``, called before the first episode, perhaps more than once, to raise errors that every episode would meet;
  and ``close()`` or ``aclose()``. Each is plain or a coroutine function.
- ``max_concurrency``: how many episodes keep it busy. ``interactive``: whether it answers one episode at a time.
- ``reads``: what it is sent. ``"messages"`` is the conversation so far as chat messages, ``"observation"`` the
  environment's observation. Without it, an agent is sent the observation; but in an environment with tools, whose
  observations are the results of single calls, the conversation so far as text, as ``concat_with_action`` shows it.
  If a view was named, every agent is sent the view.
- ``system``: system text of its own.
- ``native_tools``: whether it offers the model the schemas of ``context.tools``, so that no text has to explain them.
"""

READS = ("messages", "observation")


class AgentTraits(NamedTuple):
    """The attributes of an agent that decide what it is sent; see ``Agent``."""

    reads: str | None = None
    system: str | None = None
    native_tools: bool = False

    @classmethod
    def of(cls, agent: Any) -> Self:
        """Read the attributes of an agent.

        Raises:
            AgentError: Its ``reads`` is not one of ``READS``.
        """
        reads, system = getattr(agent, "reads", None), getattr(agent, "system", None)
        if reads is not None and reads not in READS:
            raise AgentError(
                f"an agent reads {' or '.join(map(repr, READS))}, and {agent!r:.100} says reads = {reads!r}"
            )
        return cls(reads, system if isinstance(system, str) else None, getattr(agent, "native_tools", False) is True)


def as_agent(agent: Any) -> Agent:
    """Return a callable of (observation, context) for any callable of one or two arguments.

    A second argument that has a default, as ``temperature=0.7``, is an option of the callable's own, unless its name
    is ``context``.

    Raises:
        AgentError: It cannot be called so, or its ``reads`` is not one of ``READS``.
    """
    if isinstance(agent, type):
        agent = agent()
    if not callable(agent):
        raise AgentError(f"an agent is a callable of (observation, context), not {agent!r:.100}")
    AgentTraits.of(agent)
    try:
        signature = inspect.signature(agent)
    except (TypeError, ValueError):  # a callable of C code may not tell its signature
        return _ObservationAgent(agent)
    for count in (2, 1):
        try:
            signature.bind(*[None] * count)
        except TypeError:
            continue
        return agent if count == 2 and _wants_context(signature) else _ObservationAgent(agent)
    raise AgentError(f"an agent takes (observation, context) or (observation), and {agent!r:.100} takes {signature}")


def _wants_context(signature: inspect.Signature) -> bool:
    """Tell whether the second argument is the context; one with a default is so only by its name."""
    second = list(signature.parameters.values())[1:2]
    return not second or second[0].default is inspect.Parameter.empty or second[0].name == "context"


_ATTRIBUTES = ("prepare", "close", "aclose", "interactive", "max_concurrency", *AgentTraits._fields)
"""The attributes that an agent may have; see ``Agent``."""


class _ObservationAgent:
    """An agent that takes the observation alone."""

    def __init__(self, function: Callable[[Observation], Answer]) -> None:
        self.function = function

    def __call__(self, observation: Observation, context: Context) -> Answer:
        return self.function(observation)

    def __getattr__(self, name: str) -> Any:
        # Only these: an object with all attributes of a function would be treated as a function.
        if name not in _ATTRIBUTES:
            raise AttributeError(name)
        return getattr(self.function, name)


def is_asynchronous(agent: Agent) -> bool:
    """Tell whether an agent is known to answer later, as a coroutine function does."""
    call = agent.function if isinstance(agent, _ObservationAgent) else agent
    return inspect.iscoroutinefunction(call) or inspect.iscoroutinefunction(
        getattr(call, "__call__", None)  # noqa: B004 - inspected, not called
    )


def prepare_agent(agent: Agent) -> None:
    """Call the agent's ``prepare()``, if it has one."""
    _wait_for(agent, "prepare", run_sync)


def close_agent(agent: Agent) -> None:
    """Call the agent's ``aclose()`` or ``close()``, if it has one."""
    _wait_for(agent, "aclose" if hasattr(agent, "aclose") else "close", run_or_schedule)


def _wait_for(agent: Agent, name: str, wait: Callable[[Awaitable[Any]], Any]) -> None:
    """Call a method of an agent, if it has it; wait for the result if it is awaitable."""
    method = getattr(agent, name, None)
    if callable(method):
        waited = method()
        if inspect.isawaitable(waited):
            wait(waited)


def load_agent(name: str, **options: Any) -> Agent:
    """Return the agent of a name: a registered one, or ``MODULE:CALLABLE``.

    A registered agent takes the text after the colon as its argument. Modules are also searched in the current folder,
    which is in ``sys.path`` only during the import.

    Args:
        name: As in ``"random"``, ``"openai:MODEL"``, ``"my_module:MyAgent"``.
        options: Keyword arguments for the registered entry point or the class that makes the agent.

    Raises:
        ArgumentError: The maker does not take these options; the message names the ones that it takes.
        EntryPointError: Importing the module failed.
        UnknownAgentError: There is no such agent, module or callable.
    """
    with current_folder_importable():  # a class may import more when it is made
        target, args, is_maker = _find(name)
        if is_maker:
            check_arguments(target, args, options, f"agent {name!r}")
            return as_agent(target(*args, **options))
        if options:
            raise ArgumentError(
                f"the agent {name!r} is not a class, so it takes no options, and was given: {', '.join(options)}"
            )
        return as_agent(target)


def load_agents(names: Iterable[str], **options: Any) -> dict[str, Agent]:
    """Return agents by name, each made once, with the options that it takes.

    Args:
        names: See ``load_agent``.
        options: Keyword arguments; each goes to the agents that take it.

    Raises:
        ArgumentError: No agent takes one of the options.
        UnknownAgentError: There is no such agent, module or callable.
    """
    names = list(dict.fromkeys(names))
    if len(names) == 1:
        return {names[0]: load_agent(names[0], **options)}
    taken = {name: {each: value for each, value in options.items() if _takes(name, each)} for name in names}
    for option in options:
        if not any(option in own for own in taken.values()):
            raise ArgumentError(f"none of the agents {', '.join(names)} takes the option {option}")
    return {name: load_agent(name, **own) for name, own in taken.items()}


def _takes(name: str, option: str) -> bool:
    """Tell whether the maker of an agent has a keyword argument of a name."""
    with current_folder_importable():
        target, _, is_maker = _find(name)
    parameters = (signature_of(target) or inspect.Signature()).parameters
    return is_maker and (option in parameters or any(each.kind is each.VAR_KEYWORD for each in parameters.values()))


def _find(name: str) -> tuple[Callable[..., Any], tuple[str, ...], bool]:
    """Return the target of a name, its arguments, and whether it makes the agent; otherwise it is the agent."""
    head, colon, rest = name.partition(":")
    try:
        record = registry().agent(head)
    except UnknownAgentError as unknown:
        if not (head and rest):
            raise UnknownAgentError(f"{unknown} Your own is named as MODULE:CALLABLE.") from None
        try:
            target = load_entry_point(name, f"agent {name!r}")
        except EntryPointError as error:
            cause = error.__cause__
            if registry().install_hint(head, "agent"):  # though there may be a module, as the package of OpenAI
                raise unknown from error
            if isinstance(cause, ModuleNotFoundError) and f"{head}.".startswith(f"{cause.name}."):
                raise UnknownAgentError(f"there is no agent and no module {head!r}: {unknown}") from error
            if cause is None:  # the module has no such callable
                raise UnknownAgentError(str(error)) from None
            raise
        return target, (), isinstance(target, type)
    return load_entry_point(record.entry_point, f"agent {head!r}"), (rest,) if colon else (), True


@contextmanager
def current_folder_importable() -> Iterator[None]:
    """Look for modules in the current folder as well, inside this context."""
    here = str(Path.cwd())
    sys.path.insert(0, here)
    try:
        yield
    finally:
        # Remove only one entry: one that was there before, or was added meanwhile, stays.
        with suppress(ValueError):
            sys.path.remove(here)
