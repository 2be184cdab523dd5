"""``batches``: recorded episodes as token batches."""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import sha256
from typing import Any, Literal

import numpy as np

from gem_core.errors import ArgumentError
from gem_core.records import Episode, Record, Transition
from gem_train.tokens.token_batch import TokenBatch
from gem_train.tokens.turn_tokens import Tokenizer, turn_tokens


def batches(
    episodes: Iterable[Record],
    *,
    form: Literal["transitions", "trajectories"] = "transitions",
    tokenizer: Tokenizer | None = None,
    pad_id: int = 0,
    max_length: int | None = None,
    learn_cut_off: bool = True,
) -> TokenBatch:
    """Return recorded episodes as rows of tokens.

    Token ids that the sampler reported are used as they are, never tokenized again. A turn is learnable unless its
    episode ended in an error (``Episode.error``), its slot was idle, its tokens do not fit in ``max_length``, or its
    ids were not reported and its text lacks what the model wrote, as thinking and tool calls that a server took out.

    Args:
        episodes: Of ``rollout``, ``read_episodes`` or others. Of several agents, the episode of each seat is one of its
            own.
        form: ``"transitions"``: a row for each turn, what the model was sent and its response. ``"trajectories"``: one
            for each episode; where a prompt does not begin with the tokens so far, a new row begins with it.
        tokenizer: Makes the ids that were not reported: a tokenizer as Hugging Face has it, or a function of a text.
            Messages are written by its chat template, a text is tokenized as it is, neither with special tokens added;
            a response that was not cut off is ended with ``eos_token_id``, if there is one.
        pad_id: Stands after the end of a row.
        max_length: Cut longer rows off on the right, so that what is left is what the model saw.
        learn_cut_off: Whether a response that was cut off at the model's token limit is learnable.

    Raises:
        ArgumentError: Ids are missing, and the tokenizer does not give them; or ``form`` is neither of the two.
    """
    if form not in ("transitions", "trajectories"):
        raise ArgumentError(f"form is 'transitions' or 'trajectories', not {form!r}")
    played = [one for record in episodes for one in ([record] if isinstance(record, Episode) else record)]
    turns: dict[str, list[Any]] = {
        name: [] for name in ("contexts", "responses", "logprobs", "row", "episode", "learnable")
    }
    row = -1
    for index, episode in enumerate(played):
        before: list[int] = []
        for turn, tokens in enumerate(turn_tokens(episode, tokenizer)):
            goes_on = form == "trajectories" and turn > 0 and tokens.prompt[: len(before)] == before
            row += not goes_on
            turns["contexts"].append(tokens.prompt[len(before) :] if goes_on else tokens.prompt)
            turns["responses"].append(tokens.response)
            turns["logprobs"].append(tokens.logprobs)
            turns["row"].append(row)
            turns["episode"].append(index)
            turns["learnable"].append(
                episode.error is None and tokens.complete and _may_learn(episode.transitions[turn], learn_cut_off)
            )
            before = tokens.prompt + tokens.response
    return TokenBatch.from_turns(
        **turns,
        rewards=[transition.reward for episode in played for transition in episode.transitions],
        states=_numbered(_state(episode, turn) for episode in played for turn in range(episode.turns)),
        terminated=[_terminated(episode) for episode in played],
        groups=_numbered(_group(episode, index) for index, episode in enumerate(played)),
        success=[np.nan if episode.success is None else float(episode.success) for episode in played],
        first_rewards=[episode.first_reward for episode in played],
        seats=[episode.seat for episode in played],
        pad_id=pad_id,
        max_length=max_length,
    )


def _may_learn(transition: Transition, cut_off: bool) -> bool:
    return not transition.info.get("idle") and (cut_off or not transition.action.cut_off)


def _terminated(episode: Episode) -> bool:
    return episode.transitions[-1].terminated if episode.transitions else episode.ended_first


def _group(episode: Episode, index: int) -> object:
    """Return what the episodes of a group share; the seats of an environment do not start alike."""
    return index if episode.group is None else (episode.id, episode.run_seed, episode.group, episode.seat)


def _state(episode: Episode, turn: int) -> str:
    """Return how things stood before a turn: what the task says of it, or else all that the environment showed."""
    info = episode.transitions[turn - 1].info if turn else episode.info
    return repr(_comparable(info.get("suffix") or episode.transitions[turn].observation))


def _comparable(shown: Any) -> Any:
    """Return an observation with its images by their pixels: ``repr`` of an image tells where it is in memory."""
    if isinstance(shown, list):
        return [_comparable(part) for part in shown]
    if not isinstance(shown, dict):
        return shown
    if shown.get("type") != "image":
        return {name: _comparable(value) for name, value in shown.items()}
    image = shown["image"]
    return image.mode, image.size, sha256(image.tobytes()).digest()


def _numbered(keys: Iterable[object]) -> list[int]:
    """Return a number for each key, the same for equal ones."""
    numbers: dict[object, int] = {}
    return [numbers.setdefault(key, len(numbers)) for key in keys]
