# /// script
# requires-python = ">=3.11"
# dependencies = ["trl>=1.16,<1.17", "torch", "transformers>=5.2", "gem-core", "gem-games", "gem-train"]
# [tool.gem.table]
# framework = 'TRL, `rollout_func`'
# rewards = 'summed'
# images = 'no'
# groups = 'yes'
# tools = 'in text'
# failures = 'reward None, no token learnt'
# ///
r"""TRL, ``rollout_func``: GRPO on whole episodes of GEM, token in, token out.

Shows TRL 1.16 training with ``gem.arollout``: the episodes of a batch run side by side, what the model samples is never
tokenized again, what the environment writes is masked. Real optimiser steps of a tiny random Qwen3 over bytes.

Install and run it here, in an environment of its own::

    python scripts/trainers.py trl_rollout
    python examples/trainers/trl_rollout.py

On a GPU, with a model of the hub, sampled by vLLM in the same process where that is installed::

    python examples/trainers/trl_rollout.py --model Qwen/Qwen3-0.6B --env game:GuessTheNumber-v0 --steps 200

Checkpoints are in ``--out``, the last two of them; the same command goes on from the last.

What TRL cannot take: one scalar stands for an episode, the sum of the rewards of its turns. Several agents: play one
seat (``gem.single_agent``). Images. An episode that ended in an error has the reward None, which TRL leaves out of the
group's baseline, and no token of it is learnt. A tool that fails is told to the model. A response that was cut off is
scored by the task. A context that overflows ends the episode with what was earned so far. One sequence stands for an
episode: where a chat template rewrites earlier turns, as by dropping their thinking, only those after that are learnt;
TRL has templates that keep them, used here. Each process samples by itself: vLLM ``colocate``, weights not sharded.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.util import find_spec
from typing import Any

os.environ.setdefault("TRL_EXPERIMENTAL_SILENCE", "1")

import torch
from datasets import Dataset
from transformers import AutoModelForCausalLM, AutoTokenizer, Qwen3Config, Qwen3ForCausalLM
from transformers.trainer_utils import get_last_checkpoint
from trl import GRPOConfig, GRPOTrainer
from trl.chat_template_utils import get_training_chat_template
from trl.models import unwrap_model_for_generation

import gem_core as gem
from gem_core.errors import AgentError
from gem_train import TokenAgent, batches
from gem_train.adapters import ChatSession, Generated, trial_tokenizer
from gem_train.adapters.trial import check
from gem_train.tokens import Completion, completions

MAX_TOKENS = 16
"""Longest response of the trial; ``--max-tokens`` for others."""


class BatchedEngine:
    """Turns requests that come at about the same time into one call, as a ``generate`` for ``TokenAgent``.

    One batch is answered at a time, in a thread; requests that come meanwhile are the next one.

    Args:
        ask: Answers a batch: prompts, and the sampling of each. What it raises is raised at each of its requests.
        most: Requests in a batch at most; a full batch waits no longer.
        quiet_s: A batch that is not full is sent once no request has come for this many seconds.
    """

    def __init__(self, ask: Callable[..., Sequence[Generated]], *, most: int, quiet_s: float = 0.02) -> None:
        self.ask, self.most, self.quiet_s = ask, most, quiet_s
        self._waiting: list[tuple[list[int], dict[str, Any], asyncio.Future[Generated]]] = []
        self._sender: asyncio.Task[None] | None = None

    async def __call__(self, prompt_ids: list[int], **sampling: Any) -> Generated:
        """Return the response to a prompt once its batch is answered."""
        reply: asyncio.Future[Generated] = asyncio.get_running_loop().create_future()
        self._waiting.append((prompt_ids, sampling, reply))
        if self._sender is None or self._sender.done():
            self._sender = asyncio.create_task(self._send())
        return await reply

    async def _send(self) -> None:
        while self._waiting:
            count = 0
            while count < len(self._waiting) < self.most:
                count = len(self._waiting)
                await asyncio.sleep(self.quiet_s)
            batch, self._waiting = self._waiting[: self.most], self._waiting[self.most :]
            prompts, samplings, replies = zip(*batch, strict=True)
            answers: list[Generated | Exception]
            try:
                answers = list(await asyncio.to_thread(self.ask, list(prompts), list(samplings)))
                if len(answers) != len(batch):
                    raise AgentError(f"the engine gave {len(answers)} answers to {len(batch)} prompts")
            except Exception as error:  # noqa: BLE001 - an engine may raise anything
                answers = [error] * len(batch)
            for reply, answer in zip(replies, answers, strict=True):
                if reply.done():  # its episode was given up meanwhile
                    continue
                if isinstance(answer, Exception):
                    reply.set_exception(answer)
                else:
                    reply.set_result(answer)


def engine_of(trainer: GRPOTrainer, most: int) -> BatchedEngine:
    """Return what samples for all episodes that wait, in one call of the trainer's own engine."""

    def ask(prompts: list[list[int]], limits: list[dict[str, int]]) -> list[Generated]:
        allowed = [limit["max_tokens"] for limit in limits]
        answers = []
        for (ids, logprobs), limit in zip(sample(trainer, prompts, max(allowed)), allowed, strict=True):
            ended = len(ids) <= limit and ids[-1] in trainer.eos_token_ids
            answers.append(Generated(ids[:limit], logprobs[:limit], "stop" if ended else "length"))
        return answers

    return BatchedEngine(ask, most=most)


