"""``batches``: real episodes as transitions and trajectories, with the ids that were sampled."""

from __future__ import annotations

import random
from itertools import chain
from typing import Any

import numpy as np
import pydantic
import pytest
from numpy.testing import assert_array_equal
from spelling import END, Spelling, SpellingAgent, spelled

import gem_core as gem
from gem_train import TokenBatch, batches

GUESS = "game:GuessTheNumber-v0-easy"


def played(agent: Any, *wrappers: Any, env: str = GUESS, episodes: int = 4) -> list[gem.Episode]:
    """Play a game of at most four turns."""
    return list(gem.rollout(gem.make(env, wrappers=list(wrappers)), agent, episodes=episodes, seed=1))


def chat(**options: Any) -> tuple[str, dict[str, Any]]:
    """The view of the history as the text of a chat template."""
    return ("concat_chat", {"tokenizer": Spelling(), **options})


def sampled(episodes: list[gem.Episode]) -> list[list[int]]:
    """The ids that were sampled in each episode, in order."""
    return [list(chain.from_iterable(turn.action.token_ids or () for turn in one.transitions)) for one in episodes]


def marked(batch: TokenBatch) -> list[list[int]]:
    """The ids of each episode, in order, that the mask marks."""
    return [batch.tokens[rows[:, None] & batch.token_mask].tolist() for rows in _rows_by_episode(batch)]


def rows_of(batch: TokenBatch) -> list[list[int]]:
    """The ids of each row."""
    return [batch.tokens[row, :length].tolist() for row, length in enumerate(batch.lengths)]


def _rows_by_episode(batch: TokenBatch) -> list[Any]:
    return [batch.episode == episode for episode in range(len(batch.terminated))]


@pytest.mark.parametrize("prompts", [False, True])
@pytest.mark.parametrize("ends", [False, True])
def test_an_append_only_view_keeps_the_sampled_ids(prompts: bool, ends: bool) -> None:
    """One row an episode: the conversation to the letter, in which exactly what was sampled is marked."""
    episodes = played(SpellingAgent(prompts=prompts, ends=ends), chat())
    assert max(episode.turns for episode in episodes) == 4
    tokenizer = Spelling()
    batch = batches(episodes, form="trajectories", tokenizer=tokenizer)
    assert batch.episode.tolist() == [0, 1, 2, 3]
    assert marked(batch) == sampled(episodes)
    for row, episode in zip(rows_of(batch), episodes, strict=True):
        text = f"{episode.sent(episode.turns - 1)}{episode.transitions[-1].action}{chr(END) * ends}"
        assert tokenizer.decode(row) == text
        assert tokenizer.encode(text, add_special_tokens=False) != row  # it could not have been made of the text
    reported = [logprob for one in episodes for turn in one.transitions for logprob in turn.action.logprobs or ()]
    assert_array_equal(batch.logprobs[batch.token_mask], np.array(reported, np.float32))
    assert not batch.logprobs[~batch.token_mask].any()


@pytest.mark.parametrize("options", [{"max_turns": 1}, {"drop_thinking": True}])
def test_a_view_that_is_not_append_only_is_split(options: dict[str, Any]) -> None:
    """Where the next prompt does not begin with the tokens so far, a new row begins with it."""
    episodes = played(SpellingAgent("<think>hm</think>"), chat(**options))
    batch = batches(episodes, form="trajectories", tokenizer=Spelling())
    assert len(batch.lengths) > len(episodes)
    assert marked(batch) == sampled(episodes)
    assert all(np.diff(batch.episode) >= 0)
    turns = [(one, number) for one in episodes for number in range(one.turns)]
    for row, last in zip(rows_of(batch), batch.turn.max(axis=1), strict=True):
        while turns[0][1] != last:
            turns.pop(0)  # of the same row
        episode, number = turns.pop(0)
        assert Spelling().decode(row) == f"{episode.sent(number)}{episode.transitions[number].action}{chr(END)}"


def test_messages_are_written_by_the_chat_template() -> None:
    """And a response ends with the token that ends a turn, once."""

    def agent(messages: Any, context: gem.Context) -> gem.Response:
        return gem.Response(context.sample_random_action())

    agent.reads = "messages"  # type: ignore[attr-defined]
    (episode,) = played(agent, episodes=1)
    (row,) = rows_of(batches([episode], form="trajectories", tokenizer=Spelling()))
    assert Spelling().decode(row) == Spelling().apply_chat_template(
        episode.messages[: 2 * episode.turns], tokenize=False, add_generation_prompt=False
    ).removesuffix("\n")


class Hint(gem.Tool):
    """A tool that knows nothing."""

    name = "hint"
    description = "Gives a hint."

    class Parameters(pydantic.BaseModel):
        """Nothing."""

    def call(self, arguments: Parameters, session: None) -> gem.ToolResult:
        return gem.ToolResult("Between 1 and 10.")


def test_sampled_native_calls_stay_as_they_are() -> None:
    """The server took them out of the text; their ids stand in the row once, before the result."""
    spelling = random.Random(0)

    def agent(messages: Any, context: gem.Context) -> gem.Response:
        call = {"id": "c", "type": "function", "function": {"name": "hint", "arguments": "{}"}}
        ids = [*spelled("Hint?{}", spelling), END]
        return gem.Response("Hint?", token_ids=ids, tool_calls=[call], finish_reason="tool_calls")

    agent.reads, agent.native_tools = "messages", True  # type: ignore[attr-defined]
    env = gem.ToolEnv(gem.make(GUESS), [Hint()], max_tool_uses=3)
    episodes = list(gem.rollout(env, agent, episodes=1, seed=1))
    batch = batches(episodes, form="trajectories", tokenizer=Spelling())
    assert marked(batch) == sampled(episodes)
    (row,) = rows_of(batch)
    assert Spelling().decode(row).startswith("<1 tools><user>Guess")
    assert Spelling().decode(row).count(f"<assistant>Hint?{{}}{chr(END)}\n<tool>Between 1 and 10.") == 3
    assert batch.learnable.all()
