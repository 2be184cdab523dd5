"""Finding tasks: a folder, a folder of folders, a list; broken ones are kept as data."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from task_writing import HARBOR, TERMINAL_BENCH, read_task, write

from gem_terminal.errors import TaskError
from gem_terminal.tasks.folders import find_tasks


def names(*paths: Path) -> list[str]:
    """Return the names of the tasks that are found."""
    return [task.name for task in find_tasks(paths).tasks]


def test_tasks_of_both_formats_are_found_in_the_order_of_names(tmp_path: Path) -> None:
    """In the folder, or one further down as ``tasks/NAME``; hidden ones, and what is inside a task, are no tasks."""
    for name in ("b", "b/inside", ".hidden", "tasks/c", "x/y/deeper"):
        write(tmp_path / name, HARBOR)
    write(tmp_path / "a", TERMINAL_BENCH)
    write(tmp_path, {"README.md": "Tasks."})
    found = find_tasks([tmp_path]).tasks
    assert [(task.name, task.format) for task in found] == [("a", "terminal-bench"), ("b", "harbor"), ("c", "harbor")]
    assert names(tmp_path / "b") == ["b"]


def test_equal_names_become_paths(tmp_path: Path) -> None:
    """Below the folder of the set, or further up where that is not enough; a folder given twice counts once."""
    for name in ("x/a/one", "x/b/one", "x/b/two", "y/a/one"):
        write(tmp_path / name, HARBOR)
    assert names(tmp_path / "x") == ["a/one", "b/one", "two"]
    assert names(tmp_path / "x", tmp_path / "y", tmp_path / "x/b/two") == ["x/a/one", "b/one", "two", "y/a/one"]


def test_a_broken_task_among_others_is_kept_with_its_error(tmp_path: Path) -> None:
    """The rest can be used; without a rest, the error is raised."""
    write(tmp_path / "bad", HARBOR, {"instruction.md": None})
    write(tmp_path / "worse", HARBOR, {"task.toml": "="})
    with pytest.raises(TaskError, match=r"instruction\.md.* None of the 2 tasks can be read"):
        find_tasks([tmp_path])
    write(tmp_path / "good", HARBOR)
    assert names(tmp_path) == ["good"]
    bad, _ = find_tasks([tmp_path]).broken
    assert (bad.name, bad.folder) == ("bad", tmp_path / "bad")
    assert f"{tmp_path}/bad/instruction.md" in str(bad.error)


@pytest.mark.parametrize("name", ["none", "file", "empty", "a\0b", None])
def test_a_path_without_tasks_says_what_was_expected(tmp_path: Path, name: str | None) -> None:
    """Missing, a file, a folder of other things, what can be no path, or none at all."""
    write(tmp_path, {"file": "", "empty/x/y": ""})
    with pytest.raises(TaskError, match="task"):
        find_tasks([] if name is None else [tmp_path / name])


def test_a_task_in_both_formats_is_read_as_harbors(tmp_path: Path) -> None:
    """With a note."""
    task = read_task(write(tmp_path / "t", TERMINAL_BENCH, HARBOR))
    assert task.format == "harbor"
    assert ["task.yaml" in note for note in task.notes] == [True]


CHANGES: dict[str, Callable[[Path], object]] = {
    "content": lambda folder: (folder / "tests/test.sh").write_text("#!/bin/bash\necho 2 >/logs/verifier/reward.txt\n"),
    "name": lambda folder: (folder / "tests/more.sh").rename(folder / "tests/less.sh"),
    "mode": lambda folder: os.chmod(folder / "environment/Dockerfile", 0o777),
    "new_file": lambda folder: (folder / "environment/new").write_text(""),
    "new_folder": lambda folder: (folder / "environment/new").mkdir(),
    "link": lambda folder: (folder / "environment/link").symlink_to("Dockerfile"),
    "moved": lambda folder: [(folder / "tests" / name).write_text(text) for name, text in (("a", "b"), ("ab", "c"))],
}


@pytest.mark.parametrize("change", CHANGES)
def test_the_digest_is_of_all_that_is_there(tmp_path: Path, change: str) -> None:
    """Equal for a copy elsewhere, under any name; another after any change, also of where a name or content ends."""
    folder = write(tmp_path / "t", HARBOR, {"tests/more.sh": "x", "tests/a": "bc", "tests/ab": ""})
    before = read_task(folder).digest
    assert read_task(shutil.copytree(folder, tmp_path / "copy", symlinks=True)).digest == before
    CHANGES[change](folder)
    assert read_task(folder).digest != before
