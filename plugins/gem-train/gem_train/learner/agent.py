"""``train:FOLDER``: an agent that plays as the policy of a run does."""

from __future__ import annotations

import torch

from gem_core.env import stable_hash
from gem_core.errors import ArgumentError
from gem_core.rollouts import Context
from gem_core.types import Observation, Response
from gem_train.learner.generation import sample
from gem_train.learner.model import Cache
from gem_train.learner.playing import encode, next_piece, shown_and_said, text_of
from gem_train.learner.run import RunFolder
from gem_train.learner.vocabulary import END


class CheckpointAgent:
    """Plays as the policy of a run does, from its last checkpoint; it reads what the policy reads.

    Its responses have the sampled tokens, those before them, and log-probabilities, so that ``gem_train.batches`` makes
    rows of them. Tools and views are named where it plays, as they were for training.

    Args:
        folder: Of the run.
        temperature: Of sampling; 0 takes the likeliest token, None samples as in training.
        seed: Of sampling.

    Raises:
        ArgumentError: There is no checkpoint.
    """

    reads = "observation"

    def __init__(self, folder: str = "", *, temperature: float | None = None, seed: int = 0) -> None:
        if not folder:
            raise ArgumentError("name the folder of a run of 'gem train', as train:runs/guess")
        learner = RunFolder(folder).load()
        if learner is None:
            raise ArgumentError(f"{folder} has no checkpoint of 'gem train'")
        self.policy, self.vocabulary, self.options = learner.policy, learner.vocabulary, learner.options
        self.temperature = self.options.temperature if temperature is None else temperature
        self.seed = seed

    def __call__(self, observation: Observation, context: Context) -> Response:
        """Return a response, drawn from a seed of its own: the same in each run with the same seed."""
        prompt = self._prompt(observation, context)
        place = (self.seed, context.info.get("seed"), context.env_id, context.episode, context.seat, context.turn)
        said = sample(
            Cache(self.policy, 1),
            [0],
            [prompt],
            self.options.max_tokens,
            keep=False,
            generator=torch.Generator().manual_seed(stable_hash(*map(str, place))),
            temperature=self.temperature,
        )[0]
        return Response(
            self.vocabulary.decode(said.tokens),
            token_ids=said.tokens,
            prompt_token_ids=prompt,
            logprobs=said.logprobs,
            finish_reason="stop" if said.tokens[-1] == END else "length",
        )

    def _prompt(self, observation: Observation, context: Context) -> list[int]:
        """Return all tokens before the response."""
        options, said = self.options, context.responses
        recent = slice(-(options.memory or 1), None)
        shown = context.info.get("feedback", observation) if options.feedback and said else observation
        earlier = [
            (self._encode(earlier_shown), response.token_ids or ())
            for (earlier_shown, _), response in zip(
                [*shown_and_said(context.transitions, options.feedback)][recent], said[recent], strict=True
            )
        ]
        before = [*(said[-1].prompt_token_ids or ()), *(said[-1].token_ids or ())] if said else []
        view = context.view is not None
        piece, anew = next_piece(options, self._encode(shown), earlier, len(before), view=view)
        return piece if anew else [*before, *piece]

    def _encode(self, observation: Observation) -> list[int]:
        return encode(text_of(observation), self.vocabulary)
