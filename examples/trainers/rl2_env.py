# /// script
# requires-python = ">=3.11"
# dependencies = ["transformers", "gem-core", "gem-games", "gem-train"]
# ///
r"""RL2 (9161ede, and rl-square 0.0.2 of PyPI): a GEM environment for ``rollout.env_path``.

RL2 runs the loop and keeps the ids as SGLang sampled them; it asks the environment for the text of the next prompt.
Where that begins with the text so far, the sequence goes on; where a chat template rewrites earlier turns, RL2 begins
another. Today's RL2 calls ``generate``, which here begins an episode and leaves the loop to RL2's ``base_generate``
with ``env_step``; version 0.0.2 calls ``reset`` and ``step``. RL2 needs SGLang and flash-attn and does not install on
a CPU: here stand-ins with the fields of its ``Sample`` and an engine that writes known tokens drive it::

    python scripts/trainers.py rl2_env
    python examples/trainers/rl2_env.py  # where what it needs is installed

On GPUs, with the rows of ``dataset_rows`` in ``gem.jsonl`` (read from RL2's source, and not tried)::

    torchrun --nproc_per_node=8 -m RL2.trainer.ppo rollout.train.path=gem.jsonl rollout.test.path=gem.jsonl \
        rollout.env_path=examples/trainers/rl2_env.py rollout.train.apply_chat_template=false \
        rollout.train.prompts_per_rollout=64 rollout.train.responses_per_prompt=8 adv.gamma=0.9 \
        rollout.train.sampling_params.max_new_tokens=1024 \
        actor.model_name=Qwen/Qwen3-1.7B actor.max_length_per_device=8192

0.0.2 calls the paths ``train_data.path`` and ``test_data.path``. It also needs ``GEM_TOKENIZER=Qwen/Qwen3-1.7B`` in
the environment, ``rollout.max_turns`` of at least the turns of the task, and
``+rollout.train_sampling_params.skip_special_tokens=false``, or the text does not tell what was cut off.

What RL2 cannot take: images, several agents, a limit of the context (give the task a limit of turns), and tool
results under their ids: they come from the user. Rewards of turns are kept, each on the last token of its response,
but the logged reward and dynamic filtering read the last one of each sequence only. It has no way to leave an episode
out: one that failed is played again, and after ``ATTEMPTS`` failures the error is raised (in 0.0.2 at once). It never
becomes a reward of 0.
"""

from __future__ import annotations

import asyncio
import os
import tempfile
from collections import defaultdict
from dataclasses import dataclass, field
from enum import Enum
from functools import cache, partial
from types import SimpleNamespace
from typing import Any
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


async def main() -> None:
    """Play an episode in both forms and check it token by token."""
    engine = TrialEngine(trial_tokenizer(), [r"\boxed{1 2}", r"\boxed{4 1}", r"\boxed{4 6}"])
    (row,) = dataset_rows("game:Mastermind-v0-easy", 1, seed=3)
    for skip in (True, False):  # whether SGLang's text shows the token that ended a response
        engine.calls.clear()
        sample = Sample(sample=dict(row))
        config = {"apply_chat_template": False, "prompt_key": "prompt", "max_new_tokens": 500}
        await generate(SimpleNamespace(**config, skip_special_tokens=skip), engine.tokenizer, engine, sample)
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
    asyncio.run(main())
