"""gem export: tables, files of episodes and logs of inspect_ai that say what the run says."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import made_runs
import pytest
import recorded
from click.testing import CliRunner
from PIL import Image

import gem_eval
from gem_core.cli import cli
from gem_core.errors import ArgumentError
from gem_core.records import write_episodes
from gem_eval.records import RunWriter, open_run

INSPECT = os.environ.get("GEM_INSPECT_PYTHON", sys.executable)
"""An interpreter that has inspect_ai."""


def export(*arguments: object) -> str:
    return CliRunner().invoke(cli, ["export", *map(str, arguments)], catch_exceptions=False).output


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_runs.make_run(tmp_path_factory.mktemp("runs") / "mine", rows=6, epochs=2, failing=0.3)


@pytest.fixture
def odd_run(tmp_path: Path) -> Path:
    """Tools, images, reasoning, an error and hostile text, as one task of one model."""
    picture = Image.new("RGB", (4, 4), (200, 40, 40))
    with RunWriter(tmp_path / "odd") as writer:
        writer.write_info({})
        for key, episode in enumerate([recorded.maze(picture), recorded.broken(), recorded.hostile()]):
            episode.key = str(key)
            writer.write(episode, {"id": "odd", "model": "m"})
    return tmp_path / "odd"


def test_pandas_has_a_row_for_each_episode(run: Path) -> None:
    """What is unknown is missing, and whole numbers stay whole."""
    pd = pytest.importorskip("pandas")
    table = gem_eval.to_pandas(run, texts=True)
    rows = open_run(run).rows
    assert list(table["row"]) == [row.row for row in rows]
    assert [None if value is pd.NA else bool(value) for value in table["success"]] == [row.success for row in rows]
    assert table["tokens_in"].dtype == "Int64"
    assert set(table["question"]) == {"Find the number."}
    assert len(gem_eval.to_pandas(run, run)) == 2 * len(rows)


@pytest.mark.parametrize("form", ["jsonl", "csv", "inspect"])
def test_a_damaged_episode_is_left_out_and_counted(run: Path, tmp_path: Path, form: str) -> None:
    """All others are exported; standard error says which one is missing and why."""
    path, out = shutil.copytree(run, tmp_path / "run"), tmp_path / "out"
    content = bytearray((path / "episodes.jsonl.zst").read_bytes())
    content[open_run(path).rows[1].offset + 20] ^= 0xFF
    (path / "episodes.jsonl.zst").write_bytes(content)
    done = CliRunner().invoke(
        cli, ["export", str(path), "--to", form, "--out", str(out), *(["--texts"] if form == "csv" else [])]
    )
    whole = len(open_run(run).rows) - 1
    assert (done.exit_code, done.stderr.count("line 2: passed over")) == (0, 1)
    if form == "inspect":
        logs = [ZipFile(log).namelist() for log in out.iterdir()]
        assert sum(name.startswith("samples/") for names in logs for name in names) == whole
    else:
        assert done.stdout.startswith(f"{whole} episodes")


def test_csv_holds_numbers_as_numbers_and_no_formulas(tmp_path: Path) -> None:
    """A text that a spreadsheet would calculate gets an apostrophe; texts come only when asked for."""
    episode = recorded.failed()
    episode.transitions[-1].action = type(episode.transitions[-1].action)('=HYPERLINK("x")')
    with RunWriter(tmp_path / "run") as writer:
        writer.write_info({})
        writer.write(episode, {"id": "-1+1", "model": "@m", "cost": 0.5})
    export(tmp_path / "run", "--to", "csv", "--out", tmp_path / "plain.csv")
    assert "HYPERLINK" not in (tmp_path / "plain.csv").read_text()
    export(tmp_path / "run", "--to", "csv", "--texts", "--out", tmp_path / "texts.csv")
    with (tmp_path / "texts.csv").open(newline="") as file:
        (record,) = csv.DictReader(file)
    assert (record["id"], record["model"], record["response"]) == ("'-1+1", "'@m", '\'=HYPERLINK("x")')
    assert float(record["episode_return"]) == episode.episode_return
    assert (record["success"], record["cost"], record["seconds"]) == ("False", "0.5", "")


def test_jsonl_is_a_file_of_gem_run(odd_run: Path, tmp_path: Path) -> None:
    """The same episodes, images and rows."""
    export(odd_run, "--to", "jsonl", "--out", tmp_path / "all.jsonl")
    before, after = open_run(odd_run), open_run(tmp_path / "all.jsonl")
    assert [e for _, e in after.episodes()] == [e for _, e in before.episodes()]
    assert [(r.id, r.model, r.row) for r in after.rows] == [(r.id, r.model, r.row) for r in before.rows]
    assert len(list((tmp_path / "all.images").iterdir())) == 1
    assert b"__same__" not in (tmp_path / "all.jsonl").read_bytes()


def read_log(path: Path) -> dict[str, Any]:
    """Return a log as inspect_ai reads and writes it."""
    program = (
        "import sys; from inspect_ai.log import read_eval_log; "
        "print(read_eval_log(sys.argv[1]).model_dump_json(exclude_none=True))"
    )
    done = subprocess.run([INSPECT, "-c", program, path], capture_output=True, text=True, check=False)
    if "No module named 'inspect_ai'" in done.stderr:
        pytest.skip(f"{INSPECT} has no inspect_ai: name an interpreter that has in GEM_INSPECT_PYTHON")
    assert done.returncode == 0, done.stderr
    log: dict[str, Any] = json.loads(done.stdout)
    return log


def test_inspect_ai_reads_a_log(run: Path, tmp_path: Path) -> None:
    """Samples with epochs, scores, errors, limits, usage and times; results with metrics."""
    export(run, "--to", "inspect", "--out", tmp_path / "logs")
    log = read_log(*(tmp_path / "logs").iterdir())
    rows = {(row.row, row.epoch + 1): row for row in open_run(run).rows}
    samples = {(sample["id"], sample["epoch"]): sample for sample in log["samples"]}
    assert set(samples) == set(rows)
    for key, row in rows.items():
        sample = samples[key]
        value = sample.get("scores", {}).get("success", {}).get("value")
        assert value == {True: "C", False: "I", None: None}[row.success]
        assert ("error" in sample) == (row.error is not None)
        assert ("limit" in sample) == (row.cut_off is not None)
        assert sample["model_usage"]["openai:small"]["output_tokens"] == row.tokens_out
        assert sample["total_time"] == row.seconds
        assert sum(message["role"] == "assistant" for message in sample["messages"]) == row.turns
    assert (log["eval"]["task"], log["eval"]["model"], log["eval"]["config"]["epochs"]) == ("mine:a", "openai:small", 2)
    assert log["results"]["scores"][0]["metrics"]["accuracy"]["value"] > 0
    assert log["eval"]["packages"]["gem-core"] == "0.1.0"


def test_inspect_ai_reads_tools_images_reasoning_and_hostile_text(odd_run: Path, tmp_path: Path) -> None:
    """Text of a model makes no log that cannot be read."""
    export(odd_run, "--to", "inspect", "--out", tmp_path / "logs")
    (log,) = (tmp_path / "logs").iterdir()
    samples = {sample["metadata"]["number"]: sample for sample in read_log(log)["samples"]}
    question, answer = samples[1]["messages"][:2]
    assert question["content"][1]["image"].startswith("data:image/png;base64,")
    assert answer["tool_calls"][0]["arguments"] == {"code": "print(6 * 7)"}
    assert answer["content"][0] == {"type": "reasoning", "reasoning": "Where is the door?", "redacted": False}
    assert samples[2]["error"]["message"] == "timeout: no answer in 5 s"
    assert "scores" not in samples[2] or not samples[2]["scores"]
    assert "alert(1)" in samples[3]["output"]["choices"][0]["message"]["content"][1]["text"]


def test_a_log_holds_one_task_and_one_model(tmp_path: Path) -> None:
    """Several go to a folder, under names that a file may have."""
    run = made_runs.make_run(tmp_path / "run", ["a:../b", "c"], ["m", "n"], rows=2)
    assert export(run, "--to", "inspect", "--out", tmp_path / "logs") == f"4 logs written to {tmp_path / 'logs'}\n"
    names = sorted(path.name for path in (tmp_path / "logs").iterdir())
    assert names[0] == "run_a-..-b_m_1.eval"
    headers = []
    for name in names:
        with ZipFile(tmp_path / "logs" / name) as archive:
            headers.append(json.loads(archive.read("header.json")))
    # Of logs that share a task_id, the viewer shows the latest only.
    assert len({header["eval"]["task_id"] for header in headers}) == 4


def test_a_task_that_never_tells_has_no_success_in_a_log(tmp_path: Path) -> None:
    """Not even where it was cut off."""
    run = made_runs.make_run(tmp_path / "run", tells=False, failing=0.0)
    export(run, "--to", "inspect", "--out", tmp_path / "logs")
    with ZipFile(*(tmp_path / "logs").iterdir()) as archive:
        samples = [json.loads(archive.read(name)) for name in archive.namelist() if name.startswith("samples/")]
    assert any("limit" in sample for sample in samples)
    assert {name for sample in samples for name in sample["scores"]} == {"return"}


def test_a_run_is_never_written_over(run: Path, tmp_path: Path) -> None:
    """Neither a folder nor a file."""
    with pytest.raises(ArgumentError, match="is the run itself"):
        export(run, "--to", "csv", "--out", run / "run.json")
    write_episodes(tmp_path / "one.jsonl", [recorded.maze()])
    with pytest.raises(ArgumentError, match="is the run itself"):
        export(tmp_path / "one.jsonl", "--to", "jsonl", "--out", tmp_path / "one.jsonl")
