# /// script
# requires-python = ">=3.11"
# dependencies = [
#   "torch", "transformers", "jinja2", "hydra-core", "wandb", "torchdata", "datasets",
#   "gem-core", "gem-games", "gem-train",
# ]
# [tool.gem]
# no-deps = ["rl-square==0.0.2"]
# [tool.gem.table]
# framework = 'RL2'
# rewards = 'summed; `adv.gamma` is not read'
# images = 'no'
# groups = '`responses_per_prompt`'
# tools = 'in text'
# failures = 'played again, then raised'
# ///
r"""RL2 (rl-square 0.0.2 of PyPI, and its repository at 9161ede): a GEM environment for ``rollout.env_path``.

RL2 runs the loop and keeps the ids as SGLang sampled them; it asks the environment for the text of the next prompt.
Where that begins with the text so far, the sequence goes on; where a chat template rewrites earlier turns, RL2 begins
another. Version 0.0.2 calls ``reset`` and ``step``; the repository calls ``generate``, which here begins an episode and
leaves the loop to RL2's ``base_generate`` with ``env_step``. RL2 needs SGLang and flash-attn and does not run on a CPU.
Here RL2's own configuration reads the command for its version, its own function makes the advantages of two episodes,
and an engine that writes known tokens plays an episode::

    python scripts/trainers.py rl2_env
    python examples/trainers/rl2_env.py  # where what it needs is installed

On one node of eight GPUs: write the rows, then train. With version 0.0.2::

    python examples/trainers/rl2_env.py game:GuessTheNumber-v0 12800 > gem.jsonl

    GEM_TOKENIZER=Qwen/Qwen3-1.7B torchrun --nproc_per_node=8 -m RL2.trainer.ppo \
        train_data.path=gem.jsonl test_data.path=gem.jsonl rollout.env_path=examples/trainers/rl2_env.py \
        train_data.prompts_per_rollout=64 train_data.responses_per_prompt=8 rollout.max_turns=16 \
        rollout.train_sampling_params.max_new_tokens=1024 +rollout.train_sampling_params.skip_special_tokens=false \
        actor.model_name=Qwen/Qwen3-1.7B actor.max_length_per_device=16384 adv.norm_var=true \
        trainer.use_wandb=false trainer.experiment_name=gem trainer.save_freq=64

With the repository::

    torchrun --nproc_per_node=8 -m RL2.trainer.ppo \
        rollout.train.path=gem.jsonl rollout.test.path=gem.jsonl rollout.env_path=examples/trainers/rl2_env.py \
        rollout.train.apply_chat_template=false rollout.test.prompts_per_rollout=64 \
        rollout.train.prompts_per_rollout=64 rollout.train.responses_per_prompt=8 \
        rollout.train.sampling_params.max_new_tokens=1024 actor.model_name=Qwen/Qwen3-1.7B \
        actor.max_length_per_device=16384 adv.norm_var=true trainer.total_steps=200 \
        trainer.use_wandb=false trainer.experiment_name=gem trainer.save_freq=64

What RL2 cannot take: rewards of turns and a discount of turns. The rewards are on the last tokens of their turns, but
its default estimator ``reinforce`` takes their sum and never reads ``adv.gamma``; with ``gae`` that counts tokens. Nor
images, several agents, a limit of the context (give the task a limit of turns), and tool results under their ids: they
come from the user. The logged reward and dynamic filtering read the last reward of each sequence only. RL2 has no way
to leave an episode out: one that failed is played again, and after ``ATTEMPTS`` failures the error is raised (in 0.0.2
at once). It never becomes a reward of 0.
"""

from __future__ import annotations

import asyncio
import json
import os
import shlex
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch
from uuid import uuid4

from gem_core import Response
from gem_core.errors import ArgumentError, EnvFaultError
from gem_train.adapters import ChatSession, ChatTemplate, TrialEngine, trial_tokenizer
from gem_train.adapters.trial import check, check_sequence

try:
    from RL2.datasets import Sample, base_generate