def sample(trainer: GRPOTrainer, prompts: list[list[int]], max_tokens: int) -> list[tuple[list[int], list[float]]]:
    """Return a continuation of each prompt, and the log-probability of each of its tokens."""
    if trainer.use_vllm:
        trainer.vllm_generation.max_completion_length = max_tokens
        _, ids, logprobs, _ = trainer.vllm_generation.generate(prompts=prompts, images=None, num_generations=1)
        return [(each, [float(best[0]) for best in own]) for each, own in zip(ids, logprobs, strict=True)]
    tokenizer, ends = trainer.processing_class, list(trainer.eos_token_ids)
    padded = tokenizer.pad({"input_ids": prompts}, padding_side="left", return_tensors="pt")
    inputs = padded.to(trainer.accelerator.device)
    width = inputs["input_ids"].shape[1]
    # fmt: off
    with torch.no_grad(), unwrap_model_for_generation(trainer.model_wrapped, trainer.accelerator) as model:
        made = model.generate(
            **inputs, max_new_tokens=max_tokens, do_sample=True, temperature=trainer.temperature, top_k=0, top_p=1.0,
            pad_token_id=tokenizer.pad_token_id, eos_token_id=ends, output_logits=True, return_dict_in_generate=True,
        )
    # fmt: on
    new = made.sequences[:, width:]
    logprobs = torch.log_softmax(torch.stack(made.logits, dim=1).float() / trainer.temperature, dim=-1)
    chosen = logprobs.gather(-1, new.unsqueeze(-1)).squeeze(-1)
    ended = torch.isin(new, torch.tensor(ends, device=new.device)).int()
    lengths = torch.where(ended.any(dim=1), ended.argmax(dim=1) + 1, new.shape[1]).tolist()
    return [(new[row, :size].tolist(), chosen[row, :size].tolist()) for row, size in enumerate(lengths)]


def rollout_with(max_tokens: int) -> Any:
    """Return what ``GRPOTrainer`` takes as ``rollout_func``."""

    def rollout(prompts: list[str], trainer: GRPOTrainer) -> dict[str, list[Any]]:
        """Play an episode for each prompt, which names its environment and seed."""
        starts = [json.loads(prompt) for prompt in prompts]
        plan = [
            gem.PlanItem(start["env"], start["seed"], group=prompt)
            for start, prompt in zip(starts, prompts, strict=True)
        ]
        context = trainer.accelerator.unwrap_model(trainer.model).config.max_position_embeddings
        tokenizer = trainer.processing_class
        agent = TokenAgent(engine_of(trainer, len(plan)), tokenizer, max_tokens=max_tokens, max_context=context)

        async def play() -> list[gem.Episode]:
            names = sorted({start["env"] for start in starts})
            return [each async for each in gem.arollout(names, agent, plan=plan, num_envs=len(plan))]

        episodes = sorted(asyncio.run(play()), key=lambda episode: int(episode.key))  # in the order of the prompts
        return trl_fields(episodes, tokenizer.eos_token_id)

    return rollout


