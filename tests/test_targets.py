"""Environments that no plugin offers, named on the command line: a class in a file, a module, a file of questions."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from gem_core.records.files import read_episodes

MINE = '''
import gem_core as gem

class EchoEnv(gem.Env):
    """Say a word."""

    def __init__(self, word="yes"):
        super().__init__()
        self.word = word

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        return "Say it.", {}

    def step(self, action):
        return gem.TERMINAL_STATE, 1.0, True, False, {"correct": action == self.word}

    def sample_random_action(self):
        return self.word
'''


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with an environment, a module that registers it, and questions."""
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "table.py").write_text("import gem_core as gem\ngem.register('own:No', 'mine:EchoEnv', word='no')\n")
    rows = [{"problem": f"{n} + 1?", "result": str(n + 1)} for n in range(3)]
    (tmp_path / "sums.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return tmp_path


def gem(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command in a folder."""
    return subprocess.run(
        [sys.executable, "-m", "gem_core", *arguments], cwd=folder, capture_output=True, text=True, check=False
    )


COLUMNS = ("--set", "question_key=problem", "--set", "answer_key=result")


@pytest.mark.parametrize(
    ("words", "id", "episodes"),
    [
        (("./mine.py:EchoEnv",), "mine:EchoEnv", 10),
        (("own:No", "--import", "table"), "own:No", 10),
        (("mine:EchoEnv", "--import", "./mine.py:EchoEnv"), "mine:EchoEnv", 10),
        (("sums.jsonl", *COLUMNS), "file:sums", 3),
    ],
)
def test_run_takes_what_is_in_files(folder: Path, words: tuple[str, ...], id: str, episodes: int) -> None:
    """Worker processes make the same environments; each row of a data set is asked once."""
    done = gem(folder, "run", *words, "--backend", "process:workers=1", "--num-envs", "2", "--out", "out.jsonl")
    assert done.returncode == 0, done.stderr
    played: list[Any] = list(read_episodes(folder / "out.jsonl"))
    assert [episode.id for episode in played] == [id] * episodes
    if id != "file:sums":
        assert all(episode.success for episode in played)
    else:
        assert {episode.observation.partition("\n")[0] for episode in played} == {f"{n} + 1?" for n in range(3)}
        assert all("\\boxed{}" in episode.observation for episode in played)


@pytest.mark.parametrize("word", ["none.py:X", "none.jsonl", "mine.py:Other", "sums.jsonl"])
def test_a_file_that_is_none_is_refused(folder: Path, word: str) -> None:
    """In one line: there is no such file, name, or column."""
    done = gem(folder, "run", word)
    assert done.returncode in (1, 2)
    assert len(done.stderr.splitlines()) == 1
    assert "Traceback" not in done.stderr