except ImportError:  # stand-ins with the fields and the order of calls of RL2

    @dataclass
    class Sample:
        """One episode."""

        Status = Enum("Status", {"RUNNING": "running", "ABORTED": "aborted", "DONE": "done"})
        sample: dict[str, Any] = field(default_factory=dict)
        state_text: str = ""
        action_text: str = ""
        state_dict: dict[str, list[Any]] = field(default_factory=dict)
        state_dicts: list[dict[str, list[Any]]] = field(default_factory=list)
        turn: int = 0
        metrics: dict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))
        status: Any = Status.RUNNING

    async def base_generate(config: Any, tokenizer: Any, router_url: Any, sample: Sample, env_step_fn: Any) -> None:
        """Play an episode; ``router_url`` is the engine here."""

        def written(text: str) -> dict[str, list[Any]]:
            ids = tokenizer.encode(text, add_special_tokens=False)
            return {"states": ids, **{name: [0] * len(ids) for name in ("actions", "action_mask", "logps", "rewards")}}

        def add(more: dict[str, list[Any]]) -> None:
            sample.state_dict = {name: sample.state_dict[name] + list(values) for name, values in more.items()}

        sample.state_text = sample.sample[config.prompt_key]
        sample.state_dict = written(sample.state_text)
        while sample.status == Sample.Status.RUNNING:
            made = await router_url(sample.state_dict["states"], max_tokens=config.max_new_tokens)
            ids, ones, zeros = made.token_ids, [1] * len(made.token_ids), [0] * len(made.token_ids)
            add({"states": ids, "actions": ids, "action_mask": ones, "logps": made.logprobs, "rewards": zeros})
            sample.action_text = tokenizer.decode(ids, skip_special_tokens=config.skip_special_tokens)
            answer = await env_step_fn(sample)
            sample.state_dict["rewards"][-1] = answer["reward"]
            so_far = sample.state_text + sample.action_text
            if answer["done"]:
                sample.status = Sample.Status.DONE
                sample.state_dicts.append(sample.state_dict)
            elif answer["next_state"].startswith(so_far):
                add(written(answer["next_state"][len(so_far) :]))
            else:
                sample.state_dicts.append(sample.state_dict)
                sample.state_dict = written(answer["next_state"])
            sample.state_text = answer["next_state"]


ATTEMPTS = 3
SESSIONS: dict[str, ChatSession] = {}
"""The episodes under way; a row holds the name of its own, since RL2 writes rows to a file."""


def begin(row: dict[str, Any], template: ChatTemplate) -> ChatSession:
    """Make the session of a row, which has ``env_id``, ``seed``, and where wanted ``options`` and ``kwargs``."""
    row["gem_session"] = uuid4().hex
    session = ChatSession(row["env_id"], native_tools=template.describes_tools, **row.get("kwargs") or {})
    return SESSIONS.setdefault(row["gem_session"], session)


def end(row: dict[str, Any]) -> None:
    """Close the session of a row."""
    if row.get("gem_session") in SESSIONS:
        SESSIONS.pop(row["gem_session"]).close()


async def answer(
    template: ChatTemplate, row: dict[str, Any], state: str, action: str, end_token: str
) -> dict[str, Any]:
    """Return what the environment answers to a response.

    Args:
        template: Writes the next prompt.
        row: Of the data set.
        state: The text that the model was sent.
        action: The text of the response, with the token that ended it or without.
        end_token: That token; empty for a response that was cut off.
    """
    session = SESSIONS[row["gem_session"]]
    place = len(session.messages)
    reason = "stop" if end_token else "length"
    step = await session.step(Response(action.removesuffix(end_token), finish_reason=reason))
    if step.error is not None:
        end(row)
        raise EnvFaultError(f"{session.episode.id}: {step.error['message']}")
    if step.done:
        end(row)
        return {"next_state": None, "done": True, "reward": step.reward}
    bridge = template.bridge(session.messages, place, session.tools)
    if bridge is None:  # the template rewrites earlier turns, and RL2 begins another sequence
        return {"next_state": template.render(session.messages, session.tools), "done": False, "reward": step.reward}
    return {"next_state": state + action + bridge.removeprefix(end_token), "done": False, "reward": step.reward}


