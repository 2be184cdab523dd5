"""tau-bench's retail tests: their databases end as in the original, and each write that matters is missed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tau_folders import REAL

from gem_tau import TaskSet, read_folder, replay
from gem_tau.checking import check_task

pytestmark = pytest.mark.skipif(REAL is None, reason="there is no tau_retail in ../shared/data, or GEM_SHARED_DATA")

HASHES = json.loads(Path(__file__).with_name("retail_test_hashes.json").read_text(encoding="utf-8"))
"""Index of a task to the hash of its final database, computed by sierra-research/tau-bench at 59a200c."""


@pytest.fixture(scope="module")
def retail() -> TaskSet:
    """The 115 tasks."""
    return read_folder(REAL or "", split="test")


def test_final_databases_hash_as_the_originals_do(retail: TaskSet) -> None:
    """And replaying leaves the shared records as they were."""
    before = json.dumps(retail.database)
    hashes = {str(index): retail.digest(replay(retail, task.actions)) for index, task in enumerate(retail.tasks)}
    assert len(hashes) == 115
    assert hashes == HASHES
    assert json.dumps(retail.database) == before


def test_reference_actions_get_1_and_without_one_write_0(retail: TaskSet) -> None:
    """Of 178 writes, 172 change the final database; without one of the others it is the same in the original too."""
    checks = [check_task(retail, task, drop_one_write=True) for task in retail.tasks]
    dropped = [(check.task, each) for check in checks for each in check.dropped]
    assert {check.reward for check in checks} == {1.0}
    assert [each.reward for _, each in dropped if each.effect == "final"] == [0.0] * 172
    assert {f"{task} {each.position} {each.effect}" for task, each in dropped if each.effect != "final"} == {
        "test-12 4 none",
        "test-13 4 none",
        "test-22 1 redundant",
        "test-64 6 none",
        "test-106 0 none",
        "test-111 1 none",
    }


def test_our_descriptions_name_the_parameters_that_the_benchmarks_do(retail: TaskSet) -> None:
    """They stand in where a folder has no tools.json."""

    def parameters(tools: list[dict[str, object]]) -> dict[str, object]:
        functions = [json.loads(json.dumps(tool["function"])) for tool in tools]
        return {
            each["name"]: (
                {name: what["type"] for name, what in each["parameters"]["properties"].items()},
                sorted(each["parameters"].get("required", [])),
            )
            for each in functions
        }

    assert parameters(retail.domain.schemas()) == parameters(retail.tools)
