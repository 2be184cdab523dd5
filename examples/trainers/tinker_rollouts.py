# /// script
# requires-python = ">=3.11"
# dependencies = ["tinker-cookbook>=0.5.8,<0.7", "torch", "transformers", "gem-core", "gem-games", "gem-train"]
# [tool.gem.table]
# framework = 'Tinker cookbook'
# rewards = 'on each transition; advantages take the sum'
# images = 'passed on, not tried'
# groups = 'yes'
# tools = 'native, as the renderer reads them'
# failures = 'raised: left out or tried again'
# ///
r"""Tinker cookbook: rollouts of its own in environments of GEM, with a reward on each transition.

Shows an ``Env``, an ``EnvGroupBuilder`` and a data set of tinker-cookbook (tried with 0.5.8 and 0.6.1), and drives them
with the package's own ``do_group_rollout``. Training itself runs on Tinker's paid service.

Install and run it here, in an environment of its own; a script stands in for the model::

    python scripts/trainers.py tinker_rollouts
    python examples/trainers/tinker_rollouts.py

Train with it (a key for Tinker in ``TINKER_API_KEY``): give ``GemDatasetBuilder`` to the cookbook's own loop, as in
``tinker_cookbook.rl.train.Config(dataset_builder=GemDatasetBuilder(model_name=…, renderer_name="qwen3_instruct"), …)``.

What the cookbook cannot take: the rewards of turns are kept on the transitions, but its own advantages are made of
their sum. Several agents: give ``ChatSession`` one seat, see ``gem.single_agent``. A failure that is not the agent's is
raised, so that the rollout is left out or tried anew, as the strategy says (``MinViableGroup``, ``RetryOnFailure``); it
is never a reward. A tool that fails is told to the model. A response that was cut off is scored by the task, and a chat
beyond ``max_context`` ends the episode with what was earned so far. Renderers that drop the thinking of earlier turns
make a datum of each turn; those that keep it, one of each episode.
"""

from __future__ import annotations

import asyncio
import pickle
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import chz
import tinker  # noqa: TC002 - as in the cookbook's own files
from tinker_cookbook.completers import StopCondition, TokenCompleter, TokensWithLogprobs
from tinker_cookbook.renderers import Renderer, get_renderer
from tinker_cookbook.rl import types
from tinker_cookbook.rl.data_processing import assemble_training_data, compute_advantages
from tinker_cookbook.rl.rollout_strategy import RetryOnFailure
from tinker_cookbook.rl.rollouts import do_group_rollout
from tinker_cookbook.tokenizer_utils import get_tokenizer, register_tokenizer

import gem_core as gem
from gem_core.errors import EnvFaultError
from gem_train.adapters import ChatSession, trial_tokenizer
from gem_train.adapters.trial import check

GUESS = "game:GuessTheNumber-v0-easy"
OVERFLOW = {"stop/context_overflow": 1.0}


