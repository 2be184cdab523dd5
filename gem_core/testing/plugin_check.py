"""``check_plugin``: loads an installed plugin in another interpreter and tries what it declares."""

from __future__ import annotations

from collections.abc import Collection
from importlib.metadata import EntryPoint, entry_points
from types import ModuleType

from gem_core.errors import UnknownPluginError
from gem_core.registry.hookspecs import ENTRY_POINT_GROUP
from gem_core.suggestions import did_you_mean
from gem_core.testing.findings import Findings
from gem_core.testing.importing import imported


def check_plugin(plugin: str | ModuleType, *, allow: Collection[str] = ()) -> list[str]:
    """Try everything that an installed plugin promises: that it declares only, and that what it declares is there.

    Args:
        plugin: Name of its entry point, distribution, package or module; or the module.
        allow: Packages of others that its declaring module may import.

    Returns:
        The promises that were kept, in one sentence each.

    Raises:
        CheckError: Promises are broken; the message names each, with what was seen.
        UnknownPluginError: No plugin of this name is installed.
    """
    point = find_plugin(plugin if isinstance(plugin, str) else plugin.__name__)
    seen = imported(point)
    findings = Findings(f"plugin {point.name!r}")
    if not findings.expect("It loads, and its hooks return records.", seen.failure is None, seen.failure):
        findings.result()
    own = {point.value.partition(".")[0].partition(":")[0], *allow}
    foreign = sorted(set(seen.packages) - own)
    findings.expect(
        "Declaring imports the standard library, gem_core and the plugin's own package, and nothing else.",
        not foreign,
        f"it imports {', '.join(foreign)}; import these in the module of the implementation",
    )
    findings.expect("It writes nothing to standard output.", not seen.printed, seen.printed[:200])
    findings.expect("It offers something.", bool(seen.records), "no hook returned a record")
    mute = [record["name"] for record in seen.records if not record["summary"].strip()]
    findings.expect("Every record has a summary.", not mute, f"without one: {', '.join(mute)}")
    wrong = seen.problems
    findings.expect("Every entry point can be imported, and takes its arguments.", not wrong, "; ".join(wrong))
    return findings.result()


def find_plugin(name: str) -> EntryPoint:
    """Return the entry point of an installed plugin, by its name or that of its distribution, package or module.

    Raises:
        UnknownPluginError: No plugin of this name is installed.
    """
    points = list(entry_points(group=ENTRY_POINT_GROUP))
    for point in points:
        module = point.value.partition(":")[0]
        distribution = point.dist.name if point.dist is not None else ""
        if name in (point.name, distribution, module, module.partition(".")[0]):
            return point
    names = [point.name for point in points]
    raise UnknownPluginError(
        f"no plugin {name!r}.{did_you_mean(name, names)} Installed: {', '.join(names) or 'none'}. "
        "Install yours first, as with 'pip install -e .'"
    )
