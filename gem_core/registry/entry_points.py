"""Import and call the entry point of a record, with errors that name the record."""

from __future__ import annotations

import importlib
import importlib.metadata
from collections.abc import Callable
from typing import Any, cast

from gem_core.arguments import check_arguments
from gem_core.errors import EntryPointError
from gem_core.registry.distributions import extras_of
from gem_core.registry.specs import EntryPoint, NamedSpec
from gem_core.suggestions import did_you_mean


def load_entry_point(entry_point: EntryPoint, owner: str) -> Callable[..., Any]:
    """Import what ``"package.module:Name"`` points to.

    Raises:
        EntryPointError: The module is not there, fails while it is imported, or has no such name.
    """
    if not isinstance(entry_point, str):
        return entry_point
    module_name, _, path = entry_point.partition(":")
    try:
        target: Any = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name and (module_name == error.name or module_name.startswith(f"{error.name}.")):
            what = f"there is no module {error.name!r} (entry point {entry_point!r})"
            raise EntryPointError(f"{owner}: {what}; correct the entry point, or install what has it") from error
        package = (error.name or "").partition(".")[0]
        missing = f"{owner}: {module_name!r} needs the module {error.name!r}, which is not "
        if package == module_name.partition(".")[0]:
            raise EntryPointError(f"{missing}there; correct the import, or add the module") from error
        raise EntryPointError(f"{missing}installed; try 'pip install {_provider(package, module_name)}'") from error
    except (Exception, SystemExit) as error:  # third-party code may raise anything while it is imported
        raise EntryPointError(f"{owner}: importing {module_name!r} failed: {type(error).__name__}: {error}") from error
    for part in path.split("."):
        try:
            target = getattr(target, part)
        except AttributeError:
            names = [name for name in dir(target) if not name.startswith("_")]
            hint = did_you_mean(part, names)
            raise EntryPointError(f"{owner}: {module_name!r} has no {part!r}.{hint} It is {entry_point!r}") from None
    if not callable(target):
        raise EntryPointError(f"{owner}: {entry_point!r} is a {type(target).__name__}, which cannot be called")
    return cast("Callable[..., Any]", target)


def _provider(package: str, module_name: str) -> str:
    """Return what to install for a package that a module needs: an extra of the plugin that has the module, if any."""
    wanted, home = package.replace("_", "-"), module_name.partition(".")[0]
    for point in importlib.metadata.entry_points(group="gem.plugins"):
        if point.dist is not None and point.value.partition(".")[0] == home:
            for extra, added in extras_of(point.dist.name).items():
                if wanted in added:
                    return f'"{point.dist.name}[{extra}]"'
    return wanted


def construct(record: NamedSpec, *args: Any, **options: Any) -> Any:
    """Call the entry point of a named record with arguments that are checked first."""
    owner = f"{record.kind} {record.name!r}"
    maker = load_entry_point(record.entry_point, owner)
    check_arguments(maker, args, options, owner)
    return maker(*args, **options)
