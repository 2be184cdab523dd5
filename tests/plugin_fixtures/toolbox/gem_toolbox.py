"""Tools of a third party, and what they say of themselves."""

from gem_core import EnvSpec, ToolSpec, hookimpl


@hookimpl
def gem_register_tools():
    """Offer one tool alone, two under one name, and three whose status is odd."""
    tools = "gem_toolbox_tools"
    return [
        ToolSpec(name="vault", entry_point=f"{tools}:Vault", summary="Opens.", status="gem_toolbox_status:line"),
        ToolSpec(name="box", entry_point=f"{tools}:make_box", summary="Two tools.", status="gem_toolbox_status:facts"),
        ToolSpec(name="mute", entry_point=f"{tools}:Vault", summary="Says nothing of itself."),
    ]


@hookimpl
def gem_register_envs():
    """Offer a task that no one can solve without the tools."""
    return [EnvSpec(id="vault:Word-v0", entry_point="gem_toolbox_tools:VaultEnv", summary="Find the word.")]
