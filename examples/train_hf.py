"""Train any Hugging Face causal language model: REINFORCE with Return Batch Normalization (ReBN), in one file.

On a CPU, in two minutes: a tiny random model, made on the spot, learns a toy task of two turns::

    python examples/train_hf.py --tiny --lr 3e-3 --max-tokens 8 --updates 120 --out runs/tiny

On a GPU: a real model, and the same run again after an interruption::

    pip install gem-core gem-games "gem-train[torch]" transformers peft
    python examples/train_hf.py --model Qwen/Qwen3-1.7B --env game:GuessTheNumber-v0 --lora-rank 32 --out runs/guess
    python examples/train_hf.py --resume runs/guess

Each update plays episodes by ``gem.arollout``, where one call of ``generate`` answers all episodes that wait for the
model; makes rows of tokens by ``gem_train.batches``; and takes one step of AdamW.

- Token in, token out: the loss takes the tokens that were sampled, and no text is tokenized again.
- A response that was cut off by length is learnt from, unless ``--skip-cut-off`` is given. An episode that ended in an
  error, which is no failure of the model, is left out and counted as ``errors``.
- A resumed run gives the same metrics as one that was never interrupted, where the environments repeat themselves (with
  vLLM it does not, and on a GPU up to what its kernels repeat): each update draws from a seed of its own, and a
  checkpoint holds the weights and the state of the optimizer.
- ``--engine vllm`` is written by the documents of vLLM 0.33 and has never been run.
- One process, one device, one agent in an environment, text alone. For more, see ``examples/trainers``.

Source: GEM, https://arxiv.org/abs/2510.01051.
"""

# /// script
# requires-python = ">=3.11"
# dependencies = ["gem-core", "gem-games", "gem-train[torch]", "peft>=0.17", "transformers>=5.23"]
# ///

from __future__ import annotations

import argparse
import asyncio
import contextvars
import json
import shutil
import string
import time
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
import torch
from torch.nn import functional
from transformers import AutoModelForCausalLM, AutoTokenizer, GenerationConfig, LogitsProcessor, LogitsProcessorList
from transformers.utils import logging

import gem_core as gem
from gem_core.env import stable_hash
from gem_core.records import PlanItem, write_episodes
from gem_core.rollouts import default_plan
from gem_train import TokenAgent, batches, estimators
from gem_train.adapters import Generated
from gem_train.reporting import MetricsLog, plot_run

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
DTYPE = "bfloat16" if DEVICE == "cuda" else "float32"
SHOWN = ("eval/return", "eval/success", "return", "success", "errors", "loss", "play_s", "learn_s")
"""The metrics that are printed; all are in ``metrics.jsonl``."""


def at_least_1(text):
    """Return a whole number from 1 up."""
    if (number := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"{number} is not 1 or more")
    return number


def above_0(text):
    """Return a number above 0."""
    if not (number := float(text)) > 0:
        raise argparse.ArgumentTypeError(f"{number:g} is not above 0")
    return number


