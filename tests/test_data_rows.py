"""Rows of data sets: where they may come from, how they are shared, and what is said when they are not there."""

from __future__ import annotations

import gzip
import json
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import datasets
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gem_core as gem
from gem_core.data import load_rows
from gem_core.errors import ArgumentError, DatasetError, EntryPointError, MissingRequirementError
from gem_core.registry.lookup import Registry

ROWS: list[dict[str, Any]] = [
    {"problem": f"{number} + 1 = ?", "answer": str(number + 1), "level": number % 3} for number in range(10)
]
LINES = "".join(json.dumps(row) + "\n" for row in ROWS)


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """``datasets`` writes into a folder of the test."""
    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", tmp_path_factory.mktemp("cache"))


@pytest.fixture
def lines(tmp_path: Path) -> Path:
    """A file of JSON lines."""
    path = tmp_path / "sums.jsonl"
    path.write_text(LINES, encoding="utf-8")
    return path


def is_easy(row: Any) -> bool:
    """A filter that workers find by name."""
    return int(row["level"]) == 0


def doubled(row: Any) -> dict[str, Any]:
    """A change that workers find by name."""
    return {**row, "problem": f"Twice: {row['problem']}"}


def write_as(kind: str, folder: Path) -> Path:
    """Write ROWS in one of the forms."""
    path = folder / (f"sums[1]{kind}" if kind == ".parquet" else f"sums{kind}")
    whole = datasets.Dataset.from_list(ROWS)
    texts = {".jsonl": LINES, ".jsonl.gz": LINES, ".json": json.dumps(ROWS, indent=1)}
    if kind in texts:
        path.write_bytes(gzip.compress(texts[kind].encode()) if kind.endswith(".gz") else texts[kind].encode())
    elif kind == "-saved":
        whole.save_to_disk(path)
    elif kind == "-folder":
        path.mkdir()
        whole.to_parquet(path / "train-00000-of-00001.parquet")
    else:
        whole.to_parquet(path)
    return path


@pytest.mark.parametrize("kind", [".jsonl", ".jsonl.gz", ".json", ".parquet", "-saved", "-folder"])
def test_every_form_gives_the_same_rows(kind: str, tmp_path: Path) -> None:
    """They can be sliced, and go to other processes."""
    rows = load_rows(str(write_as(kind, tmp_path)))
    assert list(rows) == ROWS
    assert (rows[-1], list(rows[2:4])) == (ROWS[-1], ROWS[2:4])
    assert list(pickle.loads(pickle.dumps(rows))) == ROWS


@pytest.mark.parametrize(("name", "mark"), [("a.csv", ","), ("a.tsv", "\t"), ("a.csv.gz", ",")])
def test_values_of_csv_stay_as_they_are_written(tmp_path: Path, name: str, mark: str) -> None:
    """An answer 007, 1.50, NA or an empty one is a text, and no number or nothing; an index of pandas is left out."""
    text = ",question,answer\n0,a,007\n1,b,1.50\n\n2,c,NA\n3,d,\n".replace(",", mark).encode("utf-8-sig")
    path = tmp_path / name
    path.write_bytes(gzip.compress(text) if name.endswith(".gz") else text)
    assert [tuple(row.items()) for row in load_rows(path)] == [
        (("question", question), ("answer", answer))
        for question, answer in zip("abcd", ["007", "1.50", "NA", ""], strict=True)
    ]


def test_json_that_holds_lines_is_read_as_lines(tmp_path: Path) -> None:
    """Many such are called .json; blank lines, a byte order mark and a last line without its end are fine."""
    path = tmp_path / "sums.json"
    path.write_bytes(b"\xef\xbb\xbf" + LINES.replace("\n", "\r\n\r\n").encode().strip())
    assert list(load_rows(path)) == ROWS
    path.write_text('{"a": "x\u2028y"}\n', encoding="utf-8")
    assert list(load_rows(path)) == [{"a": "x\u2028y"}]


def test_rows_may_be_a_dataset_with_chosen_rows() -> None:
    """A selection or shuffle of the user's holds, and its transform."""
    whole = datasets.Dataset.from_list(ROWS)
    assert [row["answer"] for row in load_rows(whole.select([7, 3]))[:2]] == ["8", "4"]
    upper = load_rows(whole.with_transform(lambda batch: {"problem": [text.upper() for text in batch["problem"]]}))
    assert dict(upper[0]) == {"problem": "0 + 1 = ?".upper()}


