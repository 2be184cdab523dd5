"""What several plugins offer costs them that id or name alone, and the core's names stay the core's."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import click
import pytest
from distributions import gem_in, install, python
from word_env import WordEnv, message

import gem_core as gem
from gem_core.cli import cli
from gem_core.registry import lookup as registry
from gem_core.registry import plugins
from gem_core.registry.specs import AgentSpec, CommandSpec, EnvSpec, ToolSpec, VectorBackendSpec, WrapperSpec
from gem_core.rollouts.agent import load_agent

KINDS = {
    "env": (lambda name: EnvSpec(id=f"toy:{name}", entry_point="a:A"), lambda name: gem.make(f"toy:{name}")),
    "tool": (lambda name: ToolSpec(name=name, entry_point="a:A"), lambda name: registry.registry().tool(name)),
    "wrapper": (lambda name: WrapperSpec(name=name, entry_point="a:A"), lambda name: registry.registry().wrapper(name)),
    "vector backend": (
        lambda name: VectorBackendSpec(name=name, entry_point="a:A"),
        lambda name: registry.registry().backend(name),
    ),
    "agent": (lambda name: AgentSpec(name=name, entry_point="a:A"), lambda name: load_agent(f"{name}:option")),
    "command": (
        lambda name: CommandSpec(name=name, entry_point="a:A"),
        lambda name: cli.get_command(click.Context(cli), name),
    ),
}


def offering(*records: object) -> list[plugins.Plugin]:
    """Return a plugin for each list of records."""
    return [
        plugins.Plugin(EntryPoint(name, f"gem_{name}._plugin", "gem.plugins"), f"gem-{name}", "1", records=each)  # type: ignore[arg-type]
        for name, each in zip("ab", records, strict=False)
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_a_conflict_costs_the_name_alone(
    kind: str, own_registry: registry.Registry, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Of every kind of record, the name is refused with both plugins, and all else of both stays."""
    record, look_up = KINDS[kind]
    both = offering([record("same"), record("own-a")], [record("same"), record("own-b")])
    monkeypatch.setattr(registry, "load_plugins", lambda: both)
    name = "toy:same" if kind == "env" else "same"
    conflict = f"{kind} {name!r} is offered by plugin 'a' (gem-a 1) and plugin 'b' (gem-b 1)"
    assert message(look_up, "same").startswith(f"RegistrationError: {conflict}; ")
    assert [plugin.conflicts for plugin in both] == [[conflict], [conflict]]
    assert [conflict in line for line in caplog.messages] == [True]
    known = own_registry.envs() if kind == "env" else own_registry.specs(type(record("x")))
    assert {"own-a", "own-b"} <= (names := {each.name for each in known})
    assert "same" not in names


def test_tools_and_wrappers_share_their_names(own_registry: registry.Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tool and a wrapper of one name are ambiguous, also if one plugin offers both."""
    one = offering([ToolSpec(name="same", entry_point="a:A"), WrapperSpec(name="same", entry_point="b:B")])
    monkeypatch.setattr(registry, "load_plugins", lambda: one)
    for look_up in own_registry.wrapper, own_registry.tool:
        assert message(look_up, "same").startswith("RegistrationError: tool or wrapper 'same' is offered by plugin 'a'")
    assert len(one[0].conflicts) == 1


def test_a_program_cannot_register_what_plugins_contest(
    own_registry: registry.Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An id that is refused to two plugins is not free for a third."""
    record = EnvSpec(id="word:Guess-v0", entry_point=WordEnv)
    monkeypatch.setattr(registry, "load_plugins", lambda: offering([record], [record]))
    assert "is offered by plugin 'a'" in message(gem.register, "word:Guess-v0", WordEnv)


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Plugins that claim what is another's."""
    target = tmp_path_factory.mktemp("sites")
    return {case: install(case, target) for case in ("fine", "taken_id", "takes_core")}


def test_both_go_on_working(sites: dict[str, Path]) -> None:
    """All but the id is listed, made and called; ``gem plugins --check`` fails for both."""
    both = [sites["fine"], sites["taken_id"]]
    conflict = "env 'fine:One-v0' is offered by plugin 'fine' (gem-fine 1.0) and plugin 'taken_id' (gem-taken-id 1.0)"
    listed = gem_in(both, "list", "--json")
    assert listed.returncode == 0
    assert '"taken:Own-v0"' in listed.stdout
    assert '"fine:One-v0"' not in listed.stdout
    assert listed.stderr.startswith(f"gem: {conflict}.")
    assert gem_in(both, "fine").stdout == "fine\n"
    for name in "fine", "taken_id":
        checked = gem_in(both, "plugins", name, "--check")
        assert (checked.returncode, checked.stdout.splitlines()[2:]) == (1, [f"    {conflict}"])


@pytest.mark.thorough
def test_names_of_the_core_stay_the_core_s(sites: dict[str, Path]) -> None:
    """Wrapper, agent, backend and command are still the core's own; the plugin is told, and its own tool is there."""
    code = (
        "import gem_core as gem\n"
        "from gem_core.rollouts.agent import load_agent\n"
        "from gem_core.registry.lookup import registry\n"
        "gem.register('t:One-v0', gem.DatasetEnv, rows=[{'question': 'What?', 'answer': 'That'}])\n"
        "vector = gem.make_vec('t:One-v0', 1, backend='sync', wrappers='latest')\n"
        "print(vector.reset(seed=1)[0], type(load_agent('random')).__name__, registry().tool('own_tool').name)\n"
    )
    done = python(code, [sites["takes_core"]])
    assert done.stdout == "['What?'] RandomAgent own_tool\n", done.stderr
    assert gem_in([sites["takes_core"]], "list").returncode == 0
    checked = gem_in([sites["takes_core"]], "plugins", "takes_core", "--check")
    assert checked.returncode == 1
    for what in "tool or wrapper 'latest'", "vector backend 'sync'", "agent 'random'", "command 'list'":
        assert f"    {what} is offered by plugin 'core'" in checked.stdout
    assert gem_in([sites["takes_core"]], "plugins", "core", "--check").returncode == 0


def test_list_without_environments_names_a_plugin_to_install(sites: dict[str, Path]) -> None:
    """Also beside a plugin that offers a tool alone."""
    installed = ",".join(sorted({point.name for point in entry_points(group="gem.plugins")}))
    listed = gem_in([sites["takes_core"]], "list", GEM_PLUGINS_DISABLE=installed)
    assert listed.returncode == 0
    assert "pip install gem-games" in listed.stdout
