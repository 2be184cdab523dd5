"""The plugin loader: real distributions, one for each way to break, installed into folders of their own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from distributions import FIXTURES, install, python

from gem_core.registry import plugins

REPORT = """
import json, sys
from gem_core.registry.known_distributions import KNOWN_DISTRIBUTIONS
from gem_core.registry.lookup import registry
KNOWN_DISTRIBUTIONS["gem-absent"] = {"namespace": "absent"}  # all of this project's may be installed
plugins = {}
for plugin in registry().plugins():
    failure = plugin.failure
    plugins.setdefault(plugin.distribution, {
        "name": plugin.name, "version": plugin.version, "disabled": plugin.disabled,
        "records": sorted(getattr(record, "id", None) or record.name for record in plugin.records),
        "failure": failure and {"stage": failure.stage, "error": failure.error, "traceback": failure.traceback},
    })
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
    """Every fixture, installed into a folder of its own."""
    target = tmp_path_factory.mktemp("sites")
    return {folder.name: install(folder.name, target) for folder in FIXTURES.iterdir() if folder.is_dir()}


def report(paths: list[Path], ids: tuple[str, ...] = ("fine:One-v0",), **variables: str) -> dict[str, Any]:
    """Return what the registry says of its plugins, with the lines on standard error."""
    done = python(f"IDS = {ids!r}\n{REPORT}", paths, **variables)
    assert done.returncode == 0, done.stderr
    return {**json.loads(done.stdout), "stderr": done.stderr.splitlines()}


BROKEN = {
    "import_error": ("load", "ImportError: cannot import name 'nothing_of_this_name' from 'gem_core'"),
    "syntax_error": ("load", "SyntaxError: invalid syntax"),
    "exits": ("load", "SystemExit: 3"),
    "mute_error": ("load", "MuteError"),
    "missing_module": ("load", "ModuleNotFoundError: No module named 'gem_missing_module_typo'"),
    "missing_attribute": ("load", "AttributeError: module 'gem_missing_attribute' has no attribute 'plugin'"),
    "uses_registry": (
        "load",
        "RegistrationError: the registry was used while plugins are being loaded; "
        "a plugin returns its records from hooks and does nothing else",
    ),
    "misspelt": (
        "hooks",
        "RegistrationError: no hook is called 'gem_register_env'. Did you mean 'gem_register_envs', "
        "'gem_register_agents' or 'gem_register_tools'? See gem_core/registry/hookspecs.py",
    ),
    "misspelt_unmarked": (
        "hooks",
        "RegistrationError: 'gem_register_env' looks like a hook, but no hook is called so. Did you mean "
        "'gem_register_envs', 'gem_register_agents' or 'gem_register_tools'? See gem_core/registry/hookspecs.py",
    ),
    "unmarked": (
        "hooks",
        "RegistrationError: 'gem_register_envs' is not marked; put '@gem_core.hookimpl' above it",
    ),
    "extra_argument": ("hooks", "PluginValidationError: Plugin 'gem-extra-argument:extra_argument' for hook"),
    "hook_raises": ("call", "ValueError: the first line and the second"),
    "hook_exits": ("call", "SystemExit: 4"),
    "wrong_type": (
        "call",
        "RegistrationError: gem_register_envs must return records of type EnvSpec, not {'id': 'wrong:Type-v0'}",
    ),
    "wrong_record": ("call", "RegistrationError: gem_register_envs must return records of type EnvSpec, not ToolSpec("),
    "returns_text": (
        "call",
        "RegistrationError: gem_register_envs must return a list of EnvSpec, not 'text:One-v0'",
    ),
    "returns_none": ("call", "RegistrationError: gem_register_envs must return a list of EnvSpec, not None"),
    "generator_fails": ("call", "RuntimeError: no second one"),
    "invalid_record": (
        "call",
        "RegistrationError: environment id 'no colon' must look like 'namespace:Name-v0', "
        "with ASCII letters, digits and '._-'",
    ),
    "wraps_hooks": (
        "hooks",
        "RegistrationError: 'gem_register_envs' wraps the hooks of others; a plugin only offers records of its own",
    ),
}


ONLY_CHECKED = {"heavy_import", "prints", "wrong_kwargs", "dangling", "hangs"}
"""They load, and what is wrong with them is for check_plugin to find: see test_check_plugin.py."""

IN_CONFLICT = {"twice", "taken_id", "taken_name", "takes_core", "same_name"}
"""They load, and claim what is another's: see test_plugin_conflicts.py."""


