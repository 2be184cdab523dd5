# /// script
# requires-python = ">=3.11"
# dependencies = [
#   "verl>=0.9.1,<0.10", "TransferQueue>=0.1.10", "torch", "cachetools", "fastapi", "uvicorn",
#   "gem-core", "gem-games", "gem-train",
# ]
# [tool.gem.table]
# framework = 'verl'
# rewards = 'yes, on the last token of each response'
# images = 'no'
# groups = '`rollout.n`'
# tools = 'in text'
# failures = 'played again, then raised: its group goes on without it'
# ///
r"""verl (0.9.1): episodes of GEM, and the paper's algorithms with a reward, a discount and an advantage for each turn.

``GemAgentLoop`` runs one episode with ``gem.arollout`` and a ``TokenAgent`` over verl's own servers. It returns one
sequence: ids as they were sampled, mask, log-probabilities, and each turn's reward on the last token of the turn. The
advantage estimators below count turns, not tokens; verl's trainer calls them by name. Tried on a CPU: verl's own check
of the commands below, its own functions with tiny tensors beside ``gem_train.estimators``, and an episode over a
server that writes known tokens instead of vLLM::

    python scripts/trainers.py verl_agent_loop
    python examples/trainers/verl_agent_loop.py  # where what it needs is installed

On eight GPUs, in a folder with this file: write the rows, then train, here by REINFORCE with return batch normalization
(ReBN) and the settings of the paper::

    python verl_agent_loop.py rows game:GuessTheNumber-v0  # train.parquet, val.parquet and gem.yaml

    PYTHONPATH=. python -m verl.trainer.main_ppo algorithm.adv_estimator=gem_rebn algorithm.gamma=0.9 \
        data.train_files=train.parquet data.val_files=val.parquet data.train_batch_size=128 \
        data.max_prompt_length=2048 data.max_response_length=10240 \
        actor_rollout_ref.model.path=Qwen/Qwen3-1.7B actor_rollout_ref.model.external_lib=verl_agent_loop \
        actor_rollout_ref.actor.optim.lr=1e-6 actor_rollout_ref.actor.optim.betas=[0.9,0.95] \
        actor_rollout_ref.actor.optim.weight_decay=0.0 \
        actor_rollout_ref.actor.ppo_mini_batch_size=128 actor_rollout_ref.actor.ppo_epochs=2 \
        actor_rollout_ref.actor.loss_agg_mode=seq-mean-token-sum-norm \
        actor_rollout_ref.actor.use_dynamic_bsz=True actor_rollout_ref.actor.ppo_max_token_len_per_gpu=16384 \
        actor_rollout_ref.rollout.name=vllm actor_rollout_ref.rollout.tensor_model_parallel_size=1 \
        actor_rollout_ref.rollout.gpu_memory_utilization=0.5 actor_rollout_ref.rollout.calculate_log_probs=True \
        actor_rollout_ref.rollout.agent.agent_loop_config_path=gem.yaml \
        trainer.n_gpus_per_node=8 trainer.nnodes=1 trainer.total_training_steps=500 \
        trainer.logger=[console] trainer.save_freq=50 trainer.test_freq=10

Instead of ``algorithm.adv_estimator=gem_rebn algorithm.gamma=0.9``:

- REINFORCE: ``algorithm.adv_estimator=gem_reinforce algorithm.gamma=0.9``
- GRPO: ``algorithm.adv_estimator=gem_grpo actor_rollout_ref.rollout.n=8``, with 16 for both batch sizes
- PPO: ``algorithm.adv_estimator=gae algorithm.gamma=0.9 algorithm.lam=0.95 critic.model.path=Qwen/Qwen3-1.7B``

A response may have 4,096 tokens (``gem.yaml``). For Qwen3-4B name it as the path; nothing else changes. Without
thinking, for shorter turns: ``+data.apply_chat_template_kwargs.enable_thinking=False``.

An episode that failed is played again; after ``attempts`` failures the error is raised, and verl's trainer goes on with
the other episodes of the group. It never becomes a reward of 0. What verl cannot take: images, several agents, the
value of what would have followed an episode that was cut off (its last turn counts as the end), and more than one
sequence for an episode: a chat template that rewrites earlier turns, as those that drop reasoning, is refused with the
setting that helps. ``algorithm.rollout_correction.rollout_rs`` by tokens would split turns; by sequences it may be
used, and so may ``rollout_is``. verl's legacy trainer (``trainer.use_v1=False``) gets the sum of the rewards alone.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import re
import shlex
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from uuid import uuid4

import numpy as np
import torch
from verl.experimental.agent_loop.agent_loop import AgentLoopBase, AgentLoopMetrics, AgentLoopOutput, register
from verl.trainer.ppo import core_algos

import gem_core as gem
from gem_core.errors import ArgumentError, ContextOverflowError, EnvFaultError
from gem_train.adapters import Generated, TokenAgent, TrialEngine, trial_tokenizer
from gem_train.adapters.trial import check, check_sequence
from gem_train.estimators import (
    discounted_returns,
    gae,
    grpo_advantages,
    normalize_advantages,
    return_batch_normalization,
)
from gem_train.tokens import batches, completions

AGENT_LOOPS = """
- name: gem
  _target_: verl_agent_loop.GemAgentLoop
  attempts: 3
  max_turn_tokens: 4096
