"""From a record to a living environment: requirements, entry points, arguments, guard and wrappers."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias, TypeGuard, cast

import gymnasium
from gymnasium.envs.registration import EnvSpec as GymnasiumSpec
from gymnasium.envs.registration import WrapperSpec as GymnasiumWrapperSpec

from gem_core.arguments import check_arguments
from gem_core.env.wrapper import AnyEnv, Guard, Wrapper
from gem_core.errors import ArgumentError, RegistrationError
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.requirements import check_requirements
from gem_core.registry.specs import EnvSpec, NamedSpec, ToolSpec

if TYPE_CHECKING:
    from gem_core.tools.tool import Tool

Maker: TypeAlias = "str | Tool | Callable[..., Any]"
"""A name, a tool, or a callable that takes an environment; a class of tools is called without one."""

Choice: TypeAlias = "tuple[Maker, dict[str, Any]]"
"""A maker with its options."""

WrapperChoice: TypeAlias = "Maker | tuple[Maker, Mapping[str, Any]]"
"""A maker, or a name or callable with its options."""

Wrappers: TypeAlias = "str | Sequence[WrapperChoice]"
"""Innermost first: ``"python,concat"`` or ``["python", ("concat", {"max_turns": 4})]``."""

LookUp = Callable[[str], NamedSpec]
"""Finds the record of a wrapper or tool by name."""

_ABSENT = object()


@dataclasses.dataclass
class MadeSpec(GymnasiumSpec):
    """What an environment was made from; ``make`` goes through GEM, so wrappers and arguments come back the same.

    ``kwargs`` holds the arguments in force, ``record`` our own record, ``wrappers`` what was put around the task.
    Copies share the values of ``kwargs``: data sets are referenced, never copied.
    """

    record: EnvSpec | None = None
    wrappers: tuple[tuple[str, dict[str, Any]], ...] = ()

    def __post_init__(self) -> None:
        # Gymnasium's own would parse the id in its syntax, which has no variants.
        record = cast("EnvSpec", self.record)
        self.namespace, self.name, self.version = record.namespace, record.name, record.version

    def make(self, wrappers: Wrappers = (), **kwargs: Any) -> AnyEnv:
        """Make the same environment again, with some arguments changed and ``wrappers`` around it."""
        from gem_core.registry.lookup import registry

        stack: list[WrapperChoice] = [*self.stack, *wrapper_choices(wrappers)]
        return make_from(cast("EnvSpec", self.record), {**self.kwargs, **kwargs}, stack, registry().wrapper)

    @property
    def stack(self) -> tuple[tuple[str, dict[str, Any]], ...]:
        """All wrappers, innermost first: ours, and those of Gymnasium's that were put around them since."""
        theirs = tuple(_as_choice(wrapper) for wrapper in self.additional_wrappers)
        if self.max_episode_steps is not None:  # how Gymnasium's TimeLimit records itself
            theirs += (("gymnasium.wrappers:TimeLimit", {"max_episode_steps": self.max_episode_steps}),)
        return (*self.wrappers, *theirs)

    def overrides(self) -> dict[str, Any]:
        """Return the keyword arguments that differ from the registered ones."""
        registered = cast("EnvSpec", self.record).kwargs
        return {name: value for name, value in self.kwargs.items() if registered.get(name, _ABSENT) is not value}

    def with_kwargs(self, overrides: Mapping[str, Any]) -> MadeSpec:
        """Return a copy whose keyword arguments are changed."""
        return dataclasses.replace(self, kwargs={**self.kwargs, **overrides}) if overrides else self

    def with_wrapper(self, name: str, options: Mapping[str, Any]) -> MadeSpec:
        """Return a copy with one more wrapper outside."""
        return dataclasses.replace(
            self, wrappers=(*self.stack, (name, dict(options))), additional_wrappers=(), max_episode_steps=None
        )

    def to_json(self) -> str:
        """Return the id, the arguments and the wrappers as JSON, for ``from_json``."""
        return json.dumps({"id": self.id, "kwargs": self.kwargs, "wrappers": self.stack})

    @staticmethod
    def from_json(json_env_spec: str) -> MadeSpec:
        """Return what ``to_json`` gave as a specification again; its id is looked up in the registry."""
        from gem_core.registry.lookup import registry

        fields = json.loads(json_env_spec)
        wrappers = tuple((name, options) for name, options in fields["wrappers"])
        return dataclasses.replace(_made_spec(registry().env(fields["id"]), fields["kwargs"]), wrappers=wrappers)

    def __deepcopy__(self, memo: dict[int, Any]) -> MadeSpec:
        return dataclasses.replace(self)


