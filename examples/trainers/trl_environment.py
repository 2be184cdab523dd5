# /// script
# requires-python = ">=3.11"
# dependencies = ["trl>=1.16,<1.17", "torch", "transformers>=5.2", "gem-core", "gem-games", "gem-train"]
# [tool.gem.table]
# framework = 'TRL, `environment_factory`'
# rewards = 'summed'
# images = 'passed on, not tried'
# groups = 'yes'
# tools = 'native: each tool is a method'
# failures = 'reward None, advantage 0'
# ///
r"""TRL, ``environment_factory``: GRPO in which the model plays by tool calls, and TRL runs the loop.

Shows TRL 1.16 training in two environments of GEM at once: a game, and another with a tool. A response to the
task is a call of ``answer``; each tool of the environment is a method of its own, made from its schema. Real optimiser
steps of a tiny random Qwen3.

Install and run it here, in an environment of its own::

    python scripts/trainers.py trl_environment
    python examples/trainers/trl_environment.py

On a GPU, with a model of the hub that calls tools (vLLM samples where it is installed)::

    python examples/trainers/trl_environment.py --model Qwen/Qwen3-0.6B --env game:Mastermind-v0-hard --steps 200

Checkpoints are in ``--out``, the last two of them; the same command goes on from the last.

What TRL cannot take: one scalar stands for an episode, the sum of the rewards of its turns. Several agents: play one
seat (``gem.single_agent``). What the model says without a call of ``answer`` reaches no environment: the episode ends
there, with what was earned so far; so does one whose response was cut off. A tool that fails is told to the model, and
the episode goes on. Where the machinery fails, the model is told that the episode is over, and the reward is None: TRL
leaves it out of the group's baseline, with an advantage of 0. For tasks that read text, see ``trl_rollout.py``.
"""

from __future__ import annotations

import argparse
import inspect
import json
import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

os.environ.setdefault("TRL_EXPERIMENTAL_SILENCE", "1")

import tokenizers
import torch
import trl
from datasets import Dataset
from pydantic import BaseModel
from transformers import AutoModelForCausalLM, AutoTokenizer, PreTrainedTokenizerFast, Qwen3Config, Qwen3ForCausalLM
from transformers.trainer_utils import get_last_checkpoint

import gem_core as gem
from gem_core.errors import EnvFaultError
from gem_train.adapters import ChatSession
from gem_train.adapters.trial import check

OVER = "The episode is over."
TYPES: dict[str, Any] = {"string": str, "integer": int, "number": float, "boolean": bool, "array": list, "object": dict}


class GemEnvironment:
    """What TRL's trainer drives; ``environment_class`` makes a subclass for each environment."""

    env_id = ""
    kwargs: Mapping[str, Any] = {}

    def __init__(self) -> None:
        self.session = ChatSession(self.env_id, native_tools=True, **self.kwargs)
        self._failed = False

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None, **row: Any) -> Any:
        """Begin the episode of a row of the data set; what is returned goes to the end of the row's last message."""
        self._failed = False
        try:
            return joined([message["content"] for message in self.session.reset_sync(seed, options)])
        except EnvFaultError as error:
            self._failed = True
            return f"{error}. {OVER}"

    def answer(self, response: str) -> Any:
        """Give a response to the task, in the form that its text asks for.

        Args:
            response: The response.
        """
        return self._take(response)

    def get_reward(self) -> float | None:
        """Return the sum of the rewards of the turns; None, which TRL leaves out, where the machinery failed."""
        return None if self._failed else self.session.episode_return

    def _take(self, response: str) -> Any:
        """Step, and return what the model is told."""
        if self._failed or self.session.done:
            return OVER
        step = self.session.step_sync(response)
        if step.error is not None:
            self._failed = True
            return f"The environment failed. {OVER}"
        return joined([*(message["content"] for message in step.messages), *([OVER] if step.done else [])])