# Today's RL2.


async def env_step(template: ChatTemplate, sample: Sample) -> dict[str, Any]:
    """Answer the response of a sample."""
    ids = sample.state_dict["states"]  # they tell whether the model ended its turn, whatever the text shows
    end_token = template.tokenizer.decode(ids[-1:]) if template.ended(ids) else ""
    return await answer(template, sample.sample, sample.state_text, sample.action_text, end_token)


async def generate(config: Any, tokenizer: Any, router_url: Any, sample: Sample) -> None:
    """Play the episode of a sample. All samples of a row have its seed, so that a group shares one start."""
    if config.apply_chat_template:
        raise ArgumentError("set apply_chat_template=false: the environment's own messages are rendered here")
    template = ChatTemplate(tokenizer)
    for attempt in range(1, ATTEMPTS + 1):
        try:
            if sample.status == Sample.Status.RUNNING:
                row = sample.sample
                session = begin(row, template)
                messages = await session.reset(int(row["seed"]), row.get("options"))
                row[config.prompt_key] = template.render(messages, session.tools)
            # One that was aborted goes on in its session.
            await base_generate(config, tokenizer, router_url, sample, partial(env_step, template))
            return
        except EnvFaultError:
            end(sample.sample)
            if attempt == ATTEMPTS:
                raise
            sample.turn, sample.state_dicts, sample.status = 0, [], Sample.Status.RUNNING
            sample.metrics.clear()


# Version 0.0.2.


@cache
def own_template() -> ChatTemplate:
    """Return the chat template of the model, which 0.0.2 does not hand over."""
    import transformers

    return ChatTemplate(transformers.AutoTokenizer.from_pretrained(os.environ["GEM_TOKENIZER"]))


