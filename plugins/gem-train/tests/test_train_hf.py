"""``examples/train_hf.py``: trains a tiny model on a toy task, is interrupted, and goes on."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import gem_core as gem

torch: Any = pytest.importorskip("torch")
transformers: Any = pytest.importorskip("transformers")
pytest.importorskip("peft")

pytestmark = pytest.mark.filterwarnings("ignore:`is_gradient_checkpointing` is deprecated")  # peft 0.21 asks for it

EXAMPLE = Path(__file__).parents[3] / "examples" / "train_hf.py"
TINY = "--tiny", "--updates", "4", "--episodes", "5", "--num-envs", "3", "--eval-episodes", "2", "--every", "2"
FEW_TOKENS = "--max-tokens", "4", "--lr", "1e-2", "--micro-batch", "2"
WEIGHTS = pytest.mark.parametrize("weights", [[], ["--lora-rank", "2"]], ids=["full", "lora"])


@pytest.fixture(scope="module")
def example() -> Iterator[Any]:
    """The example as a module; on one thread, which is the fastest for a model this small."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    specification = importlib.util.spec_from_file_location("train_hf", EXAMPLE)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    yield module
    torch.set_num_threads(threads)


def train(example: Any, *arguments: object) -> list[dict[str, Any]]:
    """Run the example, and return its metrics."""
    options = example.read_options([str(argument) for argument in arguments])
    asyncio.run(example.train(options))
    return metrics_of(options.out)


def metrics_of(out: Path) -> list[dict[str, Any]]:
    lines = (out / "metrics.jsonl").read_text(encoding="utf-8").splitlines()
    return [{name: value for name, value in json.loads(line).items() if not name.endswith("_s")} for line in lines]


def trained_weights(example: Any, out: Path, update: int | None) -> dict[str, Any]:
    """Return the weights of a checkpoint, or of the beginning."""
    options = example.read_options(["--resume", str(out)])
    model, _ = example.load_model(options, None if update is None else out / f"checkpoint-{update:06d}")
    return {name: weight for name, weight in model.named_parameters() if weight.requires_grad}


@WEIGHTS
def test_it_trains_on_the_sampled_tokens_alone(
    example: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, weights: list[str]
) -> None:
    """With one line of metrics for each update, and the log-probabilities of sampling found again by the learner."""
    learnt = []
    loss = example.estimators.policy_gradient_loss

    def watched(logprobs: Any, sampled: Any, advantages: Any, mask: Any, **options: Any) -> Any:
        learnt.append(int(mask.sum()))
        return loss(logprobs, sampled, advantages, mask, **options)

    monkeypatch.setattr(example.estimators, "policy_gradient_loss", watched)
    out = tmp_path / "run"
    lines = train(example, *TINY, *FEW_TOKENS, *weights, "--temperature", 0.7, "--out", out)
    assert [line["update"] for line in lines] == [0, 1, 2, 3, 4]
    assert [line["update"] for line in lines if "eval/return" in line] == [0, 2, 4]
    assert all(math.isfinite(line["loss"]) and line["grad_norm"] > 0 for line in lines[:4])
    assert all(line["logprob_gap"] < 1e-3 for line in lines[:4])
    responses = 5 * 2
    assert sum(learnt) == pytest.approx(sum(line["response_tokens"] * responses for line in lines[:4]))
    assert {line["turns"] for line in lines[:4]} == {2.0}
    assert sorted(path.name for path in out.glob("checkpoint-*")) == ["checkpoint-000002", "checkpoint-000004"]
    before, after = trained_weights(example, out, None), trained_weights(example, out, 4)
    assert any((before[name] - after[name]).abs().max() > 1e-3 for name in before)


@WEIGHTS
def test_a_resumed_run_is_the_run_that_was_not_interrupted(
    example: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, weights: list[str]
) -> None:
    """To the last bit of metrics and weights; what came after the last checkpoint is done again."""
    whole, interrupted = tmp_path / "whole", tmp_path / "interrupted"
    expected = train(example, *TINY, *FEW_TOKENS, *weights, "--out", whole)
    learn = example.learn
    updates = iter(range(4))

    def learn_thrice(*arguments: Any) -> Any:
        if next(updates) == 3:
            raise KeyboardInterrupt
        return learn(*arguments)

    monkeypatch.setattr(example, "learn", learn_thrice)
    with pytest.raises(KeyboardInterrupt):
        train(example, *TINY, *FEW_TOKENS, *weights, "--out", interrupted)
    assert [line["update"] for line in metrics_of(interrupted)] == [0, 1, 2]
    monkeypatch.setattr(example, "learn", learn)
    assert train(example, "--resume", interrupted) == expected
    first, second = trained_weights(example, whole, 4), trained_weights(example, interrupted, 4)
    assert all(torch.equal(first[name], second[name]) for name in first)


@pytest.fixture
def trainer(example: Any, tmp_path: Path) -> Any:
    """Options, model and engine of a tiny model that was not trained."""
    options = example.read_options([*TINY, *FEW_TOKENS, "--out", str(tmp_path / "run")])
    example.begin_run(options)
    model, tokenizer = example.load_model(options, None)
    return options, model, tokenizer, example.TransformersEngine(options, model, tokenizer)


def test_gradients_add_up_over_micro_batches(example: Any, trainer: Any) -> None:
    """Rows of unlike length, one by one or all at once: the same step."""
    options, model, _, _ = trainer
    batch = example.batches(
        [episode((1, 2), (3, 4, 5), reward=1.0), episode((1,), (6,), reward=0.0), episode((7, 8, 9), (2,), reward=0.5)],
        form="trajectories",
    )
    found = []
    for options.micro_batch in (1, 3):
        optimizer = torch.optim.SGD(model.parameters(), lr=0.0)
        found.append(example.learn(model, optimizer, batch, options))
    assert found[0]["grad_norm"] > 0.01
    assert found[0] == pytest.approx(found[1], rel=1e-4)


