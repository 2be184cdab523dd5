# /// script
# requires-python = ">=3.11"
# dependencies = ["skyrl-gym>=0.4,<0.5", "gem-core", "gem-games", "gem-train"]
# [tool.gem.table]
# framework = 'SkyRL-gym'
# rewards = 'yes, on the last token of each response'
# images = 'no'
# groups = '`n_samples_per_prompt`'
# tools = 'in text'
# failures = 'played again, then raised'
# ///
r"""GEM environments in SkyRL: an environment of SkyRL-gym around any id, rows of data for it, and the trainer's start.

Framework: SkyRL-gym 0.4 (``skyrl-gym``); the trainer is ``skyrl`` 0.4, Python 3.12.

Here, on a CPU: the environment, registered, made and stepped by SkyRL-gym, as its generator does it::

    python examples/trainers/skyrl_env.py  # in an environment of its own: make trainers ARGS=skyrl_env

On GPUs (``pip install "skyrl[fsdp]" gem-core gem-games gem-train``): write rows, then train. Every option of SkyRL's is
one here; ``environment.env_class=gem`` and ``generator.max_turns`` (1 by default) matter::

    python skyrl_env.py rows "game:GuessTheNumber-v0" 1000 > train.jsonl
    python skyrl_env.py rows "game:GuessTheNumber-v0" 100 1000 > validation.jsonl  # the seeds from 1000
    python skyrl_env.py rows "game:GuessTheNumber-v0" 1000 0 '{"wrappers": ["python"]}' > with_a_tool.jsonl
    python skyrl_env.py data.train_data="['train.jsonl']" data.val_data="['validation.jsonl']" \
        environment.env_class=gem generator.batched=false generator.max_turns=10 generator.n_samples_per_prompt=8 \
        trainer.algorithm.advantage_estimator=grpo trainer.policy.model.path=Qwen/Qwen3-1.7B trainer.strategy=fsdp

What it can take: rewards per turn. Each stands on the last token of its response (GRPO sums them; ``gae`` and
``reinforce++`` use them where they are), and ``generator.step_wise_trajectories=true`` makes a sample of every turn.

What it cannot take, and what happens then:

- Native tool calls: its environments read text. GEM explains the tools in the first message and reads calls from text.
- An episode whose environment failed: SkyRL-gym has no mark for it, so ``step`` raises ``EnvFaultError``, and the
  trainer's generator below plays the row again from its start, twice at most; then the run stops with the error. It is
  never a reward of 0.
- ``generator.max_turns``: the last response that it allows ends the episode (``done``) and closes the environment. One
  that its ``max_input_length`` ends is closed by the generator; one whose generation failed, when it is collected.
- Images: ``init`` raises. Several agents: one seat by ``gem.single_agent``, in an environment that you register.
"""

import asyncio
import json
import sys
from pathlib import Path

import skyrl_gym
from skyrl_gym.envs.base_text_env import BaseTextEnv, BaseTextEnvStepOutput

import gem_core as gem
from gem_core.errors import EnvFaultError
from gem_train import ChatSession
from gem_train.adapters.trial import FailsOnce, check, register_trial_envs


class GemTextEnv(BaseTextEnv):
    """An environment of GEM. A row says which: ``{"gem": {"id", "seed", "options", "kwargs"}}``, see ``rows``.

    SkyRL calls it from plain code, in threads of its own.
    """

    def __init__(self, env_config=None, extras=None):
        super().__init__()
        extras = extras or {}
        try:
            self.start = json.loads(extras["gem"]) if isinstance(extras["gem"], str) else extras["gem"]
        except KeyError:
            raise ValueError('a row needs {"gem": {"id": …, "seed": …}}; the command rows writes some') from None
        self.max_turns = extras.get("max_turns", 10)
        self.session = ChatSession(self.start["id"], **(self.start.get("kwargs") or {}))

    def init(self, prompt):
        """Begin the episode; the prompt of the row, which has the same words, gives way to the environment's."""
        messages = self.session.reset_sync(self.start["seed"], self.start.get("options"))
        return text_only(messages), {"seed": self.session.episode.seed}

    def step(self, action):
        """Hand a whole response to the environment."""
        self.turns += 1
        step = self.session.step_sync(action)
        if step.error is not None:
            self.close()
            raise EnvFaultError(f"{self.start['id']}: {step.error['message']}")
        done = step.done or self.turns >= self.max_turns
        if done:
            self.close()
        return BaseTextEnvStepOutput(
            observations=text_only(step.messages),
            reward=step.reward,
            done=done,
            metadata={"terminated": step.terminated},
        )

    def get_metrics(self):
        """Return numbers of the episode; SkyRL logs their means."""
        metrics = {"return": self.session.episode_return, "turns": self.turns}
        return metrics if self.session.success is None else {**metrics, "success": float(self.session.success)}

    def close(self):
        """Close the environment."""
        self.session.close()


def text_only(messages):
    """Return messages, which are to be text."""
    if any(not isinstance(message["content"], str) for message in messages):
        raise ValueError("this environment shows images, and SkyRL-gym takes text only")
    return messages


