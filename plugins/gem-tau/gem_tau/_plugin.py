"""What this distribution offers; it imports no environment."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core.registry import AgentSpec, CommandSpec, EnvSpec, hookimpl

_SEATS = ("assistant", "user")
_SPLITS = {
    "tau:Retail-test": ("test", "115 tasks of a shop's support"),
    "tau:Retail-train": ("train", "500 tasks of a shop's support"),
    "tau:Retail-dev": ("dev", "20 tasks of a shop's support"),
}


@hookimpl
def gem_register_envs() -> Iterable[EnvSpec]:
    """The sample, and the benchmarks' tasks; each for both seats, and with a simulated user."""
    yield from _both("tau:Sample", {"folder": "gem_tau:sample"}, "Ten tasks of a small shop's support; works offline")
    for env_id, (split, summary) in _SPLITS.items():
        yield from _both(env_id, {"split": split}, f"{summary}, from a folder of tau-bench's retail data")
    for domain in ("retail", "airline"):
        summary = f"Tasks of tau2-bench's {domain} that need no judge model, from a folder of its data"
        yield from _both(f"tau:Tau2-{domain}", {}, summary)


def _both(env_id: str, kwargs: dict[str, object], summary: str) -> Iterable[EnvSpec]:
    requires = () if "folder" in kwargs else ("argument:folder",)
    tags = ("tau", "tools", "text")
    yield EnvSpec(
        id=env_id,
        entry_point="gem_tau.env:TauEnv",
        kwargs=kwargs,
        summary=f"{summary}.",
        tags=tags,
        seats=_SEATS,
        requires=requires,
    )
    yield EnvSpec(
        id=f"{env_id}-solo",
        entry_point="gem_tau.env:solo",
        kwargs=kwargs,
        summary=f"{summary}; the user is simulated inside.",
        tags=tags,
        requires=requires,
    )


@hookimpl
def gem_register_agents() -> Iterable[AgentSpec]:
    """Scripted users and assistants."""
    return [
        AgentSpec(
            name="tau-user",
            entry_point="gem_tau.scripted_users:ScriptedUser",
            summary="A customer by rules: tau-user:patient, tau-user:forgetful or tau-user:terse.",
        ),
        AgentSpec(
            name="tau-assistant",
            entry_point="gem_tau.scripted_assistants:ScriptedAssistant",
            summary="An assistant of tau:Sample by rules: tau-assistant:careful, :hasty or :passive.",
        ),
    ]


@hookimpl
def gem_add_commands() -> Iterable[CommandSpec]:
    """The command that checks tasks and makes heat maps."""
    return [
        CommandSpec(
            name="tau",
            entry_point="gem_tau.command:command",
            summary="Check the tasks of tau-bench and tau2-bench; heat maps of users and assistants.",
        )
    ]