class GemEnv(types.Env):
    """One episode of an environment of GEM, rendered to tokens and parsed from tokens by the cookbook's renderer."""

    def __init__(self, session: ChatSession, renderer: Renderer, seed: int, max_context: int | None = None) -> None:
        self.session, self.renderer, self.seed, self.max_context = session, renderer, seed, max_context
        self.chat: list[dict[str, Any]] = []

    async def initial_observation(self) -> tuple[tinker.ModelInput, StopCondition] | types.InitialObservationOverflow:
        """Begin the episode; raise where the environment fails."""
        self.chat = await self.session.reset(self.seed)
        if self.session.tools:
            system = self.chat.pop(0)["content"] if self.chat[0]["role"] == "system" else ""
            tools = [tool["function"] for tool in self.session.tools]
            self.chat = [*self.renderer.create_conversation_prefix_with_tools(tools, system), *self.chat]
        prompt = self.renderer.build_generation_prompt(self.chat)
        if self.max_context is not None and prompt.length >= self.max_context:
            return types.InitialObservationOverflow(reward=0.0, metrics=OVERFLOW)
        return prompt, self.renderer.get_stop_sequences()

    async def step(self, action: list[int], *, extra: types.ActionExtra | None = None) -> types.StepResult:
        """Take the sampled tokens; raise where the machinery fails."""
        message, _ = self.renderer.parse_response(action)
        step = await self.session.step(response_of(message, self.renderer, action, extra))
        if step.error is not None:
            raise EnvFaultError(f"{self.session.episode.id}: {step.error['message']}")
        self.chat += [message, *step.messages]
        prompt = self.renderer.build_generation_prompt(self.chat)
        overflow = not step.done and self.max_context is not None and prompt.length >= self.max_context
        metrics = dict(OVERFLOW) if overflow else {}
        if (step.done or overflow) and self.session.success is not None:
            metrics["correct"] = float(self.session.success)
        return types.StepResult(
            step.reward, step.done or overflow, prompt, self.renderer.get_stop_sequences(), metrics=metrics
        )


def response_of(message: Any, renderer: Any, action: list[int], extra: Any) -> gem.Response:
    """Return what the environment is stepped with: the text to the letter, and the calls that the renderer found."""
    stop = renderer.get_stop_sequences()
    said = action[:-1] if action and action[-1] in stop else action
    calls = [
        {"id": call.id or f"call_{place}", "type": "function", "function": call.function.model_dump()}
        for place, call in enumerate(message.get("tool_calls", ()))
    ]
    cut_off = (extra or {}).get("stop_reason") == "length"
    return gem.Response(
        renderer.tokenizer.decode(said),
        token_ids=action,
        tool_calls=calls or None,
        finish_reason="length" if cut_off else "stop",
    )


@dataclass
class GemGroupBuilder(types.EnvGroupBuilder):
    """A group of episodes that start from one seed. It holds names only, so that it can be sent to another process."""

    env_id: str
    seed: int
    group_size: int
    model_name: str
    renderer_name: str
    kwargs: dict[str, Any] = field(default_factory=dict)
    max_context: int | None = None
    _made: list[ChatSession] = field(default_factory=list, init=False, repr=False)

    async def make_envs(self) -> Sequence[types.Env]:
        """Make the environments."""
        renderer = get_renderer(self.renderer_name, get_tokenizer(self.model_name), model_name=self.model_name)
        sessions = [ChatSession(self.env_id, native_tools=True, **self.kwargs) for _ in range(self.group_size)]
        self._made += sessions
        return [GemEnv(session, renderer, self.seed, self.max_context) for session in sessions]

    async def cleanup(self) -> None:
        """Close the environments."""
        while self._made:
            self._made.pop().close()


@dataclass
class GemDataset(types.RLDataset):
    """Groups of one environment: seeds from ``first_seed`` on."""

    builder: GemDatasetBuilder
    first_seed: int
    batches: int

    def get_batch(self, index: int) -> Sequence[types.EnvGroupBuilder]:
        """Return the groups of a batch."""
        own, size = self.builder, self.builder.groups_per_batch
        seeds = range(self.first_seed + index * size, self.first_seed + (index + 1) * size)
        return [GemGroupBuilder(own.env_id, seed, own.group_size, own.model_name, own.renderer_name) for seed in seeds]

    def __len__(self) -> int:
        return self.batches


@chz.chz
class GemDatasetBuilder(types.RLDatasetBuilder):
    """What the cookbook's ``train`` takes as ``dataset_builder``."""

    model_name: str
    renderer_name: str
    env_id: str = GUESS
    group_size: int = 8
    groups_per_batch: int = 16
    batches: int = 100

    async def __call__(self) -> tuple[types.RLDataset, types.RLDataset | None]:
        """Return the training set, and a test set of other seeds."""
        return GemDataset(self, 0, self.batches), GemDataset(self, 1_000_000, 4)


