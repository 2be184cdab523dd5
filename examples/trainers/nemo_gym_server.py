# /// script
# requires-python = ">=3.12"
# dependencies = ["nemo-gym>=0.4,<0.5", "gem-core", "gem-games", "gem-train"]
# [tool.gem]
# python = "3.12"
# [tool.gem.table]
# framework = 'NeMo-Gym'
# rewards = 'summed; listed in `info`'
# images = 'no'
# groups = '`--num-repeats`'
# tools = 'native or in text'
# failures = 'played again, then raised'
# ///
r"""GEM environments in NeMo-Gym: a resources server by its ``GymnasiumServer``, and rows of data for it.

Framework: NeMo-Gym 0.4 (``nemo-gym``), the environments of NeMo-RL. Python 3.12.

Here, on a CPU: the server, NeMo-Gym's own gymnasium agent and a scripted model, three servers on the loopback::

    python examples/trainers/nemo_gym_server.py  # in an environment of its own: make trainers ARGS=nemo_gym_server

For rollouts and training, this file is the server ``resources_servers/gem/app.py`` and the agent
``responses_api_agents/gem_agent/app.py`` in the folder from which ``gym`` is started (a copy or a link), each beside a
``requirements.txt`` with nemo-gym, gem-core, gem-train and the plugins of your environments. Then::

    python resources_servers/gem/app.py rows "game:GuessTheNumber-v0" 1000 '{"wrappers": []}' > rows.jsonl
    python resources_servers/gem/app.py configuration > gem.yaml
    gym env start --config gem.yaml --config YOUR_MODEL.yaml
    gym eval run --no-serve --agent gem_agent --input rows.jsonl --output rollouts.jsonl --num-repeats 8

On GPUs, NeMo-RL takes both files in its configuration (``data.train.data_path``, ``env.nemo_gym.config_paths``)::

    uv run examples/nemo_gym/run_grpo_nemo_gym.py --config YOURS.yaml

What it cannot take, and what happens then:

- Rewards per turn: its agents report one number for an episode, the sum. ``info["rewards"]`` of a result lists them.
- An episode whose environment failed: NeMo-Gym has no mark for it, so the step is answered with status 503, and
  ``GemAgent`` plays the row again from its start, ``retries`` times; after that, and with NeMo-Gym's own agent at once,
  the request fails with the error's text. It is never counted as a reward of 0.
- An agent that stops at its limit of turns does not tell the server: ``max_steps`` of the server, the same number, ends
  the episode and closes the environment. One that was left otherwise is closed after ``idle_s``.
- Images: observations are text; such an environment fails at its reset. Several agents: make one seat of it an
  environment with ``gem.single_agent``, and register that. Sessions live in one process: leave ``num_workers`` at 1.
"""

import asyncio
import json
import os
import sys
import time
from pathlib import Path
from typing import Annotated

import uvicorn
import yaml
from aiohttp import ClientResponseError
from fastapi import Body, FastAPI, HTTPException, Request
from nemo_gym.base_resources_server import BaseResourcesServerConfig
from nemo_gym.config_types import BaseServerConfig
from nemo_gym.global_config import NEMO_GYM_CONFIG_PATH_ENV_VAR_NAME
from nemo_gym.openai_utils import NeMoGymResponse
from nemo_gym.server_utils import GlobalAIOHTTPAsyncClientConfig, ServerClient, set_global_aiohttp_client
from omegaconf import OmegaConf
from resources_servers.gymnasium import GymnasiumServer, extract_text
from responses_api_agents.gymnasium_agent.app import GymnasiumAgent, GymnasiumAgentConfig, GymnasiumAgentRunRequest

import gem_core as gem
from gem_core.errors import EnvFaultError, GemError
from gem_train import ChatSession
from gem_train.adapters.trial import FailsOnce, check, register_trial_envs

# The server: one session for each rollout, found by the cookie that NeMo-Gym gives it.


class GemServerConfig(BaseResourcesServerConfig):
    """Options in the server's YAML."""

    max_steps: int = 10
    idle_s: float = 3600.0