def episode(prompt: tuple[int, ...], response: tuple[int, ...], *, reward: float) -> gem.Episode:
    """Return an episode of one turn."""
    action = gem.Response("?", prompt_token_ids=prompt, token_ids=response, logprobs=[-5.0] * len(response))
    return gem.Episode("toy:One-v0", 0, "?", {}, [gem.Transition("?", action, reward, True, False, {})])


def test_a_prompt_is_continued_the_same_alone_and_among_others(trainer: Any) -> None:
    """Prompts of unlike length, each with a limit of its own."""
    engine = trainer[-1]
    prompts, limits = [[5, 6, 7, 8], [9], [10, 11]], [4, 2, 3]
    together = engine.generate(prompts, limits, 0.0)
    alone = [engine.generate([prompt], [limit], 0.0)[0] for prompt, limit in zip(prompts, limits, strict=True)]
    assert [answer.token_ids for answer in together] == [answer.token_ids for answer in alone]
    assert [len(answer.token_ids) for answer in together] == limits
    for one, other in zip(together, alone, strict=True):
        assert one.logprobs == pytest.approx(other.logprobs, abs=1e-4)
    assert {answer.finish_reason for answer in together} == {"length"}


def test_a_response_ends_with_a_stop_token(trainer: Any) -> None:
    """Which is sampled like the others: it has a log-probability, and is learnt."""
    _, model, _, engine = trainer
    model.generation_config.eos_token_id = stops = list(range(0, 256, 4))
    answers = engine.generate([[5]] * 16, [4] * 16, 1.0)
    assert {answer.finish_reason for answer in answers} == {"stop", "length"}
    for answer in answers:
        *before, last = [token in stops for token in answer.token_ids]
        assert not any(before)
        assert last == (answer.finish_reason == "stop")
        assert len(answer.logprobs) == len(answer.token_ids)


class FailingEnv(gem.Env):
    """Fails in the middle of every other episode, or of all."""

    def __init__(self, always: bool = False) -> None:
        self.always = always

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.fails = self.always or bool(self.np_random.integers(2))
        return "Go.", {}

    def step(self, action: str) -> Any:
        if self.fails:
            raise OSError("the disk is gone")
        return gem.TERMINAL_STATE, float(len(action)), True, False, {}


gem.register("example:Failing-v0", FailingEnv)
gem.register("example:Broken-v0", FailingEnv, always=True)


def test_episodes_with_an_error_are_left_out_and_counted(example: Any, tmp_path: Path) -> None:
    """Of eight episodes, about half."""
    run = *TINY, *FEW_TOKENS, "--updates", 1, "--episodes", 8
    line, _ = train(example, *run, "--env", "example:Failing-v0", "--out", tmp_path / "some")
    assert 0 < line["errors"] < 8
    assert line["return"] > 0
    with pytest.raises(SystemExit, match=r"every episode ended in an error, the first in .*the disk is gone"):
        train(example, *run, "--env", "example:Broken-v0", "--out", tmp_path / "all")


def test_cut_off_responses_can_be_left_out(example: Any, tmp_path: Path) -> None:
    """Where all are, nothing is learnt, and nothing fails."""
    run = *TINY, *FEW_TOKENS, "--updates", 1, "--max-tokens", 1
    line, _ = train(example, *run, "--skip-cut-off", "--out", tmp_path / "run")
    assert (line["cut_off"], line["loss"], line["grad_norm"]) == (1.0, 0.0, 0.0)


def test_a_second_run_in_the_folder_of_a_first_is_refused(
    example: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It would overwrite the metrics."""
    example.begin_run(example.read_options(["--tiny", "--out", str(tmp_path)]))
    with pytest.raises(SystemExit):
        example.read_options(["--tiny", "--out", str(tmp_path)])
    assert f"{tmp_path} holds a run: continue it by --resume {tmp_path}" in capsys.readouterr().err


@pytest.mark.parametrize("wrong", [["--temperature", "0"], ["--micro-batch", "0"], ["--lr", "nan"]])
def test_numbers_that_train_nothing_are_refused(
    example: Any, wrong: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        example.read_options(["--tiny", *wrong])
    assert f"argument {wrong[0]}" in capsys.readouterr().err


def test_a_task_without_room_for_a_response_ends_the_run(example: Any, tmp_path: Path) -> None:
    """It would train on nothing."""
    with pytest.raises(SystemExit, match="--max-context"):
        train(example, *TINY, *FEW_TOKENS, "--max-context", 10, "--out", tmp_path / "run")


def test_a_wrong_environment_leaves_no_folder(example: Any, tmp_path: Path) -> None:
    """Which would hold a run that cannot go on."""
    with pytest.raises(gem.errors.UnknownEnvError):
        train(example, *TINY, "--env", "example:Nothing-v0", "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.thorough
def test_the_command_of_the_docstring_learns_the_toy_task(tmp_path: Path) -> None:
    """In its first forty updates already."""
    (command,) = [line.split()[1:] for line in EXAMPLE.read_text(encoding="utf-8").splitlines() if "--tiny --" in line]
    command = [sys.executable, str(EXAMPLE), *command[1:], "--updates", "40", "--out", str(tmp_path / "run")]
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    returns = [line["return"] for line in metrics_of(tmp_path / "run")[:40]]
    assert sum(returns[-10:]) / 10 > 2 * sum(returns[:5]) / 5
