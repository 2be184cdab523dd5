"""``gem replay``: the same again from a record, what differs, and going on from a turn."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from PIL import Image

import gem_core as gem
import gem_eval
from gem_core import Episode, Response, Transition
from gem_core.cli import cli
from gem_core.errors import ArgumentError
from gem_core.records import ImageFolder, write_episodes
from gem_eval.replaying.replay import differences

ID = "game:GuessTheNumber-v0-hard"


def call(*arguments: object, text: str = "") -> Result:
    return CliRunner().invoke(cli, ["replay", *map(str, arguments)], input=text)


def guess(observation: Any, context: Any) -> str:
    return f"\\boxed{{{context.turn * 3 + 1}}}"


@pytest.fixture
def played(tmp_path: Path) -> Path:
    """Three recorded games of seven turns."""
    path = tmp_path / "run.jsonl"
    write_episodes(path, gem.rollout(gem.make(ID, wrappers="concat_with_action"), guess, episodes=3, seed=1))
    return path


def changed(path: Path, **fields: Any) -> Path:
    """Write the first episode of a file with some fields changed."""
    record = json.loads(path.read_text().splitlines()[0])
    out = path.with_name("changed.jsonl")
    out.write_text(json.dumps({**record, **fields}) + "\n")
    return out


def test_a_replay_goes_as_recorded(played: Path) -> None:
    """The environment is made with its wrappers, and answers the same."""
    found = gem_eval.replay(played, 2)
    assert found.agrees
    assert found.episodes[0].wrappers == found.original.wrappers == [["concat_with_action", {}]]
    assert call(played, 2).exit_code == 0


def test_an_episode_that_was_cut_off_is_repeated_to_where_it_was(tmp_path: Path) -> None:
    """Although its environment would go on."""

    def gives_up(observation: Any, context: Any) -> str:
        if context.turn == 2:
            raise gem.errors.EpisodeLimitError("enough", limit="cost")
        return guess(observation, context)

    write_episodes(tmp_path / "run.jsonl", gem.rollout(gem.make(ID), gives_up, episodes=1, seed=1))
    found = gem_eval.replay(tmp_path / "run.jsonl", 1)
    assert (found.agrees, found.original.cut_off) == (True, "cost")


def test_what_differs_from_the_record_is_said_and_exits_1(played: Path) -> None:
    """The first difference of each turn; a reward is one."""
    record = json.loads(played.read_text().splitlines()[0])
    record["transitions"][1]["reward"] = 0.25
    path = changed(played, transitions=record["transitions"])
    result = call(path, 1)
    assert result.exit_code == 1
    assert result.output.startswith("not as recorded: turn 2: reward was 0.25, and is ")


def test_an_agent_goes_on_in_the_recorded_conversation(played: Path) -> None:
    """It is sent what was said so far, and its system text; the turns before are kept to the letter."""
    sent = []

    class Other:
        reads = "messages"
        system = "Be brief."

        def __call__(self, observation: Any, context: Any) -> str:
            sent.append(context.messages)
            return "\\boxed{1}"

    found = gem_eval.replay(played, 1, 4, Other(), branches=2)
    assert found.agrees
    original = found.original
    assert sent[0] == [{"role": "system", "content": "Be brief."}, *original.messages[:7]]
    for branch in found.episodes:
        assert [turn.action for turn in branch.transitions[:3]] == [turn.action for turn in original.transitions[:3]]
        assert branch.transitions[3].action == "\\boxed{1}"
    assert [branch.repeat for branch in found.episodes] == [0, 1]


class Phone(gem.Env):
    """Answers a native call under its id, then takes a number."""

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        return "Which number?", {"tools": [{"type": "function", "function": {"name": "lookup", "parameters": {}}}]}

    def step(self, action: str) -> Any:
        calls = getattr(action, "tool_calls", None)
        if not calls:
            return "Thanks.", float(action == "7"), True, False, {"correct": action == "7"}
        answers = [{"role": "tool", "tool_call_id": call["id"], "content": "It is 7."} for call in calls]
        return "It is 7.", 0.0, False, False, {"messages": answers}


def test_native_calls_and_what_a_server_reported_are_kept_to_the_letter(tmp_path: Path) -> None:
    """The calls are made again, and their results have the ids of the record."""
    call_of_tool = {"id": "c7", "type": "function", "function": {"name": "lookup", "arguments": "{}"}}
    first = Response("Let me see.", tool_calls=[call_of_tool], reasoning="Hm.", token_ids=[1, 2], logprobs=[-0.5, -0.1])

    class Caller:
        reads, native_tools = "messages", True

        def __call__(self, observation: Any, context: Any) -> str:
            return first if context.turn == 0 else "7"

    gem.register("replayed:Phone", Phone)
    path = tmp_path / "run.jsonl"
    write_episodes(path, gem.rollout(gem.make("replayed:Phone"), Caller(), episodes=1, seed=1))
    seen = []

    class Other(Caller):
        def __call__(self, observation: Any, context: Any) -> str:
            seen.extend(context.messages)
            return "8"

    branch = gem_eval.replay(path, 1, 2, Other()).episodes[0]
    assert (branch.error, branch.success, branch.native_tools) == (None, False, True)
    assert branch.transitions[0].action.reported() == first.reported()
    assert seen[1]["tool_calls"] == [call_of_tool]
    assert seen[2] == {"role": "tool", "tool_call_id": "c7", "content": "It is 7."}


def test_a_difference_ends_a_branch_unless_forced(played: Path) -> None:
    """Before the agent is asked."""
    record = json.loads(played.read_text().splitlines()[0])
    record["transitions"][0]["observation"] = "Guess!"
    path = changed(played, transitions=record["transitions"])
    asked = []

    def other(observation: Any, context: Any) -> str:
        asked.append(context.turn)
        return "\\boxed{1}"

    (branch,) = gem_eval.replay(path, 1, 3, other).episodes
    assert branch.error is not None
    assert branch.error["message"].startswith("the replay is not as recorded: the first observation was 'Guess!', and")
    assert not asked
    forced = gem_eval.replay(path, 1, 3, other, force=True)
    assert (forced.episodes[0].error, asked[0], forced.agrees) == (None, 2, False)


def test_branches_are_a_file_with_the_original_before_them(played: Path, tmp_path: Path) -> None:
    """They share its row, so that they can be compared."""
    out = tmp_path / "branches.jsonl"
    result = call(played, 3, "--from-turn", 2, "--agent", "random", "--branches", 2, "--out", out)
    assert result.exit_code == 0, result.output
    rows = gem_eval.open_run(out).rows
    assert [(row.model, row.epoch) for row in rows] == [("original", 0), ("random", 0), ("random", 1)]
    assert gem_eval.compare(out).overall.rows == 1
    assert isinstance(call(played, 3, "--from-turn", 2, "-a", "random", "-o", out).exception, ArgumentError)


def test_a_person_goes_on(played: Path, tmp_path: Path) -> None:
    """The turns before are shown, and answers take the form of the game."""
    out = tmp_path / "mine.jsonl"
    result = call(played, 1, "--from-turn", 7, "--agent", "human", "--out", out, text="9\n")
    assert result.exit_code == 0, result.output
    assert "── turn 6 of 6 ─" in result.output
    run = gem_eval.open_run(out)
    mine: Episode = run.episode(run.rows[1])
    assert (mine.turns, mine.transitions[6].action, run.rows[1].model) == (7, "\\boxed{9}", "human")


def test_arguments_that_a_record_leaves_out_are_asked_for(tmp_path: Path) -> None:
    """The rows of a data set are too long for a record."""
    rows = [{"question": f"{number} + 1?", "answer": str(number + 1)} for number in range(3000)]
    gem.register("replayed:Sums", "gem_core:DatasetEnv")
    path = tmp_path / "run.jsonl"
    env = gem.make("replayed:Sums", rows=rows)
    write_episodes(path, gem.rollout(env, lambda observation: "\\boxed{1}", episodes=1, seed=1))
    with pytest.raises(ArgumentError, match="rows"):
        gem_eval.replay(path, 1)
    assert gem_eval.replay(path, 1, kwargs={"rows": rows}).agrees
    with pytest.raises(ArgumentError, match="--set NAME=VALUE"):
        gem_eval.replay(changed(path, kwargs={"password": "***"}), 1)


def test_what_cannot_be_gone_on_from_is_refused(played: Path) -> None:
    """With what there is."""
    with pytest.raises(ArgumentError, match="no turn 9"):
        gem_eval.replay(played, 1, 9, guess)
    for arguments in (("--agent", "random"), ("--branches", "2"), ("--from-turn", "2")):
        assert isinstance(call(played, 1, *arguments).exception, ArgumentError)


def test_a_replay_is_compared_with_a_record_whose_images_were_not_read(tmp_path: Path) -> None:
    """By their hashes."""
    image = Image.new("RGB", (2, 2), "red")
    shown = [{"type": "image", "image": image}]
    turn = Transition(shown, Response("1"), 1.0, True, False, {})
    seen = Episode("a:B", 1, shown, {}, [turn], "")
    unread = Episode.from_dict(seen.to_dict(ImageFolder(tmp_path)))
    assert differences(unread, seen, 1) == []
