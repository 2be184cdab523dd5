"""``TokenAgent``: sampled tokens stay as they are, and the template writes what is between them."""

from __future__ import annotations

from typing import Any

import pytest
from chat_tokenizers import DROPPING, END, NO_TOOLS, STRIPPING, chat_tokenizer

import gem_core as gem
from gem_core.errors import ArgumentError
from gem_core.records import Episode
from gem_core.types import Info, Observation, ResetResult, StepResult
from gem_train.adapters import Generated, TokenAgent
from gem_train.tokens import batches

TOOLS = [{"type": "function", "function": {"name": "look", "parameters": {"type": "object", "properties": {}}}}]


class TalkEnv(gem.Env):
    """Answers a number of responses.

    Args:
        turns: How many.
        begin: The first observation.
        added: ``info["messages"]`` of each turn; None where the observation is the answer.
        first_info: What ``reset`` returns with it.
    """

    def __init__(
        self,
        turns: int = 3,
        begin: Observation = "Begin box.",
        added: list[dict[str, Any]] | None = None,
        first_info: Info | None = None,
    ) -> None:
        super().__init__()
        self.turns, self.begin, self.added, self.first_info = turns, begin, added, first_info or {}
        self.turn = 0

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        super().reset(seed=seed)
        self.turn = 0
        return self.begin, dict(self.first_info)

    def step(self, action: str) -> StepResult:
        self.turn += 1
        info = {"messages": self.added} if self.added else {}
        return f"Turn {self.turn}, é box.", 1.0, self.turn == self.turns, False, info


class Engine:
    """Returns given responses one after another, and keeps the prompts and the sampling arguments."""

    def __init__(self, *responses: Generated) -> None:
        self.responses = list(responses)
        self.prompts: list[list[int]] = []
        self.sampling: list[dict[str, Any]] = []

    async def __call__(self, prompt_ids: list[int], **sampling: Any) -> Generated:
        self.prompts.append(list(prompt_ids))
        self.sampling.append(sampling)
        return self.responses[len(self.prompts) - 1]


def letters(tokenizer: Any, text: str, *, end: bool = True) -> Generated:
    """Return a text as a token for each byte, which is not how the tokenizer would write ``box``."""
    ids = [token for letter in text for token in tokenizer.encode(letter, add_special_tokens=False)]
    ids += [tokenizer.eos_token_id] if end else []
    return Generated(ids, [-0.5 - place / 8 for place in range(len(ids))], "stop" if end else "length")


def played(env: Any, engine: Engine, tokenizer: Any, **options: Any) -> Episode:
    (episode,) = gem.rollout(env, TokenAgent(engine, tokenizer, **options), episodes=1, seed=1)
    return episode


def rendered(tokenizer: Any, episode: Episode, turn: int, tools: Any = None) -> list[int]:
    """Return the tokens of a fresh rendering of what the agent was sent."""
    text = tokenizer.apply_chat_template(episode.sent(turn), tools=tools, tokenize=False, add_generation_prompt=True)
    return list(tokenizer.encode(text, add_special_tokens=False))


def pieces_of(engine: Engine, turn: int) -> tuple[list[int], list[int]]:
    """Return the tokens before a response with it, and what was added to them for the next prompt."""
    so_far = [*engine.prompts[turn], *engine.responses[turn].token_ids]
    following = engine.prompts[turn + 1]
    assert following[: len(so_far)] == so_far
    return so_far, following[len(so_far) :]


def test_sampled_tokens_are_never_made_anew_from_text() -> None:
    """Responses whose tokens the tokenizer would write differently stand in the later prompts as they were sampled."""
    tokenizer = chat_tokenizer()
    engine = Engine(*(letters(tokenizer, "box é\n") for _ in range(3)))
    episode = played(TalkEnv(), engine, tokenizer)
    assert engine.prompts[0] == rendered(tokenizer, episode, 0)
    for turn in (0, 1):
        _, bridge = pieces_of(engine, turn)
        wanted = f"\n<|im_start|>user\nTurn {turn + 1}, é box.{END}\n<|im_start|>assistant\n"
        assert bridge == tokenizer.encode(wanted, add_special_tokens=False)
        assert engine.prompts[turn + 1] != rendered(tokenizer, episode, turn + 1)  # a shorter way to write box
    for place, transition in enumerate(episode.transitions):
        assert transition.action.text == "box é\n"
        assert transition.action.token_ids == engine.responses[place].token_ids
        assert transition.action.prompt_token_ids == engine.prompts[place]
        assert transition.action.logprobs == engine.responses[place].logprobs


