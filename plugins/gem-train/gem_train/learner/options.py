"""Options of a training run."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, Self, get_args

from gem_core.errors import ArgumentError

Algorithm = Literal["reinforce", "rebn", "ppo", "grpo", "dr-grpo", "rloo"]
ALGORITHMS: tuple[str, ...] = get_args(Algorithm)


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """What a run is made of; the same options and the same versions give the same run.

    Args:
        env: Id of the environment, or several that are learnt together, one episode of each in turn.
        env_kwargs: Keyword arguments for all of them.
        wrappers: Put around each; see ``gem_core.make``. Without a view among them, the policy reads the conversation:
            what it was shown and said so far. With one, it reads what the view shows, each turn anew.
        algorithm: How advantages and the loss are made. ``"reinforce"``: returns as they are. ``"rebn"``: returns
            normalized over the batch. ``"ppo"``: GAE with a critic, clipped. ``"grpo"``: relative to the mean and
            deviation of a group of episodes with one start, clipped; ``"dr-grpo"``: without the deviation.
            ``"rloo"``: relative to the mean of the others in the group.
        gamma: Discount from turn to turn; GRPO and RLOO compare undiscounted returns.
        lam: Of GAE.
        updates: Number of updates.
        episodes: Episodes of each update.
        group_size: Episodes with one start; 1, or 8 where the algorithm compares within groups.
        epochs: Passes over each batch; 1, or 4 for PPO.
        minibatches: Parts of a batch, each with a step of the optimizer; 1, or 4 for PPO. After the first step
            on a batch, what is not clipped is weighed by importance.
        learning_rate: Of AdamW; it falls to 0, in a straight line, until the last update.
        clip: How far PPO's and GRPO's ratio may be from 1 before moving further earns nothing.
        entropy: Weight of the entropy bonus.
        value_weight: Weight of the critic's loss.
        role_baselines: Subtract a moving mean of the returns of each seat, in self-play; for one environment, with
            REINFORCE or ReBN.
        failure_reward: Added to the last reward of an episode that was not solved, as -1 for rewards of 1 and -1.
        overlap: Play the next batch while learning from this one, one update off-policy, with importance weights.
        feedback: Show after the first turn only what is new (``info["feedback"]``), not how things stand, where the
            environment tells them apart: shorter, for environments whose feedback says all.
        memory: How many earlier turns the policy reads besides what it is to answer; None for all that fit in
            ``context``.
        temperature: Of sampling.
        max_tokens: The most tokens of a response.
        learn_cut_off: Whether responses that stopped there are learnt from.
        layers: Of the transformer.
        width: Of the transformer.
        heads: Of the transformer.
        context: The most tokens of a prompt and its response; the beginning of a longer prompt is dropped.
        vocabulary: The most words.
        imitate: Name of an agent to imitate first, so that the policy knows what an answer looks like; None for none.
        imitate_episodes: Episodes that it plays.
        imitate_steps: Steps of the optimizer, of 128 turns each.
        eval_every: Updates between evaluations; 0 for one at the end alone.
        eval_envs: Ids to evaluate on; the trained ones if empty.
        eval_episodes: Of each evaluation and id.
        checkpoint_every: Updates between checkpoints.
        seed: Of everything that is drawn.
        threads: Threads of torch.
    """

    env: tuple[str, ...]
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    wrappers: tuple[Any, ...] = ()
    algorithm: Algorithm = "rebn"
    gamma: float = 0.9
    lam: float = 0.95
    updates: int = 400
    episodes: int = 256
    group_size: int = 0
    epochs: int = 0
    minibatches: int = 0
    learning_rate: float = 1e-3
    clip: float = 0.2
    entropy: float = 0.0
    value_weight: float = 0.5
    role_baselines: bool = False
    failure_reward: float = 0.0
    overlap: bool = False
    feedback: bool = False
    memory: int | None = None
    temperature: float = 1.0
    max_tokens: int = 16
    learn_cut_off: bool = True
    layers: int = 2
    width: int = 64
    heads: int = 4
    context: int = 512
    vocabulary: int = 2048
    imitate: str | None = "random"
    imitate_episodes: int = 4000
    imitate_steps: int = 600
    eval_every: int = 0
    eval_envs: tuple[str, ...] = ()
    eval_episodes: int = 1024
    checkpoint_every: int = 50
    seed: int = 0
    threads: int = 0

    def __post_init__(self) -> None:
        """Fill in what depends on the algorithm, and check.

        Raises:
            ArgumentError: A value that is not accepted.
        """
        if self.algorithm not in ALGORITHMS:
            raise ArgumentError(f"algorithm is one of {', '.join(ALGORITHMS)}, not {self.algorithm!r}")
        compares = self.algorithm in ("grpo", "dr-grpo", "rloo")
        critic = self.algorithm == "ppo"
        for name, value in (
            ("group_size", 8 if compares else 1),
            ("epochs", 4 if critic else 1),
            ("minibatches", 4 if critic else 1),
        ):
            if not getattr(self, name):
                object.__setattr__(self, name, value)
        for refused, message in self._checks(compares, critic):
            if refused:
                raise ArgumentError(message)

    @property
    def off_policy(self) -> bool:
        """Whether steps are taken on what other weights sampled."""
        return self.overlap or self.epochs * self.minibatches > 1

    def _checks(self, compares: bool, critic: bool) -> Iterator[tuple[bool, str]]:
        """Yield what is refused, and what is said then."""
        for name in ("updates", "episodes", "epochs", "minibatches", "max_tokens", "layers", "width", "heads"):
            yield getattr(self, name) < 1, f"{name} must be 1 or more, not {getattr(self, name)}"
        yield not self.env, "env must name an environment, as in env=('game:GuessTheNumber-v0',)"
        yield self.temperature <= 0, f"temperature must be above 0, not {self.temperature}"
        yield (
            self.role_baselines and (compares or critic or len(self.env) > 1),
            "role_baselines is for reinforce and rebn, in one environment",
        )
        yield (
            compares and self.group_size < 2,
            f"{self.algorithm} compares episodes within groups: group_size must be 2 or more",
        )
        yield (
            self.episodes % self.group_size != 0,
            f"episodes ({self.episodes}) must be a multiple of group_size ({self.group_size})",
        )
        yield (
            self.episodes // self.group_size % len(self.env) != 0,
            f"episodes ({self.episodes}), in groups of {self.group_size}, must be as many of each of the "
            f"{len(self.env)} environments",
        )
        yield not 0 <= self.gamma <= 1, f"gamma must be from 0 to 1, not {self.gamma}"
        yield (
            self.max_tokens >= self.context,
            f"max_tokens ({self.max_tokens}) must be below context ({self.context})",
        )
        yield self.width % self.heads != 0, f"width ({self.width}) must be a multiple of heads ({self.heads})"

    def to_dict(self) -> dict[str, Any]:
        """Return the options as plain JSON.

        Raises:
            ArgumentError: A wrapper or an argument of the environments is no JSON, as a function is not.
        """
        try:
            plain: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        except (TypeError, ValueError) as error:
            raise ArgumentError(
                f"wrappers and arguments of environments must be names and plain values: {error}"
            ) from None
        return plain

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Self:
        """Return the options that ``to_dict`` made this of.

        Raises:
            ArgumentError: They are of another version.
        """
        lists = {name: tuple(plain.get(name, ())) for name in ("env", "eval_envs")}
        wrappers = tuple(each if isinstance(each, str) else tuple(each) for each in plain.get("wrappers", ()))
        try:
            return cls(**{**plain, **lists, "wrappers": wrappers})
        except TypeError as error:
            raise ArgumentError(f"these are no options of this version of gem-train: {error}") from None
