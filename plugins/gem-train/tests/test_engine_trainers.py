"""The files for verl, OpenRLHF, Oat, RL2 and ROLL, on stand-ins of the frameworks; each file checks itself as well."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import sys
from collections.abc import Callable, Iterator
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from chat_tokenizers import DROPPING, chat_tokenizer
from trainer_files import import_trainer

import gem_core as gem
from gem_core.errors import ArgumentError, EnvFaultError
from gem_core.types import ResetResult, StepResult
from gem_train.adapters import ChatTemplate, TrialEngine
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


def test_verl_refuses_an_episode_of_several_sequences(verl: Any) -> None:
    """A template that drops reasoning makes another prompt of the earlier turns."""
    engine = TrialEngine(chat_tokenizer(DROPPING), [f"<think>so</think>{text}" for text in GUESSES])
    with pytest.raises(ArgumentError, match=r"in 3 sequences.*custom_chat_template"):
        asyncio.run(verl.GemAgentLoop(verl.TrialServer(engine), engine.tokenizer).run({}, extra_info=ROW))


# OpenRLHF


class StandInExecutor:
    """Calls an instance as OpenRLHF's executor does, and keeps tokens as it does."""

    def __init__(self, agent_instance_cls: Any) -> None:
        self.agent_instance_cls = agent_instance_cls

    async def execute(
        self, prompt: str, label: str, params: Any, max_length: int, tokenizer: Any, llm: Any, images: Any = None
    ) -> Any:
        instance = self.agent_instance_cls()
        text = (await instance.reset({"observation": prompt, "label": label}))["observation"]
        ids = tokenizer.encode(text, add_special_tokens=False)[-max_length:]
        text = tokenizer.decode(ids)
        mask, logprobs, total, done = [0] * len(ids), [0.0] * len(ids), 0.0, False
        while not done:
            params.max_tokens = max_length - len(ids)
            said = (await llm.generate(ids, params)).outputs[0]
            states = {"observation_text": text, "action_text": said.text, "label": label, "sampling_params": params}
            result = await instance.step(states)
            feedback = tokenizer.encode(result["environment_feedback"], add_special_tokens=False)
            text += said.text + result["environment_feedback"]
            ids = ids + said.token_ids + feedback
            mask += [1] * len(said.token_ids) + [0] * len(feedback)
            logprobs += [one[token].logprob for token, one in zip(said.token_ids, said.logprobs, strict=True)]
            logprobs += [0.0] * len(feedback)
            total, done = total + result["rewards"].item(), result["done"]
        return {"ids": ids, "mask": mask, "logprobs": logprobs, "reward": total, **result}


@pytest.fixture
def openrlhf(load: Load) -> Any:
    """The file for OpenRLHF."""
    pytest.importorskip("torch")
    found = {"__spec__": importlib.util.spec_from_loader("openrlhf", None, is_package=True)}
    offered = {"AgentInstanceBase": object, "MultiTurnAgentExecutor": StandInExecutor}
    return load("openrlhf_agent", {"openrlhf": found, "openrlhf.utils": {}, "openrlhf.utils.agent": offered})


def executed(openrlhf: Any, engine: TrialEngine, row: Any, *, cut_off: bool = False) -> Any:
    """Play an episode as OpenRLHF does, with responses that are cut off before the token that would have ended them."""

    class Server(openrlhf.TrialVLLM):
        async def generate(self, prompt_ids: list[int], sampling_params: Any) -> Any:
            sampling_params.max_tokens = len(GUESSES[0]) if cut_off else 100
            return await super().generate(prompt_ids, sampling_params)

    params, llm = SimpleNamespace(max_tokens=None, logprobs=1), Server(engine)
    return asyncio.run(openrlhf.AgentExecutor().execute("", json.dumps(row), params, 4000, engine.tokenizer, llm))


@pytest.mark.parametrize("cut_off", [False, True])
def test_openrlhf_gets_the_marks_of_the_template_in_the_feedback(
    openrlhf: Any, engine: TrialEngine, cut_off: bool
) -> None:
    """The end of a turn is written where the response was cut off, and only there."""
    output = executed(openrlhf, engine, ROW, cut_off=cut_off)
    chat = engine.tokenizer.decode(output["ids"]).split("<|im_end|>\n<|im_start|>")
    assert [part.partition("\n")[0] for part in chat] == ["<|im_start|>user", *["assistant", "user"] * 2, "assistant"]
    assert chat[-1] == "assistant\n" + GUESSES[2] + ("" if cut_off else "<|im_end|>")
    assert output["reward"] == 1.0
    assert output["extra_logs"] == {"success": 1.0, "turns": 3.0, "terminated": 1.0}
    if not cut_off:
        check_sequence(engine, output["ids"], output["mask"], output["logprobs"])


