"""Folders in place of ids on the command line, by the files that an environment's record names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import gem_core as gem
from gem_core.records.files import read_episodes
from gem_core.registry.lookup import Registry


class RiddleEnv(gem.Env):
    """Asks what stands in a folder."""

    def __init__(self, folder: str, tries: int = 1) -> None:
        super().__init__()
        self.questions = sorted(Path(folder).rglob("riddle.txt"))

    def reset(self, seed: int | None = None) -> Any:
        """Ask."""
        super().reset(seed=seed)
        return self.questions[0].read_text(), {}

    def step(self, action: str) -> Any:
        """Accept any answer."""
        return gem.TERMINAL_STATE, 1.0, True, False, {"correct": True}

    def sample_random_action(self) -> str:
        """Return a word."""
        return "word"


def record(name: str = "riddle:Folder", **fields: Any) -> gem.EnvSpec:
    """Return the record of the environment."""
    told = {"folder_markers": ("riddle.txt",), "folder_keyword": "folder", "kwargs": {"tries": 2}} | fields
    return gem.EnvSpec(id=name, entry_point=RiddleEnv, **told)


@pytest.fixture
def riddles(own_registry: Registry, tmp_path: Path) -> Path:
    """Register the environment, and write a folder of two of its folders."""
    own_registry.add(record())
    for name in ("one", "two"):
        (tmp_path / "riddles" / name).mkdir(parents=True)
        (tmp_path / "riddles" / name / "riddle.txt").write_text(f"What is {name}?")
    return tmp_path / "riddles"


@pytest.mark.parametrize("folder", ["riddles", "./riddles/two/"])
def test_run_takes_a_folder_or_one_that_holds_such_folders(riddles: Path, run_gem, folder: str) -> None:
    """The episodes say from what they were made, so that they can be made again."""
    done = run_gem("run", folder, "--episodes", "2", "--seed", "1", "--out", "out.jsonl")
    assert done.code == 0, done.err
    assert "riddle:Folder" in done.out
    episode = next(read_episodes(Path("out.jsonl")))
    assert (episode.id, episode.kwargs["folder"]) == ("riddle:Folder", folder)
    assert episode.observation == ("What is two?" if "two" in folder else "What is one?")


def test_set_gives_arguments_of_environments(riddles: Path, run_gem) -> None:
    """As JSON or text, over those of the record and the folder; one that there is not is named."""
    words = ("--set", "tries=3", "--set", "folder=riddles/two", "--episodes", "1", "--out", "out.jsonl")
    assert run_gem("run", "riddles", *words).code == 0
    assert next(read_episodes(Path("out.jsonl"))).kwargs == {"tries": 3, "folder": "riddles/two"}
    assert run_gem("run", "riddles", "--set", "tries").err == "gem: --set takes NAME=VALUE, not 'tries'\n"
    wrong = run_gem("play", "riddles", "--set", "tires=3")
    assert (wrong.code, "Did you mean 'tries'?" in wrong.err) == (2, True)


def test_info_takes_a_folder(riddles: Path, run_gem) -> None:
    """As it takes an id."""
    shown = run_gem("info", "riddles/two")
    assert (shown.code, "What is two?" in shown.out, "folder='riddles/two'" in shown.out) == (0, True, True)


def test_folder_of_no_environment_or_of_several_is_an_error_that_says_what_there_is(
    riddles: Path, run_gem, own_registry: Registry
) -> None:
    """In one line."""
    (riddles.parent / "empty").mkdir()
    none = run_gem("run", "empty")
    wanted = "gem: the folder 'empty' belongs to no environment: riddle:Folder looks for riddle.txt\n"
    assert (none.code, none.err) == (2, wanted)
    assert run_gem("run", "no/where").err == "gem: there is no folder 'no/where'\n"
    own_registry.add(record("riddle:Other"))
    both = "gem: the folder 'riddles' belongs to riddle:Folder and riddle:Other; give the id of one of them\n"
    assert run_gem("play", "riddles").err == both
