"""Points to what cannot be imported, in many ways, and to one environment that can."""

from gem_core import CommandSpec, EnvSpec, RequirementSpec, ToolSpec, hookimpl

ENTRY_POINTS = {
    "Fine": "gem_dangling_env:MathEnv",
    "Typo": "gem_dangling_env:MatEnv",
    "NoModule": "gem_dangling_envs:MathEnv",
    "NoClass": "gem_dangling_env:MathEnv.Easy",
    "Number": "gem_dangling_env:LIMIT",
    "NoEnv": "gem_dangling_env:Helper",
    "MissingImport": "gem_dangling_import:MathEnv",
    "Deeper": "gem_dangling_deeper:MathEnv",
    "Syntax": "gem_dangling_syntax:MathEnv",
    "Raises": "gem_dangling_raises:MathEnv",
    "Exits": "gem_dangling_exits:MathEnv",
}


@hookimpl
def gem_register_envs():
    """Offer environments."""
    for name, entry_point in ENTRY_POINTS.items():
        yield EnvSpec(id=f"dangling:{name}-v0", entry_point=entry_point)
    yield EnvSpec(id="dangling:Kwargs-v0", entry_point="gem_dangling_env:MathEnv", kwargs={"lenght": 3})
    # What it needs is not here, which may be what its module imports; a name that is not there is wrong in any case.
    yield EnvSpec(id="dangling:Unmet-v0", entry_point="gem_dangling_import:MathEnv", requires=("package:no-such",))
    yield EnvSpec(id="dangling:UnmetTypo-v0", entry_point="gem_dangling_env:MatEnv", requires=("package:no-such",))


@hookimpl
def gem_register_tools():
    """Offer tools."""
    return [
        ToolSpec(name="dangling", entry_point="gem_dangling_env:Tool"),
        ToolSpec(name="dangling_class", entry_point="gem_dangling_env:Helper"),
        ToolSpec(name="dangling_status", entry_point="gem_dangling_env:make_tool", status="gem_dangling_env:stat"),
    ]


@hookimpl
def gem_add_commands():
    """Offer commands; nothing is tried after the second one."""
    return [
        CommandSpec(name="dangling", entry_point="gem_dangling_env:make_tool"),
        CommandSpec(name="dangling_dies", entry_point="gem_dangling_dies:command"),
    ]


@hookimpl
def gem_register_requirements():
    """Offer a word."""
    return [RequirementSpec(name="dangling", entry_point="gem_dangling:weather")]


def weather(argument, *, closely=False):
    """Answer with a text, which is no answer."""
    return "met"
