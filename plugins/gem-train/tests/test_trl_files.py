"""``trl_rollout.py`` and ``trl_environment.py``: what TRL is given of an episode, and what the model is told."""

from __future__ import annotations

import inspect
from typing import Any

import pytest
from failing_envs import Divide, register
from trainer_files import import_trainer

import gem_core as gem

pytest.importorskip("torch")

UNUSED = dict.fromkeys(
    ["AutoModelForCausalLM", "AutoTokenizer", "PreTrainedTokenizerFast", "Qwen3Config", "Qwen3ForCausalLM"]
)
STAND_INS: dict[str, dict[str, Any]] = {
    "trl": {"GRPOConfig": None, "GRPOTrainer": None},
    "trl.chat_template_utils": {"get_training_chat_template": None},
    "trl.models": {"unwrap_model_for_generation": None},
    "datasets": {"Dataset": None},
    "transformers": UNUSED,
    "transformers.trainer_utils": {"get_last_checkpoint": None},
    "tokenizers": {},
}


@pytest.fixture
def rollout(monkeypatch: pytest.MonkeyPatch) -> Any:
    return import_trainer(monkeypatch, "trl_rollout", STAND_INS)


@pytest.fixture
def environment(monkeypatch: pytest.MonkeyPatch) -> Any:
    return import_trainer(monkeypatch, "trl_environment", STAND_INS)


def spelled(observation: Any, context: Any) -> gem.Response:
    """Answer with tokens: [10, 11] after a prompt that begins with 1, and 2 is what the environment writes."""
    before = context.responses
    prompt = [*before[-1].prompt_token_ids, *before[-1].token_ids, 2] if before else [1]
    return gem.Response("answer", token_ids=[10, 11], prompt_token_ids=prompt, logprobs=[-0.5, -0.25])


def rewriting(observation: Any, context: Any) -> gem.Response:
    """Answer to prompts that have nothing in common, as where a template drops what came before."""
    return gem.Response("answer", token_ids=[10], prompt_token_ids=[context.turn, 3], logprobs=[-0.5])


def test_trl_rollout_masks_what_the_environment_wrote(rollout: Any) -> None:
    """Masks, log-probabilities and the return of an episode, token by token."""
    episodes = list(gem.rollout(register("Whole"), spelled, episodes=1))
    assert rollout.trl_fields(episodes, filler=9) == {
        "prompt_ids": [[1]],
        "completion_ids": [[10, 11, 2, 10, 11, 2, 10, 11]],
        "env_mask": [[1, 1, 0, 1, 1, 0, 1, 1]],
        "logprobs": [[-0.5, -0.25, 0.0, -0.5, -0.25, 0.0, -0.5, -0.25]],
        "episode_return": [6.0],
    }


def test_trl_rollout_leaves_errors_out(rollout: Any) -> None:
    """No reward and no token to learn from; an episode that never began is one masked token."""
    fails = register("FailsInTurn", fails_in_turn=2), register("FailsInReset", fails_in_reset=True)
    plan = [gem.PlanItem(env_id, 0) for env_id in fails]
    episodes = sorted(gem.rollout(list(fails), spelled, plan=plan), key=lambda episode: episode.key)
    fields = rollout.trl_fields(episodes, filler=9)
    assert fields["episode_return"] == [None, None]
    assert fields["env_mask"] == [[0] * len(fields["completion_ids"][0]), [0]]
    assert (fields["prompt_ids"][1], fields["completion_ids"][1]) == ([9], [9])
    assert rollout.reward_of_episode(**fields, prompts=[]) == [None, None]


def test_trl_rollout_takes_the_last_of_several_sequences(rollout: Any) -> None:
    """The model's text can make a template rewrite earlier turns, which must not end a training."""
    fields = rollout.trl_fields(list(gem.rollout(register("Whole"), rewriting, episodes=1)), filler=9)
    assert (fields["prompt_ids"], fields["completion_ids"], fields["env_mask"]) == ([[2, 3]], [[10]], [[1]])
    assert fields["episode_return"] == [6.0]


def test_trl_environment_plays_by_answers(environment: Any) -> None:
    """Rewards of turns are summed; after the end the model is told so, and nothing is stepped."""
    env = environment.environment_class("Whole", register("Whole"))()
    task = env.reset(seed=3, prompt="of the row")
    assert task.startswith("Be brief.\n\nTask ")
    assert env.reset(seed=3) == task
    assert env.answer("one") == "Turn 1."
    assert env.get_reward() == 1.0  # left before its end: what was earned so far
    env.answer("two")
    assert env.answer("three") == f"Turn 3.\n\n{environment.OVER}"
    assert env.answer("four") == environment.OVER
    assert env.get_reward() == 6.0
    env.reset(seed=4)
    assert env.get_reward() == 0.0


def test_trl_environment_makes_methods_of_tools(environment: Any) -> None:
    """With name, types and words of the schema; a call is executed, and one that fails is told to the model."""
    made = environment.environment_class("Tools", register("Whole"), wrappers=[Divide()])
    signature = inspect.signature(made.divide)
    assert list(signature.parameters) == ["self", "left", "right"]
    assert signature.parameters["left"].annotation is int
    assert signature.parameters["right"].default is None
    assert inspect.getdoc(made.divide) == (
        "Divides two numbers.\n\nArgs:\n    left: What is divided.\n    right: By what; 1 by default."
    )
    env = made()
    assert "<tool_call>" not in env.reset(seed=0)
    assert env.divide(left=6, right=3).startswith("2\n")
    assert env.divide(left=6).startswith("6\n")
    assert "division by zero" in env.divide(left=1, right=0)
    assert env.get_reward() == 0.0
    assert env.answer("one") == "Turn 1."


@pytest.mark.parametrize("how", [{"fails_in_turn": 2}, {"fails_in_reset": True}])
def test_trl_environment_gives_no_reward_for_an_error(environment: Any, how: dict[str, Any]) -> None:
    """And goes on telling the model that it is over; the next reset begins anew."""
    env = environment.environment_class("Fails", register("FailsInTurn", fails_in_turn=2))()
    if "fails_in_reset" in how:
        env.session = environment.ChatSession(register("FailsInReset", fails_in_reset=True))
        assert env.reset().endswith(environment.OVER)
    else:
        env.reset()
        env.answer("one")
        assert env.answer("two").endswith(environment.OVER)
    assert env.get_reward() is None
    assert env.answer("three") == environment.OVER
