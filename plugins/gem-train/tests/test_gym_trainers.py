"""``skyrl_env.py``, ``verifiers_v1.py`` and ``nemo_gym_server.py``: what each framework is given of an episode."""

from __future__ import annotations

import asyncio
import contextlib
from types import SimpleNamespace
from typing import Any, Generic, TypeVar

import pydantic
import pytest
from failing_envs import Divide, ThreeTurns, register
from trainer_files import import_trainer

import gem_core as gem
from gem_core.errors import EnvFaultError

CALL = '<tool_call>{"name": "divide", "arguments": {"left": 6, "right": 2}}</tool_call>'
A = TypeVar("A")
B = TypeVar("B")


@pytest.fixture
def closed(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Return a list to which environments of three turns are added when they are closed."""
    found: list[object] = []
    monkeypatch.setattr(ThreeTurns, "close", lambda self: found.append(self), raising=False)
    return found


# SkyRL.


class BaseTextEnv:
    """As in SkyRL-gym."""

    def __init__(self) -> None:
        self.turns, self.max_turns = 0, 1


@pytest.fixture
def skyrl(monkeypatch: pytest.MonkeyPatch) -> Any:
    base = {"BaseTextEnv": BaseTextEnv, "BaseTextEnvStepOutput": dict}
    stand_ins: dict[str, dict[str, Any]] = {
        "skyrl_gym": {},
        "skyrl_gym.envs": {},
        "skyrl_gym.envs.base_text_env": base,
    }
    return import_trainer(monkeypatch, "skyrl_env", stand_ins)


def test_skyrl_rewards_each_turn(skyrl: Any, closed: list[object]) -> None:
    """Observations are messages, and the last one ends and closes the episode."""
    (row,) = skyrl.rows(register("Whole"), 1, 7)
    closed.clear()
    env = skyrl.GemTextEnv({}, {**row, "max_turns": 9})
    prompt, _ = env.init(row["prompt"])
    assert prompt == row["prompt"]
    assert [message["role"] for message in prompt] == ["system", "user"]
    steps = [env.step("a") for _ in range(3)]
    assert [(step["reward"], step["done"]) for step in steps] == [(1.0, False), (2.0, False), (3.0, True)]
    assert steps[0]["observations"] == [{"role": "user", "content": "Turn 1."}]
    assert env.get_metrics() == {"return": 6.0, "turns": 3, "success": 1.0}
    assert len(closed) == 1


def test_skyrl_turn_limit_closes_the_environment(skyrl: Any, closed: list[object]) -> None:
    """The generator asks no more once the environment says that it is done."""
    env = skyrl.GemTextEnv({}, {"gem": {"id": register("Whole"), "seed": 0}, "max_turns": 2})
    env.init([])
    assert [env.step("a")["done"] for _ in range(2)] == [False, True]
    assert len(closed) == 1
    assert env.get_metrics()["success"] == 0.0


@pytest.mark.parametrize("arguments", [{"fails_in_turn": 2}, {"fails_in_reset": True}])
def test_skyrl_plays_a_failed_episode_again(skyrl: Any, closed: list[object], arguments: dict[str, Any]) -> None:
    """As often as asked; then the error reaches the trainer. There is no reward in between."""
    env_id = register("".join(arguments).title().replace("_", ""), **arguments)
    played = []

    class Generator:
        async def agent_loop(self, row: Any) -> None:
            played.append(row)
            env = skyrl.GemTextEnv({}, row)
            env.init([])
            while not env.step("a")["done"]:
                pass

    with pytest.raises(EnvFaultError, match="server"):
        asyncio.run(skyrl.patient(Generator, retries=2)().agent_loop({"gem": {"id": env_id, "seed": 0}}))
    assert len(played) == 3
    assert len(closed) == 3


def test_skyrl_rows_go_through_a_data_set(skyrl: Any) -> None:
    """A row for each task, and a validation set goes on with other seeds."""
    questions = [{"question": f"What is {number}?", "answer": str(number)} for number in range(2)]
    gem.register("rows:Skyrl-v0", gem.DatasetEnv, rows=questions)
    first, second = skyrl.rows("rows:Skyrl-v0")
    assert "What is 0?" in first["prompt"][0]["content"]
    assert "What is 1?" in second["prompt"][0]["content"]
    (other,) = skyrl.rows("rows:Skyrl-v0", 1, 3)
    assert other["prompt"] == second["prompt"]
    assert other["gem"] == '{"id": "rows:Skyrl-v0", "seed": 3, "options": {"index": 1}, "kwargs": {}}'


def test_skyrl_says_what_a_row_needs(skyrl: Any) -> None:
    """And names an id that is near."""
    with pytest.raises(ValueError, match="a row needs"):
        skyrl.GemTextEnv({}, {})
    with pytest.raises(gem.GemError, match="Did you mean"):
        skyrl.GemTextEnv({}, {"gem": {"id": "game:GuesTheNumber-v0", "seed": 0}})


# verifiers.


class Configured(Generic[A]):
    """The parts of verifiers that have a configuration."""

    def __init__(self, config: Any) -> None:
        self.config = config


class Task(Generic[A]):
    """As in verifiers."""

    def __init__(self, data: Any, config: Any = None) -> None:
        self.data = data


class Taskset(Configured[A], Generic[A, B]):
    """As in verifiers."""


class TasksetConfig(pydantic.BaseModel):
    """As in verifiers."""

    task: Any = None


@pytest.fixture
def verifiers(monkeypatch: pytest.MonkeyPatch) -> Any:
    offered = {
        "TasksetConfig": TasksetConfig,
        "TaskData": type("TaskData", (pydantic.BaseModel,), {"__annotations__": {"name": str}}),
        "Task": Task,
        "Taskset": Taskset,
        "EnvConfig": object,
        "AgentConfig": lambda **options: None,
        "Env": Configured,
    }
    return import_trainer(monkeypatch, "verifiers_v1", {"verifiers": {}, "verifiers.v1": offered})


class Player:
    """Answers as often as it may, as an agent of verifiers does; keeps what it was sent."""

    def __init__(self, answers: list[str]) -> None:
        self.answers = answers
        self.sent: list[Any] = []
        self.rewards: dict[str, float] = {}
        self.metrics: dict[str, float] = {}
        self.trace = SimpleNamespace(
            info={}, errors=[], record_reward=self.rewards.__setitem__, record_metric=self.metrics.__setitem__
        )

    @contextlib.asynccontextmanager
    async def interaction(self, task: Any) -> Any:
        yield self

    async def turn(self, messages: list[dict[str, Any]]) -> Any:
        if len(self.sent) == len(self.answers):
            return SimpleNamespace(terminated=True, messages=[])
        self.sent.append(messages)
        said = SimpleNamespace(role="assistant", content=self.answers[len(self.sent) - 1], reasoning_content=None)
        return SimpleNamespace(terminated=False, messages=[said])


def play(verifiers: Any, player: Player, env_id: str) -> Player:
    """Play the first task of an environment."""
    taskset = verifiers.GemTaskset(verifiers.GemTasksetConfig(env_id=env_id, first_seed=5))
    task = next(iter(taskset.load()))
    asyncio.run(verifiers.GemEnv(None).run(task, SimpleNamespace(player=player)))
    return player


def test_verifiers_reward_is_the_sum_of_the_turns(verifiers: Any) -> None:
    """The rewards of the turns are in the trace's info."""
    player = play(verifiers, Player(["a"] * 9), register("Whole"))
    assert player.rewards == {"gem": 6.0}
    assert player.metrics == {"success": True}
    assert player.trace.info["gem"]["rewards"] == [1.0, 2.0, 3.0]
    assert [[message["role"] for message in sent] for sent in player.sent] == [["system", "user"], ["user"], ["user"]]


def test_verifiers_turn_limit_closes_the_environment(verifiers: Any, closed: list[object]) -> None:
    """An agent that stops keeps what it earned; the task is not solved."""
    player = play(verifiers, Player(["a"]), register("Whole"))
    assert player.rewards == {"gem": 1.0}
    assert player.metrics == {"success": False}
    assert player.trace.info["gem"]["ended"] is False
    assert len(closed) == 2  # the taskset's, which counts the tasks, and the episode's


def test_verifiers_failure_is_raised(verifiers: Any, closed: list[object]) -> None:
    """No reward is recorded, so that the framework leaves the episode out."""
    player = Player(["a"] * 9)
    with pytest.raises(RuntimeError, match="failed, not the agent: step raised ConnectionError: the server is gone"):
        play(verifiers, player, register("FailsInTurn", fails_in_turn=2))
    assert player.rewards == {}
    assert len(closed) == 2


def test_verifiers_tasks_are_the_rows_of_a_data_set(verifiers: Any) -> None:
    """A finite taskset; a game's has no end."""
    gem.register("rows:Verifiers-v0", gem.DatasetEnv, rows=[{"question": "What?", "answer": "42"}] * 3)
    taskset = verifiers.GemTaskset(verifiers.GemTasksetConfig(env_id="rows:Verifiers-v0"))
    assert [task.data.options for task in taskset.load()] == [{"index": 0}, {"index": 1}, {"index": 2}]
    with pytest.raises(gem.GemError, match="Did you mean"):
        verifiers.GemTaskset(verifiers.GemTasksetConfig(env_id="game:GuesTheNumber-v0"))


# NeMo-Gym.


class HTTPException(Exception):
    """As in FastAPI."""

    def __init__(self, status_code: int, detail: str) -> None:
        super().__init__(f"{status_code}: {detail}")


class GymnasiumServer:
    """As in NeMo-Gym."""

    def __init__(self, config: Any) -> None:
        self.config = config
        self.session_state: dict[str, Any] = {}


class ClientResponseError(Exception):
    """As in aiohttp."""

    def __init__(self, status: int) -> None:
        self.status = status


class GymnasiumAgent:
    """Plays what it is given."""

    async def run(self, request: Any, body: Any) -> Any:
        return body.pop(0)()


@pytest.fixture
def nemo(monkeypatch: pytest.MonkeyPatch) -> Any:
    server_utils = ["GlobalAIOHTTPAsyncClientConfig", "ServerClient", "set_global_aiohttp_client"]
    agent = {"GymnasiumAgent": GymnasiumAgent, "GymnasiumAgentConfig": None, "GymnasiumAgentRunRequest": None}
    stand_ins: dict[str, dict[str, Any]] = {
        "uvicorn": {},
        "yaml": {},
        "aiohttp": {"ClientResponseError": ClientResponseError},
        "fastapi": {"Body": None, "FastAPI": None, "HTTPException": HTTPException, "Request": None},
        "nemo_gym": {},
        "nemo_gym.base_resources_server": {"BaseResourcesServerConfig": pydantic.BaseModel},
        "nemo_gym.config_types": {"BaseServerConfig": None},
        "nemo_gym.global_config": {"NEMO_GYM_CONFIG_PATH_ENV_VAR_NAME": ""},
        "nemo_gym.openai_utils": {"NeMoGymResponse": None},
        "nemo_gym.server_utils": dict.fromkeys(server_utils),
        "omegaconf": {"OmegaConf": None},
        "resources_servers": {},
        "resources_servers.gymnasium": {"GymnasiumServer": GymnasiumServer, "extract_text": lambda action: action.text},
        "responses_api_agents": {},
        "responses_api_agents.gymnasium_agent": {},
        "responses_api_agents.gymnasium_agent.app": agent,
    }
    return import_trainer(monkeypatch, "nemo_gym_server", stand_ins)


def said(text: str, *calls: Any, cut_off: bool = False) -> Any:
    """Return a response in the form of NeMo-Gym."""
    reason = SimpleNamespace(reason="max_output_tokens") if cut_off else None
    return SimpleNamespace(text=text, output=list(calls), incomplete_details=reason)


def test_nemo_sessions_do_not_mix(nemo: Any, closed: list[object]) -> None:
    """Two rollouts of one row start alike and go on apart; the server's limit of turns closes the second."""
    row = {"gem": {"id": register("Whole"), "seed": 3}}

    async def play() -> Any:
        server = nemo.GemServer(nemo.GemServerConfig(max_steps=2))
        (first, _), (second, _) = [await server.reset(row, key) for key in "ab"]
        assert first == second
        assert (await server.step(said("x"), row, "a"))[:4] == ("Turn 1.", 1.0, False, False)
        assert (await server.step(said("x"), row, "b"))[:4] == ("Turn 1.", 1.0, False, False)
        last = await server.step(said("x"), row, "b")
        await server.close_session("b")  # as NeMo-Gym's endpoint does at the end
        return last, list(server.session_state)

    last, left = asyncio.run(play())
    assert last == ("Turn 2.", 2.0, False, True, {"rewards": [1.0, 2.0], "success": False, "tool_outputs": []})
    assert left == ["a"]
    assert len(closed) == 1


def test_nemo_failure_is_no_reward(nemo: Any, closed: list[object]) -> None:
    """The request fails, and the agent plays the row again."""
    row = {"gem": {"id": register("FailsAtOnce", fails_in_turn=1), "seed": 3}}
    broken = {"gem": {"id": register("FailsInReset", fails_in_reset=True), "seed": 3}}

    async def play() -> None:
        server = nemo.GemServer(nemo.GemServerConfig())
        await server.reset(row, "a")
        with pytest.raises(HTTPException, match=r"503: the environment failed, not the agent: .*the server is gone"):
            await server.step(said("x"), row, "a")
        with pytest.raises(HTTPException, match="409: no episode"):
            await server.step(said("x"), row, "a")
        with pytest.raises(HTTPException, match=r"503: .*no server"):
            await server.reset(broken, "a")
        assert server.session_state == {}

    asyncio.run(play())
    assert len(closed) == 2


def test_nemo_agent_plays_a_failed_row_again(nemo: Any) -> None:
    """Only where the environment failed."""

    def fails(status: int) -> Any:
        raise ClientResponseError(status)

    agent = nemo.GemAgent()
    assert asyncio.run(agent.run(None, [lambda: fails(503), lambda: fails(503), lambda: "played"])) == "played"
    for statuses in ([503, 503, 503], [400]):
        with pytest.raises(ClientResponseError):
            asyncio.run(agent.run(None, [*(lambda status=status: fails(status) for status in statuses), lambda: "no"]))


def test_nemo_answers_native_calls_under_their_ids(nemo: Any) -> None:
    """The row offers the tools; the text does not explain them."""
    gem.register("rows:Nemo-v0", lambda: gem.ToolEnv(gem.DatasetEnv([{"question": "What?", "answer": "3"}]), [Divide]))
    (row,) = nemo.rows("rows:Nemo-v0")
    assert row["responses_create_params"]["tools"][0]["name"] == "divide"
    call = SimpleNamespace(type="function_call", call_id="c1", name="divide", arguments='{"left": 6, "right": 2}')

    async def play() -> Any:
        server = nemo.GemServer(nemo.GemServerConfig())
        observation, _ = await server.reset(row, "a")
        assert "tool_call" not in observation
        return await server.step(said("Let me see.", call), row, "a")

    observation, reward, terminated, truncated, info = asyncio.run(play())
    assert (observation, reward, terminated, truncated) == (None, 0.0, False, False)
    assert [(each["call_id"], each["output"][:1]) for each in info["tool_outputs"]] == [("c1", "3")]


def test_nemo_refuses_what_it_cannot_play(nemo: Any) -> None:
    """A wrong id, and a row of another server."""

    async def reset(row: Any) -> None:
        await nemo.GemServer(nemo.GemServerConfig()).reset(row, "a")

    with pytest.raises(HTTPException, match=r"400: no environment 'game:GuesTheNumber-v0'. Did you mean"):
        asyncio.run(reset({"gem": {"id": "game:GuesTheNumber-v0", "seed": 0}}))
    with pytest.raises(HTTPException, match=r"400: .*a row needs 'gem'"):
        asyncio.run(reset({}))


def test_nemo_tells_a_response_that_was_cut_off(nemo: Any) -> None:
    """It is stepped as it is."""
    assert nemo.response_of(said("x", cut_off=True)).finish_reason == "length"
    assert nemo.response_of(said("x")).finish_reason == "stop"


def test_nemo_closes_what_was_left(nemo: Any, closed: list[object]) -> None:
    """An episode whose session begins another, and those of agents that never came back."""
    row = {"gem": {"id": register("Whole"), "seed": 3}}

    async def play() -> None:
        server = nemo.GemServer(nemo.GemServerConfig(idle_s=3600.0))
        await server.reset(row, "a")
        await server.reset(row, "a")
        assert len(closed) == 1
        server.config.idle_s = -1.0
        await server.reset(row, "b")
        assert list(server.session_state) == ["b"]

    asyncio.run(play())
    assert len(closed) == 2
