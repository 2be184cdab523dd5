# /// script
# requires-python = ">=3.11"
# dependencies = ["transformers", "gem-core", "gem-games", "gem-train"]
# ///
r"""Oat (0.2.4, read at c1a074c): an actor that collects GEM episodes, one ``Transition`` a turn.

``GemActor.collect_experience`` plays episodes with ``gem.rollout`` and a ``TokenAgent`` over the actor's own vLLM,
several at once, and hands each turn over with its ids as they were sampled, its log-probabilities and its reward. Oat
asks for Python 3.10, vLLM 0.8.4 and flash-attn, so that it does not install on a CPU: here the actor runs on
stand-ins that have the fields and methods of Oat's classes, over an engine that writes known tokens::

    python scripts/trainers.py oat_actor
    python examples/trainers/oat_actor.py  # where what it needs is installed

On GPUs, in an environment with ``oat-llm`` and gem-train; any argument starts the training, which was not tried
here::

    python examples/trainers/oat_actor.py --env_id game:GuessTheNumber-v0 --pretrain Qwen/Qwen3-1.7B-Base --gpus 8 \
        --rollout_batch_size_per_device 64 --train_batch_size_per_device 1 --num_gpus_per_actor 1 --critic_type drgrpo \
        --prompt_max_length 4096 --generate_max_length 1024 --gamma 0.9

What Oat cannot take: images, several agents, and a value after the end: its learner puts 1e9 there, so that the last
transition of an episode that was cut off is ``done`` as well. Groups are not used by its multi-turn learner. It
counts an episode as a success whose last reward is 1; ``info["actor/success"]`` says what the task says. Episodes
that failed are left out of what is returned, and others are played until there are enough transitions; they never
become a reward of 0.
"""

from __future__ import annotations

import asyncio
import copy
import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import gem_core as gem
from gem_train.adapters import BatchedEngine, Generated, TokenAgent, TrialEngine, trial_tokenizer
from gem_train.adapters.trial import check, trial_logprob
from gem_train.tokens import batches

try:
    from oat.algorithms.ppo import PPOArgs
    from oat.algorithms.ppo_multiturn import PPOMultiTurnActor, PPOMultiTurnLearner
    from oat.types import Transition
except ImportError:  # stand-ins with the fields that are used here

    class PPOMultiTurnActor:
        """Has ``args``, ``tokenizer``, ``sampling_params`` and ``generate`` once Oat has called ``init``."""

    class PPOMultiTurnLearner:
        """Calls ``prepare_data`` once."""

    @dataclass
    class PPOArgs:
        """The arguments of a run."""

        prompt_max_length: int = 1024
        generate_max_length: int = 512
        rollout_batch_size_per_device: int = 16
        seed: int = 0

    @dataclass
    class Transition:
        """One turn."""

        obs: str
        action: str
        rewards: float
        done: bool
        prompt: str
        prompt_ids: list
        response: str
        response_ids: list
        response_logprobs: list
        response_is_truncated: bool
        action_is_formatted: bool
        loss_mask: bool = True
        info: dict[str, Any] | None = None


@dataclass
class GemArgs(PPOArgs):
    """Arguments of the environment, beside those of Oat.

    ``wave``: episodes that are played to their ends before it is asked whether there are enough transitions. Stopping
    at a number of transitions would prefer short episodes.
    """

    env_id: str = "game:GuessTheNumber-v0"
    num_envs: int = 64
    wave: int = 64


class GemActor(PPOMultiTurnActor):
    """Collects episodes of ``args.env_id``."""

    steps = 0

    def collect_experience(self) -> tuple[Sequence[Sequence[Transition]], dict[str, Any]]:
        """Play waves of episodes until there are enough transitions for the learner."""
        args = self.args
        agent = TokenAgent(
            BatchedEngine(self.ask, most=args.num_envs),
            self.tokenizer,
            max_tokens=args.generate_max_length,
            max_context=args.prompt_max_length + args.generate_max_length,
        )
        kept: list[gem.Episode] = []
        played = 0
        while sum(episode.turns for episode in kept) < args.rollout_batch_size_per_device:
            self.steps += 1
            wave = gem.rollout(
                args.env_id, agent, episodes=args.wave, num_envs=args.num_envs, seed=args.seed * 1_000_003 + self.steps
            )
            episodes = list(wave)
            played += len(episodes)
            kept += [episode for episode in episodes if episode.error is None and episode.turns]
        known = [episode.success for episode in kept if episode.success is not None]
        metrics = {
            "actor/num_episodes": len(kept),
            "actor/left_out": played - len(kept),
            "actor/success": sum(known) / len(known) if known else 0.0,
            "actor/cut_off": sum(episode.cut_off is not None for episode in kept) / len(kept),
        }
        return [transitions(episode, self.tokenizer) for episode in kept], metrics

    def ask(self, prompts: list[list[int]], samplings: list[dict[str, Any]]) -> list[Generated]:
        """Ask the actor's vLLM."""
        params = [copy.copy(self.sampling_params) for _ in prompts]
        for one, sampling in zip(params, samplings, strict=True):
            one.n, one.logprobs, one.max_tokens = 1, 0, sampling["max_tokens"]
        found = []
        for request in self.generate(prompts, params):
            output = request.outputs[0]
            ids = list(output.token_ids)
            logprobs = [each[token].logprob for token, each in zip(ids, output.logprobs, strict=True)]
            found.append(Generated(ids, logprobs, output.finish_reason))
        return found


