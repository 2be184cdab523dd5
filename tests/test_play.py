"""``gem play``: a person, or a pipe, is the agent."""

from __future__ import annotations

import io
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import gem_core as gem
from gem_core.records.files import read_episodes
from gem_core.terminal import BLOCK

if TYPE_CHECKING:
    from command_calls import Outcome, RunGem

COUNTDOWN, ECHO, SUMS = "toy:Countdown-v0", "toy:Echo-v0", "toy:Sums-v0"
BOARD = "play:Board-v0"


class BoardEnv(gem.Env):
    """Asks for four letters in boxes; draws them in red, and shows them as an image if asked to."""

    metadata = {"render_modes": ["ansi"]}  # noqa: RUF012 - as in Gymnasium

    def __init__(self, image: bool = False) -> None:
        super().__init__()
        self.image, self.letters = image, ""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.letters = ""
        return self._observed("Write a letter.\n")

    def step(self, action: str) -> Any:
        answer = gem.extract_last_boxed_answer(action)
        self.letters += (answer or "?")[:1]
        over = len(self.letters) == 4
        observation, info = self._observed("Noted.\n")
        if over:
            info["correct"] = self.letters == "abcd"
        return observation, 0.25, over, False, info

    def _observed(self, feedback: str) -> Any:
        suffix = f"Letters: {self.letters!r}."
        info = {"feedback": feedback, "suffix": suffix}
        if not self.image:
            return feedback + suffix, info
        from PIL import Image

        return [{"type": "text", "text": feedback}, {"type": "image", "image": Image.new("RGB", (4, 3))}], {}

    def sample_random_action(self) -> str:
        return f"\\boxed{{{'abcd'[int(self.action_random.integers(4))]}}}"

    def render(self) -> Any:
        return f"[\x1b[31m{self.letters:<4}\x1b[0m]"


gem.register(BOARD, BoardEnv, summary="Write letters.")


@pytest.fixture
def play(run_gem: RunGem, monkeypatch: pytest.MonkeyPatch):
    """Call ``gem play`` in this process, in an empty folder, with input from a pipe."""

    def call(*arguments: str, typed: str = "", command: str = "play") -> Outcome:
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(typed.encode("utf-8", "surrogateescape"))))
        return run_gem(command, *arguments)

    return call


class StrictEnv(BoardEnv):
    """Ends at what is no letter, and says that it did nothing with it; so does the second x."""

    def step(self, action: str) -> Any:
        answer = gem.extract_last_boxed_answer(action)
        if answer is None or not answer.isalpha() or answer == "x":
            self.letters = "gone"
            info = {"correct": False, "parsed_action": None}
            return f"{answer} is no letter. The end: abcd.", -1.0, True, False, info
        *result, info = super().step(action)
        return *result, info | {"parsed_action": answer}


STRICT = "play:Strict-v0"
gem.register(STRICT, StrictEnv)


# Piped.


def test_a_piped_episode_from_beginning_to_end(play) -> None:
    """What a reader sees: no prompt, no colours, and one line for each turn."""
    outcome = play(BOARD, "--seed", "1", typed="a\nb\n\\boxed{c}\nd\n")
    assert (outcome.code, outcome.err) == (0, "")
    before, _, after = outcome.out.partition("turn 2")
    assert before == (
        "\nplay:Board-v0 · episode 1\nWrite letters.\nAn answer is sent as \\boxed{…}. Type ? for help.\n"
        "\nWrite a letter.\n\n  [    ]\n\n"
        "turn 1 · \\boxed{a} · reward 0.25 · return 0.25\n\nNoted.\n\n  [a   ]\n\n"
    )
    assert after.endswith("\nWon after 4 turns. Return 1.\nThe same again: gem play play:Board-v0 --seed 1\n")
    assert "\x1b" not in outcome.out
    assert ">" not in outcome.out


def test_a_typo_does_not_end_the_episode(play) -> None:
    """It is taken back and asked again, and what the environment said of the end is not shown."""
    outcome = play(STRICT, "-o", "a.jsonl", typed="a\n7\nb\nx\nc\nd\n")
    assert outcome.out.count("was not played: it cannot be read, or breaks the rules.") == 2
    assert "The end" not in outcome.out
    assert "Noted.\n\n  [ab  ]\n" in outcome.out  # the board of the episode that goes on, not of the one that ended
    assert "Won after 4 turns. Return 1.\n" in outcome.out
    (episode,) = read_episodes("a.jsonl")
    assert [str(turn.action) for turn in episode.transitions] == [f"\\boxed{{{letter}}}" for letter in "abcd"]


