"""After a change of gem-train's learner: its cost beside a bare PyTorch loop, and what playing beside learning saves.

The bare loop is what a practitioner writes in an hour: a list of environments made by ``gem.make``, prompts padded on
the left, torch's own modules and ``torch.multinomial``. It runs with cached keys and values, and where prompts are
short also without. Both sides play GuessTheNumber and learn by REINFORCE with normalized returns, on one thread: the
same transformer with the same weights to begin with, the same tokenizer, number of episodes and of updates. In "one
turn back" the policy reads the last turn and the present one, and has imitated a scripted player for a few steps, so
that its responses look as they do in training. In "conversation" it reads all that it was shown and said, and has
learnt nothing: ten turns of any words.

The second table is ``overlap``, the next batch played beside learning: where a step of the environment waits, and where
it does not.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import harness

UPDATES, STEP_S, MOST_REPEATS = 3, 0.02, 2
FORMS: dict[str, tuple[int | None, int]] = {"one turn back": (1, 128), "conversation": (None, 16)}
"""How many earlier turns the policy reads, None for all, and the episodes of an update."""

OPTIONS = """
import dataclasses, json, time
import torch
import gem_core as gem
from gem_train.learner.options import TrainOptions

FILE, MEMORY, UPDATES = {file!r}, {memory}, {updates}
game = {{}} if MEMORY else {{"format_error_ends": False}}
options = TrainOptions(env=("game:GuessTheNumber-v0",), env_kwargs=game, algorithm="rebn", episodes={episodes},
    updates=1000, feedback=True, memory=MEMORY, max_tokens=10, context=64 if MEMORY else 512, overlap={overlap},
    imitate="gem_train.gamma_study:interval_player" if MEMORY else None, imitate_episodes=300, imitate_steps=60)
torch.set_num_threads(1)
seconds = {{"playing": 0.0, "environment": 0.0, "learning": 0.0}}

def timed(name, function):
    def call(*args, **more):
        started = time.perf_counter()
        result = function(*args, **more)
        seconds[name] += time.perf_counter() - started
        return result
    return call

def report(started, tokens):
    whole = time.perf_counter() - started[0]
    playing = seconds["playing"] - seconds["environment"]
    shares = {{name: each / whole for name, each in {{**seconds, "playing": playing}}.items()}}
    print(json.dumps({{"seconds": whole, "cpu_s": time.process_time() - started[1], "tokens": tokens, **shares}}))
"""

WAITING = """
from gem_games.guess_the_number import GuessTheNumberEnv
class WaitingEnv(GuessTheNumberEnv):
    concurrency = "thread"
    def step(self, action):
        time.sleep({step_s})
        return super().step(action)
gem.register("bench:Waiting-v0", WaitingEnv)
options = dataclasses.replace(options, env=("bench:Waiting-v0",))
"""

WARM_START = """
from gem_train.learner.training import warm_start
learner = warm_start(options)
torch.save({"words": learner.vocabulary.words, "policy": learner.policy.state_dict()}, FILE)
"""

OURS = """
from gem_core.vector import VectorEnv
from gem_train.learner.learning import Learner
from gem_train.learner.playing import Player
from gem_train.learner.training import Training
from gem_train.learner.vocabulary import Vocabulary

start = torch.load(FILE, weights_only=True)
learner = Learner(options, Vocabulary(start["words"]))
learner.policy.load_state_dict(start["policy"])
VectorEnv.step, VectorEnv.reset = timed("environment", VectorEnv.step), timed("environment", VectorEnv.reset)
Player.play, Learner.learn = timed("playing", Player.play), timed("learning", Learner.learn)
with Training(learner) as training:
    training.update()
    seconds = dict.fromkeys(seconds, 0.0)
    started, tokens = (time.perf_counter(), time.process_time()), 0
    for _ in range(UPDATES):
        tokens += sum(len(turn.said.tokens) for seat in training.update().played for turn in seat.turns)
    report(started, tokens)
"""

BARE = """
from torch import nn
from torch.nn import functional as F
from gem_train.learner.vocabulary import ANSWER, END, PAD, Vocabulary

class Block(nn.Module):
    def __init__(self, width, heads):
        super().__init__()
        self.heads = heads
        self.attention_norm, self.feed_norm = nn.LayerNorm(width), nn.LayerNorm(width)
        self.project, self.out = nn.Linear(width, 3 * width, bias=False), nn.Linear(width, width, bias=False)
        self.widen, self.narrow = nn.Linear(width, 4 * width), nn.Linear(4 * width, width)

    def forward(self, x, mask, past):
        parts = self.project(self.attention_norm(x)).unflatten(2, (3, self.heads, -1))
        query, key, value = parts.permute(2, 0, 3, 1, 4)
        if past is not None:
            key, value = torch.cat([past[0], key], 2), torch.cat([past[1], value], 2)
        read = F.scaled_dot_product_attention(query, key, value, attn_mask=mask)
        x = x + self.out(read.transpose(1, 2).flatten(2))
        return x + self.narrow(F.gelu(self.widen(self.feed_norm(x)))), (key, value)