class GemServer(GymnasiumServer):
    """Plays the environment that a row names: ``{"gem": {"id", "seed", "options", "kwargs", "native_tools"}}``."""

    config: GemServerConfig

    async def reset(self, metadata, session_id=None):
        """Make the environment that the row names, and return its task."""
        now = time.monotonic()
        left = [key for key, (_, last_used) in self.session_state.items() if now - last_used > self.config.idle_s]
        for key in [session_id, *left]:
            await self.close_session(key)
        row = {"id": "(none: a row needs 'gem', see the command rows)"} | (metadata.get("gem") or {})
        try:
            session = ChatSession(row["id"], native_tools=row.get("native_tools", False), **(row.get("kwargs") or {}))
            self.session_state[session_id] = session, now
            messages = await session.reset(row.get("seed"), row.get("options"))
            return text_of(messages, "user"), {"seed": session.episode.seed}
        except (GemError, TypeError, ValueError) as error:
            await self.close_session(session_id)
            raise HTTPException(503 if isinstance(error, EnvFaultError) else 400, str(error)) from error

    async def step(self, action, metadata, session_id=None):
        """Hand a response to the environment."""
        if session_id not in self.session_state:
            raise HTTPException(409, "no episode is under way in this session: /reset comes first")
        session, _ = self.session_state[session_id]
        self.session_state[session_id] = session, time.monotonic()
        step = await session.step(response_of(action))
        if step.error is not None:
            await self.close_session(session_id)
            raise HTTPException(503, f"the environment failed, not the agent: {step.error['message']}")
        truncated = step.truncated or (not step.terminated and session.episode.turns >= self.config.max_steps)
        answers = [message for message in step.messages if message["role"] == "tool"]
        outputs = [{"call_id": each["tool_call_id"], "output": text_of([each], "tool")} for each in answers]
        info = {"rewards": session.rewards, "success": session.success, "tool_outputs": outputs}
        return text_of(step.messages, "user"), step.reward, step.terminated, truncated, info

    async def close_session(self, session_id):
        """Close the environment of a session; NeMo-Gym calls this when an episode is over."""
        session, _ = self.session_state.pop(session_id, (None, 0.0))
        if session is not None:
            await asyncio.to_thread(session.close)


class GemAgent(GymnasiumAgent):
    """NeMo-Gym's agent, which plays a row again whose environment failed."""

    retries: int = 2

    async def run(self, request: Request, body: GymnasiumAgentRunRequest):
        """Return the result of an episode that counts."""
        for left in reversed(range(self.retries + 1)):
            try:
                return await super().run(request, body)
            except ClientResponseError as error:
                if error.status != 503 or not left:
                    raise


def text_of(messages, role):
    """Return the text of those messages that are of a role; None where there are none."""
    contents = [message["content"] for message in messages if message["role"] == role]
    if any(not isinstance(content, str) for content in contents):
        raise ValueError("this environment shows images, and observations in NeMo-Gym are text")
    return "\n\n".join(contents) or None


def response_of(action: NeMoGymResponse):
    """Return the text and the native calls of a response in OpenAI's Responses format as one of GEM."""
    calls = [
        {"id": item.call_id, "type": "function", "function": {"name": item.name, "arguments": item.arguments}}
        for item in action.output
        if item.type == "function_call"
    ]
    cut_off = action.incomplete_details is not None and action.incomplete_details.reason == "max_output_tokens"
    return gem.Response(extract_text(action), tool_calls=calls or None, finish_reason="length" if cut_off else "stop")


# The data.


def rows(env_id, count=None, native_tools=True, **kwargs):
    """Yield ``count`` rows of an environment, each with a seed of its own, by default one for each task of a data set.

    Equal rows start alike; a group is one row that is collected several times.
    """
    env = gem.make(env_id, **kwargs)
    tasks = env.unwrapped.num_tasks
    with ChatSession(env, native_tools=native_tools) as session:
        for number in range(count or tasks or 10):
            start = {"seed": number, "options": {"index": number % tasks} if tasks else None}
            system = [each for each in session.reset_sync(**start) if each["role"] == "system"]
            tools = [{"type": "function", "strict": False, **tool["function"]} for tool in session.tools]
            yield {
                "responses_create_params": {"input": system, "tools": tools if native_tools else []},
                "gem": {"id": env_id, **start, "kwargs": kwargs, "native_tools": native_tools},
                "agent_ref": {"type": "responses_api_agents", "name": "gem_agent"},
            }


CONFIGURATION = """
gem:
  resources_servers:
    gem: {entrypoint: app.py, domain: games, max_steps: 10}  # the same as the agent's
gem_agent:
  responses_api_agents:
    gem_agent:
      entrypoint: app.py
      max_steps: 10
      resources_server: {type: resources_servers, name: gem}
      model_server: {type: responses_api_models, name: policy_model}
"""


# What this file does here: all of it, with a scripted model.