def test_episodes_are_those_of_a_run_with_the_same_seed(play) -> None:
    """So that a person and a model can be compared, start for start."""
    played = play(COUNTDOWN, "-s", "5", "-n", "3", "-t", "2", "-o", "a.jsonl", typed="x\n" * 6)
    assert played.code == 0
    assert "3 episodes written to a.jsonl.\n" in played.out
    Path("says_x.py").write_text("def act(observation): return 'x'\n")
    play(COUNTDOWN, "-s", "5", "-n", "3", "-t", "2", "-a", "says_x:act", "-k", "1", "-o", "b.jsonl", command="run")
    assert list(read_episodes("a.jsonl")) == list(read_episodes("b.jsonl"))
    assert {episode.run_seed for name in ("a.jsonl", "b.jsonl") for episode in read_episodes(name)} == {5}


def test_a_data_set_is_played_row_by_row(play) -> None:
    """As a run does; the example in the help is no answer of a row."""
    outcome = play(SUMS, "-n", "2", typed="?\n1\n<answer>3</answer>\n")
    assert "The form of an answer: \\boxed{…}\n\n0+1\n" in outcome.out
    assert "Won after 1 turn. Return 1.\n" in outcome.out
    assert "\n1+1\n" in outcome.out
    assert "Lost after 1 turn. Return 0.\n" in outcome.out
    assert "<episode over>" not in outcome.out


def test_answers_over_several_lines(play) -> None:
    """In a block, where nothing is a command; a backslash is one."""
    typed = f'{BLOCK}\n?\n    """\n!undo\n{BLOCK}\n{BLOCK}\n{BLOCK}\n\nback\\\\\nstop\n'
    play(ECHO, "-o", "a.jsonl", typed=typed)
    (episode,) = read_episodes("a.jsonl")
    answers = ['?\n    """\n!undo', "", "back\\\\", "stop"]
    assert [str(turn.action) for turn in episode.transitions] == answers


def test_wrappers_show_observations_to_the_letter(play) -> None:
    """Nothing is drawn; the command that plays it again has the same options, and the seed that was drawn."""
    out = play(BOARD, "-w", "").out
    assert "  [    ]" not in out
    assert "─\nWrite a letter.\nLetters: ''.\n─" in out
    assert re.search(r"again: gem play play:Board-v0 -w '' --seed \d+\n", out)


def test_control_characters_are_shown_and_not_obeyed(play) -> None:
    """Laid out for a person, text of an environment cannot move the cursor."""
    out = play(ECHO, typed="\x1b]0;title\x07\n").out
    assert "Heard: \\x1b]0;title\\x07" in out


# Commands.


def test_undone_turns_are_in_no_record(play) -> None:
    """The board and the return are as before, and the record replays."""
    out = play(BOARD, "-o", "a.jsonl", typed="x\na\n!undo\n!undo\n!undo\na\nb\nc\nd\n").out
    assert "Taken back: \\boxed{a}\n\nNoted.\n\n  [x   ]\n" in out
    assert "there is no turn to take back.\n" in out
    (episode,) = read_episodes("a.jsonl")
    assert [str(turn.action) for turn in episode.transitions] == [f"\\boxed{{{letter}}}" for letter in "abcd"]
    (replayed,) = gem.rollout(
        gem.make(BOARD),
        lambda observation, context: str(episode.transitions[context.turn].action),
        plan=[gem.PlanItem(seed=episode.seed)],
    )
    assert replayed == episode


def test_undo_where_episodes_cannot_be_repeated(play) -> None:
    """A line says why, and play goes on; so does one for a command that there is not."""
    gem.register("play:Once-v0", "toys:EchoEnv", deterministic=False)
    outcome = play("play:Once-v0", typed="a\n!undo\n!undoo\nstop\n")
    assert outcome.code == 0
    assert "no command '!undoo'. Did you mean 'undo'?" in outcome.out
    assert "turns of this environment cannot be taken back: a seed and the actions do not repeat it" in outcome.out
    assert "Over after 2 turns." in outcome.out


def test_help_shows_keys_rules_and_an_example(play) -> None:
    """Whatever happened since."""
    out = play(BOARD, typed="a\n?\n").out.partition("return 0.25")[2]
    assert "!undo      take the last turn back" in out
    assert "The form of an answer: \\boxed{…}\n\nWrite a letter.\n" in out
    assert "The form of an answer: any text\n\nSay something.\n" in play(ECHO, typed="?\n").out


def test_system_text_comes_first(play) -> None:
    """A person reads what a model is told."""

    class Part(BoardEnv):
        def reset(self, seed: Any = None, options: Any = None) -> Any:
            observation, info = super().reset(seed)
            return observation, {**info, "system": "You play the clerk."}

    gem.register("play:Part-v0", Part)
    assert "You play the clerk.\n\n" in play("play:Part-v0").out


# Other environments, and mistakes.


def test_images_are_named_and_written_beside_the_record(play) -> None:
    """A person can open them while playing."""
    pytest.importorskip("PIL")
    gem.register("play:Images-v0", BoardEnv, image=True)
    assert "Write a letter.\n\n[image 4x3]\n" in play("play:Images-v0").out
    (path,) = set(re.findall(r"\[image 4x3 (.+)\]", play("play:Images-v0", "-o", "a.jsonl").out))
    assert Path(path).is_file()