"""

# The algorithms: by turns, for verl's tensors of tokens.


class Turns:
    """The turns of a batch of verl: runs of sampled tokens in its response mask, E rows with at most T of them.

    Args:
        rewards: float (E, L), of tokens; those from a turn's first token to the next turn's are the turn's.
        response_mask: (E, L), 1 on sampled tokens.
    """

    def __init__(self, rewards: torch.Tensor, response_mask: torch.Tensor) -> None:
        self.sampled = response_mask.bool()
        before = torch.nn.functional.pad(self.sampled, (1, 0))[:, :-1]
        number = (self.sampled & ~before).cumsum(dim=1)  # of each token's turn, from 1; 0 before the first
        self.turn = (number - 1).clamp(min=0)
        count = int(number.max()) if number.numel() else 0
        self.mask = torch.arange(count, device=number.device) < number[:, -1:]
        self.first = self.sampled & ~before
        self.rewards = self._by_turn(rewards)

    def _by_turn(self, tokens: torch.Tensor) -> torch.Tensor:
        """Sum tokens (E, L) to turns (E, T)."""
        sums = torch.zeros(self.mask.shape, dtype=tokens.dtype, device=tokens.device)
        return sums.scatter_add(1, self.turn, tokens) if sums.numel() else sums

    def values(self, tokens: torch.Tensor) -> torch.Tensor:
        """Return the critic's value before each turn, (E, T): that of its first token."""
        return self._by_turn(tokens * self.first)

    def to_tokens(self, turns: torch.Tensor) -> torch.Tensor:
        """Give each sampled token the value of its turn, (E, L)."""
        return turns.gather(1, self.turn) * self.sampled if turns.numel() else torch.zeros_like(self.turn).to(turns)


