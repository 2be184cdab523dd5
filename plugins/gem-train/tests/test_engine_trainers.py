"""The file for verl on stand-ins, and those that need no framework; `make trainers` runs every file on its own."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Iterator
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from chat_tokenizers import chat_tokenizer
from trainer_files import import_trainer

import gem_core as gem
from gem_core.errors import EnvFaultError
from gem_core.types import ResetResult, StepResult
from gem_train.adapters import TrialEngine
from gem_train.adapters.trial import check_sequence

GUESSES = [r"\boxed{1 2}", r"\boxed{4 1}", r"\boxed{4 6}"]
ROW = {"env_id": "game:Mastermind-v0-easy", "seed": 3}
Load = Callable[..., Any]


class Breaking(gem.Env):
    """Fails at its second step, in as many episodes as the class says."""

    failures = 0

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        super().reset(seed=seed)
        self.turn = 0
        return "Say something.", {}

    def step(self, action: str) -> StepResult:
        self.turn += 1
        if self.turn == 2 and Breaking.failures:
            Breaking.failures -= 1
            return "", 0.0, False, True, {"error": {"kind": "engine", "message": "the engine is down"}}
        return "Go on.", 0.25, self.turn == 2, False, {}


@pytest.fixture
def breaking() -> Iterator[dict[str, Any]]:
    """The row of an environment that fails; its number of failures is set by the test."""
    if "trial:Breaking" not in gem.list_envs("trial"):
        gem.register("trial:Breaking", Breaking)
    yield {"env_id": "trial:Breaking", "seed": 1}
    Breaking.failures = 0


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch) -> Load:
    """Import a file, with what stands for the modules that are not installed."""
    monkeypatch.setitem(sys.modules, "gem", ModuleType("gem"))
    del sys.modules["gem"]  # what the file for ROLL puts there goes with the test
    return lambda name, stand_ins=None: import_trainer(monkeypatch, name, stand_ins or {})


@pytest.fixture
def engine() -> TrialEngine:
    """An engine that solves the task of ``ROW`` in three turns."""
    return TrialEngine(chat_tokenizer(), GUESSES)


# verl


class AgentLoopBase:
    """The attributes of verl's base that the file reads."""

    def __init__(self, server_manager: Any, tokenizer: Any, response_length: int = 2000) -> None:
        self.rollout_config = SimpleNamespace(prompt_length=1500, response_length=response_length)
        self.server_manager, self.tokenizer, self.apply_chat_template_kwargs = server_manager, tokenizer, {}


@pytest.fixture
def verl(load: Load) -> Any:
    """The file for verl."""
    offered = {
        "AgentLoopBase": AgentLoopBase,
        "AgentLoopMetrics": SimpleNamespace,
        "AgentLoopOutput": lambda **fields: SimpleNamespace(**fields),
        "register": lambda name: lambda cls: cls,
    }
    packages: dict[str, Any] = {"verl": {}, "verl.experimental": {}, "verl.experimental.agent_loop": {}}
    return load("verl_agent_loop", packages | {"verl.experimental.agent_loop.agent_loop": offered})


def test_verl_takes_an_episode_as_one_sequence(verl: Any, engine: TrialEngine) -> None:
    """Ids, mask and log-probabilities token by token; the sum as the score, the turns beside it."""
    output = asyncio.run(verl.GemAgentLoop(verl.TrialServer(engine), engine.tokenizer).run({}, extra_info=ROW))
    before = [0] * len(output.prompt_ids)
    assert output.prompt_ids == engine.calls[0][0]
    check_sequence(
        engine,
        output.prompt_ids + output.response_ids,
        before + output.response_mask,
        before + output.response_logprobs,
    )
    assert (output.reward_score, output.num_turns) == (1.0, 6)
    assert output.extra_fields["turn_scores"] == [0.0, 0.5, 0.5]
    assert output.extra_fields["reward_extra_info"] == {"success": 1.0, "truncated": 0.0}


def test_verl_has_the_score_of_an_episode_whose_room_is_used_up(verl: Any, engine: TrialEngine) -> None:
    """It ends with the last response that fits, and what was earned so far."""
    loop = verl.GemAgentLoop(verl.TrialServer(engine), engine.tokenizer, response_length=120)
    output = asyncio.run(loop.run({}, extra_info=ROW))
    assert len(output.response_ids) <= 120
    assert output.response_mask[-1] == 1
    assert output.extra_fields["reward_extra_info"] == {"success": 0.0, "truncated": 1.0}


def test_verl_plays_a_failed_episode_again_and_then_raises(verl: Any, engine: TrialEngine, breaking: Any) -> None:
    """A failure is no reward of 0: the second try counts, and a third failure in a row is raised."""
    loop = verl.GemAgentLoop(verl.TrialServer(engine), engine.tokenizer)
    Breaking.failures = 1
    assert asyncio.run(loop.run({}, extra_info=breaking)).reward_score == 0.5
    Breaking.failures = 3
    with pytest.raises(EnvFaultError, match=r"3 episodes failed.*the engine is down"):
        asyncio.run(loop.run({}, extra_info=breaking))


# All of them


@pytest.mark.parametrize("name", ["oat_actor", "rl2_env", "roll_env"])
def test_file_holds_what_it_promises(
    load: Load, name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those that need no framework run as they are, and check an episode token by token."""
    pytest.importorskip("transformers")
    monkeypatch.setenv("GEM_TOKENIZER", "set by the file")
    result = load(name).main()
    if asyncio.iscoroutine(result):
        asyncio.run(result)
    assert capsys.readouterr().out.count("held:") >= 8