def test_split_of_several_must_be_chosen(tmp_path: Path) -> None:
    """The error names the splits that are there; so it is with a folder, a saved one and a dictionary of data sets."""
    both = datasets.DatasetDict(
        {"train": datasets.Dataset.from_list(ROWS), "test": datasets.Dataset.from_list(ROWS[:2])}
    )
    both.save_to_disk(tmp_path / "saved")
    (tmp_path / "files").mkdir()
    for name, rows in both.items():
        rows.to_parquet(tmp_path / "files" / f"{name}-00000-of-00001.parquet")
    sources: list[Any] = [tmp_path / "saved", str(tmp_path / "files"), both]
    for source in sources:
        assert len(load_rows(source, split="test")) == 2
        for wrong in (None, "tets"):
            with pytest.raises(DatasetError, match="'train', 'test'"):
                load_rows(source, split=wrong)


def test_filter_and_map_by_function_and_by_name(lines: Path) -> None:
    """The filter sees the rows as they are; the map changes what is left, whenever it is asked for."""
    rows = load_rows(lines, row_filter=is_easy, map_row=f"{__name__}:doubled")
    assert [row["problem"] for row in rows] == [f"Twice: {number} + 1 = ?" for number in (0, 3, 6, 9)]
    assert list(load_rows(ROWS, row_filter=f"{__name__}:is_easy")) == ROWS[::3]
    with pytest.raises(EntryPointError, match="'is_eazy'"):
        load_rows(lines, row_filter=f"{__name__}:is_eazy")


@pytest.mark.parametrize(
    ("function", "message"),
    [
        ({"row_filter": lambda row: row["lvl"]}, r"row_filter .* row 0: KeyError: 'lvl'.*'problem'"),
        ({"row_filter": lambda row: False}, "none of the 10 rows"),
        ({"row_filter": 3}, r"row_filter .*'int'"),
        ({"map_row": lambda row: None}, r"map_row .* NoneType"),
    ],
)
def test_filter_or_map_that_fails_names_the_row(lines: Path, function: dict[str, Any], message: str) -> None:
    """With what it raised, and the row."""
    with pytest.raises(DatasetError, match=message):
        load_rows(lines, **function)[0]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.jsonl", b'{"a": 1}\n{"a": \n', "a.jsonl, line 2"),
        ("a.jsonl", b'{"a": 1}\n[1, 2]\n', "a.jsonl, row 1"),
        ("a.json", b'{"a": ' * 100_000 + b"1" + b"}" * 100_000, "a.json, line 1"),
        ("a.json", b"[1]", "a.json, row 0"),
        ("a.jsonl.gz", b"not gzip", "a.jsonl.gz'"),
        ("a.csv", b'a,b\n"1,2\n', "inside string"),
        ("a.csv", b"a,b\n1,2\n1,2,3\n", "line 3, saw 3"),
        ("a.csv", b"a,b\n\xff,2\n", "0xff"),
        ("a.parquet", b"garbage", "a.parquet'"),
        ("a.xlsx", b"", ".jsonl, .ndjson, .json, .csv, .tsv, .parquet"),
    ],
)
def test_garbled_file_is_an_error_that_says_where(name: str, content: bytes, message: str, tmp_path: Path) -> None:
    """Never a crash, and never rows that were not meant."""
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(DatasetError) as caught:
        load_rows(path)
    assert message in str(caught.value)