@core_algos.register_adv_est("gem_reinforce")
def reinforce(
    token_level_rewards: torch.Tensor, response_mask: torch.Tensor, config: Any, **_: Any
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the discounted return of each turn, as advantages and as returns."""
    turns = Turns(token_level_rewards, response_mask)
    returns = turns.to_tokens(discounted_returns(turns.rewards, turns.mask, gamma=config.gamma))
    return returns, returns


@core_algos.register_adv_est("gem_rebn")
def rebn(
    token_level_rewards: torch.Tensor, response_mask: torch.Tensor, config: Any, **_: Any
) -> tuple[torch.Tensor, torch.Tensor]:
    """Normalize the returns over all turns of the batch."""
    turns = Turns(token_level_rewards, response_mask)
    returns = discounted_returns(turns.rewards, turns.mask, gamma=config.gamma)
    return turns.to_tokens(return_batch_normalization(returns, turns.mask)), turns.to_tokens(returns)


@core_algos.register_adv_est("gem_grpo")
def grpo(
    token_level_rewards: torch.Tensor, response_mask: torch.Tensor, config: Any, index: Any, **_: Any
) -> tuple[torch.Tensor, torch.Tensor]:
    """Compare the return of each episode with those of its group; rows without a token are padding of verl's."""
    turns = Turns(token_level_rewards, response_mask)
    groups = torch.as_tensor(np.unique(index, return_inverse=True)[1], device=turns.mask.device)
    scale = "std" if config.get("norm_adv_by_std_in_grpo", True) else "none"
    present = turns.mask.any(dim=1)
    advantages = grpo_advantages(turns.rewards.sum(dim=1), groups, scale=scale, learnable=present)
    tokens = turns.to_tokens(advantages[:, None] * turns.mask)
    return tokens, tokens


def turn_level_gae(
    token_level_rewards: torch.Tensor, values: torch.Tensor, response_mask: torch.Tensor, gamma: float, lam: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return generalized advantages over turns, normalized, and the target of each token's value: that of its turn."""
    turns = Turns(token_level_rewards, response_mask)
    nothing = torch.zeros(len(values), dtype=values.dtype, device=values.device)
    with torch.no_grad():
        advantages, targets = gae(
            turns.rewards, turns.values(values), turns.mask, nothing == 0, nothing, gamma=float(gamma), lam=float(lam)
        )
        return turns.to_tokens(normalize_advantages(advantages, turns.mask)), turns.to_tokens(targets)


# verl hands the critic's values to its own estimator "gae" alone, so ours takes its place where this file is loaded.
core_algos.compute_gae_advantage_return = turn_level_gae


# The episodes.


class TurnRewards(AgentLoopOutput):
    """An episode whose rewards are on the last tokens of their turns, not all on the last one.

    Args:
        token_rewards: One for each token of ``response_ids``.
    """

    token_rewards: list[float]

    def as_dict(self) -> dict[str, Any]:
        """Return what verl's trainer stores."""
        output: dict[str, Any] = super().as_dict()
        output["rm_scores"] = torch.tensor(output.pop("token_rewards"), dtype=torch.float32)
        return output


@register("gem")
class GemAgentLoop(AgentLoopBase):
    """Plays the episode of a row: ``extra_info`` holds ``env_id``, ``seed``, and ``options`` and ``kwargs`` as JSON.

    All samples of a row (``rollout.n``) have its seed, so that a group shares one start.
    """

    def __init__(self, *args: Any, attempts: int = 3, max_turn_tokens: int = 4096, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.attempts, self.max_turn_tokens = attempts, max_turn_tokens

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
            room = min(most - len(prompt_ids), self.max_turn_tokens)
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
        batch = batches([episode], form="trajectories")
        rows = completions(batch)
        if len(rows) != 1:
            raise ArgumentError(
                f"the episode is in {len(rows)} sequences and verl takes one: the template rewrites earlier turns. "
                "Set actor_rollout_ref.model.custom_chat_template to one that keeps them, or "
                "data.apply_chat_template_kwargs"
            )
        row, turn_scores = rows[0], [turn.reward for turn in episode.transitions]
        first = len(row.prompt_ids)
        success = math.nan if episode.success is None else float(episode.success)
        return TurnRewards(
            token_rewards=batch.to_last_tokens(batch.rewards)[0, first : first + len(row.completion_ids)].tolist(),
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


def write_rows(folder: Path, env_id: str, kwargs: str, train: int, val: int, seed: int) -> None:
    """Write ``train.parquet``, ``val.parquet`` and ``gem.yaml``.

    A row is a task: of a data set by its index, the last ones for validation; of any other environment by its seed.
    """
    import pandas as pd

    with gem.make(env_id, **json.loads(kwargs)) as env:
        tasks = env.get_wrapper_attr("num_tasks")
    if tasks is not None:
        train = min(train, tasks - val)
        if train < 1:
            raise ArgumentError(f"{env_id} has {tasks} tasks, and {val} are for validation; give a smaller --val")
    places = {"train": range(train), "val": range(train, train + val) if tasks is None else range(tasks - val, tasks)}
    for name, numbers in places.items():
        table = [
            {
                "data_source": env_id,
                "agent_name": "gem",
                "prompt": [{"role": "user", "content": f"(the task comes from {env_id})"}],
                "reward_model": {"style": "rule", "ground_truth": ""},
                "extra_info": {
                    "env_id": env_id,
                    "seed": seed + number,
                    "index": number,
                    "options": "" if tasks is None else json.dumps({"index": number}),
                    "kwargs": kwargs,
                },
            }
            for number in numbers
        ]
        pd.DataFrame(table).to_parquet(folder / f"{name}.parquet")
    (folder / "gem.yaml").write_text(AGENT_LOOPS)


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


def printed_commands() -> dict[str, list[str]]:
    """Return the overrides of each command above, by algorithm."""
    text = str(__doc__)
    command = text[text.index("python -m verl.trainer.main_ppo") : text.index("Instead of")].replace("\\\n", " ")
    rebn = shlex.split(command)[3:]
    others = {name: shlex.split(line) for name, line in re.findall(r"^- (\w+): ``(.*?)``", text, re.MULTILINE)}
    return {"ReBN": rebn, **{name: [*rebn[2:], *overrides] for name, overrides in others.items()}}


def check_commands(folder: str) -> None:
    """Compose each printed command with verl's own configuration, and let verl's own check read it.

    Args:
        folder: For files that stand for those of the model, which the check of a critic reads.
    """
    import verl.trainer
    from hydra import compose, initialize_config_dir
    from transformers import Qwen3Config
    from verl.trainer.ppo.utils import need_critic, need_reference_policy
    from verl.utils.config import validate_config

    Qwen3Config(architectures=["Qwen3ForCausalLM"]).save_pretrained(folder)
    trial_tokenizer().save_pretrained(folder)
    commands = printed_commands()
    commands["GRPO"] += ["data.train_batch_size=16", "actor_rollout_ref.actor.ppo_mini_batch_size=16"]
    for name, overrides in commands.items():
        with initialize_config_dir(str(Path(verl.trainer.__file__).parent / "config"), version_base=None):
            config = compose("ppo_trainer", [each.replace("Qwen/Qwen3-1.7B", folder) for each in overrides])
        validate_config(config, need_reference_policy(config), need_critic(config))
        estimator = config.algorithm.adv_estimator
        known = estimator == "gae" or core_algos.get_adv_estimator_fn(estimator) is not None
        check(known and need_critic(config) == (name == "PPO"), f"verl takes the command of {name}")
    check(list(commands) == ["ReBN", "REINFORCE", "GRPO", "PPO"], "there is a command for each algorithm")


def check_algorithms() -> None:
    """Let verl's own function compute advantages of two groups, and compare them with ``gem_train.estimators``."""
    from verl import DataProto
    from verl.trainer.config import AlgoConfig
    from verl.trainer.ppo.v1.utils import compute_advantage_for_multi_trajectories

    spans = [[(0, 3), (5, 7), (8, 9)], [(0, 2)], [(1, 2), (4, 9)], [(0, 4), (6, 7)]]  # of tokens, for each turn
    rewards, mask = torch.zeros(4, 3, dtype=torch.float64), torch.zeros(4, 3, dtype=torch.bool)
    draws = torch.Generator().manual_seed(1)
    values = torch.rand(4, 10, generator=draws, dtype=torch.float64)
    sampled, scores = torch.zeros(4, 10, dtype=torch.int64), torch.zeros(4, 10, dtype=torch.float64)
    turn_values = torch.zeros(4, 3, dtype=torch.float64)
    for row, turns in enumerate(spans):
        for turn, (start, end) in enumerate(turns):
            sampled[row, start:end], mask[row, turn] = 1, True
            rewards[row, turn] = scores[row, end - 1] = torch.rand(1, generator=draws, dtype=torch.float64)
            turn_values[row, turn] = values[row, start]

    def tokens(by_turn: torch.Tensor) -> torch.Tensor:
        spread = torch.zeros(4, 10, dtype=torch.float64)
        for row, turns in enumerate(spans):
            for turn, (start, end) in enumerate(turns):
                spread[row, start:end] = by_turn[row, turn]
        return spread

    def by_verl(estimator: str) -> tuple[torch.Tensor, torch.Tensor]:
        tensors = {"token_level_rewards": scores, "response_mask": sampled, "values": values}
        data = DataProto.from_dict(tensors, non_tensors={"uid": np.array(["b", "b", "a", "a"], dtype=object)})
        config = AlgoConfig(gamma=0.9, lam=0.8, adv_estimator=estimator)
        keys = ["b_0_0", "b_1_0", "a_0_0", "a_1_0"]  # item, episode of its group, sequence
        made = compute_advantage_for_multi_trajectories(data, keys, estimator, 0.9, 0.8, config=config).batch
        return made["advantages"], made["returns"]

    ended, nothing = torch.ones(4, dtype=torch.bool), torch.zeros(4, dtype=torch.float64)
    returns = discounted_returns(rewards, mask, gamma=0.9)
    advantages, targets = gae(rewards, turn_values, mask, ended, nothing, gamma=0.9, lam=0.8)
    relative = grpo_advantages(rewards.sum(dim=1), torch.tensor([1, 1, 0, 0]))[:, None] * mask
    expected = {
        "gem_reinforce": (returns, returns),
        "gem_rebn": (return_batch_normalization(returns, mask), returns),
        "gem_grpo": (relative, relative),
        "gae": (normalize_advantages(advantages, mask), targets),
    }
    for estimator, wanted in expected.items():
        found = by_verl(estimator)
        same = all(torch.equal(one, tokens(other)) for one, other in zip(found, wanted, strict=True))
        check(same, f"verl's trainer gets the numbers of gem_train from {estimator}")


async def check_episode() -> None:
    """Play an episode through verl's classes and check it token by token."""
    engine = TrialEngine(trial_tokenizer(), [r"\boxed{1 2}", r"\boxed{4 1}", r"\boxed{4 6}"])
    loop = trial_loop(engine)
    row = {"env_id": "game:Mastermind-v0-easy", "seed": 3}
    output = await loop.run({"temperature": 1.0, "logprobs": True}, extra_info=row)
    ids, before = output.prompt_ids + output.response_ids, [0] * len(output.prompt_ids)
    check_sequence(engine, ids, before + output.response_mask, before + output.response_logprobs)
    check(output.extra_fields["turn_scores"] == [0.0, 0.5, 0.5], "the rewards of the turns are logged")
    stored = output.as_dict()
    turns = Turns(stored["rm_scores"][None], stored["response_mask"][None])
    check(turns.rewards.tolist() == [[0.0, 0.5, 0.5]], "verl's trainer finds each reward in its turn")
    check(float(stored["rm_scores"].sum()) == output.reward_score == 1.0, "their sum is the score")
    output = await trial_loop(engine, response_length=5).run({}, extra_info=row)
    check(len(output.response_ids) == 5 and output.response_mask == [1] * 5, "max_response_length cuts a response off")
    check(output.extra_fields["reward_extra_info"]["truncated"] == 0.0, "which is answered as it is")
    print(engine.tokenizer.decode(ids))


def check_rows(folder: str) -> None:
    """Write rows into a folder, and read them with verl's own data set."""
    from omegaconf import OmegaConf
    from verl.utils.dataset.rl_dataset import RLHFDataset

    write_rows(Path(folder), "game:Mastermind-v0-easy", '{"max_turns": 4}', train=3, val=2, seed=5)
    config = OmegaConf.create({"max_prompt_length": 1024, "cache_dir": folder})
    rows = RLHFDataset(str(Path(folder, "val.parquet")), trial_tokenizer(), config)
    check([rows[place]["extra_info"]["seed"] for place in range(len(rows))] == [8, 9], "verl reads the rows")


def main() -> None:
    """Write rows for training, or try everything that needs no GPU."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    commands = parser.add_subparsers(dest="command")
    rows = commands.add_parser("rows", help="write train.parquet, val.parquet and gem.yaml into this folder")
    rows.add_argument("env_id")
    rows.add_argument("--kwargs", default="{}", help="""of the environment: '{"wrappers": "python"}'""")
    rows.add_argument("--train", type=int, default=4096, help="tasks to train on (default: 4096)")
    rows.add_argument("--val", type=int, default=128, help="other tasks, for validation (default: 128)")
    rows.add_argument("--seed", type=int, default=0, help="seed of the first task (default: 0)")
    given = parser.parse_args()
    if given.command == "rows":
        write_rows(Path(), given.env_id, given.kwargs, given.train, given.val, given.seed)
        return
    with tempfile.TemporaryDirectory() as folder:
        check_commands(folder)
        check_rows(folder)
    check_algorithms()
    asyncio.run(check_episode())


if __name__ == "__main__":
    sys.modules["verl_agent_loop"] = sys.modules["__main__"]  # verl names it so, and must not load it a second time
    main()