def rows(env_id, count=None, first=0, **kwargs):
    """Yield ``count`` rows of an environment, each with a seed of its own, by default one for each task of a data set.

    Equal rows start alike; a group is one row, ``generator.n_samples_per_prompt`` times.
    """
    env = gem.make(env_id, **kwargs)
    tasks = env.unwrapped.num_tasks
    with ChatSession(env) as session:
        for number in range(first, first + (count or tasks or 10)):
            options = {"index": number % tasks} if tasks else None
            prompt = text_only(session.reset_sync(number, options))
            # As JSON, since the columns of a table cannot differ from row to row.
            start = json.dumps({"id": env_id, "seed": number, "options": options, "kwargs": kwargs})
            yield {"data_source": env_id, "prompt": prompt, "env_class": "gem", "gem": start}


def register():
    """Tell SkyRL-gym of the environment, in the process that plays."""
    skyrl_gym.register(id="gem", entry_point=GemTextEnv)


# The trainer, on GPUs.


def patient(generator_class, retries=2):
    """Return a generator of SkyRL that plays a row again whose environment failed."""

    class PatientGenerator(generator_class):
        async def agent_loop(self, *arguments, **options):
            for left in reversed(range(retries + 1)):
                try:
                    return await super().agent_loop(*arguments, **options)
                except EnvFaultError:
                    if not left:
                        raise

    return PatientGenerator


def train(options):
    """Start SkyRL's trainer with its own options."""
    import ray
    from skyrl.train.config import SkyRLTrainConfig
    from skyrl.train.utils import initialize_ray, validate_cfg

    config = SkyRLTrainConfig.from_cli_overrides(options)
    validate_cfg(config)
    initialize_ray(config)
    ray.get(ray.remote(num_cpus=1)(run_trainer).remote(config))


def run_trainer(config):
    """Register the environment and train, in a process of Ray's."""
    from skyrl.train.entrypoints.main_base import BasePPOExp

    class Experiment(BasePPOExp):
        def get_generator(self, *arguments):
            generator = super().get_generator(*arguments)
            generator.__class__ = patient(type(generator))
            return generator

    register()
    Experiment(config).run()


# What this file does here: SkyRL-gym's part of an episode, with a scripted model.


class ScriptedGenerator:
    """Calls an environment as SkyRL's generator does, with a model that bisects and calls a tool once."""

    def __init__(self, max_turns):
        sys.path.append(str(Path(__file__).resolve().parents[1]))
        import scripted_server

        self.max_turns, self.answer = max_turns, scripted_server.answer

    async def agent_loop(self, prompt, env_class, env_extras):
        """Play one row; return the rewards of its turns, the chat and the metrics."""
        env = skyrl_gym.make(env_class, env_config={}, extras={**env_extras, "max_turns": self.max_turns})
        chat, _ = env.init(prompt)
        same = chat == prompt
        rewards, done = [], False
        while not done:
            await asyncio.sleep(0)  # to other episodes, as while a model generates
            offered = "multiply" in chat[0]["content"] and len(chat) == 1
            said = CALL if offered else self.answer(chat, None)[0]
            step = env.step(said)
            chat = [*chat, {"role": "assistant", "content": said}, *step["observations"]]
            rewards, done = [*rewards, step["reward"]], step["done"]
        env.close()
        return {"rewards": rewards, "chat": chat, "metrics": env.get_metrics(), "as in the row": same}


CALL = '<tool_call>{"name": "multiply", "arguments": {"left": 6, "right": 7}}</tool_call>'


async def main():
    """Play rows at once, and check what came back."""
    register_trial_envs()
    register()
    game = list(rows("game:GuessTheNumber-v0", 3))
    batch = [*game, game[0], *rows("trial:Product-v0"), *rows("trial:FailsOnce-v0")]
    generator = patient(ScriptedGenerator)(max_turns=4)
    results = await asyncio.gather(*(generator.agent_loop(row["prompt"], row["env_class"], row) for row in batch))
    for row, result in zip(batch, results, strict=True):
        print(f"{row['gem']}: rewards {result['rewards']}, {result['metrics']}")
    first, cut, _, again, tool, flaky = results
    check(all(result["as in the row"] for result in results), "the prompt of a row is what its seed starts")
    check(first["chat"] == again["chat"], "equal rows go alike")
    check(first["chat"] != cut["chat"] and first["rewards"] == [0, 0, 1], "episodes that are played at once do not mix")
    check(cut["rewards"] == [0, 0, 0, 0] and cut["metrics"]["success"] == 0, "max_turns ends an episode")
    check(tool["rewards"] == [0.25, 1], "a tool is called in the text")
    check(flaky["rewards"] == [1] and FailsOnce.failures == 1, "a failed environment is played again, not scored")
    try:
        skyrl_gym.make("gem", env_config={}, extras={"gem": {"id": "game:GuesTheNumber-v0", "seed": 0}})
        check(False, "a wrong id is an error")
    except gem.GemError as error:
        check("Did you mean" in str(error), "a wrong id is an error that names the right one")


if __name__ == "__main__":
    match sys.argv[1:]:
        case []:
            asyncio.run(main())
        case ["rows", env_id, *rest]:
            count, first, kwargs = (*rest, *("0", "0", "{}")[len(rest) :])
            for row in rows(env_id, int(count), int(first), **json.loads(kwargs)):
                print(json.dumps(row))
        case options:
            train(options)
