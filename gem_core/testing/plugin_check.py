"""``check_plugin``: loads an installed plugin in an interpreter of its own and tries what it declares."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Collection
from importlib.metadata import EntryPoint, entry_points
from types import ModuleType
from typing import Any

from gem_core.errors import UnknownPluginError
from gem_core.hookspecs import ENTRY_POINT_GROUP
from gem_core.suggestions import did_you_mean
from gem_core.testing.findings import Findings

_TIMEOUT_S = 300.0
_MARK = "gem-check-plugin:"


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
    point = _find(plugin if isinstance(plugin, str) else plugin.__name__)
    seen = _in_another_interpreter(point)
    findings = Findings(f"plugin {point.name!r}")
    if not findings.expect("It loads, and its hooks return records.", seen["failure"] is None, seen["failure"]):
        findings.result()
    own = {point.value.partition(".")[0].partition(":")[0], *allow}
    foreign = sorted(set(seen["imported"]) - own)
    findings.expect(
        "Declaring imports the standard library, gem_core and the plugin's own package, and nothing else.",
        not foreign,
        f"it imports {', '.join(foreign)}; import these in the module of the implementation",
    )
    findings.expect("It writes nothing to standard output.", not seen["printed"], seen["printed"][:200])
    findings.expect("It offers something.", bool(seen["records"]), "no hook returned a record")
    mute = [record["name"] for record in seen["records"] if not record["summary"].strip()]
    findings.expect("Every record has a summary.", not mute, f"without one: {', '.join(mute)}")
    wrong = [f"{record['name']}: {record['error']}" for record in seen["records"] if record["error"]]
    findings.expect("Every entry point can be imported, and takes its arguments.", not wrong, "; ".join(wrong))
    return findings.result()


def _find(name: str) -> EntryPoint:
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


def _in_another_interpreter(point: EntryPoint) -> dict[str, Any]:
    # Whatever this process has imported, as a test session has, must not hide what the plugin imports.
    environment = {name: value for name, value in os.environ.items() if name != "GEM_PLUGINS_STRICT"}
    names = {other.name for other in entry_points(group=ENTRY_POINT_GROUP)} - {point.name}
    environment["GEM_PLUGINS_DISABLE"] = ",".join(sorted(names))
    done = subprocess.run(
        [sys.executable, "-c", f"from {__name__} import _report; _report()"],
        input=json.dumps({"name": point.name, "path": sys.path}),
        env={**environment, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True,
        text=True,
        timeout=_TIMEOUT_S,
        check=False,
    )
    printed, mark, answer = done.stdout.rpartition(_MARK)
    if not mark:
        failure = f"the interpreter ended with exit code {done.returncode}: {done.stderr[-500:]}"
        return {"failure": failure, "printed": printed, "imported": [], "records": []}
    return {**json.loads(answer), "printed": printed}


def _report() -> None:
    """Load the plugin that standard input names, and write what was seen; run in the other interpreter."""
    from gem_core.registry import registry

    asked = json.loads(sys.stdin.read())
    sys.path[:] = asked["path"]
    import pluggy  # noqa: F401 - what the loader itself needs is no import of the plugin's

    before = set(sys.modules)
    plugin = next(plugin for plugin in registry().plugins() if plugin.name == asked["name"])
    imported = {name.partition(".")[0] for name in set(sys.modules) - before}
    imported -= {*sys.stdlib_module_names, "gem_core", "pluggy"}
    failure = None if plugin.failure is None else plugin.failure.error
    answer = {
        "failure": failure,
        "imported": sorted(name for name in imported if not name.startswith("__editable__")),
        "records": [
            {"name": getattr(record, "id", None) or f"{getattr(record, 'kind', '')} {getattr(record, 'name', '')}"}
            | {"summary": record.summary, "error": _error_of(record)}
            for record in plugin.records
        ],
    }
    sys.stdout.write(f"{_MARK}{json.dumps(answer)}")


def _error_of(record: Any) -> str:
    from gem_core.arguments import check_arguments
    from gem_core.entry_points import load_entry_point
    from gem_core.requirements import unmet
    from gem_core.specs import EnvSpec

    if isinstance(record, EnvSpec) and unmet(record.requires):
        return ""  # what it needs is not here, and may be what its module imports
    try:
        maker = load_entry_point(record.entry_point, "its entry point")
        if isinstance(record, EnvSpec):
            check_arguments(maker, (), {k: v for k, v in record.kwargs.items() if k != "render_mode"}, record.id)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever a plugin's module does is what was seen
        return f"{type(error).__name__}: {error}"
    return ""