def _made_spec(record: EnvSpec, kwargs: dict[str, Any]) -> MadeSpec:
    return MadeSpec(
        id=record.id,
        entry_point=record.entry_point,
        nondeterministic=not record.deterministic,
        kwargs=kwargs,
        record=record,
    )


def _as_choice(wrapper: GymnasiumWrapperSpec) -> tuple[str, dict[str, Any]]:
    if wrapper.kwargs is None:
        raise ArgumentError(
            f"{wrapper.name} does not record its arguments, so it cannot be made again; "
            "derive it from gymnasium.utils.RecordConstructorArgs"
        )
    return wrapper.entry_point, dict(wrapper.kwargs)


def make_from(record: EnvSpec, kwargs: Mapping[str, Any], wrappers: Wrappers, look_up: LookUp) -> AnyEnv:
    """Make the environment of a record.

    Args:
        record: What is made.
        kwargs: Keyword arguments over those of the record; ``render_mode`` is handled here.
        wrappers: What is put around it, innermost first.
        look_up: Finds wrappers and tools by name.

    Raises:
        MissingRequirementError: Something has to be installed, started or set first.
        EntryPointError: What the record points to cannot be imported.
        ArgumentError: A keyword that the environment, or an option that a wrapper, does not have.
    """
    arguments = {**record.kwargs, **kwargs}
    check_requirements(record, arguments)
    render_mode = arguments.pop("render_mode", None)
    entry_point = load_entry_point(record.entry_point, f"environment {record.id!r}")
    env = _construct(entry_point, (), arguments, f"environment {record.id!r}")
    if not isinstance(env, gymnasium.Env):
        raise RegistrationError(f"{record.id}: the entry point returned {type(env).__name__}, not an environment")
    try:
        return _finish_env(env, record, arguments, render_mode, wrappers, look_up)
    except BaseException:
        env.close()  # it may have started a server or a container
        raise


def _finish_env(
    env: AnyEnv,
    record: EnvSpec,
    arguments: dict[str, Any],
    render_mode: str | None,
    wrappers: Wrappers,
    look_up: LookUp,
) -> AnyEnv:
    """Give a task its render mode, record, guard and wrappers."""
    task = env.unwrapped
    if render_mode is not None:
        _set_render_mode(task, render_mode, record.id)
        arguments = {**arguments, "render_mode": render_mode}
    task.spec = _made_spec(record, arguments)
    guarded: AnyEnv = Guard(env)
    if record.max_turns is not None:
        from gem_core.wrappers.turn_limit import TurnLimit

        guarded = TurnLimit(guarded, max_turns=record.max_turns)
        guarded.implicit = True
    return wrap(guarded, wrappers, look_up)


def wrap(env: AnyEnv, wrappers: Wrappers, look_up: LookUp) -> AnyEnv:
    """Put wrappers and tools around an environment, innermost first; all tools share one, in the place of the first."""
    for maker, options in _tools_gathered(wrapper_choices(wrappers), look_up):
        env = _with_wrapper(env, maker, options, look_up(maker) if _is_name(maker) else None)
    return env


def check_choices(record: EnvSpec, kwargs: Mapping[str, Any], wrappers: Wrappers, look_up: LookUp) -> None:
    """Raise what ``make_from`` would for a keyword or an option that there is not, before anything is made.

    Raises:
        ArgumentError: A keyword that the environment, or an option that a wrapper or a tool, does not have.
        EntryPointError: What a record points to cannot be imported.
    """
    if kwargs:
        owner = f"environment {record.id!r}"
        arguments = {name: value for name, value in {**record.kwargs, **kwargs}.items() if name != "render_mode"}
        check_arguments(load_entry_point(record.entry_point, owner), (), arguments, owner)
    for maker, options in wrapper_choices(wrappers):
        found = look_up(maker) if _is_name(maker) else None
        if found is not None and options and maker != "tools":
            owner = f"{found.kind} {found.name!r}"
            args = () if isinstance(found, ToolSpec) else (None,)  # a wrapper takes the environment
            check_arguments(load_entry_point(found.entry_point, owner), args, options, owner)


def construct(record: NamedSpec, *args: Any, **options: Any) -> Any:
    """Call the entry point of a named record with arguments that are checked first."""
    owner = f"{record.kind} {record.name!r}"
    return _construct(load_entry_point(record.entry_point, owner), args, options, owner)


def _construct(maker: Callable[..., Any], args: tuple[Any, ...], options: Mapping[str, Any], owner: str) -> Any:
    check_arguments(maker, args, options, owner)
    return maker(*args, **options)


