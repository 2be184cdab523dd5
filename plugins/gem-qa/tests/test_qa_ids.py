"""The ids are gem-llm's, with its data sets, splits and columns; and their data sets load when they are local."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import gem_core as gem

QA = {"question_key": "problem", "answer_key": "answer", "split": "train"}
EVAL = {"question_key": "question", "answer_key": "answer"}
LOGIC = {**EVAL, "split": "train", "extract_boxed": True}
SEARCH = "axon-rl/search-eval"
EXPECTED: dict[str, dict[str, Any]] = {
    "qa:NaturalQuestions": {**QA, "dataset_name": "axon-rl/NaturalQuestions"},
    "qa:HotpotQA": {**QA, "dataset_name": "axon-rl/HotpotQA"},
    **{f"logic:RuleTaker-d{n}": {**LOGIC, "dataset_name": f"axon-rl/RuleTaker-d{n}-70k"} for n in (0, 1, 2, 3, 5)},
    "eval:2Wiki": {**EVAL, "dataset_name": SEARCH, "split": "2wiki"},
    "eval:PopQA": {**EVAL, "dataset_name": SEARCH, "split": "popqa"},
    "eval:TriviaQA": {**EVAL, "dataset_name": SEARCH, "split": "tq"},
    "eval:HotpotQA": {**EVAL, "dataset_name": SEARCH, "split": "hotpotqa"},
    "eval:Bamboogle": {**EVAL, "dataset_name": SEARCH, "split": "bamboogle"},
    "eval:NaturalQuestions": {**EVAL, "dataset_name": SEARCH, "split": "nq"},
    "eval:Musique": {**EVAL, "dataset_name": SEARCH, "split": "musique"},
    "eval:QaOpen": {**EVAL, "dataset_name": "google-research-datasets/nq_open", "split": "validation"},
}


@pytest.mark.parametrize("env_id", EXPECTED)
def test_id_has_the_data_set_of_gem_llm(env_id: str) -> None:
    """Name, split, columns and form of the answer, and the hub as its requirement."""
    record = gem.spec(env_id)
    assert dict(record.kwargs) == EXPECTED[env_id]
    assert record.requires == ("hub",)


def test_there_are_no_other_ids() -> None:
    """But the sample."""
    ours = [env_id for env_id in gem.list_envs() if gem.spec(env_id).entry_point == "gem_qa:QAEnv"]
    assert sorted(ours) == sorted([*EXPECTED, "qa:Sample"])


@pytest.mark.parametrize("env_id", EXPECTED)
def test_id_runs_on_a_local_copy(env_id: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder with the hub's layout, a card that names the file of each split among it, loads as the hub's does."""
    datasets = pytest.importorskip("datasets")
    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", tmp_path / "cache")
    expected = EXPECTED[env_id]
    question = "Anne is kind. If someone is kind then they are nice. Is it true or false: Dave is nice."
    rows = [{expected["question_key"]: question, "answer": "False"}] * 2
    (tmp_path / "copy").mkdir()
    for split in (expected["split"], "other"):
        (tmp_path / "copy" / f"{split}.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows), "utf-8")
    files = [{"split": split, "path": f"{split}.jsonl"} for split in (expected["split"], "other")]
    config = {"configs": [{"config_name": "default", "data_files": files}]}
    (tmp_path / "copy" / "README.md").write_text(f"---\n{json.dumps(config)}\n---\n", "utf-8")
    env = gem.make(env_id, dataset_name=str(tmp_path / "copy"))
    observation, _ = env.reset(options={"index": 1})
    assert observation.startswith(question)
    boxed = "extract_boxed" in expected
    assert ("\\boxed{}" in observation) is boxed
    assert env.step("\\boxed{false}" if boxed else "<answer>false</answer>")[1] == 1.0