class Model(nn.Module):
    def __init__(self, size, options):
        super().__init__()
        self.embedding = nn.Embedding(size, options.width)
        self.positions = nn.Embedding(options.context, options.width)
        self.stack = nn.ModuleList(Block(options.width, options.heads) for _ in range(options.layers))
        self.norm, self.unembedding = nn.LayerNorm(options.width), nn.Linear(options.width, size, bias=False)

    def forward(self, tokens, real, past=None):
        # real: (rows, columns so far), False on padding
        new = tokens.shape[1]
        places = (real.long().cumsum(1) - 1).clamp(min=0)[:, -new:]
        causal = torch.ones(real.shape[1], real.shape[1], dtype=torch.bool).tril()[-new:]
        mask = (causal & real[:, None, :]) | torch.eye(real.shape[1], dtype=torch.bool)[-new:]
        x, present = self.embedding(tokens) + self.positions(places), []
        for number, block in enumerate(self.stack):
            x, kept = block(x, mask[:, None], past and past[number])
            present.append(kept)
        logits = self.unembedding(self.norm(x))
        logits[..., [PAD, ANSWER]] = -torch.inf
        return logits, present

@torch.no_grad()
def generate(prompts):
    longest = max(map(len, prompts))
    tokens = torch.tensor([[PAD] * (longest - len(prompt)) + prompt for prompt in prompts])
    real = torch.tensor([[False] * (longest - len(prompt)) + [True] * len(prompt) for prompt in prompts])
    said, running, past, new = [[] for _ in prompts], torch.ones(len(prompts), dtype=torch.bool), None, tokens
    for _ in range(options.max_tokens):
        logits, present = model(new, real, past)
        drawn = torch.multinomial(logits[:, -1].softmax(-1), 1)
        for row in running.nonzero().flatten().tolist():
            said[row].append(int(drawn[row]))
        running = running & (drawn[:, 0] != END)
        if not running.any():
            break
        tokens, real = torch.cat([tokens, drawn], 1), torch.cat([real, torch.ones_like(drawn, dtype=torch.bool)], 1)
        past, new = (present, drawn) if CACHED else (None, tokens)
    return said

