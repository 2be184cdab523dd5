# /// script
# requires-python = ">=3.11"
# dependencies = [
#   "verl>=0.9.1,<0.10", "torch", "cachetools", "fastapi", "uvicorn", "gem-core", "gem-games", "gem-train",
# ]
# ///
r"""verl (0.9.1): an agent loop that plays a GEM environment.

``GemAgentLoop`` runs one episode with ``gem.arollout`` and a ``TokenAgent`` over verl's own servers, and returns it
as one sequence: ids as they were sampled, mask, log-probabilities, and one score. Run on a CPU: verl's own classes,
with a server that writes known tokens instead of vLLM::

    python scripts/trainers.py verl_agent_loop
    python examples/trainers/verl_agent_loop.py  # where what it needs is installed

On GPUs, with this file in the folder where the trainer starts, ``gem.yaml`` with the three lines of ``AGENT_LOOPS``
below, and the rows of ``write_dataset``::

    python -m verl.trainer.main_ppo algorithm.adv_estimator=grpo \
        data.train_files=gem.parquet data.val_files=gem.parquet \
        data.return_raw_chat=True data.max_prompt_length=1024 data.max_response_length=4096 \
        actor_rollout_ref.model.path=Qwen/Qwen3-4B actor_rollout_ref.rollout.name=vllm actor_rollout_ref.rollout.n=8 \
        actor_rollout_ref.rollout.calculate_log_probs=True \
        actor_rollout_ref.rollout.agent.agent_loop_config_path=gem.yaml

What verl cannot take: rewards per turn (the score is their sum, on the last token; ``extra_fields["turn_scores"]``
holds them for logging), images, several agents, and more than one sequence for an episode: a chat template that
rewrites earlier turns, as those that drop reasoning, is refused with the setting that helps. Nor can it leave an
episode out of a group: an episode that failed is played again, and after ``attempts`` failures the error is raised.
It never becomes a reward of 0.
"""

from __future__ import annotations

import asyncio
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from uuid import uuid4

from verl.experimental.agent_loop.agent_loop import AgentLoopBase, AgentLoopMetrics, AgentLoopOutput, register

import gem_core as gem
from gem_core.errors import ArgumentError, ContextOverflowError, EnvFaultError
from gem_train.adapters import Generated, TokenAgent, TrialEngine, trial_tokenizer
from gem_train.adapters.trial import check, check_sequence
from gem_train.tokens import batches, completions

AGENT_LOOPS = """
- name: gem
  _target_: verl_agent_loop.GemAgentLoop
  attempts: 3
"""


