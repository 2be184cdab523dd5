# /// script
# requires-python = ">=3.11"
# dependencies = ["torch", "transformers", "aiohttp", "gem-core", "gem-games", "gem-train"]
# [tool.gem]
# no-deps = ["openrlhf>=0.11.2,<0.12"]
# [tool.gem.table]
# framework = 'OpenRLHF'
# rewards = 'summed'
# images = 'no'
# groups = '`n_samples_per_prompt`'
# tools = 'in text'
# failures = 'played again, then raised'
# ///
r"""OpenRLHF (0.11.2): an agent function that plays a GEM environment.

OpenRLHF's own ``MultiTurnAgentExecutor`` runs the loop and keeps the ids as they were sampled. It appends the text of
``environment_feedback`` as it is, so that the marks of the chat template have to stand in it: they are found by
rendering the chat with the template of the model. Run on a CPU: OpenRLHF's ``agent.py`` from its wheel, with an
engine that writes known tokens instead of vLLM::

    python scripts/trainers.py openrlhf_agent
    python examples/trainers/openrlhf_agent.py  # where what it needs is installed

On one node of eight GPUs: write the rows, then train. The trial puts this command before OpenRLHF's own parser and
checks, up to where it would start its workers::

    python examples/trainers/openrlhf_agent.py game:GuessTheNumber-v0 12800 > gem.jsonl

    python -m openrlhf.cli.train_ppo_ray --train.agent_func_path examples/trainers/openrlhf_agent.py \
        --data.prompt_dataset gem.jsonl --data.input_key input --data.label_key label --data.max_len 8192 \
        --actor.model_name_or_path Qwen/Qwen3-4B-Instruct-2507 --actor.gradient_checkpointing_enable \
        --rollout.batch_size 128 --rollout.n_samples_per_prompt 8 --train.batch_size 1024 \
        --algo.advantage.estimator group_norm --algo.kl.init_coef 0 --train.colocate_all --ds.zero_stage 3 \
        --ds.enable_sleep --vllm.num_engines 8 --vllm.enable_sleep --vllm.gpu_memory_utilization 0.6 \
        --ckpt.save_steps 20 --ckpt.output_dir runs/openrlhf

What OpenRLHF cannot take: rewards per turn (its executor adds them up), native tool calls, several agents, and more
than one sequence for an episode: a chat template that rewrites earlier turns, as those that drop reasoning, is
refused. A task that does not fit beside the response is refused too; OpenRLHF would cut its beginning off. Its
executor gives every turn all that is left of ``max_len``, so that ``max_new_tokens`` is no limit of a turn. It has no
way to leave an episode out: one that failed is played again, and after ``ATTEMPTS`` failures the error is raised. It
never becomes a reward of 0.
"""

from __future__ import annotations

import asyncio
import importlib.util
import json
import runpy
import shlex
import sys
from copy import deepcopy
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import MagicMock, patch

import torch

if importlib.util.find_spec("vllm") is None:
    # The package imports DeepSpeed and more; its agent module needs none of that, so it is loaded without the rest.
    utils = ModuleType("openrlhf.utils")
    utils.__path__ = [f"{place}/utils" for place in importlib.util.find_spec("openrlhf").submodule_search_locations]
    sys.modules["openrlhf.utils"] = utils

from openrlhf.utils.agent import AgentInstanceBase, MultiTurnAgentExecutor

from gem_core import Response
from gem_core.errors import ArgumentError, EnvFaultError
from gem_train.adapters import ChatSession, ChatTemplate, TrialEngine, trial_tokenizer
from gem_train.adapters.trial import check, check_sequence

ATTEMPTS = 3


class GemInstance(AgentInstanceBase):
    """One episode. The row's label is JSON: ``env_id``, ``seed``, and where wanted ``options`` and ``kwargs``.

    All samples of a row have its seed, so that a group shares one start.
    """

    def __init__(self, tokenizer: Any = None) -> None:
        self.template = ChatTemplate(tokenizer)
        self.session: ChatSession | None = None
        self.first = ""

    async def reset(self, states: dict[str, Any], **kwargs: Any) -> dict[str, Any]:
        """Return the task as the model is sent it; the prompt of the data set is not used."""
        start = json.loads(states["label"])
        self.session = ChatSession(
            start["env_id"], native_tools=self.template.describes_tools, **start.get("kwargs") or {}
        )
        messages = await self.session.reset(start["seed"], start.get("options"))
        self.first = self.template.render(messages, self.session.tools)
        return {"observation": self.first}

    async def step(self, states: dict[str, Any], **kwargs: Any) -> dict[str, Any]:
        """Answer a response with what the template writes after it."""
        session, template = self.session, self.template
        if not states["observation_text"].startswith(self.first):
            raise ArgumentError("OpenRLHF cut the task's beginning off; raise --data.max_len, or lower max_new_tokens")
        text, end = template.split_end(states["action_text"])
        place = len(session.messages)
        step = await session.step(Response(text, finish_reason="stop" if end else "length"))
        if step.error is not None:
            raise EnvFaultError(f"{session.episode.id}: {step.error['message']}")
        feedback = "" if step.done else template.bridge(session.messages, place, session.tools)
        if feedback is None:
            raise ArgumentError(
                "the chat template rewrites earlier turns, and OpenRLHF only appends; give the model another"
            )
        success = session.success
        return {
            "rewards": torch.tensor(step.reward),
            "scores": torch.tensor(session.episode_return if success is None else float(success)),
            "environment_feedback": feedback.removeprefix(end),
            "done": step.done,
            "sampling_params": states["sampling_params"],
            "extra_logs": {
                "success": float(bool(success)),
                "turns": float(session.episode.turns),
                "terminated": float(step.terminated),
            },
        }