def scripted_model():
    """Return a server in the place of vLLM's: it plays by the rules of ``examples/scripted_server.py``."""
    sys.path.append(str(Path(__file__).resolve().parents[1]))
    from scripted_server import answer

    app = FastAPI()

    @app.post("/v1/responses")
    def respond(body: Annotated[dict, Body()]):
        messages = [{**item, "role": item.get("role", "tool")} for item in body["input"]]
        tools = [{"function": tool} for tool in body.get("tools", [])]
        text, calls = answer(messages, tools)
        content = [{"type": "output_text", "text": text, "annotations": []}]
        said = [{"id": "m", "type": "message", "role": "assistant", "status": "completed", "content": content}]
        said += [{"type": "function_call", "call_id": call["id"], **call["function"]} for call in calls]
        fixed = {"parallel_tool_calls": True, "tool_choice": "auto", "tools": [], "object": "response"}
        return {"id": "r", "created_at": 0, "model": "scripted", "output": said, **fixed}

    return app


async def serve(app, running):
    """Serve an application on a free port of the loopback, in this event loop; return the port."""
    server = uvicorn.Server(uvicorn.Config(app, host="127.0.0.1", port=0, log_level="critical"))
    running.append(asyncio.create_task(server.serve()))
    while not server.started:
        await asyncio.sleep(0.01)
    return server.servers[0].sockets[0].getsockname()[1]


async def play(batch, max_steps):
    """Run rows as NeMo-Gym's collection does, all at once; return the results, or errors, and the server."""
    set_global_aiohttp_client(GlobalAIOHTTPAsyncClientConfig())  # one for all servers of a process
    found, running = OmegaConf.create(), []  # where NeMo-Gym's client finds each server
    client = ServerClient(head_server_config=BaseServerConfig(host="127.0.0.1", port=0), global_config_dict=found)
    here = {"host": "127.0.0.1", "port": 0, "entrypoint": "app.py"}
    options = yaml.safe_load(CONFIGURATION)["gem_agent"]["responses_api_agents"]["gem_agent"] | here
    server = GemServer(config=GemServerConfig(**here, name="gem", max_steps=max_steps), server_client=client)
    agent = GemAgent(config=GymnasiumAgentConfig(**options, name="gem_agent"), server_client=client)
    apps = {"policy_model": scripted_model(), "gem": server.setup_webserver(), "gem_agent": agent.setup_webserver()}
    agent.setup_exception_middleware(apps["gem_agent"])
    for name, app in apps.items():
        found[name] = {"kind": {"name": {**here, "port": await serve(app, running)}}}

    async def one(row):
        answer = await client.post(server_name="gem_agent", url_path="/run", json=row)
        return await answer.json()

    return await asyncio.gather(*map(one, batch)), server


def main():
    """Run rows through the three servers, and check what came back."""
    register_trial_envs()
    game = list(rows("game:GuessTheNumber-v0", 3))
    wrong = {**game[0], "gem": {"id": "game:GuesTheNumber-v0"}}
    batch = [*game, game[0], *rows("trial:Product-v0"), *rows("trial:FailsOnce-v0"), wrong]
    results, server = asyncio.run(play(batch, max_steps=5))
    for row, result in zip(batch, results, strict=True):
        if isinstance(result, dict):
            result = f"reward {result['reward']:g}, truncated {result['truncated']}, {json.dumps(result['info'])}"
        print(f"{row['gem']['id']} seed {row['gem'].get('seed')}: {result}")

    first, second, cut, again, tool, flaky, refused = results
    check(first["response"]["output"] == again["response"]["output"], "equal seeds start and go alike")
    check(first["info"]["rewards"] != second["info"]["rewards"], "sessions that run at once do not mix")
    check(all(r["reward"] == sum(r["info"]["rewards"]) for r in results[:6]), "the reward is the sum of the turns")
    check(cut["truncated"] and len(cut["info"]["rewards"]) == 5, "a limit of turns truncates")
    check("function_call_output" in str(tool["response"]) and tool["reward"] == 1.25, "tools are called natively")
    check(flaky["reward"] == 1 and FailsOnce.failures == 1, "a failed environment is played again, not scored")
    check("Did you mean" in refused, "a wrong id is told")
    check(not server.session_state, "every environment is closed")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["rows", env_id, *rest]:
            count, kwargs = (*rest, *("0", "{}")[len(rest) :])
            for row in rows(env_id, int(count), **json.loads(kwargs)):
                print(json.dumps(row))
        case ["configuration"]:
            print(CONFIGURATION)
        case [] if NEMO_GYM_CONFIG_PATH_ENV_VAR_NAME not in os.environ:
            main()
        case _:  # started by NeMo-Gym, in the folder of a server
            folder = Path(__file__).absolute().parents[1].name
            (GemAgent if folder == "responses_api_agents" else GemServer).run_webserver()