def trl_fields(episodes: Sequence[gem.Episode], filler: int) -> dict[str, list[Any]]:
    """Return episodes as TRL takes completions, with the return of each for the reward function.

    An episode without a response, as where the environment could not start, is a token that is not learnt. Of one whose
    chat template rewrote earlier turns, those after that are learnt, with what is before them as their prompt.
    """
    batch = batches(episodes, form="trajectories", pad_id=filler)
    rows = {row.episode: row for row in completions(batch)}  # of several sequences the last: TRL takes one
    every = [rows.get(place, Completion([filler], [filler], [0], [0.0], place)) for place in range(len(episodes))]
    return {
        "prompt_ids": [row.prompt_ids for row in every],
        "completion_ids": [row.completion_ids for row in every],
        "env_mask": [row.completion_mask for row in every],
        "logprobs": [row.logprobs for row in every],
        "episode_return": [None if episode.error else episode.episode_return for episode in episodes],
    }


def reward_of_episode(episode_return: list[float | None], **kwargs: Any) -> list[float | None]:
    """Return each episode's return; None, which TRL leaves out, for those that ended in an error."""
    return episode_return


# A trial of it.


class Flaky(gem.Env):
    """Fails in every other episode, as where a server is gone now and then; pays 1 for a response with a 7."""

    episodes = 0

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        """Count the episode."""
        super().reset(seed=seed)
        Flaky.episodes += 1
        self.broken = Flaky.episodes % 2 == 0
        return "Turns left: 1. Put your guess inside \\boxed{}.", {}

    def step(self, action: str) -> Any:
        """Fail or pay."""
        if self.broken:
            raise ConnectionError("the server is gone")
        return "Thanks.", float("7" in action), True, False, {"correct": "7" in action}


def imitate(model: Any, tokenizer: Any, steps: int = 120) -> None:
    """Teach a random model to answer with some number in a box, so that it has something to learn from."""
    session, optimizer = ChatSession("game:GuessTheNumber-v0-easy"), torch.optim.Adam(model.parameters(), lr=3e-3)
    for step in range(steps):
        prompt = tokenizer.apply_chat_template(session.reset_sync(step), tokenize=False, add_generation_prompt=True)
        asked, answer = tokenizer.encode(prompt), tokenizer.encode(f"\\boxed{{{step % 9 + 1}}}<|im_end|>")
        labels = torch.tensor([[-100] * len(asked) + answer])
        model(input_ids=torch.tensor([asked + answer]), labels=labels).loss.backward()
        optimizer.step()
        optimizer.zero_grad()


def difference(model: Any, fields: dict[str, list[Any]]) -> float:
    """Return how far the reported log-probabilities are from those of the model, at most."""
    most = 0.0
    for prompt, ids, mask, logprobs in zip(*list(fields.values())[:4], strict=True):
        with torch.no_grad():
            logits = model(input_ids=torch.tensor([prompt + ids])).logits[0, len(prompt) - 1 : -1].float()
        own = torch.log_softmax(logits, dim=-1).gather(-1, torch.tensor(ids).unsqueeze(-1)).squeeze(-1)
        most = max([most, *(abs(float(a) - b) for a, b, used in zip(own, logprobs, mask, strict=True) if used)])
    return most


def check_trial(seen: list[Any], before: list[Any], trainer: GRPOTrainer) -> None:
    """Check a trial."""
    prompts, fields, worst = seen[0]
    print(trainer.processing_class.decode(fields["prompt_ids"][0] + fields["completion_ids"][0]))
    for prompt, mask, reward in zip(prompts, fields["env_mask"], fields["episode_return"], strict=True):
        print(f"{prompt}: {sum(mask)} of {len(mask)} tokens are the model's, return {reward}")
    check(worst < 1e-3, f"log-probabilities are those of the model (largest difference {worst:.1e})")
    starts = {(prompt, tuple(ids)) for prompt, ids in zip(prompts, fields["prompt_ids"], strict=True)}
    check(len(starts) == len(set(prompts)), "a group shares a start")
    masks = zip(fields["episode_return"], fields["env_mask"], strict=True)
    failed = [sum(mask) for value, mask in masks if value is None]
    check(failed == [0, 0], "an episode with an error has no reward, and none of its tokens is learnt")
    weights = zip(before, trainer.model.parameters(), strict=True)
    moved = sum(bool(new.isfinite().all()) and not torch.equal(old, new.detach()) for old, new in weights)
    check(moved == len(before), f"{len(seen)} optimiser steps moved all {moved} weight tensors")