# A trial of it.


class ScriptedCompleter(TokenCompleter):
    """Stands in for the model: answers by bisection, but gives up every fifth time."""

    def __init__(self, tokenizer: Any) -> None:
        self.tokenizer, self.asked = tokenizer, 0

    async def __call__(
        self, model_input: tinker.ModelInput, stop: StopCondition, *, max_tokens: int | None = None
    ) -> Any:
        """Answer what was asked last."""
        text = self.tokenizer.decode(model_input.to_ints())
        low, high = map(int, re.findall(r"from (\d+) to (\d+)", text)[-1])
        low = max([low, *(int(number) + 1 for number in re.findall(r"higher than (\d+)", text))])
        high = min([high, *(int(number) - 1 for number in re.findall(r"lower than (\d+)", text))])
        self.asked += 1
        guess = "I give up." if self.asked % 5 == 0 else f"\\boxed{{{(low + high) // 2}}}"
        tokens = [*self.tokenizer.encode(guess, add_special_tokens=False), *stop]
        return TokensWithLogprobs(tokens, [-0.5] * len(tokens))


class Breaks(gem.Env):
    """Fails in the first episode that it is asked for, and pays 1 in each later one."""

    episodes = 0

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        """Count the episode."""
        super().reset(seed=seed)
        Breaks.episodes += 1
        self.broken = Breaks.episodes == 1
        return "A number from 1 to 3?", {}

    def step(self, action: str) -> Any:
        """Fail or pay."""
        if self.broken:
            raise ConnectionError("the server is gone")
        return "Thanks.", 1.0, True, False, {"correct": True}


async def main() -> int:
    """Roll out a group with the package's own loop, and look at what it would train on."""
    register_tokenizer("bytes", trial_tokenizer)
    completer = ScriptedCompleter(get_tokenizer("bytes"))
    data = GemDatasetBuilder(model_name="bytes", renderer_name="qwen3_instruct", group_size=4, groups_per_batch=2)
    train, _ = await data()
    builder = pickle.loads(pickle.dumps(train.get_batch(0)[1]))
    group = await do_group_rollout(builder, completer)

    replays = []
    for trajectory in group.trajectories_G:
        session = ChatSession(GUESS)
        session.reset_sync(builder.seed)
        for turn in trajectory.transitions:
            session.step_sync(completer.tokenizer.decode(turn.ac.tokens[:-1]))
        replays.append(session.rewards)
        print(f"rewards of turns: {session.rewards}")
    kept = [[turn.reward for turn in trajectory.transitions] for trajectory in group.trajectories_G]
    check(kept == replays, "each transition has the reward that the environment gave for it")
    check(
        len({tuple(each.transitions[0].ob.to_ints()) for each in group.trajectories_G}) == 1, "a group shares a start"
    )

    advantages = compute_advantages([group])
    datums, _ = assemble_training_data([group], advantages)
    trained = [int(sum(datum.loss_fn_inputs["mask"].to_torch())) for datum in datums]
    sampled = [sum(len(turn.ac.tokens) for turn in each.transitions) for each in group.trajectories_G]
    print(f"returns {group.get_total_rewards()}, advantages {advantages[0].tolist()}, sampled tokens {sampled}")
    check(trained == sampled, "one datum an episode, and the loss is on the sampled tokens, each once")

    gem.register("trial:Breaks-v0", Breaks)
    failing = GemGroupBuilder("trial:Breaks-v0", 0, 2, "bytes", "qwen3_instruct")
    retried = await do_group_rollout(failing, ScriptedCompleter(completer.tokenizer), RetryOnFailure(max_retries=2))
    check(retried.get_total_rewards() == [1.0, 1.0], "an episode whose environment failed was tried anew, and is no 0")
    check([each.error_type for each in retried.rollout_errors] == ["EnvFaultError"], "the failure was reported")
    return 0


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))
