"""Runs of ``gem train``: their folder, resuming them, and the command."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import torch
from learner_envs import register, tiny

from gem_core.cli import main
from gem_core.errors import ArgumentError
from gem_train import train
from gem_train.learner.run import RunFolder
from gem_train.reporting import read_metrics


class Outcome(NamedTuple):
    """What one call of the command did."""

    code: int
    out: str
    err: str


@pytest.fixture
def gem_train(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Call gem train in this process, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    register()

    def call(*arguments: str) -> Outcome:
        with pytest.raises(SystemExit) as caught:
            main(["train", *arguments])
        return Outcome(int(caught.value.code or 0), *capsys.readouterr())

    return call


SMALL = (
    *("arms:One-v0", "--threads", "1", "--updates", "2", "--episodes", "8", "--width", "16", "--layers", "1"),
    *("--imitate-episodes", "16", "--imitate-steps", "10", "--eval-episodes", "8"),
)


def metrics_of(folder: Path) -> list[dict[str, Any]]:
    return [{name: value for name, value in line.items() if name != "seconds"} for line in read_metrics(folder)]


def test_a_resumed_run_is_that_which_was_never_stopped(tmp_path: Path):
    """Metrics, samples and weights to the last bit, after Ctrl-C and lines that a killed process had written."""
    options = tiny("arms:Four-v0", algorithm="ppo", updates=3, eval_every=2, eval_envs=("arms:One-v0", "arms:Four-v0"))
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    train(options, whole)

    def interrupt(update: int, metrics: dict[str, float]) -> None:
        if update == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(options, stopped, on_update=interrupt)
    with (stopped / "metrics.jsonl").open("a") as file:
        file.write('{"update": 3}\n{"upd')
    steps = []
    last = train(options, stopped, on_imitation=lambda step, loss: steps.append(step))
    assert steps == []
    assert metrics_of(stopped) == metrics_of(whole)
    assert last["eval/arms:One-v0/return"] == read_metrics(whole)[-1]["eval/arms:One-v0/return"]
    one, other = (torch.load(folder / "checkpoint.pt", weights_only=True) for folder in (whole, stopped))
    assert json.dumps(one["options"]) == json.dumps(other["options"])
    for name, value in one["policy"].items():
        assert torch.equal(value, other["policy"][name])


def test_a_folder_with_another_run_is_refused(tmp_path: Path):
    """The message names what differs, one difference as one; before the first checkpoint there is nothing to keep."""
    run = RunFolder(tmp_path)
    run.begin(tiny(gamma=0.5))
    run.begin(tiny(gamma=0.9))
    run.save({})
    with pytest.raises(ArgumentError, match=r"other options: gamma is 0.9 there, not 0.8; seed is 0 there, not 3\. Go"):
        run.begin(tiny(gamma=0.8, seed=3))
    with pytest.raises(ArgumentError, match=r"other options: seed is 0 there, not 3\. Go"):
        run.begin(tiny(gamma=0.8, width=32, updates=9, seed=3), named=["seed", "layers"])
    with pytest.raises(ArgumentError, match=r"other options: algorithm is 'rebn' there, not 'ppo'\. Go"):
        run.begin(tiny(algorithm="ppo"))
    with pytest.raises(ArgumentError, match="must be names and plain values"):
        run.begin(tiny(wrappers=(len,)))


def test_a_context_that_drops_the_rules_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    """Once, with the length of the task and what the context leaves for it."""
    train(tiny(context=64, updates=1), tmp_path / "whole")
    assert not caplog.records
    train(tiny(context=6, updates=2), tmp_path / "cut")
    (record,) = caplog.records
    assert record.args is not None
    assert record.args[1:] == (6, 3)


def test_gem_train_from_the_first_update_to_the_curves(gem_train: Any, capsys: pytest.CaptureFixture[str]):
    """Its metrics as JSON, the files of its folder, the same command again, and an agent that plays."""
    outcome = gem_train(*SMALL, "--out", "run", "--json")
    assert outcome.code == 0, outcome.err
    metrics = json.loads(outcome.out)
    assert metrics["folder"] == "run"
    assert metrics["update"] == 2
    assert {"return", "success", "turns", "loss", "entropy", "kl", "seconds", "eval/success"} <= set(metrics)
    run = Path("run")
    assert (run / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((run / "options.json").read_text())["imitate"] == "random"
    (run / "tensorboard").mkdir()
    again = gem_train("--resume", "run")
    assert again.code == 0
    assert list((run / "tensorboard").iterdir())  # it goes on as it began
    assert "let it play: gem run arms:One-v0 --agent train:run" in again.out
    assert len(read_metrics(run)) == 2
    with pytest.raises(SystemExit) as caught:
        main(["run", "arms:One-v0", "--agent", "train:run", "--episodes", "3", "--json"])
    assert caught.value.code == 0
    assert json.loads(capsys.readouterr().out)["environments"][0]["episodes"] == 3


def test_what_lets_it_play_has_the_stack_of_the_run(gem_train: Any):
    """Its wrappers and arguments, in a form that gem run takes."""
    outcome = gem_train(*SMALL, "--set", "turns=2", "--wrappers", "concat:max_turns=1", "--out", "run")
    (line,) = [line for line in outcome.out.splitlines() if line.startswith("let it play: gem ")]
    with pytest.raises(SystemExit) as caught:
        main([*shlex.split(line)[4:], "--episodes", "2"])
    assert caught.value.code == 0


def test_ctrl_c_says_how_to_go_on(gem_train: Any):
    """With a code of its own; here before the first update, so that the same run begins."""
    outcome = gem_train(*SMALL[:-6], "--imitate", "learner_envs:interrupts", "--out", "my run")
    assert outcome.code == 130
    assert outcome.err.endswith("gem: interrupted; go on with: gem train --resume 'my run'\n")


def test_episodes_with_an_error_are_told(gem_train: Any):
    """And set the exit code, as in gem run."""
    outcome = gem_train("arms:Failing-v0", *SMALL[1:], "--out", "run")
    assert outcome.code == 1
    assert "had an error, and were left out" in outcome.err


WRONG = {
    "name an environment, as in 'gem train game:GuessTheNumber-v0'; 'gem list' shows them": [],
    "run holds no run: it has no options.json": ["--resume", "run"],
    "--resume goes on with the options of the run; leave out --gamma": ["--resume", "run", "--gamma", "0.5"],
    "--resume goes on with the options of the run; leave out the ids": ["arms:One-v0", "--resume", "run"],
    "there is no agent and no module 'nobody_here'": ["arms:One-v0", "--imitate", "nobody_here:agent"],
    "environment 'arms:One-v0': got an unexpected keyword argument 'nothing'": ["arms:One-v0", "--set", "nothing=1"],
    "episodes (8), in groups of 8, must be as many of each of the 2 environments": [
        *("arms:One-v0", "arms:Four-v0", "--algorithm", "grpo", "--episodes", "8")
    ],
    "width (18) must be a multiple of heads (4)": ["arms:One-v0", "--width", "18"],
}


@pytest.mark.parametrize(("message", "arguments"), WRONG.items(), ids=range(len(WRONG)))
def test_wrong_arguments_are_told(gem_train: Any, message: str, arguments: list[str]):
    """In one line, and nothing is written."""
    outcome = gem_train(*arguments)
    assert outcome.code == 2
    assert outcome.err.startswith("gem: ")
    assert message in outcome.err
    assert outcome.err.count("\n") == 1
    assert not Path("runs").exists()