class AgentExecutor(MultiTurnAgentExecutor):
    """What OpenRLHF looks for in this file."""

    def __init__(self) -> None:
        super().__init__(GemInstance)

    async def execute(
        self,
        prompt: str,
        label: str,
        sampling_params: Any,
        max_length: int,
        hf_tokenizer: Any,
        llm_engine: Any,
        images=None,
    ) -> dict[str, Any]:
        """Play an episode with OpenRLHF's executor, again if it failed."""
        for attempt in range(1, ATTEMPTS + 1):
            instance = GemInstance(hf_tokenizer)
            executor = MultiTurnAgentExecutor(GemInstance)
            executor.agent_instance_cls = lambda made=instance: made
            try:
                # A copy: the executor changes it, and the samples of a prompt share it.
                return await executor.execute(
                    prompt, label, deepcopy(sampling_params), max_length, hf_tokenizer, llm_engine, images
                )
            except EnvFaultError:
                if attempt == ATTEMPTS:
                    raise
            finally:
                if instance.session is not None:
                    instance.session.close()


def dataset_rows(env_id: str, count: int, seed: int = 0) -> list[dict[str, str]]:
    """Return rows for ``--data.prompt_dataset``: each is a task of an environment by its seed."""
    return [
        {"input": f"(a task of {env_id})", "label": json.dumps({"env_id": env_id, "seed": seed + index})}
        for index in range(count)
    ]


# A trial without a GPU.


class TrialVLLM:
    """Stands for OpenRLHF's vLLM actor: the method that its executor calls, and the fields that it reads."""

    def __init__(self, engine: TrialEngine) -> None:
        self.engine = engine

    async def generate(self, prompt_ids: list[int], sampling_params: Any, multi_modal_data: Any = None) -> Any:
        """Return what vLLM's ``RequestOutput`` holds."""
        made = await self.engine(prompt_ids, max_tokens=sampling_params.max_tokens)
        ids, logprobs = list(made.token_ids), [SimpleNamespace(logprob=one) for one in made.logprobs]
        text = self.engine.tokenizer.decode(ids, skip_special_tokens=False)
        return SimpleNamespace(
            outputs=[
                SimpleNamespace(
                    token_ids=ids,
                    text=text,
                    finish_reason=made.finish_reason,
                    logprobs=[{token: one} for token, one in zip(ids, logprobs, strict=True)],
                )
            ]
        )


async def play(engine: TrialEngine, row: dict[str, str], max_length: int = 4000) -> dict[str, Any]:
    """Play the episode of a row as OpenRLHF does."""
    sampling_params = SimpleNamespace(max_tokens=None, logprobs=1)
    return await AgentExecutor().execute(
        row["input"], row["label"], sampling_params, max_length, engine.tokenizer, TrialVLLM(engine)
    )


def check_command() -> None:
    """Let OpenRLHF's own program read the printed command; what would start workers is a stand-in."""
    text = str(__doc__)
    command = text[text.index("--train.agent_func_path") : text.index("What OpenRLHF cannot take")]
    trainer = "openrlhf.trainer.ppo_trainer"
    workers = (
        "openrlhf.trainer.ray",
        *(f"openrlhf.trainer.ray.{part}" for part in ("launcher", "ppo_actor", "ppo_critic")),
    )
    stand_ins = {
        name: MagicMock() for name in ("ray", "ray.util", "ray.util.placement_group", "openrlhf.trainer", trainer)
    }
    stand_ins |= {name: MagicMock() for name in workers}
    with (
        patch.dict(sys.modules, stand_ins),
        patch.object(sys.modules["openrlhf.utils"], "get_strategy", MagicMock(), create=True),
        patch.object(sys, "argv", ["train_ppo_ray", *shlex.split(command.replace("\\\n", " "))]),
    ):
        runpy.run_module("openrlhf.cli.train_ppo_ray", run_name="__main__")
    made = stand_ins["openrlhf.trainer.ray"].create_vllm_engines
    trained = stand_ins[trainer].PPOTrainer.remote.call_args
    check(made.called and made.call_args.args[0] == 8, "OpenRLHF takes the command, and starts eight engines")
    check(trained.args[3] is None and trained.args[4] is None, "neither a critic nor a model of rewards is started")


async def main() -> None:
    """Play an episode through OpenRLHF's executor and check it token by token."""
    check_command()
    engine = TrialEngine(trial_tokenizer(), [r"\boxed{1 2}", r"\boxed{4 1}", r"\boxed{4 6}"])
    (row,) = dataset_rows("game:Mastermind-v0-easy", 1, seed=3)
    output = await play(engine, row)
    ids, ranges = output["observation_tokens"], output["action_ranges"]
    mask = [any(start <= place < end for start, end in ranges) for place in range(len(ids))]
    check_sequence(engine, ids, mask, output["rollout_log_probs"])
    check(
        output["reward"] == 1.0 and output["scores"].item() == 1.0,
        "the rewards of the turns, 0, 0.5 and 0.5, are added",
    )
    check(output["extra_logs"] == {"success": 1.0, "turns": 3.0, "terminated": 1.0}, "success and turns are logged")
    output = await play(engine, row, max_length=len(engine.calls[0][0]) + 5)
    check(
        output["truncated"] and output["action_ranges"] == [(ranges[0][0], ranges[0][0] + 5)],
        "max_len cuts a response off",
    )
    print(engine.tokenizer.decode(ids))


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print("\n".join(map(json.dumps, dataset_rows(sys.argv[1], int(sys.argv[2])))))
    else:
        asyncio.run(main())