def read_options(arguments: list[str] | None = None) -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--model", help="a model of the hub; by default a tiny random one, for a trial")
    parser.add_argument("--env", default="game:GuessTheNumber-v0-easy")
    parser.add_argument("--steps", type=int, default=3)
    parser.add_argument("--max-tokens", type=int, default=512, help="longest response, with --model")
    parser.add_argument("--out", default="runs/trl-rollout", help="folder of checkpoints and of the model")
    parser.add_argument("--save-steps", type=int, default=50, help="steps from one checkpoint to the next")
    return parser.parse_args(arguments)


def configuration(options: argparse.Namespace, folder: str) -> GRPOConfig:
    """Return what TRL reads of the options."""
    trial = options.model is None
    # fmt: off
    return GRPOConfig(
        folder, max_steps=options.steps, per_device_train_batch_size=8, num_generations=4, shuffle_dataset=False,
        learning_rate=1e-3 if trial else 1e-6, beta=0.0, logging_steps=1, report_to="none",
        save_steps=options.save_steps, save_total_limit=2,
        use_cpu=not torch.cuda.is_available(), use_vllm=not trial and find_spec("vllm") is not None,
        vllm_mode="colocate",
    )
    # fmt: on


def check_command(folder: str) -> None:
    """Let this file's parser and TRL's own checks of a configuration read the printed command."""
    printed = next(line for line in str(__doc__).splitlines() if "--model" in line).split()[2:]
    options = read_options(printed)
    config = configuration(options, folder)
    check(config.max_steps == options.steps == 200 and config.save_strategy == "steps", "TRL takes the command")


def main() -> int:
    """Train; without a model's name, do the trial and check what the first lines of this file promise."""
    options = read_options()
    torch.manual_seed(0)
    if options.model is None:
        torch.set_num_threads(1)  # more would wait for each other at this size
        tokenizer = trial_tokenizer()
        size = {"hidden_size": 64, "intermediate_size": 128, "num_hidden_layers": 2, "head_dim": 16}
        heads = {"num_attention_heads": 4, "num_key_value_heads": 2, "max_position_embeddings": 2048}
        model: Any = Qwen3ForCausalLM(Qwen3Config(vocab_size=len(tokenizer), **size, **heads))
        imitate(model, tokenizer)
    else:
        tokenizer = AutoTokenizer.from_pretrained(options.model)
        with suppress(ValueError):  # of a family that TRL has no template for: it stays as it is
            tokenizer.chat_template = get_training_chat_template(tokenizer) or tokenizer.chat_template
        model = AutoModelForCausalLM.from_pretrained(options.model, dtype="auto")
    trial = options.model is None
    rollout, seen = rollout_with(MAX_TOKENS if trial else options.max_tokens), []

    def watched(prompts: list[str], trainer: GRPOTrainer) -> dict[str, list[Any]]:
        fields = rollout(prompts, trainer)
        seen.append((prompts, fields, difference(trainer.model, fields)))
        return fields

    gem.register("trial:Flaky-v0", Flaky)
    env_ids = [options.env, "trial:Flaky-v0"] if trial else [options.env]
    rows = [{"prompt": json.dumps({"env": env_id, "seed": seed})} for seed in range(1000) for env_id in env_ids]
    with tempfile.TemporaryDirectory() as temporary:
        if trial:
            check_command(temporary)
            options.out, options.save_steps = temporary, options.steps
        trainer = GRPOTrainer(
            model,
            reward_of_episode,
            configuration(options, options.out),
            Dataset.from_list(rows),
            processing_class=tokenizer,
            rollout_func=watched if trial else rollout,
        )
        before = [weight.detach().clone() for weight in model.parameters()]
        trainer.train(resume_from_checkpoint=get_last_checkpoint(options.out) if os.path.isdir(options.out) else None)
        if trial:
            check_trial(seen, before, trainer)
            check(get_last_checkpoint(options.out) is not None, "a checkpoint is there to go on from")
        else:
            trainer.save_model(options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