def read_options(arguments=None):
    """Return the options; a resumed run keeps its own, but for those that are given anew, as ``--updates``."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--model", help="name on the Hugging Face hub, or a folder")
    add("--tiny", action="store_true", help="make a tiny random model, and train that")
    add("--env", nargs="+", default=["example:LettersAndDigits-v0"], help="ids of environments, which take turns")
    add("--wrappers", default="", help="put around each of them, as tools: python,search")
    add("--out", type=Path, default=Path("runs/train_hf"), help="folder of metrics, checkpoints and evaluations")
    add("--resume", type=Path, metavar="OUT", help="go on with the run of this folder from its last checkpoint")
    add("--updates", type=int, default=100, help="steps of the optimizer")
    add("--episodes", type=at_least_1, default=64, help="episodes for each update")
    add("--num-envs", type=at_least_1, default=64, help="how many of them run at once, and are generated for")
    add("--gamma", type=float, default=0.9, help="discount from turn to turn")
    add("--lora-rank", type=int, default=0, help="train a LoRA adapter of this rank; 0 trains all weights")
    add("--lr", type=above_0, help="learning rate; by default 1e-4 with LoRA, else 1e-6")
    add("--micro-batch", type=at_least_1, default=8, help="rows in one forward and backward pass; gradients accumulate")
    add("--gradient-checkpointing", action="store_true", help="less memory for a third more time")
    add("--dtype", choices=["float32", "bfloat16"], default=DTYPE, help="of the computation")
    add("--engine", choices=["transformers", "vllm"], default="transformers", help="what generates")
    add("--temperature", type=above_0, default=1.0, help="of sampling; evaluations are greedy")
    add("--max-tokens", type=at_least_1, default=512, help="longest response")
    add("--max-context", type=at_least_1, default=8192, help="longest conversation; one that overflows is cut off")
    add("--template", type=json.loads, default={}, help="""for the chat template: '{"enable_thinking": false}'""")
    add("--skip-cut-off", action="store_true", help="do not learn from responses that were cut off by length")
    add("--eval-env", nargs="+", help="ids of environments to evaluate on, by default those of --env")
    add("--every", type=at_least_1, default=10, help="updates from one greedy evaluation, and checkpoint, to the next")
    add("--eval-episodes", type=at_least_1, default=32, help="for each environment; of a data set, the first rows")
    add("--tensorboard", action="store_true", help="write for TensorBoard as well, into the folder of the run")
    add("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    if options.resume:
        if not (options.resume / "options.json").exists():
            parser.error(f"{options.resume} holds no run to resume")
        saved = json.loads((options.resume / "options.json").read_text(encoding="utf-8"))
        parser.set_defaults(**saved, out=options.resume)
        return parser.parse_args(arguments)
    if (options.out / "options.json").exists():
        parser.error(f"{options.out} holds a run: continue it by --resume {options.out}, or choose another --out")
    if not (options.model or options.tiny):
        parser.error("choose a --model, or --tiny")
    if options.tiny:
        options.model = str(options.out / "tiny-model")
    options.lr = options.lr or (1e-4 if options.lora_rank else 1e-6)
    return options


def begin_run(options):
    """Make the folder of a new run, with its options, and the tiny model if that is trained."""
    if (options.out / "options.json").exists():
        return
    if options.tiny:
        make_tiny_model(options.model, options.seed)
    options.out.mkdir(parents=True, exist_ok=True)
    saved = {name: value for name, value in vars(options).items() if name not in ("out", "resume")}
    (options.out / "options.json").write_text(json.dumps(saved, indent=1), encoding="utf-8")


# The model.


def load_model(options, checkpoint):
    """Return the model, new or of a checkpoint, and its tokenizer.

    Weights that learn are float32, since bfloat16 would round small steps away; those under an adapter have the type of
    the computation.
    """
    tokenizer = AutoTokenizer.from_pretrained(options.model)
    tokenizer.pad_token = tokenizer.pad_token or tokenizer.eos_token
    dtype = getattr(torch, options.dtype) if options.lora_rank else torch.float32
    weights = checkpoint if checkpoint and not options.lora_rank else options.model
    model = AutoModelForCausalLM.from_pretrained(weights, dtype=dtype).to(DEVICE)
    stops = {tokenizer.eos_token_id, *np.atleast_1d(model.generation_config.eos_token_id).tolist()} - {None}
    # Without what a model may bring along, as top_k: the loss has to be that of the distribution that was sampled from.
    model.generation_config = GenerationConfig(eos_token_id=sorted(stops), pad_token_id=tokenizer.pad_token_id)
    if options.lora_rank:
        from peft import LoraConfig, PeftModel, get_peft_model

        if checkpoint:
            model = PeftModel.from_pretrained(model, checkpoint, is_trainable=True)
        else:
            torch.manual_seed(options.seed)
            rank = {"r": options.lora_rank, "lora_alpha": 2 * options.lora_rank}
            model = get_peft_model(model, LoraConfig(**rank, target_modules="all-linear", task_type="CAUSAL_LM"))
    if options.gradient_checkpointing:
        model.activation_checkpointing_enable()
    return model.eval(), tokenizer  # no dropout: a token has one probability, in generation and in learning


def autocast(options):
    """Compute in the type of the options, in generation as in learning."""
    return torch.autocast(DEVICE, dtype=torch.bfloat16, enabled=options.dtype == "bfloat16")


def token_logprobs(model, tokens, lengths, first, temperature):
    """Return the log-probability of each token given those before it, (rows, L); 0 in the columns before ``first``."""
    attention_mask = (torch.arange(tokens.shape[1], device=DEVICE) < lengths[:, None]).long()
    kept = tokens.shape[1] - first + 1  # the logits of the first prompt are large, and of no use
    output = model(input_ids=tokens, attention_mask=attention_mask, logits_to_keep=kept, use_cache=False)
    logits = output.logits[:, -kept:-1].float() / temperature
    logprobs = -functional.cross_entropy(logits.transpose(1, 2), tokens[:, first:], reduction="none")
    return functional.pad(logprobs, (first, 0))


# Generation. An engine answers many prompts at once.


class TransformersEngine:
    """Generate by the very weights that learn."""

    def __init__(self, options, model, tokenizer):
        self.options, self.model, self.config = options, model, model.generation_config

    def load_weights(self, update):
        """Do nothing: there is one model."""

    @torch.no_grad()
    def generate(self, prompts, limits, temperature):
        """Return a continuation of each prompt, of at most so many tokens; temperature 0 takes the likeliest."""
        width, pad, stops = max(map(len, prompts)), self.config.pad_token_id, self.config.eos_token_id
        ids = [[pad] * (width - len(prompt)) + prompt for prompt in prompts]
        mask = [[0] * (width - len(prompt)) + [1] * len(prompt) for prompt in prompts]
        sampling = {"do_sample": True, "temperature": temperature, "top_k": 0} if temperature else {"do_sample": False}
        recorder = LogprobRecorder(temperature or 1.0)
        with autocast(self.options):
            sequences = self.model.generate(
                input_ids=torch.tensor(ids, device=DEVICE),
                attention_mask=torch.tensor(mask, device=DEVICE),
                generation_config=GenerationConfig(max_new_tokens=max(limits), **sampling),
                logits_processor=LogitsProcessorList([recorder]),
            )
        recorder(sequences, None)
        answers = []
        rows = zip(sequences[:, width:].tolist(), torch.cat(recorder.logprobs, 1).tolist(), limits, strict=True)
        for tokens, logprobs, limit in rows:
            stop = next((place for place, token in enumerate(tokens[:limit]) if token in stops), None)
            end = limit if stop is None else stop + 1
            answers.append(Generated(tokens[:end], logprobs[:end], "length" if stop is None else "stop"))
        return answers


class LogprobRecorder(LogitsProcessor):
    """Keep the log-probability of each sampled token, and of the whole distributions only the last."""

    def __init__(self, temperature):
        self.temperature, self.logprobs, self.last = temperature, [], None

    def __call__(self, input_ids, scores):
        """Look up the token that was sampled since the last call."""
        if self.last is not None:
            self.logprobs.append(self.last.gather(1, input_ids[:, -1:]))
        self.last = None if scores is None else (scores / self.temperature).log_softmax(-1)
        return scores


class VLLMEngine:
    """Generate by vLLM on the same GPU; it reads the weights of each update from files. Never run: see the top."""

    def __init__(self, options, model, tokenizer):
        from vllm import LLM

        self.options, self.model, self.adapter = options, model, None
        self.llm = LLM(
            options.model,
            dtype=options.dtype,
            gpu_memory_utilization=0.4,  # the rest is for learning
            max_model_len=options.max_context,
            generation_config="vllm",  # nothing that the model brings along, as above
            logprobs_mode="processed_logprobs",  # at the temperature
            enable_lora=options.lora_rank > 0,
            max_lora_rank=max(options.lora_rank, 8),
            seed=options.seed,
        )

    def load_weights(self, update):
        """Hand over the weights as they are now."""
        from vllm.lora.request import LoRARequest

        folder = self.options.out / "vllm-weights"
        self.model.save_pretrained(folder)
        if self.options.lora_rank:
            self.adapter = LoRARequest(f"update-{update}", update + 1, str(folder))
        else:
            self.llm.collective_rpc("reload_weights", kwargs={"weights_path": str(folder)})
            self.llm.reset_prefix_cache()

    def generate(self, prompts, limits, temperature):
        """Return a continuation of each prompt, of at most so many tokens; temperature 0 takes the likeliest."""
        from vllm import SamplingParams

        fixed = {"temperature": temperature, "logprobs": 0, "stop_token_ids": self.model.generation_config.eos_token_id}
        outputs = self.llm.generate(
            [{"prompt_token_ids": prompt} for prompt in prompts],
            [SamplingParams(max_tokens=limit, **fixed) for limit in limits],
            lora_request=self.adapter,
            use_tqdm=False,
        )
        answers = []
        for answer in (output.outputs[0] for output in outputs):
            logprobs = [found[token].logprob for token, found in zip(answer.token_ids, answer.logprobs, strict=True)]
            answers.append(Generated(answer.token_ids, logprobs, answer.finish_reason))
        return answers


# Episodes. One agent acts in all of them.

asking = contextvars.ContextVar("asking")
"""Id of the episode for which a task asks."""


class Policy(TokenAgent):
    """The model as an agent: it waits until every open episode asks for a response, then generates all of them.

    So batches are full, and the same in every run, which resuming needs.
    """

    def __init__(self, engine, tokenizer, **settings):
        super().__init__(self.request, tokenizer, **settings)
        self.engine, self.requests = engine, {}
        self.left, self.num_envs = 0, 0  # episodes of the plan that have not ended, and how many are open at once

    async def __call__(self, observation, context):
        """Answer one turn of one episode: ``TokenAgent`` makes a prompt of the tokens so far, and calls ``request``."""
        asking.set(context.episode)
        return await super().__call__(observation, context)

    async def request(self, prompt, *, max_tokens, temperature):
        """Return a continuation of one prompt."""
        answer = asyncio.get_running_loop().create_future()
        self.requests[asking.get()] = (prompt, max_tokens, temperature, answer)
        self.generate_if_complete()
        return await answer

    def generate_if_complete(self):
        """Answer all requests, unless an open episode has not asked yet."""
        if not self.requests or len(self.requests) < min(self.left, self.num_envs):
            return
        requests, self.requests = [self.requests[episode] for episode in sorted(self.requests)], {}
        prompts, limits, temperatures, answers = zip(*requests, strict=True)
        for answer, generated in zip(answers, self.engine.generate(prompts, limits, temperatures[0]), strict=True):
            if not answer.done():  # it is where the episode was given up meanwhile
                answer.set_result(generated)


async def play(vector, agent, plan, seed):
    """Return the episodes of a plan, in its order."""
    torch.manual_seed(seed)
    episodes, agent.left, agent.num_envs = [], len(plan), vector.num_envs
    async for episode in gem.arollout(vector, agent, plan=plan, seed=seed):
        episodes.append(episode)
        agent.left -= 1
        agent.generate_if_complete()
    return sorted(episodes, key=lambda episode: int(episode.key))


def summary(episodes):
    """Return what happened in episodes as numbers; those with an error are only counted."""
    counted = [episode for episode in episodes if episode.error is None]
    if not counted:
        raise SystemExit(f"every episode ended in an error, the first in {episodes[0].error}")
    actions = [transition.action for episode in counted for transition in episode.transitions]
    if not actions:
        raise SystemExit("no episode has a response: their first prompts leave no room in --max-context")
    known = [episode.success for episode in counted if episode.success is not None]
    return ({"success": float(np.mean(known))} if known else {}) | {
        "return": float(np.mean([episode.episode_return for episode in counted])),
        "turns": len(actions) / len(counted),
        "response_tokens": sum(len(action.token_ids) for action in actions) / len(actions),
        "cut_off": sum(action.cut_off for action in actions) / len(actions),
        "errors": len(episodes) - len(counted),
    }


# Learning.


def learn(model, optimizer, batch, options):
    """Take one step of REINFORCE with ReBN, and return what it did as numbers."""
    returns = estimators.discounted_returns(batch.rewards, batch.mask, gamma=options.gamma)
    by_turn = estimators.return_batch_normalization(returns, batch.learnable)
    advantages, learnt = batch.to_tokens(by_turn).astype(np.float32), batch.loss_mask
    rows = np.flatnonzero(learnt.any(axis=1))
    rows = rows[np.argsort(batch.lengths[rows], kind="stable")]  # like lengths together, for little padding
    loss_sum, gaps = 0.0, [torch.zeros(1)]
    model.train(options.gradient_checkpointing)  # which is off otherwise
    for start in range(0, len(rows), options.micro_batch):
        chosen = rows[start : start + options.micro_batch]
        width, first = int(batch.lengths[chosen].max()), int(learnt[chosen].argmax(axis=1).min())
        arrays = (array[chosen, :width] for array in (batch.tokens, learnt, batch.logprobs, advantages))
        tokens, mask, sampled, advantage = (torch.as_tensor(array, device=DEVICE) for array in arrays)
        with autocast(options):
            lengths = torch.as_tensor(batch.lengths[chosen], device=DEVICE)
            logprobs = token_logprobs(model, tokens, lengths, first, options.temperature)
        # These correct for an engine that rounds otherwise than the model that learns, as vLLM does; they are 1 if not.
        weights = estimators.truncated_importance_weights(logprobs, sampled, mask)
        # All divide by the same number, so that the gradients of the parts add up to that of the mean over all tokens.
        accumulation = {"weights": weights, "denominator": int(learnt.sum())}
        loss, _ = estimators.policy_gradient_loss(logprobs, sampled, advantage, mask, **accumulation)
        loss.backward()
        loss_sum += loss.item()
        gaps.append((logprobs.detach() - sampled)[mask].abs().cpu())
    norm = torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
    optimizer.step()
    optimizer.zero_grad()
    model.eval()
    return {"loss": loss_sum, "grad_norm": norm.item(), "logprob_gap": torch.cat(gaps).max().item()}


def save_checkpoint(options, update, model, tokenizer, optimizer):
    """Write a folder that ``from_pretrained`` reads, with the optimizer; it has its name only when it is complete."""
    partial = options.out / "partial"
    shutil.rmtree(partial, ignore_errors=True)
    model.save_pretrained(partial)
    tokenizer.save_pretrained(partial)
    torch.save(optimizer.state_dict(), partial / "optimizer.pt")
    partial.rename(options.out / f"checkpoint-{update:06d}")
    for old in sorted(options.out.glob("checkpoint-*"))[:-2]:
        shutil.rmtree(old)


def load_optimizer(options, checkpoint, model):
    """Return AdamW, new or as it was at the checkpoint."""
    weights = [weight for weight in model.parameters() if weight.requires_grad]
    optimizer = torch.optim.AdamW(weights, lr=options.lr, weight_decay=0.0)
    if checkpoint:
        optimizer.load_state_dict(torch.load(checkpoint / "optimizer.pt", map_location=DEVICE))
        optimizer.param_groups[0]["lr"] = options.lr  # which may be given anew
    return optimizer


async def train(options):
    """Evaluate, play, learn and save, with one line in ``metrics.jsonl`` for each update."""
    with ExitStack() as at_end:
        # First, so that a wrong name is told at once, and leaves nothing behind.
        vector = at_end.enter_context(gem.make_vec(options.env, options.num_envs, wrappers=options.wrappers))
        eval_env = options.eval_env or options.env
        eval_vector = at_end.enter_context(gem.make_vec(eval_env, options.num_envs, wrappers=options.wrappers))
        begin_run(options)
        await train_in(vector, eval_vector, options)
    print(f"The curves are in {plot_run(options.out)}")


async def train_in(vector, eval_vector, options):
    """Train in one vector environment, and evaluate in another."""
    checkpoint = max(options.out.glob("checkpoint-*"), default=None)
    begin = int(checkpoint.name.removeprefix("checkpoint-")) if checkpoint else 0
    model, tokenizer = load_model(options, checkpoint)
    optimizer = load_optimizer(options, checkpoint, model)
    engine = {"transformers": TransformersEngine, "vllm": VLLMEngine}[options.engine](options, model, tokenizer)
    settings = {"max_tokens": options.max_tokens, "max_context": options.max_context}
    settings["chat_template_kwargs"] = options.template
    agent = Policy(engine, tokenizer, **settings, sampling={"temperature": options.temperature})
    greedy = Policy(engine, tokenizer, **settings, sampling={"temperature": 0.0})
    with closing(MetricsLog(options.out, tensorboard=options.tensorboard)) as log:
        log.truncate_after(begin - 1)
        plan = [PlanItem(options.env[place % len(options.env)]) for place in range(options.episodes)]
        eval_plan = default_plan(eval_vector, options.eval_episodes)

        for update in range(begin, options.updates + 1):
            metrics, last = {}, update == options.updates
            engine.load_weights(update)
            if last or update % options.every == 0:
                episodes = await play(eval_vector, greedy, eval_plan, options.seed)
                write_episodes(options.out / f"evaluation-{update:06d}.jsonl", episodes)  # for: gem show FILE
                metrics |= {f"eval/{name}": value for name, value in summary(episodes).items()}
            if not last:
                started = time.monotonic()
                episodes = await play(vector, agent, plan, stable_hash(options.seed, "update", update))
                played = time.monotonic()
                cut_off = not options.skip_cut_off
                batch = batches(episodes, form="trajectories", pad_id=tokenizer.pad_token_id, learn_cut_off=cut_off)
                metrics |= summary(episodes) | learn(model, optimizer, batch, options)
                metrics |= {"play_s": played - started, "learn_s": time.monotonic() - played}
            log.write(update, metrics)
            print(update, *(f"{name} {metrics[name]:.3g}" for name in SHOWN if name in metrics), sep="  ", flush=True)
            if not last and ((update + 1) % options.every == 0 or update + 1 == options.updates):
                save_checkpoint(options, update + 1, model, tokenizer, optimizer)


# A toy task and a tiny model, to try it all without a download.


class LettersAndDigitsEnv(gem.Env):
    """Asks for small letters, then for digits; the reward of each turn is the share of characters that are."""

    asked = (("letters", string.ascii_lowercase), ("digits", string.digits))

    def reset(self, seed=None):
        """Ask for letters."""
        super().reset(seed=seed)
        self.rewards = []
        return f"Write {self.asked[0][0]}.", {}

    def step(self, action):
        """Score the response; ask for digits, once."""
        allowed = self.asked[len(self.rewards)][1]
        self.rewards.append(sum(character in allowed for character in action) / max(len(action), 1))
        if len(self.rewards) == 2:
            return gem.TERMINAL_STATE, self.rewards[1], True, False, {"correct": self.rewards == [1.0, 1.0]}
        return f"Write {self.asked[1][0]}.", self.rewards[0], False, False, {}


gem.register("example:LettersAndDigits-v0", LettersAndDigitsEnv)

CHAT_TEMPLATE = """{% for message in messages %}<|start|>{{ message.role }}
{{ message.content }}<|end|>
{% endfor %}{% if add_generation_prompt %}<|start|>assistant
{% endif %}"""


def make_tiny_model(folder, seed):
    """Save a random Qwen3 of two layers and a tokenizer of bytes, as ``from_pretrained`` reads them."""
    from tokenizers import Tokenizer, decoders, models, pre_tokenizers
    from transformers import PreTrainedTokenizerFast, Qwen3Config, Qwen3ForCausalLM

    alphabet = sorted(pre_tokenizers.ByteLevel.alphabet())
    byte_level = Tokenizer(models.BPE({character: place for place, character in enumerate(alphabet)}, []))
    byte_level.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False, use_regex=False)
    byte_level.decoder = decoders.ByteLevel()
    special = {"eos_token": "<|end|>", "pad_token": "<|pad|>", "additional_special_tokens": ["<|start|>"]}
    tokenizer = PreTrainedTokenizerFast(tokenizer_object=byte_level, chat_template=CHAT_TEMPLATE, **special)
    tokenizer.save_pretrained(folder)
    torch.manual_seed(seed)
    sizes = {"hidden_size": 32, "intermediate_size": 64, "num_hidden_layers": 2, "head_dim": 16}
    heads = {"num_attention_heads": 2, "num_key_value_heads": 1, "tie_word_embeddings": True}
    words = {"vocab_size": len(tokenizer), "eos_token_id": tokenizer.eos_token_id}
    # The usual 0.02 leaves a model this narrow close to uniform, whatever an adapter learns.
    config = Qwen3Config(**sizes, **heads, **words, initializer_range=0.2)
    Qwen3ForCausalLM(config).save_pretrained(folder)
    return folder


if __name__ == "__main__":
    logging.disable_progress_bar()  # transformers shows one for each checkpoint
    asyncio.run(train(read_options()))
