"""``gem doctor``: what it finds, says and exits with."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from distributions import gem_in, install, python

import gem_core as gem
from gem_core.cli import diagnosis
from gem_core.registry.lookup import Registry
from gem_core.registry.requirements import RequirementStatus
from gem_core.registry.specs import RequirementSpec

if TYPE_CHECKING:
    import subprocess


def doctor(*arguments: str, paths: list[Path], **variables: str) -> subprocess.CompletedProcess[str]:
    """Run the command in an interpreter that sees some distributions."""
    done = gem_in(paths, "doctor", *arguments, **variables)
    # On a machine with nothing stronger than the level `process`, one line says so, whoever asks.
    done.stderr = "".join(line for line in done.stderr.splitlines(True) if "weakest level" not in line)
    return done


def found(paths: list[Path], **variables: str) -> dict[str, Any]:
    """Return what ``gem doctor --quick --json`` finds."""
    return json.loads(doctor("--quick", "--json", paths=paths, **variables).stdout)


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A fine plugin, one that fails, one that claims an id of the first, and one that points to nothing."""
    target = tmp_path_factory.mktemp("sites")
    return {case: install(case, target) for case in ("fine", "hook_raises", "taken_id", "heavy_neighbour")}


@pytest.mark.thorough
def test_nothing_broken_exits_with_0(sites: dict[str, Path]) -> None:
    """A fine installation, with whatever requirements unmet."""
    done = doctor(paths=[sites["fine"]])
    assert (done.returncode, done.stderr) == (0, "")
    assert "nothing that is installed is broken" in done.stdout
    assert "ok      fine (gem-fine 1.0), " in done.stdout
    assert "1 environment, 1 tool, " in " ".join(done.stdout.split())


def test_broken_plugin_exits_with_1_and_shows_its_traceback(sites: dict[str, Path]) -> None:
    """Once; GEM_PLUGINS_STRICT does not stop the report."""
    done = doctor("--quick", paths=[sites["fine"], sites["hook_raises"]], GEM_PLUGINS_STRICT="1")
    assert done.returncode == 1
    assert done.stdout.count("Traceback (most recent call last)") == 1
    assert "broken  hook_raises (gem-hook-raises 1.0)" in done.stdout
    assert "ok      fine (gem-fine 1.0), " in done.stdout


def test_diagnosis_loads_nothing_heavy(sites: dict[str, Path]) -> None:
    """Versions are read, not imported."""
    heavy = "[m for m in ('gymnasium', 'numpy', 'pydantic', 'gem_fine_env') if m in sys.modules]"
    done = python(
        f"import sys\nfrom gem_core.cli.diagnosis import diagnose\ndiagnose(quick=True)\nprint({heavy})",
        [sites["fine"]],
    )
    assert done.stdout == "[]\n"


@pytest.fixture
def needy(own_registry: Registry) -> Registry:
    """Environments that require things, met and unmet."""
    for number in range(3):
        gem.register(f"need:Key{number}", "toys:CountdownEnv", requires=("key:GEMT_SECRET", "network"))
    gem.register("need:Word", "toys:CountdownEnv", requires=("quantum:4",))
    gem.register("need:Docker", "toys:CountdownEnv", requires=("docker",))
    return own_registry


def row(report: list[dict[str, Any]], requirement: str) -> dict[str, Any]:
    """Return what is said of one requirement."""
    return next(entry for entry in report if entry["requirement"] == requirement)


def test_requirements_are_grouped_with_number_and_example(needy: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    """One row for a requirement, however many environments have it; the unmet ones first."""
    monkeypatch.delenv("GEMT_SECRET", raising=False)
    rows = diagnosis.requirements(needy)
    assert rows[0]["status"] == "unmet"
    assert row(rows, "key:GEMT_SECRET") == {
        "requirement": "key:GEMT_SECRET",
        "status": "unmet",
        "detail": "is not set",
        "advice": "it needs a key: set the environment variable GEMT_SECRET",
        "environments": 3,
        "example": "need:Key0",
    }


def probe_of_gems(argument: str, *, closely: bool = False) -> RequirementStatus:
    """Want seven of them, and fail where none is asked for."""
    return RequirementStatus("met" if int(argument) > 6 else "unmet", f"looked at {'closely' * closely}")


def test_words_of_plugins_are_probed_closely(needy: Registry, offer: Callable[..., None]) -> None:
    """With what stands behind the colon, or with nothing; a probe that fails does not end the report."""
    offer(RequirementSpec(name="gems", entry_point=probe_of_gems))
    gem.register("need:Gems", "toys:CountdownEnv", requires=("gems:7", "gems:many"))
    assert row(diagnosis.requirements(needy), "gems:7")["detail"] == "looked at closely"
    assert row(diagnosis.requirements(needy), "gems:many")["detail"].startswith("its probe failed: ValueError: ")


def test_tools_say_what_is_in_force(toolbox_site: Path) -> None:
    """A line or facts, each in a row, and in the JSON as they are; a tool that says nothing is listed."""
    report = found([toolbox_site])
    assert [tool for tool in report["tools"] if tool["tool"] in ("box", "mute", "vault")] == [
        {"tool": "box", "summary": "Two tools.", "status": {"level": "high", "drawers": 2}, "error": None},
        {"tool": "mute", "summary": "Says nothing of itself.", "status": None, "error": None},
        {"tool": "vault", "summary": "Opens.", "status": "two locks in force", "error": None},
    ]
    shown = doctor("--quick", paths=[toolbox_site]).stdout
    assert "    ok      box: level: high, drawers: 2\n" in shown
    assert "            mute: Says nothing of itself.\n" in shown
    assert "    ok      vault: two locks in force\n" in shown


@pytest.mark.parametrize(
    ("status", "error"),
    [
        (lambda: sys.exit(3), "SystemExit: 3"),
        (lambda: 3, "TypeError: it returned int"),
        ("gem_core_missing:status", "EntryPointError: the status of tool 'odd': there is no module 'gem_core_missing'"),
    ],
)
def test_status_that_fails_is_told_and_spoils_nothing(
    status: Any, error: str, own_registry: Registry, offer: Callable[..., None]
) -> None:
    """Each is asked in its own guard; what fails is broken."""
    own_registry.load()
    odd = gem.ToolSpec(name="odd", entry_point="toys:Calculator", status=status)
    fine = gem.ToolSpec(name="well", entry_point="toys:Calculator", status=lambda: {1: Path("x")})
    offer(odd, fine)
    report = diagnosis.diagnose(quick=True)
    failed, well = report["tools"]
    assert failed["error"].startswith(error)
    assert (failed["status"], well["status"], well["error"]) == (None, {"1": "x"}, None)
    assert report["broken"] == [f"the status of tool 'odd' failed: {failed['error']}"]
