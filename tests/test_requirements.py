"""What has to be there, and the advice when it is not."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING

import pytest

from gem_core.registry import lookup
from gem_core.registry.plugins import Plugin
from gem_core.registry.requirements import RequirementStatus, find, unmet
from gem_core.registry.specs import RequirementSpec

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    ("requirement", "advice"),
    [
        ("key:GEMT_KEY", "variable GEMT_KEY"),
        ("package:gemt.none.deep", "'pip install gemt.none.deep'"),
        ("package:gemt-none[x]", "'pip install \"gemt-none[x]\"'"),
        ("package:gem-core[gemt]", "'pip install \"gem-core[gemt]\"'"),
        ("command:gemt-none", "'gemt-none'"),
        ("argument:rows", "rows=…"),
        ("never:its data were withdrawn", "its data were withdrawn"),
    ],
)
def test_unmet_requirement_has_advice(requirement: str, advice: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each kind of requirement says what to set, install or start."""
    monkeypatch.setenv("GEMT_KEY", "")
    assert advice in unmet([requirement])[requirement]


def test_met_and_untried_requirements_are_silent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is there, and what is known only in use, gives no advice."""
    monkeypatch.setenv("GEMT_KEY", "secret")
    monkeypatch.setenv("PATH", str(tmp_path))
    (tmp_path / "gemt-command").touch(0o755)
    packages = [f"package:{name}" for name in ("typing-extensions", "gem-core", "gem-core[images]")]
    assert unmet([*packages, "key:GEMT_KEY", "command:gemt-command", "network", "hub", "other:x", ""]) == {}


def probe(status: str) -> RequirementSpec:
    """Return a record of the word ``gems``, whose probe returns a status and says what it was asked."""

    def answer(argument: str, *, closely: bool = False) -> RequirementStatus:
        return RequirementStatus(status, f"{argument} {closely}", f"get {argument}")

    return RequirementSpec(name="gems", entry_point=answer)


def test_a_word_that_several_plugins_offer_is_answered_by_the_first(
    own_registry: lookup.Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Several may need the same thing, so that this is no conflict; what the core knows stays the core's."""
    network = RequirementSpec(name="network", entry_point="a:none")
    first, second = (
        Plugin(EntryPoint(name, f"gem_{name}", "gem.plugins"), f"gem-{name}", "1", records=[probe(status), network])
        for name, status in (("a", "unmet"), ("b", "met"))
    )
    monkeypatch.setattr(lookup, "load_plugins", lambda: [first, second])
    assert find("gems:7", closely=True) == RequirementStatus("unmet", "7 True", "get 7")
    assert unmet(["gems:7", "network"]) == {"gems:7": "get 7"}
    assert first.conflicts == second.conflicts == []