@given(content=st.binary(max_size=200))
def test_any_bytes_give_rows_or_an_error_of_ours(content: bytes, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Whatever a file of JSON holds."""
    path = tmp_path_factory.mktemp("any") / "a.jsonl"
    path.write_bytes(content)
    try:
        rows = load_rows(path)
    except DatasetError:
        return
    assert all(isinstance(row, dict) for row in rows)


@pytest.mark.parametrize("name", ["wrong.jsonl", "a/b/c", f"a/b/{'c' * 5000}"])
def test_unknown_path_names_what_lies_there(name: str, lines: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A name that is none of a hub either."""
    monkeypatch.chdir(lines.parent)
    with pytest.raises(DatasetError, match=r"sums\.jsonl"):
        load_rows(name)
    with pytest.raises(DatasetError, match="no file or folder ''"):
        load_rows("")


def test_hub_that_is_not_reached_is_an_error_with_advice() -> None:
    """It comes from the library's own attempt."""
    code = "import gem_core as gem; gem.DatasetEnv(dataset_name='nobody/nothing-of-this-name')"
    env = {**os.environ, "HF_HUB_OFFLINE": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=120)
    assert "DatasetError: the data set 'nobody/nothing-of-this-name'" in done.stderr
    assert "go online once" in done.stderr


def test_file_that_a_package_ships(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the package's name, so that the arguments of an environment are the same on every machine."""
    (tmp_path / "shipping" / "data").mkdir(parents=True)
    (tmp_path / "shipping" / "__init__.py").write_text("raise AssertionError('it was imported')", encoding="utf-8")
    (tmp_path / "shipping" / "data" / "sums.jsonl").write_text(LINES, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    assert list(load_rows("shipping:data/sums.jsonl")) == ROWS
    with pytest.raises(DatasetError, match=r"sums\.jsonl"):
        load_rows("shipping:data/sum.jsonl")
    with pytest.raises(DatasetError, match="'shiping'"):
        load_rows("shiping:data/sums.jsonl")


def test_without_the_library_the_error_names_the_command(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """JSON needs no more than the core."""
    path = write_as(".json", tmp_path)
    monkeypatch.setitem(sys.modules, "datasets", None)
    assert len(load_rows(path)) == 10
    (tmp_path / "sums.csv").touch()
    with pytest.raises(MissingRequirementError, match=r"pip install 'gem-core\[datasets\]'"):
        load_rows(tmp_path / "sums.csv")


def test_environments_share_their_rows(lines: Path) -> None:
    """Filtered or not; a file that was changed since is loaded anew, whatever it holds."""
    parquet = write_as(".parquet", lines.parent)
    for path in (lines, parquet):
        first, second = (gem.DatasetEnv(dataset_name=path, question_key="problem", row_filter=is_easy) for _ in "12")
        assert first.rows is second.rows
        assert gem.DatasetEnv(dataset_name=path, question_key="problem").rows is load_rows(path)
    before, was = load_rows(parquet), load_rows(lines)
    lines.write_text(LINES + json.dumps(ROWS[0]) + "\n", encoding="utf-8")
    datasets.Dataset.from_list(ROWS[:3]).to_parquet(parquet)
    assert (len(load_rows(lines)), len(load_rows(parquet))) == (11, 3)
    assert list(before) == list(was) == ROWS


def test_environments_of_many_threads_load_a_file_once(lines: Path) -> None:
    """At the same time, and filter it once."""
    seen = []

    def count(row: Any) -> bool:
        seen.append(row)
        return True

    with ThreadPoolExecutor(16) as pool:
        rows = list(pool.map(lambda _: load_rows(lines, row_filter=count), range(64)))
    assert all(each is rows[0] for each in rows)
    assert len(seen) == 10


def test_registered_file_is_made_and_planned(lines: Path, own_registry: Registry) -> None:
    """One call of ``register``; a covering plan asks each row once, in worker processes too."""
    gem.register(
        "toy:File",
        "gem_core:DatasetEnv",
        dataset_name=str(lines),
        question_key="problem",
        row_filter=f"{__name__}:is_easy",
        prompt_template="Compute {question} (level {level}) in \\boxed{answer}, {other}.",
    )
    env = gem.make("toy:File")
    assert env.reset(options={"index": 1})[0] == "Compute 3 + 1 = ? (level 0) in \\boxed{answer}, {other}."
    with gem.make_vec("toy:File", 2, backend="process", seed=0) as vector:
        episodes = list(gem.rollout(vector, lambda observation: f"\\boxed{{{int(observation.split()[1]) + 1}}}"))
    assert sorted(episode.info["task_id"] for episode in episodes) == ["0", "1", "2", "3"]
    assert [episode.transitions[-1].reward for episode in episodes] == [1.0] * 4


def test_choice_that_would_be_ignored_is_refused(lines: Path) -> None:
    """Of a split of rows that are given, and of a subset or a version of a file."""
    for option in ("config", "revision"):
        with pytest.raises(ArgumentError, match=option):
            load_rows(lines, **{option: "main"})  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="split"):
        load_rows(ROWS, split="test")
    for path in lines, write_as("-saved", lines.parent):
        assert list(load_rows(path, split="train")) == ROWS
        with pytest.raises(DatasetError, match="'train'"):
            load_rows(path, split="test")
    assert list(load_rows(lines, split="train[-2:]")) == ROWS[-2:]
    for rows, name in ((None, None), (ROWS, "x")):
        with pytest.raises(ArgumentError, match="rows or dataset_name"):
            gem.DatasetEnv(rows, dataset_name=name)