def _set_render_mode(task: AnyEnv, render_mode: str, env_id: str) -> None:
    modes = task.metadata.get("render_modes", [])
    if render_mode not in modes:
        raise ArgumentError(
            f"{env_id}: no render mode {render_mode!r}; it offers {', '.join(map(repr, modes)) or 'none'}"
        )
    task.render_mode = render_mode


def wrapper_choices(wrappers: Wrappers) -> list[Choice]:
    """Return each wrapper or tool that is asked for, by name or object, with its options, innermost first."""
    return [_choice(choice) for choice in _split(wrappers)]


def wrapper_targets(wrappers: Wrappers) -> list[Maker]:
    """Return the name or object of each wrapper and tool that is asked for, those among the options of tools too."""
    makers: list[Maker] = []
    for maker, options in wrapper_choices(wrappers):
        makers.append(maker)
        if maker == "tools":
            makers += [each if isinstance(each, str) or _is_tool(each) else each[0] for each in _named_tools(options)]
    return makers


def _named_tools(options: Mapping[str, Any]) -> list[Any]:
    from gem_core.tools.selection import tool_choices

    return tool_choices(options.get("tools", []))


def _split(wrappers: Wrappers) -> list[WrapperChoice]:
    if isinstance(wrappers, str):
        return [name.strip() for name in wrappers.split(",") if name.strip()]
    if isinstance(wrappers, Iterable):
        return list(wrappers)
    raise ArgumentError(f"wrappers must be names joined by commas or a list, not {wrappers!r}")


def _choice(choice: WrapperChoice) -> Choice:
    if isinstance(choice, str) or callable(choice) or _is_tool(choice):
        return cast("Maker", choice), {}
    if isinstance(choice, Sequence) and len(choice) == 2 and isinstance(choice[1], Mapping):
        return choice[0], dict(choice[1])
    raise ArgumentError(f"a wrapper is a name, a tool, a callable, or (name, {{options}}), not {choice!r}")


def _with_wrapper(env: AnyEnv, maker: Maker, options: dict[str, Any], record: NamedSpec | None) -> AnyEnv:
    if record is not None:
        wrapped, name = construct(record, env, **options), record.name
    else:
        maker = cast("str | Callable[..., Any]", maker)
        name = maker if isinstance(maker, str) else getattr(maker, "__qualname__", repr(maker))
        wrapped = _construct(load_entry_point(maker, f"wrapper {name!r}"), (env,), options, f"wrapper {name!r}")
    if not isinstance(wrapped, gymnasium.Env):
        raise ArgumentError(f"wrapper {name!r} returned {type(wrapped).__name__}, not an environment")
    if record is not None and isinstance(wrapped, Wrapper):
        wrapped._made_as = (record.name, options)
    return cast("AnyEnv", wrapped)


def _is_name(maker: object) -> TypeGuard[str]:
    return isinstance(maker, str) and ":" not in maker


def _tools_gathered(choices: Iterable[Choice], look_up: LookUp) -> list[Choice]:
    """Return the wrappers with all tools, and the options of ``"tools"``, in one: a call counts once, wherever."""
    result: list[Choice] = []
    gathered: dict[str, Any] | None = None
    for maker, options in choices:
        found = _as_tools(maker, options, look_up)
        if found is None:
            result.append((maker, options))
            continue
        if gathered is None:
            gathered = {"tools": []}
            result.append(("tools", gathered))
        gathered["tools"] += found.pop("tools")
        for name, value in found.items():
            if gathered.setdefault(name, value) != value:
                raise ArgumentError(f"the tools are given {name} twice, as {gathered[name]!r} and as {value!r}")
    if gathered is not None and not gathered["tools"]:
        raise ArgumentError("options for tools are given, and no tool; name some, as in 'python,tools'")
    return result


def _as_tools(maker: Maker, options: dict[str, Any], look_up: LookUp) -> dict[str, Any] | None:
    """Return a choice as options of ``ToolEnv``; None for any other wrapper."""
    if _is_tool(maker):
        return {"tools": [(maker, options) if isinstance(maker, type) else maker]}
    if maker in ("tools", "gem_core.tools.env:ToolEnv") or _is_tool_env(maker):
        return {**options, "tools": _named_tools(options)}
    if _is_name(maker) and isinstance(look_up(maker), ToolSpec):
        return {"tools": [(maker, options)]}
    return None


def _is_tool_env(maker: object) -> bool:
    module = sys.modules.get("gem_core.tools.env")
    return module is not None and maker is module.ToolEnv


def _is_tool(maker: object) -> bool:
    """Tell whether this is a tool or a class of tools, without loading what would be loaded if there were any."""
    module = sys.modules.get("gem_core.tools.tool")
    if module is None:
        return False
    return isinstance(maker, module.Tool) or (isinstance(maker, type) and issubclass(maker, module.Tool))