def test_openrlhf_plays_a_failed_episode_again_and_then_raises(
    openrlhf: Any, engine: TrialEngine, breaking: Any
) -> None:
    """A failure is no reward of 0."""
    Breaking.failures = 1
    assert executed(openrlhf, engine, breaking)["reward"] == 0.5
    Breaking.failures = 3
    with pytest.raises(EnvFaultError, match="the engine is down"):
        executed(openrlhf, engine, breaking)


def test_openrlhf_is_refused_what_it_cannot_append(openrlhf: Any) -> None:
    """A template that rewrites earlier turns, and a task that was cut off on the left."""
    engine = TrialEngine(chat_tokenizer(DROPPING), [f"<think>so</think>{GUESSES[0]}"])
    with pytest.raises(ArgumentError, match="rewrites earlier turns"):
        executed(openrlhf, engine, ROW)
    instance = openrlhf.GemInstance(engine.tokenizer)
    asyncio.run(instance.reset({"label": json.dumps(ROW)}))
    with pytest.raises(ArgumentError, match=r"raise --data\.max_len"):
        asyncio.run(instance.step({"observation_text": "a code of numbers.", "action_text": "a"}))


# Oat


def test_oat_is_given_other_episodes_for_those_that_failed(load: Load, engine: TrialEngine, breaking: Any) -> None:
    """They are left out and counted, and the learner has as many transitions as it wants."""
    oat = load("oat_actor")
    actor = oat.trial_actor(engine, rollout_batch_size_per_device=4, wave=2, num_envs=1)
    actor.args.env_id, Breaking.failures = breaking["env_id"], 1
    episodes, metrics = actor.collect_experience()
    assert [[turn.rewards for turn in episode] for episode in episodes] == [[0.25, 0.25]] * 3
    assert (metrics["actor/num_episodes"], metrics["actor/left_out"]) == (3, 1)
    Breaking.failures = 100
    with pytest.raises(EnvFaultError, match=r"no episode of trial:Breaking counts.*the engine is down"):
        actor.collect_experience()


def test_oat_marks_an_episode_that_was_cut_off_as_done(load: Load, engine: TrialEngine) -> None:
    """Its learner would bootstrap from 1e9 otherwise."""
    oat = load("oat_actor")
    actor = oat.trial_actor(engine, rollout_batch_size_per_device=1, wave=1, prompt_max_length=270, num_envs=1)
    actor.args.generate_max_length = 420
    (episode,), metrics = actor.collect_experience()
    assert metrics["actor/cut_off"] == 1.0
    assert episode[-1].done


# RL2


def played(rl2: Any, engine: TrialEngine, row: Any, **options: Any) -> Any:
    """Play an episode as RL2 does."""
    config = {"apply_chat_template": False, "prompt_key": "prompt", "max_new_tokens": 500, "skip_special_tokens": True}
    sample = rl2.Sample(sample=dict(row))
    asyncio.run(rl2.generate(SimpleNamespace(**config | options), engine.tokenizer, engine, sample))
    assert not rl2.SESSIONS
    return sample


def test_rl2_closes_a_turn_that_was_cut_off(load: Load, engine: TrialEngine) -> None:
    """The end of the turn is in the next state, outside the mask."""
    (made,) = played(load("rl2_env"), engine, ROW, max_new_tokens=len(GUESSES[0])).state_dicts
    ends = [len(prompt) + len(said.token_ids) for prompt, said in engine.calls[:-1]]
    assert [(made["states"][end], made["action_mask"][end]) for end in ends] == [(engine.tokenizer.eos_token_id, 0)] * 2


def test_rl2_begins_another_sequence_where_a_template_rewrites(load: Load) -> None:
    """As it does for every state that does not begin with the text so far."""
    engine = TrialEngine(chat_tokenizer(DROPPING), [f"<think>so</think>{text}" for text in GUESSES])
    made = played(load("rl2_env"), engine, ROW).state_dicts
    whole = [[*prompt, *said.token_ids] for prompt, said in engine.calls]
    assert [one["states"] for one in made] == whole
    assert [one["rewards"][-1] for one in made] == [0.0, 0.5, 0.5]


