"""The plugin loader: real distributions, one for each way to break, installed into folders of their own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from distributions import ONE_MODULE, install, python

REPORT = """
import json, sys
from gem_core.registry.known_distributions import KNOWN_DISTRIBUTIONS
from gem_core.registry.lookup import registry
KNOWN_DISTRIBUTIONS["gem-absent"] = {"namespace": "absent"}  # all of this project's may be installed
plugins = {
    plugin.distribution: {
        "disabled": plugin.disabled, "version": plugin.version, "failure": plugin.failure and vars(plugin.failure),
        "records": sorted(getattr(record, "id", None) or record.name for record in plugin.records),
    }
    for plugin in registry().plugins()
}
def attempt(call):
    try:
        return str(call())
    except Exception as error:
        return f"{type(error).__name__}: {error}"
import gem_core as gem
envs = gem.list_envs()
heavy = sorted({"gymnasium", "datasets", "torch", "gem_fine_env"} & set(sys.modules))
made = {env_id: attempt(lambda: gem.make(env_id).reset(seed=0)[0]) for env_id in IDS}
print(json.dumps({"plugins": plugins, "envs": envs, "heavy": heavy, "made": made}))
"""


@pytest.fixture(scope="session")
def sites(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Each distribution, installed into a folder of its own."""
    target = tmp_path_factory.mktemp("sites")
    return {case: install(case, target) for case in ["fine", *ONE_MODULE]}


def report(paths: list[Path], ids: tuple[str, ...] = ("fine:One-v0",), **variables: str) -> dict[str, Any]:
    """Return what the registry says of its plugins, with the lines on standard error."""
    done = python(f"IDS = {ids!r}\n{REPORT}", paths, **variables)
    assert done.returncode == 0, done.stderr
    return {**json.loads(done.stdout), "stderr": done.stderr.splitlines()}


BROKEN = {
    "import_error": ("load", "ImportError: ", "nothing_of_this_name"),
    "exits": ("load", "SystemExit: 3", ""),
    "mute_error": ("load", "MuteError", ""),
    "missing_module": ("load", "ModuleNotFoundError: ", "gem_missing_module_typo"),
    "missing_attribute": ("load", "AttributeError: ", "'plugin'"),
    "uses_registry": ("load", "RegistrationError: the registry was used", ""),
    "misspelt": ("hooks", "RegistrationError: ", "'gem_register_env'. Did you mean 'gem_register_envs'"),
    "misspelt_unmarked": ("hooks", "RegistrationError: ", "'gem_register_env'. Did you mean 'gem_register_envs'"),
    "unmarked": ("hooks", "RegistrationError: 'gem_register_envs'", "'@gem_core.hookimpl'"),
    "extra_argument": ("hooks", "PluginValidationError: ", "'gem-extra-argument:extra_argument'"),
    "hook_raises": ("call", "ValueError: the first line and the second", ""),
    "wrong_type": ("call", "RegistrationError: gem_register_envs", "EnvSpec records, not {'id'"),
    "returns_text": ("call", "RegistrationError: gem_register_envs", "not 'text:One-v0'"),
    "returns_none": ("call", "RegistrationError: gem_register_envs", "not None"),
    "generator_fails": ("call", "RuntimeError: no second one", ""),
}


@pytest.fixture(scope="session")
def all_broken(sites: dict[str, Path]) -> dict[str, Any]:
    """The report of one interpreter that sees every broken plugin, and the fine one."""
    ids = ("fine:One-v0", "raises:One-v0", "heavy:One-v0")
    return report([sites[case] for case in ["fine", "heavy_neighbour", *BROKEN]], ids)


@pytest.mark.parametrize("case", BROKEN)
def test_failure_is_kept_as_data(all_broken: dict[str, Any], case: str) -> None:
    """A broken plugin has its version, stage, error and traceback on record, offers nothing, and is told in a line."""
    plugin = all_broken["plugins"][f"gem-{case.replace('_', '-')}"]
    stage, error, value = BROKEN[case]
    assert (plugin["version"], plugin["records"], plugin["failure"]["stage"]) == ("1.0", [], stage)
    assert plugin["failure"]["error"].startswith(error)
    assert value in plugin["failure"]["error"]
    assert plugin["failure"]["traceback"].strip()
    told = f"(gem-{case.replace('_', '-')} 1.0) failed at stage '{stage}': "
    assert len([line for line in all_broken["stderr"] if told in line]) == 1


