# /// script
# requires-python = ">=3.12"
# dependencies = ["verifiers>=0.4,<0.5", "uv", "gem-core", "gem-games", "gem-train"]
# [tool.gem]
# python = "3.12"
# [tool.gem.table]
# framework = 'verifiers'
# rewards = 'summed; listed in `trace.info`'
# images = 'as data URLs'
# groups = '`-r`, `group_size`'
# tools = 'in text'
# failures = 'left out, as an error of the trace'
# ///
r"""GEM environments in verifiers and prime-rl: a v1 taskset, and the environment that plays its tasks.

Framework: verifiers 0.4 (``verifiers.v1``; the older interface is gone), the environments of prime-rl.

Here, on a CPU: real episodes of ``GemEnv`` against a scripted chat server on the loopback, which streams::

    python examples/trainers/verifiers_v1.py  # in an environment of its own: make trainers ARGS=verifiers_v1

This file is the package that verifiers asks for: a module that can be imported, whose ``__all__`` names a taskset and
an environment. With it on ``PYTHONPATH``, evaluate any model::

    vf-eval verifiers_v1 -m MODEL -n 20 -r 8 --env.taskset.env-id game:GuessTheNumber-v0 --no-push \
        --env.player.runtime.type subprocess --client.base-url http://localhost:8000/v1 --client.api-key-var KEY

and train on GPUs with prime-rl (``uv run rl @ rl.toml``), where the source is::

    [[orchestrator.train.source]]
    name = "gem"
    env.taskset = {id = "verifiers_v1", env_id = "game:GuessTheNumber-v0"}
    env.player.runtime.type = "subprocess"

verifiers' own taskset ``openenv`` plays OpenEnv servers without this file, with each observation as JSON beside the
schema of an action.

What it cannot take, and what happens then:

- Rewards per turn: a trace has named scalars. ``gem`` is the sum of the rewards; those of the turns are in
  ``trace.info["gem"]["rewards"]``, with the seed, the success and how the episode ended.
- Native tool calls: the harness ``null`` offers the model no tools of ours. GEM explains them in the text and reads
  calls from it.
- An episode whose environment failed raises in ``run``: the trace and the episode bear the error, ``ok`` is False and
  no reward is recorded; prime-rl leaves such episodes out, and ``--env.retries.max-retries 2`` plays them again.
- An episode that the agent's ``max_turns`` or tokens end keeps the rewards that it has. Empty responses are responses.
- Images go to the model as they come (as data URLs). Several agents: one seat by ``gem.single_agent``, in an
  environment that you register.
"""

import asyncio
import itertools
import os
import sys
import threading
from pathlib import Path
from typing import Any

import verifiers.v1 as vf
from pydantic import Field

import gem_core as gem
from gem_train.adapters import ChatSession, images_as_urls
from gem_train.adapters.trial import check, register_trial_envs

__all__ = ["GemEnv", "GemTaskset"]


class GemTasksetConfig(vf.TasksetConfig):
    """Options under ``--env.taskset``."""

    env_id: str = "game:GuessTheNumber-v0"
    """Id of the environment."""
    kwargs: dict[str, Any] = Field(default_factory=dict)
    """Keyword arguments of ``gem.make``, ``wrappers`` among them."""
    first_seed: int = 0


class GemData(vf.TaskData):
    """What an episode starts from. Rollouts of one task, a group, start alike."""

    env_id: str
    kwargs: dict
    seed: int
    options: dict | None = None


class GemTask(vf.Task[GemData]):
    """The rewards are those of the environment: nothing is scored here."""


class GemTaskset(vf.Taskset[GemTask, GemTasksetConfig]):
    """The rows of a data set once each; of any other environment, a seed for each task, without end."""

    INFINITE = True

    def __init__(self, config):
        super().__init__(config)
        env = gem.make(config.env_id, **config.kwargs)  # an id that does not exist is told here, before anything runs
        self.num_tasks = env.unwrapped.num_tasks
        env.close()
        self._bounded = self.num_tasks is not None

    def load(self):
        """Yield the tasks."""
        for number in itertools.count() if self.num_tasks is None else range(self.num_tasks):
            data = GemData(
                name=f"{self.config.env_id}#{number}",
                env_id=self.config.env_id,
                kwargs=self.config.kwargs,
                seed=self.config.first_seed + number,
                options=None if self.num_tasks is None else {"index": number},
            )
            yield GemTask(data, self.config.task)


class GemEnvConfig(vf.EnvConfig):
    """The one agent, a plain chat loop without tools of its own."""

    player: vf.AgentConfig = vf.AgentConfig(harness={"id": "null"})


