"""The warm start: episodes of a scripted player, the vocabulary built from them, and learning to answer as it does."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch

import gem_core as gem
from gem_core.env import stable_hash
from gem_core.errors import ArgumentError, SamplingNotSupported
from gem_core.records import Episode, PlanItem
from gem_train.learner.environments import seat_count
from gem_train.learner.learning import Learner
from gem_train.learner.options import TrainOptions
from gem_train.learner.playing import encode, next_piece, shown_and_said, text_of
from gem_train.learner.policy_loss import score
from gem_train.learner.vocabulary import END, Vocabulary
from gem_train.tokens import TokenBatch

_STEP_ROWS = 128
_LEARNING_RATE = 3e-3
_VOCABULARY_EPISODES = 256


def record_episodes(options: TrainOptions, env_ids: Sequence[str], agent: str, episodes: int) -> list[Episode]:
    """Let a player play, and return its episodes, one for each seat, in the order of the plan.

    Args:
        options: How the environments are made.
        env_ids: Which ones.
        agent: Name of the player, as ``load_agent`` takes it.
        episodes: Number of episodes of each environment.

    Raises:
        SamplingNotSupported: The player is "random", and an environment has no random actions.
    """
    recorded: list[Episode] = []
    for env_id in dict.fromkeys(env_ids):
        seed = stable_hash(options.seed, "imitation")
        plan = [PlanItem() for _ in range(episodes)]
        try:
            with gem.make_vec(env_id, 64, wrappers=options.wrappers, seed=seed, **options.env_kwargs) as vec:
                if seat_count(env_id, options):
                    joints = sorted(gem.rollout(vec, agents=agent, plan=plan), key=lambda joint: int(joint.key))
                    recorded.extend(seat for joint in joints for seat in joint)
                else:
                    recorded.extend(sorted(gem.rollout(vec, agent, plan=plan), key=lambda episode: int(episode.key)))
        except SamplingNotSupported as error:
            raise SamplingNotSupported(
                f"{env_id} does not say what a valid action is, so nobody can play it at random; "
                "name another player with --imitate"
            ) from error
    return recorded


def build_vocabulary(options: TrainOptions, recorded: Sequence[Episode]) -> Vocabulary:
    """Return the words of what a player was shown and said, and of what a random one meets, evaluations included."""
    episodes = [*recorded, *_random_episodes(options, shown={episode.id for episode in recorded})]
    return Vocabulary.build(
        (
            text
            for episode in episodes
            for shown, said in shown_and_said(episode.transitions, options.feedback)
            for text in (text_of(shown), said)
        ),
        options.vocabulary,
    )


def _random_episodes(options: TrainOptions, shown: set[str]) -> Iterator[Episode]:
    """Yield what a random player meets in each environment, evaluations included.

    Where there are no random actions, what the imitated player met is enough; words of evaluations are spelled then.

    Raises:
        SamplingNotSupported: Nobody has played an environment that is learnt.
    """
    for env_id in dict.fromkeys((*options.env, *options.eval_envs)):
        if env_id in shown and options.imitate == "random":
            continue
        try:
            yield from record_episodes(options, [env_id], "random", _VOCABULARY_EPISODES)
        except SamplingNotSupported:
            if env_id in options.env and env_id not in shown:
                raise


def imitate(learner: Learner, recorded: Sequence[Episode]) -> Iterator[float]:
    """Learn to say what a player said; yields the loss of each step, a mean over tokens.

    Args:
        learner: Whose policy learns, with an optimizer of its own.
        recorded: Episodes of the player.

    Raises:
        ArgumentError: Nothing that the player said is short enough.
    """
    options, policy = learner.options, learner.policy
    batch = _rows(learner, recorded)
    fits = batch.loss_mask.any(axis=1) & (batch.lengths <= options.context)
    if not fits.any():
        raise ArgumentError(
            f"nothing that {options.imitate!r} said fits in max_tokens ({options.max_tokens}) and context "
            f"({options.context}); raise them"
        )
    # Rows of like length go together, so that little of a batch is padding.
    usable = np.flatnonzero(fits)
    order = usable[np.argsort(batch.lengths[usable], kind="stable")]
    tokens, sampled = torch.from_numpy(batch.tokens[order]), torch.from_numpy(batch.loss_mask[order])
    lengths = torch.from_numpy(batch.lengths[order])
    optimizer = torch.optim.AdamW(policy.parameters(), lr=_LEARNING_RATE, betas=(0.9, 0.95), weight_decay=0.0)
    generator = torch.Generator().manual_seed(stable_hash(options.seed, "imitation"))
    for step in range(options.imitate_steps):
        part = min(1.0, (step + 1) / 30, 2 * (options.imitate_steps - step) / options.imitate_steps)
        optimizer.param_groups[0]["lr"] = _LEARNING_RATE * part
        optimizer.zero_grad(set_to_none=True)
        rows = torch.randint(len(tokens), (_STEP_ROWS,), generator=generator).sort().values
        count = int(sampled[rows].sum())
        total = 0.0
        for half in rows.chunk(2):
            width = int(lengths[half].max())
            loss = -score(policy, tokens[half, :width], sampled[half, :width]).logprobs.sum() / count
            loss.backward()  # type: ignore[no-untyped-call]
            total += float(loss.detach())
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
        optimizer.step()
        yield total


def _rows(learner: Learner, recorded: Sequence[Episode]) -> TokenBatch:
    """Return the rows of episodes as the policy would read and say them."""
    options, vocabulary = learner.options, learner.vocabulary
    read, said, owner, row = [], [], [], []
    for index, episode in enumerate(recorded):
        view = episode.info.get("view") is not None
        earlier: list[tuple[list[int], list[int]]] = []
        length = 0
        for shown, text in shown_and_said(episode.transitions, options.feedback):
            asked = encode(text_of(shown), vocabulary)
            answered = [*vocabulary.encode(text, phrases=False), END]
            piece, anew = next_piece(options, asked, earlier, length, view=view)
            length = (0 if anew else length) + len(piece) + len(answered)
            read.append(piece)
            said.append(answered)
            owner.append(index)
            row.append(anew)
            earlier.append((asked, answered))
    return TokenBatch.from_turns(
        contexts=read,
        responses=said,
        episode=owner,
        row=np.cumsum(row) - 1,
        rewards=[0.0] * len(owner),
        learnable=[len(tokens) <= options.max_tokens for tokens in said],
        terminated=[True] * len(recorded),
    )