def play():
    # rows: tokens, which of them were sampled, and the return of the turn on those
    rows, tokens = [], 0
    shown = [timed("environment", env.reset)(seed=next(seeds))[0] for env in envs]
    history, rewards = [[] for _ in envs], [[] for _ in envs]
    running = list(range(len(envs)))
    while running:
        for number in running:
            history[number].append(tokenizer.encode(shown[number]) + [ANSWER])
        kept = 0 if MEMORY is None else 2 * MEMORY + 1
        prompts = [sum(history[number][-kept:], []) for number in running]
        said = generate(prompts)
        tokens += sum(map(len, said))
        ended = set()
        for number, prompt, response in zip(running, prompts, said):
            text = tokenizer.decode(response)
            _, reward, terminated, truncated, info = timed("environment", envs[number].step)(text)
            shown[number] = info.get("feedback", "")
            if MEMORY is not None:
                rows.append((number, len(rewards[number]), prompt, response))
            history[number].append(response)
            rewards[number].append(float(reward))
            if terminated or truncated:
                ended.add(number)
        running = [number for number in running if number not in ended]
    returns = []
    for earned in rewards:
        after, found = 0.0, []
        for reward in reversed(earned):
            after = reward + options.gamma * after
            found.append(after)
        returns.append(found[::-1])
    if MEMORY is None:
        made = [([], [], []) for _ in envs]
        for number, turns in enumerate(history):
            for place, ids in enumerate(turns):
                made[number][0].extend(ids)
                made[number][1].extend([bool(place % 2)] * len(ids))
                made[number][2].extend([returns[number][place // 2]] * len(ids))
    else:
        made = [
            (prompt + response, [False] * len(prompt) + [True] * len(response),
                [returns[number][turn]] * (len(prompt) + len(response)))
            for number, turn, prompt, response in rows
        ]
    flat = torch.tensor([each for of_episode in returns for each in of_episode])
    return made, flat.mean(), flat.std(), tokens

def learn(rows, mean, std):
    total = sum(sum(sampled) for _, sampled, _ in rows)
    optimizer.zero_grad(set_to_none=True)
    for begin in range(0, len(rows), 64):
        part = rows[begin : begin + 64]
        width = max(len(ids) for ids, _, _ in part)
        tokens = torch.tensor([ids + [PAD] * (width - len(ids)) for ids, _, _ in part])
        sampled = torch.tensor([mask + [False] * (width - len(mask)) for _, mask, _ in part])
        returns = torch.tensor([values + [0.0] * (width - len(values)) for _, _, values in part])
        logits, _ = model(tokens[:, :-1], tokens[:, :-1] != PAD)
        logprobs = logits.log_softmax(-1).gather(2, tokens[:, 1:, None]).squeeze(2)
        advantages = (returns - mean) / (std + 1e-8)
        loss = -(logprobs * advantages[:, 1:]).where(sampled[:, 1:], 0.0).sum() / total
        loss.backward()
    torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
    optimizer.step()

start = torch.load(FILE, weights_only=True)
tokenizer = Vocabulary(start["words"])
model = Model(len(tokenizer), options)
model.load_state_dict({name: value for name, value in start["policy"].items() if name in model.state_dict()})
optimizer = torch.optim.AdamW(model.parameters(), lr=options.learning_rate, betas=(0.9, 0.95), weight_decay=0.0)
envs, seeds = [gem.make(options.env[0], **game) for _ in range(options.episodes)], iter(range(10**6))
for number in range(UPDATES + 1):
    if number == 1:  # the first was to warm up
        seconds, tokens = dict.fromkeys(seconds, 0.0), 0
        started = time.perf_counter(), time.process_time()
    *batch, count = timed("playing", play)()
    timed("learning", learn)(*batch)
    if number:
        tokens += count
report(started, tokens)
"""


def main() -> None:
    """Measure and print the tables."""
    sides = harness.arguments()
    repeats = min(sides.repeats, MOST_REPEATS)
    with tempfile.TemporaryDirectory() as folder:
        files = {form: str(Path(folder) / f"{form}.pt") for form in FORMS}
        for form, file in files.items():
            harness.run_once(harness.snippet(sides.ours, _options(file, form) + WARM_START))
        for form, file in files.items():
            measure_learner(sides.ours, form, file, repeats)
        measure_overlap(sides.ours, files["one turn back"], repeats)


def _options(file: str, form: str, *, overlap: bool = False) -> str:
    memory, episodes = FORMS[form]
    return OPTIONS.format(file=file, memory=memory, updates=UPDATES, episodes=episodes, overlap=overlap)


def measure_learner(python: str, form: str, file: str, repeats: int) -> None:
    """Compare wall time and sampled tokens a second with the bare loop's."""
    given = _options(file, form)
    cases = {
        "ours": harness.snippet(python, given + OURS),
        "bare, cached keys": harness.snippet(python, f"{given}CACHED = True\n{BARE}"),
    }
    if FORMS[form][0] is not None:  # a conversation takes it minutes
        cases["bare, no cache"] = harness.snippet(python, f"{given}CACHED = False\n{BARE}")
    results = harness.measure(cases, repeats=repeats, warm_up=0)
    ours = results["ours"]
    rows = [
        [
            name,
            f"{case.median('seconds'):.2f}",
            f"{case.median('seconds') / ours.median('seconds'):.2f}",
            f"{case.median('cpu_s') / ours.median('cpu_s'):.2f}",
            f"{case.median('tokens') / case.median('seconds'):.0f}",
            *(f"{case.median(part):.0%}" for part in ("playing", "environment", "learning")),
        ]
        for name, case in results.items()
    ]
    title = (
        f"GuessTheNumber, {form}: {UPDATES} updates of {FORMS[form][1]} episodes; medians of {repeats} alternating runs"
    )
    parts = ["playing", "environment", "learning"]
    harness.print_table(
        title, ["side", "seconds", "of ours", "processor time of ours", "sampled tokens/s", *parts], rows
    )


def measure_overlap(python: str, file: str, repeats: int) -> None:
    """Compare runs with and without playing beside learning."""
    rows, form = [], "one turn back"
    for name, step_s in ((f"waits {STEP_S * 1000:.0f} ms a step", STEP_S), ("does not wait", 0.0)):
        waiting = WAITING.format(step_s=step_s) if step_s else ""
        results = harness.measure(
            {
                str(overlap): harness.snippet(python, _options(file, form, overlap=overlap) + waiting + OURS)
                for overlap in (False, True)
            },
            repeats=repeats,
            warm_up=0,
        )
        apart, beside = results["False"], results["True"]
        shares = [f"{apart.median(part):.0%}" for part in ("playing", "environment", "learning")]
        seconds = [case.median("seconds") for case in (apart, beside)]
        rows.append([name, *shares, *(f"{each:.2f}" for each in seconds), f"{seconds[0] / seconds[1]:.2f}"])
    header = ["environment", "playing", "environment", "learning", "seconds", "overlap, seconds", "times as fast"]
    harness.print_table(f"Rollouts beside learning, {UPDATES} updates of {FORMS[form][1]} episodes", header, rows)


if __name__ == "__main__":
    main()