def transitions(episode: gem.Episode, tokenizer: Any) -> list[Transition]:
    """Return an episode as Oat takes it."""
    batch = batches([episode], form="transitions")
    made = []
    for place, turn in enumerate(episode.transitions):
        sampled = batch.token_mask[place]
        prompt_ids, response_ids = turn.action.prompt_token_ids, batch.tokens[place][sampled].tolist()
        made.append(
            Transition(
                obs=str(turn.observation),
                action=turn.action.text,
                rewards=float(batch.rewards[0, place]),
                done=place + 1 == episode.turns,
                prompt=tokenizer.decode(prompt_ids),
                prompt_ids=prompt_ids,
                response=turn.action.text,
                response_ids=response_ids,
                response_logprobs=batch.logprobs[place][sampled].tolist(),
                response_is_truncated=turn.action.cut_off,
                action_is_formatted=turn.info.get("parsed_action", "") is not None,
                loss_mask=bool(batch.learnable[0, place]),
                info={},  # the actor writes its metrics into it
            )
        )
    return made


class GemLearner(PPOMultiTurnLearner):
    """Oat counts steps by prompts; the tasks come from the environment, so these are empty."""

    def prepare_data(self, strategy: Any, tokenizer: Any) -> None:
        """Make a prompt for each transition that is wanted."""
        self.prompts_dataset = [("", "", "")] * strategy.args.max_train
        self.eval_prompts_dataset = self.prompts_dataset[:1]
        size = strategy.args.rollout_batch_size_per_device
        self.prompts_dataloader = strategy.setup_dataloader(self.prompts_dataset, size, shuffle=False)
        self.eval_prompts_dataloader = strategy.setup_dataloader(self.eval_prompts_dataset, 1, shuffle=False)


def train() -> None:
    """Train with Oat, with its own arguments and those of ``GemArgs``."""
    import launchpad as lp
    from oat.args import default_args_validation, get_default_args
    from oat.interface import get_program

    args = default_args_validation(get_default_args(GemArgs))
    program, resources = get_program(args, GemLearner, GemActor)
    lp.launch(program, launch_type=args.launch_type, local_resources=resources, terminal="current_terminal")


# A trial without a GPU.


def trial_actor(engine: TrialEngine, **options: Any) -> GemActor:
    """Return an actor whose vLLM writes known tokens."""
    actor = GemActor()
    actor.args = GemArgs(env_id="game:Mastermind-v0-easy", **options)
    actor.tokenizer, actor.sampling_params = engine.tokenizer, SimpleNamespace(temperature=1.0)

    def generate(prompts: list[list[int]], sampling: list[Any]) -> list[Any]:
        outputs = []
        for ids, params in zip(prompts, sampling, strict=True):
            made = asyncio.run(engine(ids, max_tokens=params.max_tokens))
            logprobs = [
                {token: SimpleNamespace(logprob=one)} for token, one in zip(made.token_ids, made.logprobs, strict=True)
            ]
            output = SimpleNamespace(token_ids=made.token_ids, logprobs=logprobs, finish_reason=made.finish_reason)
            outputs.append(SimpleNamespace(outputs=[output]))
        return outputs

    actor.generate = generate
    return actor


def main() -> None:
    """Collect episodes with the actor and check each transition token by token."""
    engine = TrialEngine(trial_tokenizer(), [r"\boxed{1 2}", r"\boxed{3 4}", r"\boxed{5 6}", "no guess"])
    actor = trial_actor(engine, rollout_batch_size_per_device=20, wave=4, num_envs=2, prompt_max_length=1500)
    episodes, metrics = actor.collect_experience()
    print(f"{len(episodes)} episodes, {metrics}")
    turns = [turn for episode in episodes for turn in episode]
    check(len(turns) >= 20, "there are as many transitions as the learner wants")
    calls = {tuple(prompt): made for prompt, made in engine.calls}
    made = [calls[tuple(turn.prompt_ids)] for turn in turns]
    check(len(turns) == len(engine.calls), "every response is one transition")
    check(
        [turn.response_ids for turn in turns] == [list(one.token_ids) for one in made],
        "ids are those that were sampled",
    )
    logprobs = [
        [trial_logprob(len(turn.prompt_ids) + place) for place in range(len(turn.response_ids))] for turn in turns
    ]
    check([turn.response_logprobs for turn in turns] == logprobs, "log-probabilities are those of their places")
    pairs = [pair for episode in episodes for pair in itertools.pairwise(episode)]
    goes_on = [b.prompt_ids[: len(a.prompt_ids + a.response_ids)] == a.prompt_ids + a.response_ids for a, b in pairs]
    check(all(goes_on), "a prompt begins with the tokens so far")
    done = [[turn.done for turn in episode] for episode in episodes]
    check(done == [[False] * (len(each) - 1) + [True] for each in done], "the last transition is done")
    check({turn.rewards for turn in turns} == {-0.1, 0.0, 0.5, 1.0}, "each turn has its reward")
    check(any(not turn.action_is_formatted for turn in turns), "a response that cannot be read is told")
    check(all(turn.info == {} and turn.loss_mask for turn in turns), "info is a dict that Oat can write into")


if __name__ == "__main__":
    train() if len(sys.argv) > 1 else main()