def joined(contents: list[Any]) -> Any:
    """Return contents of messages as one text, or as one list of parts where there are images among them."""
    if all(isinstance(content, str) for content in contents):
        return "\n\n".join(contents)
    lists = [[{"type": "text", "text": content}] if isinstance(content, str) else content for content in contents]
    return [part for parts in lists for part in parts]


def environment_class(name: str, env_id: str, **kwargs: Any) -> type[GemEnvironment]:
    """Return a class for ``environment_factory``, with a method for each tool of the environment.

    Args:
        name: Of the class, under which TRL logs its rewards.
        env_id: Id of the environment.
        **kwargs: Passed to ``gem.make``, ``wrappers`` with tools among them.
    """
    with ChatSession(env_id, native_tools=True, **kwargs) as session:
        session.reset_sync(0)
        methods = {tool["function"]["name"]: tool_method(tool["function"]) for tool in session.tools}
    return type(name, (GemEnvironment,), {"env_id": env_id, "kwargs": kwargs, **methods})


def tool_method(schema: Mapping[str, Any]) -> Callable[..., Any]:
    """Return a method that calls a tool: TRL reads its name, types and docstring, and tells the model of them."""

    def call(self: GemEnvironment, **arguments: Any) -> Any:
        given = {name: value for name, value in arguments.items() if value is not None}
        function = {"name": schema["name"], "arguments": json.dumps(given)}
        return self._take(gem.Response("", tool_calls=[{"id": "call", "type": "function", "function": function}]))

    properties, required = schema["parameters"].get("properties", {}), schema["parameters"].get("required", [])
    parameters, described = [inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)], []
    for name in sorted(properties, key=lambda name: name not in required):
        kind = TYPES.get(properties[name].get("type"), str)
        kind, default = (kind, inspect.Parameter.empty) if name in required else (kind | None, None)
        parameters.append(parameters[0].replace(name=name, annotation=kind, default=default))
        described.append(f"    {name}: {' '.join(properties[name].get('description', name).split())}")
    call.__name__ = schema["name"]
    call.__doc__ = "\n".join([schema["description"], *(["", "Args:", *described] if described else [])])
    call.__annotations__ = {each.name: each.annotation for each in parameters[1:]}
    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return call


# A trial of it.