def test_rl2_plays_a_failed_episode_again_and_then_raises(load: Load, breaking: Any) -> None:
    """A failure is no reward of 0, and leaves nothing of its tokens, here in sequences of one turn each."""
    rl2, engine = load("rl2_env"), TrialEngine(chat_tokenizer(DROPPING), ["<think>so</think>a"])
    Breaking.failures = 1
    made = played(rl2, engine, breaking).state_dicts
    assert [one["rewards"][-1] for one in made] == [0.25, 0.25]
    Breaking.failures = 3
    with pytest.raises(EnvFaultError, match="the engine is down"):
        played(rl2, engine, breaking)
    assert not rl2.SESSIONS


# ROLL


@pytest.fixture
def roll(load: Load) -> Any:
    """The file for ROLL, where the package gem-llm is not installed."""
    return load("roll_env")


def test_roll_plays_groups_from_one_seed(roll: Any) -> None:
    """Members of a group share their start, other episodes do not."""
    starts = []
    for group_seed, episode_id in ((2, 1), (2, 1), (2, 3)):
        engine = TrialEngine(chat_tokenizer(), GUESSES)
        made = roll.TrialManager(engine, group_seed, env=ROW["env_id"]).play(episode_id)
        check_sequence(engine, made["ids"], made["mask"], made["logprobs"])
        starts.append(made["rewards"])
    assert starts[0] == starts[1] == [0.0, 0.5, 0.5]
    assert starts[2] != starts[0]


def test_roll_is_told_of_every_end_as_terminated(roll: Any) -> None:
    """It ends an episode by that flag alone."""
    env = roll.RollEnv(ROW["env_id"], wrappers=[("turn_limit", {"max_turns": 1})])
    observation, info = env.reset(seed=3)
    assert observation.startswith("Mastermind")
    assert "suffix" not in info
    observation, reward, terminated, truncated, info = env.step(f"{GUESSES[1]}<|im_end|>")
    assert (reward, terminated, truncated) == (0.5, True, True)
    assert info["metrics"] == {"action_is_valid": 1.0, "success": 0.0, "truncated": 1.0, "gem_error": 0.0}
    assert set(info) == {"metrics", "metrics_agg_mode", "use_tool"}


def test_roll_drops_a_group_in_which_an_episode_failed(roll: Any, breaking: Any) -> None:
    """By its own filter of groups, from the metrics of the rollouts."""
    env = roll.RollEnv(breaking["env_id"])
    Breaking.failures = 1
    env.reset(seed=1)
    env.step("a")
    _, _, terminated, _, info = env.step("b")
    assert terminated
    assert info["metrics"]["gem_error"] == 1.0
    rollouts = [
        SimpleNamespace(meta_info={"metrics": {"env/Trial/gem_error": value, "env/Trial/success": 1.0}})
        for value in (0.0, info["metrics"]["gem_error"])
    ]
    chosen = roll.LeaveOutErrors(None, None, "train")
    assert chosen.filter(0, 0, rollouts)
    assert not chosen.filter(0, 0, rollouts[:1])


def test_roll_has_a_stand_in_of_gem(roll: Any) -> None:
    """The stand-in's ``register`` and ``make`` do what those of the package do."""
    import gem as served

    served.register("own", entry_point="collections:Counter", a=1)
    assert served.make(env_id="own", b=2) == {"a": 1, "b": 2}
    env = served.make(env_id="gem_core", env=ROW["env_id"])
    assert isinstance(env, served.Env)


def test_roll_uses_the_package_where_it_is_installed(load: Load) -> None:
    """The environment is registered there."""
    registered: dict[str, Any] = {}
    package = {
        "register": lambda env_id, entry_point: registered.update({env_id: entry_point}),
        "__spec__": importlib.util.spec_from_loader("gem", None),
    }
    roll = load("roll_env", {"gem": package})
    assert registered == {"gem_core": roll.RollEnv}


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


def test_template_closes_what_the_text_does_not(engine: TrialEngine) -> None:
    """A response with special tokens in its text is split from the one that ended it, if any."""
    template = ChatTemplate(engine.tokenizer)
    assert template.split_end("a<|im_end|>") == ("a", "<|im_end|>")
    assert template.split_end("a<|endoftext|>") == ("a", "<|endoftext|>")
    assert template.split_end("a") == ("a", "")
