"""The hooks: all that a plugin can offer, each with an example.

A hook returns records and has no side effects. It lives in a module that imports ``gem_core`` and nothing heavy,
named by one entry point of the distribution::

    [project.entry-points."gem.plugins"]
    mine = "gem_mine._plugin"

A plugin implements the hooks it needs, each marked with ``gem_core.hookimpl``.
"""

from __future__ import annotations

from collections.abc import Iterable

import pluggy

from gem_core.registry.specs import (
    AgentSpec,
    CallFormatSpec,
    CommandSpec,
    EnvSpec,
    RequirementSpec,
    ToolSpec,
    VectorBackendSpec,
    WrapperSpec,
)

PROJECT = "gem"
ENTRY_POINT_GROUP = "gem.plugins"

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@hookspec
def gem_register_envs() -> Iterable[EnvSpec]:  # type: ignore[empty-body]
    """Offer environments.

    One that is made of a folder of the user's says by which files it is known, and which keyword takes it:
    ``folder_markers=("puzzle.toml",), folder_keyword="path"``. ``gem run FOLDER`` then needs no id.

    Example::

        @hookimpl
        def gem_register_envs():
            yield EnvSpec(
                id="mine:Reverse-v0",
                entry_point="gem_mine.reverse:ReverseEnv",
                kwargs={"length": 5},
                summary="Write a word backwards.",
            )
    """


@hookspec
def gem_register_tools() -> Iterable[ToolSpec]:  # type: ignore[empty-body]
    """Offer tools, which ``make(…, wrappers="name")`` puts around any task.

    An entry point may return several tools, as those of a server. ``gem doctor`` shows what ``status`` returns, where
    it is given: ``status="gem_mine.status:sandbox"``.

    Example::

        @hookimpl
        def gem_register_tools():
            return [ToolSpec(name="calculator", entry_point="gem_mine.tools:Calculator", summary="Adds and divides.")]
    """


@hookspec
def gem_register_call_formats() -> Iterable[CallFormatSpec]:  # type: ignore[empty-body]
    """Offer forms in which models write calls of tools; the core itself reads JSON, a tool's tag and its blocks.

    A reader is a function: it takes the place where a call begins, and the tools by name, and returns a ``ToolCall``
    or None; see ``CallFormatSpec``.

    Example::

        @hookimpl
        def gem_register_call_formats():
            yield CallFormatSpec(
                name="mine",
                opening="<my_call>",
                entry_point="gem_mine.call_formats:read",
                summary="The calls of my model.",
            )
    """


@hookspec
def gem_register_wrappers() -> Iterable[WrapperSpec]:  # type: ignore[empty-body]
    """Offer wrappers. Tools and wrappers share one space of names.

    Example::

        @hookimpl
        def gem_register_wrappers():
            return [WrapperSpec(name="shout", entry_point="gem_mine.wrappers:Shout", summary="Upper case.")]
    """


@hookspec
def gem_register_vector_backends() -> Iterable[VectorBackendSpec]:  # type: ignore[empty-body]
    """Offer ways to run many environments at once, chosen by ``make_vec(…, backend="name")``.

    Example::

        @hookimpl
        def gem_register_vector_backends():
            return [VectorBackendSpec(name="mine", entry_point="gem_mine.vector:MineVectorEnv")]
    """


@hookspec
def gem_register_agents() -> Iterable[AgentSpec]:  # type: ignore[empty-body]
    """Offer agents, chosen by ``gem run --agent name`` or ``--agent name:argument``.

    Options that were given, such as ``--temperature 0.7``, reach the entry point by keyword. What an agent's
    ``prepare()`` raises is said before the first episode; ``aclose()`` is called at the end of the run.

    Example::

        @hookimpl
        def gem_register_agents():
            return [AgentSpec(name="mine", entry_point="gem_mine.agents:MineAgent", summary="Plays by the book.")]
    """


@hookspec
def gem_register_requirements() -> Iterable[RequirementSpec]:  # type: ignore[empty-body]
    """Offer words for ``EnvSpec.requires``, each with a probe that tells whether this machine meets it.

    The probe takes what stands behind the colon, and ``closely``, which ``gem doctor`` sets; it returns a
    ``RequirementStatus``, as ``RequirementStatus("unmet", "there is none", "plug one in")``.

    Example::

        @hookimpl
        def gem_register_requirements():
            return [RequirementSpec(name="gpu", entry_point="gem_mine.probes:gpu", summary="A graphics processor.")]
    """


@hookspec
def gem_add_commands() -> Iterable[CommandSpec]:  # type: ignore[empty-body]
    """Offer subcommands of ``gem``.

    Example::

        @hookimpl
        def gem_add_commands():
            return [CommandSpec(name="serve", entry_point="gem_mine.cli:serve", summary="Serve an environment.")]
    """