class Halfway(gem.Tool):
    """A tool for the game."""

    name = "halfway"
    description = "Returns the whole number halfway between two others."
    concurrency = "inline"

    class Parameters(BaseModel):
        """The two numbers."""

        left: int
        right: int

    def call(self, arguments: Any, session: Any) -> str:
        """Return the middle; a call with numbers that are not in order fails."""
        if arguments.left > arguments.right:
            raise ValueError("left is greater than right")
        return str((arguments.left + arguments.right) // 2)


def as_text(call: Mapping[str, Any]) -> str:
    """Return a call as the model writes it."""
    return f"<tool_call>\n{json.dumps(call)}\n</tool_call><|im_end|>"


def tiny(texts: list[str], template: str) -> tuple[Any, Any]:
    """Return a random model of two layers, and a tokenizer over bytes whose merges are learnt from some texts."""
    made = tokenizers.Tokenizer(tokenizers.models.BPE())
    made.pre_tokenizer = tokenizers.pre_tokenizers.ByteLevel(add_prefix_space=False)
    made.decoder = tokenizers.decoders.ByteLevel()
    marks = ["<|im_start|>", "<|im_end|>", "<|endoftext|>"]
    alphabet = tokenizers.pre_tokenizers.ByteLevel.alphabet()
    learn = tokenizers.trainers.BpeTrainer(vocab_size=800, special_tokens=marks, initial_alphabet=alphabet)
    made.train_from_iterator(texts, learn)
    tokenizer = PreTrainedTokenizerFast(
        tokenizer_object=made, eos_token=marks[1], pad_token=marks[2], chat_template=template
    )
    size = {"hidden_size": 64, "intermediate_size": 128, "num_hidden_layers": 2, "head_dim": 16}
    heads = {"num_attention_heads": 4, "num_key_value_heads": 2, "max_position_embeddings": 4096}
    return Qwen3ForCausalLM(Qwen3Config(vocab_size=len(tokenizer), **size, **heads)), tokenizer


def imitate(
    model: Any, tokenizer: Any, environments: list[GemEnvironment], steps: int = 300, rate: float = 1e-2
) -> None:
    """Teach a random model to write calls, first ones and second ones, so that it has something to learn from."""
    optimizer = torch.optim.Adam(model.parameters())
    for step in range(steps):
        optimizer.param_groups[0]["lr"] = rate * (1 - step / steps)
        env = environments[step % 2]
        chat: list[dict[str, Any]] = [{"role": "user", "content": env.reset(step)}]
        first, second = step % 5 + 1, step // 5 % 5 + 1
        call = {"name": "answer", "arguments": {"response": f"\\boxed{{{first} {second}}}"}}
        if env is environments[1]:
            call["arguments"] = {"response": f"\\boxed{{{first}}}"}
            if step % 4 == 1:
                call = {"name": "halfway", "arguments": {"left": first, "right": second}}
        if step % 3 == 0:
            answered = env.answer(call["arguments"].get("response", ""))
            chat += [{"role": "assistant", "content": "", "tool_calls": [{"type": "function", "function": call}]},
                     {"role": "tool", "name": call["name"], "content": answered}]  # fmt: skip
        tools = [getattr(env, name) for name in ("answer", *(["halfway"] if env is environments[1] else []))]
        prompt = tokenizer.apply_chat_template(chat, tools=tools, tokenize=False, add_generation_prompt=True)
        asked, written = tokenizer.encode(prompt), tokenizer.encode(as_text(call))
        labels = torch.tensor([[-100] * len(asked) + written])
        model(input_ids=torch.tensor([asked + written]), labels=labels).loss.backward()
        optimizer.step()
        optimizer.zero_grad()


def check_trial(seen: list[Any], before: list[Any], trainer: Any) -> None:
    """Check a trial: what was played at each step, the weights before it, and the trainer after it."""
    for name, seed, completion, episode in seen[0]:
        rewards = [turn.reward for turn in episode.transitions]
        print(f"{name}, seed {seed}: {len(completion)} messages, rewards of turns {rewards}")
    played = [(name, seed, episode) for step in seen for name, seed, _, episode in step]
    starts = {(name, seed, episode.observation) for name, seed, episode in played}
    check(len(starts) == len({(name, seed) for name, seed, _ in played}), "a group shares a start")
    turns = [turn for _, _, episode in played for turn in episode.transitions]
    used = sum("tool" in turn.info for turn in turns)
    check(0 < used < len(turns), f"the model gave {len(turns) - used} answers and used the tool {used} times")
    for name, column in (("plain", "Plain"), ("with_tool", "WithTool")):
        returns = [episode.episode_return for own, _, _, episode in seen[0] if own == name]
        logged = float(trainer.state.log_history[0][f"rewards/{column}/mean"])
        same = abs(logged - sum(returns) / len(returns)) < 1e-3
        check(same, f"{name}: TRL's rewards are the returns of the episodes")
    weights = zip(before, trainer.model.parameters(), strict=True)
    moved = sum(bool(new.isfinite().all()) and not torch.equal(old, new.detach()) for old, new in weights)
    check(moved == len(before), f"{len(seen)} optimiser steps moved all {moved} weight tensors")


def read_options(arguments: list[str] | None = None) -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--model", help="of the hub, one that calls tools; by default a tiny random one, for a trial")
    parser.add_argument("--env", default="game:Mastermind-v0-easy")
    parser.add_argument("--steps", type=int, default=3)
    parser.add_argument("--out", default="runs/trl-environment", help="folder of checkpoints and of the model")
    parser.add_argument("--save-steps", type=int, default=50, help="steps from one checkpoint to the next")
    return parser.parse_args(arguments)


def environments_of(options: argparse.Namespace) -> dict[str, type[GemEnvironment]]:
    """Return the classes of the environments that are played; in a trial, one with a tool as well."""
    classes = {"plain": environment_class("Plain", options.env)}
    if options.model is None:
        tools = ("tools", {"tools": [Halfway()], "tool_success_reward": 0.25})
        classes["with_tool"] = environment_class("WithTool", "game:GuessTheNumber-v0-easy", wrappers=[tools])
    return classes


def configuration(options: argparse.Namespace, folder: str) -> trl.GRPOConfig:
    """Return what TRL reads of the options."""
    trial = options.model is None
    # fmt: off
    return trl.GRPOConfig(
        folder, max_steps=options.steps, per_device_train_batch_size=8, num_generations=4, shuffle_dataset=False,
        learning_rate=1e-4 if trial else 1e-6, beta=0.0, logging_steps=1, report_to="none",
        save_steps=options.save_steps, save_total_limit=2,
        max_completion_length=256 if trial else 4096, max_tool_calling_iterations=3 if trial else None,
        use_cpu=not torch.cuda.is_available(), use_vllm=not trial and find_spec("vllm") is not None,
        vllm_mode="colocate",
    )
    # fmt: on


def check_command(folder: str) -> None:
    """Let this file's parser and TRL's own checks of a configuration read the printed command."""
    printed = next(line for line in str(__doc__).splitlines() if "--model" in line).split()[2:]
    options = read_options(printed)
    config = configuration(options, folder)
    check(config.max_steps == options.steps == 200 and config.save_strategy == "steps", "TRL takes the command")
    played = [made.env_id for made in environments_of(options).values()]
    check(played == ["game:Mastermind-v0-hard"], "it trains on the environment that is named, and on no other")


def main() -> int:
    """Train; without a model's name, do the trial and check what the first lines of this file promise."""
    options = read_options()
    torch.manual_seed(0)
    classes = environments_of(options)
    trial, seen = options.model is None, []
    if trial:
        torch.set_num_threads(1)  # more would wait for each other at this size
        template = (Path(trl.__file__).with_name("chat_templates") / "qwen3_instruct_2507.jinja").read_text()
        environments = [each() for each in classes.values()]
        texts = [*(each.reset(0) for each in environments), template]
        texts.append(as_text({"name": "answer", "arguments": {"response": "\\boxed{5}"}}))
        model, tokenizer = tiny(texts, template)
        imitate(model, tokenizer, environments)
    else:
        tokenizer = AutoTokenizer.from_pretrained(options.model)
        model = AutoModelForCausalLM.from_pretrained(options.model, dtype="auto")

    def watch(environments: list[GemEnvironment], completions: list[Any], **row: Any) -> list[None]:
        """Note what was played; give no reward, since the environments do."""
        episodes = [each.session.episode for each in environments]
        seen.append(list(zip(row["environment"], row["seed"], completions, episodes, strict=True)))
        return [None] * len(environments)

    rows = [{"prompt": [{"role": "user", "content": ""}], "environment": name, "seed": seed}
            for seed in range(1000) for name in classes]  # fmt: skip
    with tempfile.TemporaryDirectory() as temporary:
        if trial:
            check_command(temporary)
            options.out, options.save_steps = temporary, options.steps
        trainer = trl.GRPOTrainer(
            model,
            watch if trial else None,
            configuration(options, options.out),
            Dataset.from_list(rows),
            processing_class=tokenizer,
            environment_factory=classes,
        )
        before = [weight.detach().clone() for weight in model.parameters()]
        trainer.train(resume_from_checkpoint=get_last_checkpoint(options.out) if os.path.isdir(options.out) else None)
        if trial:
            check_trial(seen, before, trainer)
            check(get_last_checkpoint(options.out) is not None, "a checkpoint is there to go on from")
        else:
            trainer.save_model(options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