@register("gem")
class GemAgentLoop(AgentLoopBase):
    """Plays the episode of a row: ``extra_info`` holds ``env_id``, ``seed``, and ``options`` and ``kwargs`` as JSON.

    All samples of a row (``rollout.n``) have its seed, so that a group shares one start.
    """

    def __init__(self, *args: Any, attempts: int = 3, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.attempts = attempts

    async def run(self, sampling_params: dict[str, Any], **row: Any) -> AgentLoopOutput:
        """Play an episode, and return it as one sequence."""
        for _ in range(self.attempts):
            episode = await self.play(sampling_params, row["extra_info"])
            if episode.error is None:
                return self.output(episode)
        raise EnvFaultError(f"{episode.id}: {self.attempts} episodes failed, the last one with {episode.error}")

    async def play(self, sampling_params: dict[str, Any], start: dict[str, Any]) -> gem.Episode:
        """Play an episode over verl's servers."""
        request_id = uuid4().hex  # the same for all turns, so that one server keeps their prefix in its cache
        most: int | None = None

        async def generate(prompt_ids: list[int], **sampling: Any) -> Generated:
            nonlocal most
            if most is None:
                if len(prompt_ids) > self.rollout_config.prompt_length:
                    raise ArgumentError(f"the task has {len(prompt_ids)} tokens; raise data.max_prompt_length")
                most = len(prompt_ids) + self.rollout_config.response_length
            room = most - len(prompt_ids)
            if room < 1:
                raise ContextOverflowError(
                    f"data.max_response_length of {self.rollout_config.response_length} is used up"
                )
            output = await self.server_manager.generate(
                request_id=request_id, prompt_ids=prompt_ids, sampling_params={**sampling, "max_tokens": room}
            )
            reason = "length" if len(output.token_ids) >= room else "stop"
            return Generated(output.token_ids, output.log_probs, "abort" if output.stop_reason == "aborted" else reason)

        agent = TokenAgent(
            generate, self.tokenizer, sampling=sampling_params, chat_template_kwargs=self.apply_chat_template_kwargs
        )
        item = gem.PlanItem(
            id=start["env_id"],
            seed=int(start["seed"]),
            options=json.loads(start.get("options") or "null"),
            kwargs=json.loads(start.get("kwargs") or "{}"),
        )
        (episode,) = [episode async for episode in gem.arollout(start["env_id"], agent, plan=[item], num_envs=1)]
        return episode

    def output(self, episode: gem.Episode) -> AgentLoopOutput:
        """Return an episode as verl takes it."""
        rows = completions(batches([episode], form="trajectories"))
        if len(rows) != 1:
            raise ArgumentError(
                f"the episode is in {len(rows)} sequences and verl takes one: the template rewrites earlier turns. "
                "Set actor_rollout_ref.model.custom_chat_template to one that keeps them, or "
                "data.apply_chat_template_kwargs"
            )
        row, turn_scores = rows[0], [turn.reward for turn in episode.transitions]
        success = math.nan if episode.success is None else float(episode.success)
        return AgentLoopOutput(
            prompt_ids=row.prompt_ids,
            response_ids=row.completion_ids,
            response_mask=row.completion_mask,
            response_logprobs=None if any(map(math.isnan, row.logprobs)) else row.logprobs,
            reward_score=episode.episode_return,
            num_turns=2 * episode.turns,
            metrics=AgentLoopMetrics(),
            extra_fields={
                "turn_scores": turn_scores,
                "tool_rewards": [],
                "reward_extra_info": {"success": success, "truncated": float(not episode.transitions[-1].terminated)},
            },
        )


def write_dataset(path: Path, env_id: str, rows: int, seed: int = 0) -> None:
    """Write rows for ``data.train_files``: each is a task of an environment by its seed."""
    import pandas as pd

    prompt = [{"role": "user", "content": f"(the task comes from {env_id})"}]
    table = [
        {
            "data_source": env_id,
            "agent_name": "gem",
            "prompt": prompt,
            "reward_model": {"style": "rule", "ground_truth": ""},
            "extra_info": {"env_id": env_id, "seed": seed + index, "index": index, "options": "", "kwargs": ""},
        }
        for index in range(rows)
    ]
    pd.DataFrame(table).to_parquet(path)


# A trial without a GPU.


class TrialServer:
    """Stands for verl's client of its servers, and has the method that agent loops call."""

    def __init__(self, engine: TrialEngine) -> None:
        self.engine = engine

    async def generate(self, request_id: str, *, prompt_ids: list[int], sampling_params: dict[str, Any]) -> Any:
        """Return what verl's ``TokenOutput`` holds."""
        made = await self.engine(prompt_ids, max_tokens=sampling_params["max_tokens"])
        return SimpleNamespace(token_ids=list(made.token_ids), log_probs=made.logprobs, stop_reason="completed")


def trial_loop(engine: TrialEngine, response_length: int = 2000) -> Any:
    """Return the agent loop as verl's worker makes it, over a server that writes known tokens."""
    import hydra
    from omegaconf import OmegaConf
    from verl.experimental.agent_loop.agent_loop import DictConfigWrap, ToolListWrap
    from verl.utils.dataset.rl_dataset import RLHFDataset

    rollout = {"prompt_length": 1500, "response_length": response_length}
    config = OmegaConf.create({"actor_rollout_ref": {"rollout": rollout}, "data": {}})
    return hydra.utils.instantiate(
        OmegaConf.create(AGENT_LOOPS)[0],
        trainer_config=DictConfigWrap(config),
        server_manager=TrialServer(engine),
        tokenizer=engine.tokenizer,
        processor=None,
        dataset_cls=RLHFDataset,
        data_config=DictConfigWrap(config.data),
        tools=ToolListWrap([]),
    )


async def main() -> None:
    """Play an episode through verl's classes and check it token by token."""
    engine = TrialEngine(trial_tokenizer(), [r"\boxed{1 2}", r"\boxed{4 1}", r"\boxed{4 6}"])
    loop = trial_loop(engine)
    row = {"env_id": "game:Mastermind-v0-easy", "seed": 3}
    output = await loop.run({"temperature": 1.0, "logprobs": True}, extra_info=row)
    ids, before = output.prompt_ids + output.response_ids, [0] * len(output.prompt_ids)
    check_sequence(engine, ids, before + output.response_mask, before + output.response_logprobs)
    check(output.extra_fields["turn_scores"] == [0.0, 0.5, 0.5], "the rewards of the turns are logged")
    check(output.reward_score == 1.0, "the score is their sum")
    scores = output.as_dict()["rm_scores"]
    check(scores[-1] == 1.0 and scores.count_nonzero() == 1, "verl puts it on the last token")
    output = await trial_loop(engine, response_length=5).run({}, extra_info=row)
    check(len(output.response_ids) == 5 and output.response_mask == [1] * 5, "max_response_length cuts a response off")
    check(output.extra_fields["reward_extra_info"]["truncated"] == 0.0, "which is answered as it is")
    print(engine.tokenizer.decode(ids))


if __name__ == "__main__":
    asyncio.run(main())