@pytest.fixture(scope="session")
def all_broken(sites: dict[str, Path]) -> dict[str, Any]:
    """The report of one interpreter that sees every broken plugin, and the fine one."""
    ids = ("fine:One-v0", "raises:One-v0", "heavy:One-v0")
    return report([sites[case] for case in ["fine", "heavy_neighbour", *BROKEN]], ids)


def test_every_fixture_is_used() -> None:
    """No folder under plugin_fixtures is left without a test."""
    others = {"fine", "heavy_neighbour", "toolbox", *ONLY_CHECKED}
    assert {folder.name for folder in FIXTURES.iterdir() if folder.is_dir()} == {*BROKEN, *IN_CONFLICT, *others}


@pytest.mark.parametrize("case", BROKEN)
def test_failure_is_kept_as_data(all_broken: dict[str, Any], case: str) -> None:
    """A broken plugin has its distribution, version, stage, error and traceback on record, and offers nothing."""
    plugin = all_broken["plugins"][f"gem-{case.replace('_', '-')}"]
    stage, error = BROKEN[case]
    assert plugin["version"] == "1.0"
    assert plugin["records"] == []
    assert plugin["failure"]["stage"] == stage
    assert plugin["failure"]["error"].startswith(error)
    assert plugin["failure"]["traceback"].strip()


@pytest.mark.parametrize("case", BROKEN)
def test_failure_is_one_line_on_standard_error(all_broken: dict[str, Any], case: str) -> None:
    """Exactly one line on standard error names each plugin that failed."""
    distribution = f"(gem-{case.replace('_', '-')} 1.0) failed at stage '{BROKEN[case][0]}': "
    lines = [line for line in all_broken["stderr"] if distribution in line]
    assert len(lines) == 1
    assert lines[0].endswith("Everything else works; run 'gem plugins --check' for the whole.")


def test_one_line_for_each_broken_plugin_and_no_more(all_broken: dict[str, Any]) -> None:
    """Standard error has as many lines as there are broken plugins."""
    assert len(all_broken["stderr"]) == len(BROKEN)


def test_records_are_taken_all_or_none(all_broken: dict[str, Any]) -> None:
    """A plugin that fails anywhere offers none of its records, those before the failure included."""
    taken = {"raises:One-v0", "midway:One-v0", "midway:Fine-v0"}
    assert not taken & set(all_broken["envs"])


def test_listing_imports_nothing_heavy(all_broken: dict[str, Any]) -> None:
    """Listing every environment imports neither gymnasium nor the module of any environment."""
    assert all_broken["heavy"] == []


def test_all_hooks_are_taken(all_broken: dict[str, Any]) -> None:
    """The fine plugin offers a record by each hook, whatever happens to the others."""
    names = [
        "fine",
        "fine:One-v0",
        "fine_agent",
        "fine_backend",
        "fine_call",
        "fine_tool",
        "fine_weather",
        "fine_wrapper",
    ]
    assert all_broken["plugins"]["gem-fine"]["records"] == names


def test_make_works_beside_a_broken_plugin(sites: dict[str, Path]) -> None:
    """The environment of a fine plugin is made while another plugin is broken."""
    done = report([sites["fine"], sites["hook_raises"]], ("fine:One-v0", "raises:One-v0"))
    assert done["made"]["fine:One-v0"] == "Say anything."


def test_make_of_an_id_of_a_failed_plugin_says_the_cause(sites: dict[str, Path]) -> None:
    """An unknown id may belong to the plugin that failed, and the message says why it failed."""
    done = report([sites["hook_raises"]], ("raises:One-v0",))
    failed = (
        " It may belong to a plugin that failed: plugin 'hook_raises' (gem-hook-raises 1.0): "
        "ValueError: the first line and the second. Run 'gem list'"
    )
    assert done["made"]["raises:One-v0"] == f"UnknownEnvError: no environment 'raises:One-v0'.{failed}"


def test_a_failed_plugin_does_not_hide_the_one_to_install(sites: dict[str, Path]) -> None:
    """An id of a published namespace names the distribution to install, whatever else has failed."""
    done = report([sites["hook_raises"]], ("absent:Nothing",))
    assert done["made"]["absent:Nothing"].startswith(
        "UnknownEnvError: no environment 'absent:Nothing'. It comes with a plugin: "
        "try 'pip install gem-absent'. It may belong to a plugin that failed: "
    )


def test_missing_module_of_an_environment_is_told_at_make(all_broken: dict[str, Any]) -> None:
    """A record whose module is missing is listed, and make says what is missing."""
    assert all_broken["made"]["heavy:One-v0"] == (
        "EntryPointError: environment 'heavy:One-v0': there is no module 'gem_heavy_missing' (entry point "
        "'gem_heavy_missing:HeavyEnv'); correct the entry point, or install the distribution that has it"
    )