@pytest.mark.parametrize(
    "added",
    [
        None,
        [{"role": "tool", "tool_call_id": "1", "content": "4"}, {"role": "tool", "tool_call_id": "2", "content": "5"}],
        [{"role": "tool", "tool_call_id": "1", "content": "4"}, {"role": "user", "content": "Go on."}],
    ],
)
def test_prompt_equals_fresh_rendering_where_text_round_trips(added: Any) -> None:
    """With one answer of the user a turn, with several results of tools, and with both."""
    tokenizer = chat_tokenizer()
    texts = ["look", "box", ""]
    engine = Engine(*(Generated(tokenizer.encode(text + END, add_special_tokens=False)) for text in texts))
    episode = played(TalkEnv(added=added, first_info={"tools": TOOLS, "system": "Be brief."}), engine, tokenizer)
    for turn in range(3):
        assert engine.prompts[turn] == rendered(tokenizer, episode, turn, TOOLS)
    assert "Tools: look" in tokenizer.decode(engine.prompts[0])
    assert episode.native_tools
    engine = Engine(*(letters(tokenizer, "box") for _ in range(3)))
    played(TalkEnv(added=added), engine, tokenizer)
    assert pieces_of(engine, 1)  # kept, though the tokenizer would write them differently


def test_template_without_tools_leaves_them_to_the_text_of_the_environment() -> None:
    """Then the agent is no one who offers tools natively, and the environment explains them."""
    tokenizer = chat_tokenizer(NO_TOOLS)
    engine = Engine(letters(tokenizer, "a"))
    info = {"tools": TOOLS, "tool_instructions": {"text": "Call look.", "native": ""}}
    episode = played(TalkEnv(turns=1, begin="Begin. Call look.", first_info=info), engine, tokenizer)
    assert not episode.native_tools
    assert "Begin. Call look." in tokenizer.decode(engine.prompts[0])


def test_response_cut_off_by_length_gets_the_end_of_its_turn() -> None:
    """The bridge begins with it, so that it is masked; it is in no sampled tokens and in no text."""
    tokenizer = chat_tokenizer()
    engine = Engine(letters(tokenizer, "box", end=False), letters(tokenizer, "box"))
    episode = played(TalkEnv(turns=2), engine, tokenizer)
    _, bridge = pieces_of(engine, 0)
    assert bridge[0] == tokenizer.eos_token_id
    first = episode.transitions[0].action
    assert (first.text, first.cut_off) == ("box", True)
    assert tokenizer.eos_token_id not in first.token_ids


def test_lone_surrogates_of_an_observation_are_question_marks() -> None:
    """Tokenizers refuse them, and a model can have an environment say them by the JSON of a call."""
    tokenizer = chat_tokenizer()
    episode = played(TalkEnv(turns=2, begin="Begin \ud800."), Engine(*[letters(tokenizer, "a")] * 2), tokenizer)
    assert "Begin ?." in tokenizer.decode(episode.transitions[0].action.prompt_token_ids)
    assert episode.turns == 2


def test_white_space_that_a_template_strips_is_no_reason_to_write_tokens_anew() -> None:
    """The sampled tokens stay, white space included."""
    tokenizer = chat_tokenizer(STRIPPING)
    engine = Engine(*(letters(tokenizer, " box \n") for _ in range(3)))
    played(TalkEnv(), engine, tokenizer)
    assert all(pieces_of(engine, turn)[1][0] == tokenizer.encode("\n")[0] for turn in (0, 1))


def test_template_that_drops_reasoning_has_its_prompt_rendered_anew() -> None:
    """What is sent is what the template writes, and the tokens so far are not its beginning."""
    tokenizer = chat_tokenizer(DROPPING)
    said = ["<think>so</think>box", "box", "box"]
    engine = Engine(*(letters(tokenizer, text) for text in said))
    episode = played(TalkEnv(), engine, tokenizer)
    assert engine.prompts[1] == rendered(tokenizer, episode, 1)
    assert "<think>" not in tokenizer.decode(engine.prompts[1])
    pieces_of(engine, 1)  # nothing was dropped since: the tokens so far are kept again
    batch = batches([episode], form="trajectories")
    assert batch.tokens.shape[0] == 2
    for row, turns in ((0, [0]), (1, [1, 2])):
        sampled = [token for turn in turns for token in engine.responses[turn].token_ids]
        assert batch.tokens[row][batch.token_mask[row]].tolist() == sampled
        assert set(batch.turn[row].tolist()) == {-1, *turns}