async def reset(extra_info: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Begin the episode of a row."""
    template, extra_info = own_template(), dict(extra_info)
    session = begin(extra_info, template)
    messages = await session.reset(int(extra_info["seed"]), extra_info.get("options"))
    return template.render(messages, session.tools), extra_info


async def step(state: str, action: str, extra_info: dict[str, Any]) -> dict[str, Any]:
    """Answer a response."""
    template = own_template()
    result = await answer(template, extra_info, state, action, template.split_end(action)[1])
    return {**result, "score": result["reward"], "extra_info": extra_info}


def dataset_rows(env_id: str, count: int, seed: int = 0) -> list[dict[str, Any]]:
    """Return rows of a data set: each is a task of an environment by its seed. 0.0.2 reads ``extra_info``."""
    rows = [{"env_id": env_id, "seed": seed + index} for index in range(count)]
    return [{**row, "extra_info": row} for row in rows]


# A trial without a GPU.


def check_command(folder: Path) -> None:
    """Compose the printed command with the configuration of the RL2 that is installed, and look for what it needs."""
    from hydra import compose, initialize_config_dir
    from omegaconf import OmegaConf

    released = not (folder / "trainer" / "config" / "actor").is_dir()
    text = str(__doc__).partition("With version 0.0.2" if released else "With the repository")[2]
    command = text.partition("RL2.trainer.ppo")[2].partition("\n\n")[0].replace("\\\n", " ")
    with initialize_config_dir(str(folder / "trainer" / "config"), version_base=None):
        config = compose("ppo", shlex.split(command))
    OmegaConf.resolve(config)
    needed = ["actor.model_name", "actor.max_length_per_device", "rollout.env_path", "trainer.experiment_name"]
    if released:
        needed += ["train_data.path", "train_data.prompts_per_rollout", "test_data.path"]
        needed += ["rollout.train_sampling_params.max_new_tokens", "trainer.n_epochs"]
    else:
        needed += [f"rollout.{part}.{name}" for part in ("train", "test") for name in ("path", "prompts_per_rollout")]
        needed += ["rollout.train.sampling_params.max_new_tokens", "trainer.total_steps"]
    missing = [name for name in needed if OmegaConf.select(config, name) is None]
    check(not missing, f"RL2 takes the command, and nothing that it needs is null{': ' * bool(missing)}{missing or ''}")


def check_advantages() -> None:
    """Let RL2's own function compare two episodes with the same rewards in another order."""
    import torch
    from RL2.utils import algorithms

    advantages = getattr(algorithms, "compute_reinforce_adv", None) or algorithms._compute_reinforce_adv
    rewards = torch.tensor([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    batch = {"rewards": rewards, "action_mask": torch.ones(3, 3)}
    made = advantages(batch, 3, global_norm=False, norm_var=False)["advantages"]
    expected = [[1 / 3] * 3, [1 / 3] * 3, [-2 / 3] * 3]
    check(torch.allclose(made, torch.tensor(expected)), "every token has the episode's sum, without its place in time")


@contextmanager
def in_place_of_sglang(engine: TrialEngine, skip: bool) -> Iterator[None]:
    """Let the engine answer what RL2's own ``base_generate`` asks a server."""

    async def answered(url: Any, path: str, json: dict[str, Any]) -> dict[str, Any]:
        made = await engine(json["input_ids"], max_tokens=json["sampling_params"]["max_new_tokens"])
        logprobs = [(logprob, token, None) for logprob, token in zip(made.logprobs, made.token_ids, strict=True)]
        about = {"output_token_logprobs": logprobs, "finish_reason": {"type": made.finish_reason}}
        text = engine.tokenizer.decode(made.token_ids, skip_special_tokens=skip)
        return {"text": text, "meta_info": {**about, "completion_tokens": len(made.token_ids)}}

    if base_generate.__module__ == __name__:
        yield
        return
    from RL2.datasets import rl

    with patch.object(rl, "async_request", answered), patch.object(rl.OmegaConf, "to_container", dict):
        yield


async def main() -> None:
    """Play an episode in both forms and check it token by token."""
    found = find_spec("RL2")
    if found is not None:
        check_command(Path(str(next(iter(found.submodule_search_locations or [])))))
        check_advantages()
    engine = TrialEngine(trial_tokenizer(), [r"\boxed{1 2}", r"\boxed{4 1}", r"\boxed{4 6}"])
    (row,) = dataset_rows("game:Mastermind-v0-easy", 1, seed=3)
    for skip in (True, False):  # whether SGLang's text shows the token that ended a response
        engine.calls.clear()
        sample = Sample(sample=dict(row))
        config = {"apply_chat_template": False, "prompt_key": "prompt", "max_new_tokens": 500}
        config |= {"sampling_params": {"max_new_tokens": 500}, "skip_special_tokens": skip}
        with in_place_of_sglang(engine, skip):
            await generate(SimpleNamespace(**config), engine.tokenizer, engine, sample)
        (made,) = sample.state_dicts
        check(sample.status == Sample.Status.DONE and not SESSIONS, "the episode is done, and its session closed")
        check_sequence(engine, made["states"], made["action_mask"], made["logps"])
        ends = [len(prompt_ids) + len(said.token_ids) - 1 for prompt_ids, said in engine.calls]
        paid = {place: reward for place, reward in enumerate(made["rewards"]) if reward}
        check(paid == {ends[1]: 0.5, ends[2]: 0.5}, "each reward is on the last token of its turn")
    with tempfile.TemporaryDirectory() as folder:
        engine.tokenizer.save_pretrained(folder)
        os.environ["GEM_TOKENIZER"] = folder
        state, info = await reset(row["extra_info"])
    for text in engine.texts:
        result = await step(state, f"{text}<|im_end|>", info)
        goes_on = str(result["next_state"]).startswith(f"{state}{text}<|im_end|>\n<|im")
        check(result["done"] or goes_on, "0.0.2: the next state begins with the state and the response")
        state, info = result["next_state"], result["extra_info"]
    check(result["done"] and result["reward"] == result["score"] == 0.5, "0.0.2: the end has its reward")
    print(engine.tokenizer.decode(made["states"]))


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print("\n".join(map(json.dumps, dataset_rows(sys.argv[1], int(sys.argv[2])))))
    else:
        asyncio.run(main())
