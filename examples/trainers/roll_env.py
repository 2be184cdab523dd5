# /// script
# requires-python = ">=3.11"
# dependencies = ["transformers", "jinja2", "gem-core", "gem-games", "gem-train"]
# [tool.gem.table]
# framework = 'ROLL'
# tried = 'stand-ins'
# rewards = 'yes, with `StepManager`'
# images = 'no'
# groups = '`group_size`'
# tools = 'in text'
# failures = 'a filter drops its group'
# ///
r"""ROLL (8eb27cc): GEM environments for its environment managers, without a fork of ROLL or of ``gem``.

ROLL makes its environments by ``gem.make`` of the package ``gem-llm``, which its requirements install. This file
registers ``RollEnv`` there as ``gem_core``; every worker imports it, because the YAML names its manager. ``gem-llm``
and ``gem-core`` live side by side: one is imported as ``gem``, the other as ``gem_core``. ROLL has no package and needs
GPUs: here stand-ins of its manager and of ``gem``, with the same calls in the same order, and an engine that writes
known tokens drive the environment::

    python scripts/trainers.py roll_env
    python examples/trainers/roll_env.py  # where what it needs is installed

On GPUs, from a checkout of ROLL, with ``PYTHONPATH=/path/to/examples/trainers`` and in the YAML of an agentic
pipeline, where ``StepManager`` instead of ``TrajManager`` gives one sample a turn, with its own reward::

    custom_envs:
      GuessTheNumber:
        env_type: gem_core
        max_steps: 20
        max_tokens_per_step: 512
        env_manager_cls: roll_env.TrajManager
        agent_system_template: You are a careful player.
        agent_template: "{observation}"
        env_config: {env: "game:GuessTheNumber-v0"}
    train_env_manager:
      group_filter_cls: roll_env.LeaveOutErrors
      tags: [GuessTheNumber]

then ``python examples/start_agentic_pipeline.py --config_path … --config_name …``.

What ROLL cannot take: images, several agents and native tool calls (the text explains tools, and ROLL shows their
results under the role ``tool``). Only ``terminated`` ends an episode there, so that a truncated one is given both
flags, and nothing is bootstrapped. The members of a group are reset with one seed and so share a start. An episode
that failed carries the metric ``gem_error``, and ``LeaveOutErrors`` drops its whole group; it never becomes a reward
of 0.
"""

from __future__ import annotations

import asyncio
import importlib.util
import sys
from types import ModuleType
from typing import Any

from gem_core import Response
from gem_core.errors import EnvFaultError
from gem_train.adapters import ChatSession, ChatTemplate, TrialEngine, trial_tokenizer
from gem_train.adapters.trial import check, check_sequence

ATTEMPTS = 3


class RollEnv:
    """One environment, with the results that ROLL's managers read.

    Args:
        env: Id of the environment.
        end_tokens: Special tokens that end a response; ROLL keeps them in its text.
        **kwargs: For the environment.
    """

    def __init__(self, env: str, end_tokens: tuple[str, ...] = ("<|im_end|>", "<|endoftext|>"), **kwargs: Any) -> None:
        self.session = ChatSession(env, **kwargs)
        self.end_tokens = end_tokens

    def reset(self, seed: int | None = None) -> tuple[str, dict[str, Any]]:
        """Begin an episode; an observation of None would tell ROLL that there are no more tasks."""
        for attempt in range(1, ATTEMPTS + 1):
            try:
                messages = self.session.reset_sync(seed)
                break
            except EnvFaultError:
                if attempt == ATTEMPTS:
                    raise
        system = "\n".join(each["content"] for each in messages if each["role"] == "system")
        return messages[-1]["content"], {"env_instruction": system} if system else {}

    def step(self, action: str) -> tuple[str, float, bool, bool, dict[str, Any]]:
        """Answer a response."""
        end = next((token for token in self.end_tokens if action.endswith(token)), "")
        step = self.session.step_sync(Response(action.removesuffix(end), finish_reason="stop" if end else "length"))
        metrics = {
            "action_is_valid": float(step.info.get("parsed_action", "") is not None),
            "success": float(bool(self.session.success)),
            "truncated": float(step.truncated),
            "gem_error": float(step.error is not None),
        }
        # Only what the managers read: they write all of it into their own record of the turn.
        info = {
            "metrics": metrics,
            "metrics_agg_mode": {"success": "last", "truncated": "last", "gem_error": "max"},
            "use_tool": "tool" in step.info,
        }
        observation = step.messages[-1]["content"] if step.messages else ""
        return observation, step.reward, step.done, step.truncated, info

    def close(self) -> None:
        """Close the environment."""
        self.session.close()