@pytest.mark.parametrize("wrappers", [["messages"], [("messages", {"max_turns": 1})]])
def test_view_that_drops_turns_has_its_prompt_rendered_anew(wrappers: Any) -> None:
    """A view that keeps the whole chat is continued; one that leaves turns out never is."""
    gem.register("talk:Talk", TalkEnv)
    tokenizer = chat_tokenizer()
    engine = Engine(*(Generated(tokenizer.encode("a" + END, add_special_tokens=False)) for _ in range(3)))
    episode = played(gem.make("talk:Talk", wrappers=wrappers), engine, tokenizer)
    for turn in range(3):
        assert engine.prompts[turn] == rendered(tokenizer, episode, turn)
    drops = wrappers != ["messages"]
    so_far = [*engine.prompts[1], *engine.responses[1].token_ids]
    assert (engine.prompts[2][: len(so_far)] != so_far) is drops


def test_context_overflow_ends_the_episode_as_one_that_is_scored() -> None:
    """A prompt that leaves no room is not sent; one that leaves little makes the response shorter."""
    tokenizer = chat_tokenizer()
    engine = Engine(*(letters(tokenizer, "boxbox") for _ in range(3)))
    first = len(
        tokenizer.apply_chat_template([{"role": "user", "content": "Begin box."}], add_generation_prompt=True)[
            "input_ids"
        ]
    )
    episode = played(TalkEnv(), engine, tokenizer, max_tokens=50, max_context=first + 20, sampling={"temperature": 0.7})
    assert engine.sampling == [{"temperature": 0.7, "max_tokens": 20}]
    assert (episode.turns, episode.cut_off, episode.error) == (1, "tokens", None)
    assert episode.transitions[-1].truncated


def test_engine_that_gives_up_is_an_error_of_its_episode() -> None:
    """An aborted request is never a response."""
    episode = played(TalkEnv(), Engine(Generated([64], None, "abort")), chat_tokenizer())
    assert episode.error is not None
    assert episode.error["cause"] == "aborted"
    assert episode.turns == 0


def test_images_are_refused() -> None:
    """A tokenizer reads none."""
    picture = [{"type": "text", "text": "Look: "}, {"type": "image", "image": None}]
    with pytest.raises(ArgumentError, match="holds an image"):
        played(TalkEnv(begin=picture), Engine(), chat_tokenizer())


class Look(gem.Tool):
    """Looks."""

    name = "look"
    description = "Looks somewhere."
    concurrency = "inline"

    class Parameters(gem.Tool.Parameters):
        """Where."""

        where: str

    def call(self, arguments: Any, session: Any) -> str:
        return f"A box at {arguments.where}."


def test_calls_are_shown_in_training_as_in_evaluation() -> None:
    """Read out of the text as a server does; the result has role tool; what was sampled stays as it was sampled."""
    tokenizer = chat_tokenizer()
    thought = '<think><tool_call>{"name": "look", "arguments": {"where": "no"}}</tool_call></think>'
    call = '<tool_call>\n{"name":"look",  "arguments": {"where": "x"}}\n</tool_call>'
    texts = [f"{thought}I look.\n{call}", "No call: <tool_call>{</tool_call>", "box", "box"]
    engine = Engine(*(letters(tokenizer, text) for text in texts))

    def evaluated(messages: Any, context: gem.Context) -> gem.Response:
        """Answer as an agent over the chat API of a server that reads calls."""
        if context.turn:
            return gem.Response(texts[context.turn])
        function = {"name": "look", "arguments": '{"where": "x"}'}
        return gem.Response(
            f"{thought}I look.", tool_calls=[{"id": "call_0_0", "type": "function", "function": function}]
        )

    evaluated.reads, evaluated.native_tools = "messages", True  # type: ignore[attr-defined]
    trained = played(gem.ToolEnv(TalkEnv(turns=2), [Look()]), engine, tokenizer)
    (served,) = gem.rollout(gem.ToolEnv(TalkEnv(turns=2), [Look()]), evaluated, episodes=1, seed=1)
    assert trained.messages == served.messages
    assert [message["role"] for message in trained.messages[1:3]] == ["assistant", "tool"]
    assert "A box at x." in trained.messages[2]["content"]
    for turn in (0, 1):
        _, bridge = pieces_of(engine, turn)
        assert tokenizer.decode(bridge).startswith(f"\n<|im_start|>{'user' if turn else 'tool'}\n")
