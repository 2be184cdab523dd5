"""The ids are gem-llm's, with its data sets, splits and columns; and their data sets load when they are local."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import gem_core as gem
from gem_code import _plugin

COLUMNS = {"question_key": "problem", "test_key": "tests"}
EXPECTED: dict[str, dict[str, Any]] = {
    "code:CodeContest": {**COLUMNS, "dataset_name": "axon-rl/CodeContest", "split": "train"},
    "code:Taco8k": {**COLUMNS, "dataset_name": "axon-rl/TACO-8k", "split": "train"},
    "code:PrimeIntellect15k": {**COLUMNS, "dataset_name": "axon-rl/PrimeIntellect-15k", "split": "train"},
    "eval:CodeContest": {**COLUMNS, "dataset_name": "axon-rl/CodeContest", "split": "test"},
}


@pytest.mark.parametrize("env_id", EXPECTED)
def test_id_has_the_data_set_of_gem_llm(env_id: str) -> None:
    """Name, split and columns, and the hub as its requirement."""
    record = gem.spec(env_id)
    assert dict(record.kwargs) == EXPECTED[env_id]
    assert record.requires == ("hub",)


def test_there_are_no_other_ids() -> None:
    """But the sample, and HumanEval."""
    ours = [record.id for record in _plugin.gem_register_envs()]
    assert set(ours) <= set(gem.list_envs())
    assert sorted(ours) == sorted([*EXPECTED, "code:Sample", "eval:HumanEval"])


@pytest.mark.parametrize("env_id", EXPECTED)
def test_id_runs_on_a_local_copy(env_id: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder with the hub's layout, a card that names the file of each split among it, loads as the hub's does."""
    datasets = pytest.importorskip("datasets")
    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", tmp_path / "cache")
    tests = json.dumps({"inputs": ["3\n", "4\n"], "outputs": ["9\n", "16\n"]})
    row = json.dumps({"problem": "Print the square.", "tests": tests}) + "\n"
    (tmp_path / "copy").mkdir()
    files = [{"split": split, "path": f"{split}.jsonl"} for split in (EXPECTED[env_id]["split"], "other")]
    for file in files:
        (tmp_path / "copy" / file["path"]).write_text(row, "utf-8")
    config = {"configs": [{"config_name": "default", "data_files": files}]}
    (tmp_path / "copy" / "README.md").write_text(f"---\n{json.dumps(config)}\n---\n", "utf-8")
    env = gem.make(env_id, dataset_name=str(tmp_path / "copy"))
    assert env.reset(seed=0)[0] == "Print the square."
    assert env.step("```python\nprint(int(input()) ** 2)\n```")[1] == 1.0


def test_humaneval_from_the_local_file(shared_data: Path) -> None:
    """In its original form and columns, under the id of the hub's copy."""
    path = str(shared_data / "code" / "HumanEval.jsonl.gz")
    env = gem.make("eval:HumanEval", dataset_name=path, split=None)
    assert env.unwrapped.num_tasks == 164
    observation, info = env.reset(seed=0, options={"index": 2})
    assert info["task_id"] == "HumanEval/2"
    assert "def truncate_number(number: float) -> float:" in observation
    _, reward, _, _, info = env.step("```python\ndef truncate_number(number):\n    return number % 1.0\n```")
    assert (reward, info["total"]) == (1.0, 3)