def test_the_others_work(all_broken: dict[str, Any]) -> None:
    """All records of the fine plugin are there, one is made, and nothing heavy was imported; no half plugin is."""
    assert len(all_broken["stderr"]) == len(BROKEN)
    kinds = ["agent", "backend", "call", "tool", "weather", "wrapper"]
    expected = ["fine", "fine:One-v0", *(f"fine_{kind}" for kind in kinds)]
    assert all_broken["plugins"]["gem-fine"]["records"] == expected
    assert all_broken["made"]["fine:One-v0"] == "Say anything."
    assert all_broken["heavy"] == []
    assert not {"raises:One-v0", "midway:One-v0"} & set(all_broken["envs"])


def test_an_id_of_a_failed_plugin_says_the_cause(sites: dict[str, Path]) -> None:
    """An unknown id may belong to the plugin that failed, unless another distribution is known to have it."""
    made = report([sites["hook_raises"]], ("raises:One-v0", "absent:Nothing"))["made"]
    assert made["raises:One-v0"].startswith("UnknownEnvError: no environment 'raises:One-v0'.")
    assert "plugin 'hook_raises' (gem-hook-raises 1.0): ValueError" in made["raises:One-v0"]
    assert "'pip install gem-absent'" in made["absent:Nothing"]


def test_missing_module_of_an_environment_is_told_at_make(all_broken: dict[str, Any]) -> None:
    """A record whose module is missing is listed, and make says what is missing."""
    assert "there is no module 'gem_heavy_missing'" in all_broken["made"]["heavy:One-v0"]


def test_strict_raises_at_the_first_failure(sites: dict[str, Path]) -> None:
    """GEM_PLUGINS_STRICT=1 turns a failure, or a conflict, into a PluginError with its cause, at every look-up."""
    code = (
        "import gem_core as gem\n"
        "for _ in range(2):\n"
        "    try:\n        gem.list_envs()\n"
        "    except gem.GemError as error:\n        print(type(error).__name__, error, repr(error.__cause__))\n"
    )
    for case, told in ("hook_raises", "stage 'call': ValueError: the first line"), ("taken_id", "is offered by"):
        first, second = python(code, [sites["fine"], sites[case]], GEM_PLUGINS_STRICT="1").stdout.splitlines()
        assert first == second
        assert first.startswith("PluginError")
        assert told in first
        assert ("ValueError('the first" in first) == (case == "hook_raises")


def test_disabled_plugin_is_not_loaded(sites: dict[str, Path]) -> None:
    """GEM_PLUGINS_DISABLE skips plugins by either name, and their failure."""
    done = report([sites["fine"], sites["exits"]], GEM_PLUGINS_DISABLE="exits, gem-fine")
    assert done["stderr"] == []
    assert [done["plugins"][name]["disabled"] for name in ("gem-exits", "gem-fine")] == [True, True]
    assert "fine:One-v0" not in done["envs"]


def test_broken_metadata_breaks_nothing_else(sites: dict[str, Path], tmp_path: Path) -> None:
    """A distribution with garbage for entry points, and a second one of the same module."""
    for name, points in {"garbage": "no equals sign", "copy": "zcopy = gem_fine"}.items():
        info = tmp_path / f"{name}-1.0.dist-info"
        info.mkdir()
        (info / "entry_points.txt").write_text(f"[gem.plugins]\n{points}\n")
        (info / "METADATA").write_text(f"Metadata-Version: 2.4\nName: {name}\nVersion: 1.0\n")
    done = report([sites["fine"], tmp_path])
    assert done["made"]["fine:One-v0"] == "Say anything."
    assert any("garbage-1.0.dist-info cannot be read (" in line for line in done["stderr"])
    assert done["plugins"]["copy"]["failure"]["stage"] == "hooks"


def test_import_gem_core_loads_no_plugin(sites: dict[str, Path]) -> None:
    """Importing the package alone imports no plugin and nothing heavy."""
    code = "import sys, gem_core\nprint([m for m in ('gem_fine', 'gymnasium', 'numpy', 'pluggy') if m in sys.modules])"
    assert python(code, [sites["fine"]]).stdout == "[]\n"