def test_strict_raises_at_the_first_failure(sites: dict[str, Path]) -> None:
    """GEM_PLUGINS_STRICT=1 turns a failure into a PluginError that has the original error as its cause."""
    code = "import gem_core as gem\ngem.list_envs()"
    done = python(code, [sites["fine"], sites["hook_raises"]], GEM_PLUGINS_STRICT="1")
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == (
        "gem_core.errors.PluginError: plugin 'hook_raises' (gem-hook-raises 1.0) failed at stage 'call': "
        "ValueError: the first line and the second (GEM_PLUGINS_STRICT is set)"
    )
    assert "The above exception was the direct cause" in done.stderr


def test_strict_says_the_same_the_second_time(sites: dict[str, Path]) -> None:
    """After a strict failure, the next look-up fails for the same reason and not for its own leftovers."""
    code = (
        "import gem_core as gem\n"
        "for _ in range(2):\n"
        "    try:\n        gem.list_envs()\n"
        "    except gem.GemError as error:\n        print(error)\n"
    )
    first, second = python(code, [sites["fine"], sites["taken_id"]], GEM_PLUGINS_STRICT="1").stdout.splitlines()
    assert first == second


def test_disabled_plugin_is_not_loaded(sites: dict[str, Path]) -> None:
    """GEM_PLUGINS_DISABLE skips plugins by name, so that not even their failure shows."""
    done = report([sites["fine"], sites["exits"]], GEM_PLUGINS_DISABLE="exits, fine")
    assert done["stderr"] == []
    assert [done["plugins"][name]["disabled"] for name in ("gem-exits", "gem-fine")] == [True, True]
    assert "fine:One-v0" not in done["envs"]


def test_unknown_name_to_disable_is_warned_of(sites: dict[str, Path]) -> None:
    """A misspelt name in GEM_PLUGINS_DISABLE gives one line with the nearest plugin."""
    done = report([sites["fine"]], GEM_PLUGINS_DISABLE="fin")
    assert done["stderr"] == [
        "gem: GEM_PLUGINS_DISABLE names 'fin', and no such plugin is installed. Did you mean 'fine'?"
    ]


def test_unreadable_entry_points_break_nothing_else(sites: dict[str, Path], tmp_path: Path) -> None:
    """A distribution whose entry_points.txt is garbage is named, and every other plugin works."""
    info = tmp_path / "garbage-1.0.dist-info"
    info.mkdir()
    (info / "entry_points.txt").write_text("[gem.plugins]\nno equals sign\n")
    done = report([sites["fine"], tmp_path])
    assert done["made"]["fine:One-v0"] == "Say anything."
    assert len(done["stderr"]) == 1
    assert "garbage-1.0.dist-info cannot be read (" in done["stderr"][0]


def test_distribution_without_metadata_breaks_nothing(sites: dict[str, Path], tmp_path: Path) -> None:
    """A plugin whose METADATA file is missing is still loaded, under whatever name is left."""
    info = tmp_path / "bare-1.0.dist-info"
    info.mkdir()
    (info / "entry_points.txt").write_text("[gem.plugins]\nbare = gem_fine\n")
    done = report([sites["fine"], tmp_path], GEM_PLUGINS_DISABLE="bare")
    assert done["made"]["fine:One-v0"] == "Say anything."


def test_two_plugins_of_one_module_fail_only_the_second(sites: dict[str, Path], tmp_path: Path) -> None:
    """A module that two distributions name works for the first of them."""
    info = tmp_path / "copy-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.4\nName: copy\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[gem.plugins]\nzcopy = gem_fine\n")
    done = report([sites["fine"], tmp_path])
    assert done["made"]["fine:One-v0"] == "Say anything."
    assert done["plugins"]["copy"]["failure"]["stage"] == "hooks"


def test_import_gem_core_loads_no_plugin(sites: dict[str, Path]) -> None:
    """Importing the package alone imports no plugin and nothing heavy."""
    code = "import sys, gem_core\nprint([m for m in ('gem_fine', 'gymnasium', 'numpy', 'pluggy') if m in sys.modules])"
    assert python(code, [sites["fine"]]).stdout == "[]\n"


def test_long_error_is_cut() -> None:
    """A plugin's error cannot fill the screen; the whole of it stays in the report."""
    assert plugins.one_line(ValueError("x" * 5_000)) == f"ValueError: {'x' * 500}…"
