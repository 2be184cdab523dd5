"""``batches``: what is learnable, how episodes end, groups and seats, refusals; and any episode at all."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from spelling import END, Spelling

import gem_core as gem
from gem_core.errors import ArgumentError
from gem_core.records import Episode, Transition
from gem_train import batches
from gem_train.tokens import completions


def turn(response: gem.Response | None = None, reward: float = 0.0, **options: Any) -> Transition:
    """One turn whose tokens are known."""
    if response is None:
        response = gem.Response("a", token_ids=[7, 8], prompt_token_ids=[1])
    fields = {"observation": "Q", "terminated": False, "truncated": False, "info": {}}
    return Transition(action=response, reward=reward, **{**fields, **options})


def episode(*turns: Transition, **options: Any) -> Episode:
    return Episode(**{"id": "toy:Q", "seed": 0, "observation": "Q", "info": {}, "transitions": list(turns), **options})


ERROR = {"error": {"kind": "exception", "message": "the engine is down"}}


def test_what_is_not_the_agents_fault_or_doing_is_not_learnable() -> None:
    """Episodes with an error, also of their reset, and idle slots; their rewards stay."""
    batch = batches(
        [
            episode(turn(reward=0.5), turn(truncated=True, info=ERROR)),
            episode(info=ERROR),
            episode(turn(info={"idle": True}), turn(terminated=True, reward=1.0)),
        ]
    )
    assert_array_equal(batch.mask, [[True, True], [False, False], [True, True]])
    assert_array_equal(batch.learnable, [[False, False], [False, False], [False, True]])
    assert_array_equal(batch.episode_returns, [0.5, 0.0, 1.0])
    assert batch.token_mask.sum() == 8
    assert batch.loss_mask.sum() == 2
    assert batch.to_tokens(batch.rewards)[batch.loss_mask].tolist() == [1.0, 1.0]


def test_cut_off_responses_are_learnable_unless_asked() -> None:
    """A response that stopped at the token limit, of an episode that counts."""
    cut = gem.Response("a", token_ids=[7], prompt_token_ids=[1], finish_reason="length")
    played = episode(turn(), turn(cut, terminated=True))
    assert batches([played]).learnable.tolist() == [[True, True]]
    assert batches([played], learn_cut_off=False).learnable.tolist() == [[True, False]]


def test_ends_and_success_are_those_of_the_record() -> None:
    """Whoever sets both flags has terminated; who never began has not, unless the game was over before."""
    over: dict[str, Any] = {"terminated": True, "info": {"correct": True}}
    batch = batches(
        [
            episode(turn(**over)),
            episode(turn(**over, truncated=True)),
            episode(turn(truncated=True)),
            episode(turn(terminated=True)),
            episode(info=ERROR),
            episode(ended_first=True, first_reward=-1.0, seat="second"),
        ]
    )
    assert batch.terminated.tolist() == [True, True, False, True, False, True]
    assert_array_equal(batch.truncated, ~batch.terminated)
    assert_array_equal(batch.success, [1, 1, 0, np.nan, np.nan, np.nan])
    assert_array_equal(batch.episode_returns, [0, 0, 0, 0, 0, -1])


def test_groups_are_those_of_the_plan() -> None:
    """Equal names of one run of one task are one group; without a name each episode is its own."""
    named = [("0", 1, "toy:Q"), ("1", 1, "toy:Q"), (None, 1, "toy:Q"), ("0", 1, "toy:Q"), (None, 1, "toy:Q")]
    named += [("0", 2, "toy:Q"), ("0", 1, "toy:R")]
    batch = batches([episode(turn(), group=group, run_seed=run, id=task) for group, run, task in named])
    assert batch.groups.tolist() == [0, 1, 2, 0, 3, 4, 5]


def test_states_are_how_things_stood_before_a_turn() -> None:
    """The suffix, whatever the view shows; or else the observation."""
    told = {"feedback": "No.", "suffix": "Door 1."}
    first = episode(turn(info={}), turn(observation="Q a No.Door 1.", info=told), turn(observation="Q b"), info=told)
    second = episode(turn(observation="Q a No.Door 1."))
    assert_array_equal(batches([first, second]).states, [[0, 1, 0], [1, -1, -1]])


def test_states_compare_images_by_their_pixels() -> None:
    """Two renderings of one state are one state."""
    shown = [[{"type": "image", "image": Image.new("RGB", (2, 2), colour)}] for colour in ("red", "red", "blue")]
    assert_array_equal(batches([episode(*(turn(observation=each) for each in shown))]).states, [[0, 0, 1]])


def test_thinking_that_a_server_took_out_is_not_learnable() -> None:
    """Nor native calls: the text alone is not what was sampled. With their ids, they are."""
    calls = [{"id": "c", "type": "function", "function": {"name": "note", "arguments": "{}"}}]
    for reported in ({"reasoning": "hm"}, {"tool_calls": calls}):
        unknown, known = (
            gem.Response("a", **reported),
            gem.Response("a", token_ids=[7], prompt_token_ids=[1], **reported),
        )
        batch = batches([episode(turn(unknown), turn(known), turn(gem.Response("a")))], tokenizer=Spelling())
        assert batch.learnable.tolist() == [[False, True, True]]
        assert batch.tokens[0].tolist()[: batch.lengths[0]] == [ord("Q"), ord("a")]  # not ended: more followed
        assert batch.tokens[2].tolist()[: batch.lengths[2]] == [ord("Q"), ord("a"), END]


def test_text_that_no_tokenizer_takes_is_tokenized_as_replacement() -> None:
    """A model may write lone surrogates."""
    batch = batches([episode(turn(gem.Response("a\ud800")))], tokenizer=lambda text: list(text.encode()))
    assert bytes(batch.tokens[0].tolist()) == b"Qa?"


PICTURE = [{"type": "text", "text": "What is it?"}, {"type": "image", "image": Image.new("RGB", (2, 2))}]
IN_CHAT = [{"role": "user", "content": PICTURE}]
PLAIN = gem.Response("a")


@pytest.mark.parametrize(
    ("second", "options", "value"),
    [
        (turn(PLAIN), {}, r"toy:Q, episode 0\.0, turn 1: .* no token_ids; .*tokenizer=.*return_token_ids=True"),
        (turn(gem.Response("a", token_ids=[1])), {}, "turn 1: .* no prompt_token_ids; .*tokenizer="),
        (turn(gem.Response("a", token_ids=[1, 2], prompt_token_ids=[1], logprobs=[-1.0])), {}, "2 .* 1 logprobs"),
        (turn(PLAIN, observation=PICTURE), {"tokenizer": Spelling()}, "turn 1: an image .*prompt_token_ids"),
        (turn(PLAIN, observation=IN_CHAT), {"tokenizer": Spelling()}, "turn 1: an image .*prompt_token_ids"),
        (
            turn(PLAIN, observation=[{"role": "user", "content": "Q"}]),
            {"tokenizer": str.split},
            "turn 1: .*apply_chat_template",
        ),
        (turn(PLAIN), {"tokenizer": "qwen"}, "'qwen'"),
        (turn(), {"form": "rows"}, "'transitions' or 'trajectories', not 'rows'"),
    ],
)
def test_what_cannot_be_made_is_refused(second: Transition, options: dict[str, Any], value: str) -> None:
    """With the turn, and what to do."""
    with pytest.raises(ArgumentError, match=value):
        batches([episode(turn(), second)], **options)


ids = st.lists(st.integers(0, 9), max_size=3)


@st.composite
def episodes(draw: st.DrawFn) -> Episode:
    """Any episode; a prompt goes on with the tokens so far, or is another."""
    turns: list[Transition] = []
    known: list[int] = []
    for _ in range(draw(st.integers(0, 4))):
        prompt = (known if draw(st.booleans()) else []) + draw(ids)
        sampled = draw(ids)
        turns.append(turn(gem.Response("a", token_ids=sampled, prompt_token_ids=prompt), draw(st.floats(-1, 1))))
        known = prompt + sampled
    return episode(*turns, first_reward=draw(st.floats(-1, 1)))


@given(st.lists(episodes(), max_size=4), st.sampled_from(["transitions", "trajectories"]))
def test_of_any_episode_nothing_is_lost(played: list[Episode], form: Any) -> None:
    """Sampled ids in order, each prompt before its response, values on their tokens, sums of rewards."""
    batch = batches(played, form=form)
    turns = [(place, number, one) for place, each in enumerate(played) for number, one in enumerate(each.transitions)]
    values = np.arange(1.0, batch.rewards.size + 1).reshape(batch.rewards.shape)
    spread, last = batch.to_tokens(values), batch.to_last_tokens(values)
    for place, number, one in turns:
        sampled = one.action.token_ids
        rows, columns = np.nonzero((batch.episode == place)[:, None] & (batch.turn == number))
        assert batch.tokens[rows, columns].tolist() == sampled
        if sampled:
            assert batch.tokens[rows[0], : columns[0]].tolist() == one.action.prompt_token_ids
            assert spread[rows, columns].tolist() == [values[place, number]] * len(sampled)
            assert last[rows, columns].tolist() == [0.0] * (len(sampled) - 1) + [values[place, number]]
    assert not spread[~batch.token_mask].any()
    assert batch.token_mask.sum() == sum(len(one.action.token_ids or ()) for _, _, one in turns)
    assert_allclose(batch.episode_returns, [one.episode_return for one in played])
    for row, completion in enumerate(completions(batch)):
        assert [*completion.prompt_ids, *completion.completion_ids] == batch.tokens[row, : batch.lengths[row]].tolist()
        assert completion.completion_mask[:1] != [0]