class LeaveOutErrors:
    """ROLL's ``group_filter_cls``: drops a group in which an episode failed."""

    def __init__(self, config: Any, env_manager_config: Any, mode: str) -> None:
        pass

    def filter(self, group_id: int, episode_id: int, group: list[Any]) -> bool:
        """Tell whether a group is dropped."""
        metrics = [rollout.meta_info["metrics"] for rollout in group]
        return any(value for each in metrics for name, value in each.items() if name.endswith("/gem_error"))


def serve_gem() -> ModuleType:
    """Return the module ``gem``, or for a trial without it a stand-in, with ``gem_core`` registered in it."""
    if importlib.util.find_spec("gem") is None and "gem" not in sys.modules:
        served, entries = ModuleType("gem"), {}

        def register(env_id: str, entry_point: Any, **kwargs: Any) -> None:
            entries[env_id] = entry_point, kwargs

        def make(env_id: str, **kwargs: Any) -> Any:
            entry_point, registered = entries[env_id]
            if isinstance(entry_point, str):
                module, _, name = entry_point.partition(":")
                entry_point = getattr(importlib.import_module(module), name)
            return entry_point(**registered | kwargs)

        served.register, served.make, served.Env = register, make, RollEnv
        sys.modules["gem"] = served
    import gem

    gem.register("gem_core", entry_point=RollEnv)
    return gem


serve_gem()  # before ROLL's managers, which make environments with it

if importlib.util.find_spec("roll") is not None:  # the YAML names these, so that this file is imported
    from roll.pipeline.agentic.env_manager.step_env_manager import StepEnvManager as StepManager  # noqa: F401
    from roll.pipeline.agentic.env_manager.traj_env_manager import TrajEnvManager as TrajManager  # noqa: F401


# A trial without a GPU.


class TrialManager:
    """Stands for ROLL's manager of one environment: its seeds, its calls of it, and its record of an episode."""

    def __init__(self, engine: TrialEngine, group_seed: int, max_steps: int = 10, **env_config: Any) -> None:
        import gem

        self.engine, self.template, self.max_steps = engine, ChatTemplate(engine.tokenizer), max_steps
        self.env, self.group_seed = gem.make(env_id="gem_core", **env_config), group_seed

    def play(self, episode_id: int) -> dict[str, Any]:
        """Play an episode; return what a sample is made of: ids, mask, log-probabilities, rewards, metrics."""
        observation, info = self.env.reset(seed=self.group_seed + episode_id)
        ids, mask, logprobs, rewards, history = [], [], [], [], []
        terminated, use_tool = False, False
        while not terminated:
            message = {"role": "tool" if use_tool else "user", "content": observation}
            added = self.template.encode(("\n" if ids else "") + self.template.render([message]))
            made = asyncio.run(self.engine(ids + added, max_tokens=50))
            text = self.engine.tokenizer.decode(made.token_ids, skip_special_tokens=False)
            observation, reward, terminated, _, info = self.env.step(action=text)
            terminated = terminated or len(rewards) + 1 >= self.max_steps
            ids = ids + added + list(made.token_ids)
            mask += [0] * len(added) + [1] * len(made.token_ids)
            logprobs += [0.0] * len(added) + list(made.logprobs)
            rewards.append(reward)
            use_tool = info["use_tool"]
            history.append(info["metrics"])
        return {"ids": ids, "mask": mask, "logprobs": logprobs, "rewards": rewards, "metrics": history}


def main() -> None:
    """Play a group of two episodes, and check them token by token."""
    texts = [r"\boxed{1 2}", r"\boxed{4 1}", r"\boxed{4 6}"]
    starts = []
    for _ in range(2):
        engine = TrialEngine(trial_tokenizer(), texts)
        made = TrialManager(engine, group_seed=2, env="game:Mastermind-v0-easy").play(episode_id=1)
        check_sequence(engine, made["ids"], made["mask"], made["logprobs"])
        check(made["rewards"] == [0.0, 0.5, 0.5], "each turn has its reward")
        check(made["metrics"][-1]["success"] == 1.0 and not made["metrics"][-1]["gem_error"], "success is a metric")
        starts.append(engine.calls[0][0])
    check(starts[0] == starts[1], "the members of a group share their start")
    engine = TrialEngine(trial_tokenizer(), texts)
    limited = TrialManager(engine, 2, env="game:Mastermind-v0-easy", wrappers=[("turn_limit", {"max_turns": 2})]).play(
        1
    )
    check(
        len(limited["rewards"]) == 2 and limited["metrics"][-1]["truncated"] == 1.0,
        "a truncated episode ends there too",
    )
    print(engine.tokenizer.decode(made["ids"]))


if __name__ == "__main__":
    main()