class GemEnv(vf.Env[GemEnvConfig]):
    """Plays a task: the environment is the user of the player's chat."""

    async def run(self, task, agents):
        """Play one episode."""
        start = task.data
        with ChatSession(start.env_id, **start.kwargs) as session:
            messages = await session.reset(start.seed, start.options)
            async with agents.player.interaction(task) as interaction:
                segment = await interaction.turn(images_as_urls(messages))
                while not segment.terminated:
                    step = await session.step(response_of(segment))
                    if step.error is not None:
                        raise RuntimeError(f"{start.env_id} failed, not the agent: {step.error['message']}")
                    if step.done:
                        break
                    segment = await interaction.turn(images_as_urls(step.messages))
                trace = interaction.trace
                episode = session.episode
                told = {"rewards": session.rewards, "seed": episode.seed, "success": session.success}
                trace.info["gem"] = told | {"turns": episode.turns, "ended": session.done, "cut_off": episode.cut_off}
                if not trace.errors:  # as where the model's server is gone
                    trace.record_reward("gem", session.episode_return)
                    if session.success is not None:
                        trace.record_metric("success", session.success)


def response_of(segment):
    """Return what the model said last, to the letter, as one of GEM."""
    said = [message for message in segment.messages if message.role == "assistant"][-1]
    return gem.Response(said.content or "", reasoning=said.reasoning_content)


# What this file does here: real episodes, with a scripted model.


def scripted_model():
    """Start ``examples/scripted_server.py``, whose model here also calls the tool once, in the text; return its URL."""
    sys.path.append(str(Path(__file__).resolve().parents[1]))
    import scripted_server

    plain = scripted_server.answer

    def answer(messages, tools):
        text = "".join(scripted_server.text_of(message) for message in messages)
        if "multiply" in text and "Output of" not in text:
            return '<tool_call>{"name": "multiply", "arguments": {"left": 6, "right": 7}}</tool_call>', []
        return plain(messages, tools)

    scripted_server.answer = answer
    server = scripted_server.Server(("127.0.0.1", 0), scripted_server.Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"http://127.0.0.1:{server.server_port}/v1"


async def play(url, env_id, tasks=1, rollouts=1, **player):
    """Play tasks of an environment, each several times, all at once; return verifiers' episodes."""
    agent = {"runtime": {"type": "subprocess"}, **player}
    config = vf.resolve_env_config({"taskset": {"id": "verifiers_v1", "env_id": env_id}, "player": agent})
    env = vf.load_environment(config)
    client = vf.EvalClientConfig(base_url=url, api_key_var="NO_KEY")
    model = vf.ModelContext(model="scripted", client=client)
    async with env.serving():
        slots = [slot for task in env.taskset.take(tasks) for slot in env.slots(task, rollouts)]
        return await asyncio.gather(*(env.run_slot(slot, model) for slot in slots))


async def main():
    """Play, and check what verifiers recorded."""
    register_trial_envs()
    url = scripted_model()
    first, same, other, _ = game = await play(url, "game:GuessTheNumber-v0", tasks=2, rollouts=2)
    (short,) = await play(url, "game:GuessTheNumber-v0", max_turns=2)
    (tool,) = await play(url, "trial:Product-v0")
    (broken,) = await play(url, "trial:FailsOnce-v0")
    for episode in (*game, short, tool, broken):
        (trace,) = episode.traces
        name, error = episode.task.data.name, trace.last_error
        print(f"{name}: ok {trace.ok}, reward {trace.reward:g}, {error.message if error else trace.info['gem']}")

    check(told(first) == told(same) and told(first) != told(other), "rollouts of one task start and go alike")
    check(
        all(each.traces[0].reward == sum(told(each)["rewards"]) for each in game), "the reward is the sum of the turns"
    )
    check(told(short)["turns"] == 2 and not told(short)["ended"] and short.ok, "max_turns cuts off")
    check(told(tool)["rewards"] == [0.25, 1.0], "a tool is called in the text")
    check(not broken.ok and not broken.traces[0].rewards, "a failed environment is an error and no reward")
    try:
        await play(url, "game:GuesTheNumber-v0")
        check(False, "a wrong id is an error")
    except gem.GemError as error:
        check("Did you mean" in str(error), "a wrong id is an error that names the right one")


def told(episode):
    """Return what GEM recorded of the one trace."""
    return episode.traces[0].info["gem"]


if __name__ == "__main__":
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"  # where uv is
    asyncio.run(main())
