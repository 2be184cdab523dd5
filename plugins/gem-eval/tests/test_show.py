"""gem show: lists, filters, one episode, and what it says of files that are none."""

from __future__ import annotations

import json
import os
import pty
import re
import shlex
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded import broken, failed, hostile, maze, turn, write_all

from gem_core import Episode, Response
from gem_core.cli import main
from gem_core.testing import check_plugin
from gem_eval.records import RunWriter
from gem_eval.show.lines import episode_lines
from gem_eval.show.text import escaped, highlighted, one_line
from gem_eval.turns import parts_of, turn_views

ANY_TEXT = st.text(st.characters(codec=None, categories=None), max_size=60)
README = Path(__file__).parent.parent / "README.md"
COLOURS = re.compile(r"\x1b\[[\d;]*m")


class Outcome(NamedTuple):
    """What one call of the command did."""

    code: int
    out: str
    err: str


@pytest.fixture
def show(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Call gem show on a file of five episodes, in this process."""
    monkeypatch.chdir(tmp_path)
    write_all(tmp_path / "run.jsonl")

    def call(*arguments: str, file: str = "run.jsonl") -> Outcome:
        with pytest.raises(SystemExit) as caught:
            main(["show", file, *arguments])
        return Outcome(int(caught.value.code or 0), *capsys.readouterr())

    return call


def numbers(outcome: Outcome) -> list[int]:
    """The numbers of the episodes of a list."""
    assert (outcome.code, outcome.err) == (0, "")
    return [int(line.split()[0]) for line in outcome.out.splitlines()[1:]]


def plain(lines: Iterable[str]) -> list[str]:
    """Lines without their colours."""
    return [COLOURS.sub("", line) for line in lines]


def test_the_plugin_keeps_to_the_rules() -> None:
    """Its command is found, says what it does, and is not imported before it is called."""
    check_plugin("gem-eval")


def test_the_list_has_a_line_for_each_episode(show) -> None:
    """A header, then plain columns."""
    lines = show().out.splitlines()
    assert lines[0].split() == ["number", "environment", "outcome", "return", "turns", "seed", "group", "error"]
    assert lines[1].split() == ["1", "maze:Room-v0", "success", "0.75", "3", "7", "g1"]
    assert lines[2].split() == ["2", "maze:Room-v0", "failure", "0.25", "2", "7", "g1"]
    assert lines[3].split() == ["3", "chat:Talk-v0", "error", "0", "1", "3", "timeout:", "no", "answer", "in", "5", "s"]
    assert len(lines) == 6


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--env", "ROOM"], [1, 2, 5]),
        (["--env", "*:Talk*"], [3]),
        (["--success"], [1, 5]),
        (["--return", ">0.25"], [1, 5]),
        (["--return", "<= 0.25", "--no-errors"], [2, 4]),
        (["--return", "!=0.75", "--errors"], [3]),
        (["--return", "0.75"], [1, 5]),
        (["--no-errors", "--env", "a"], [1, 2, 4, 5]),
        (["--group", "g1"], [1, 2, 5]),
        (["--grep", "night FALLS."], [2]),
        (["--grep", "no answer in 5 s"], [3]),
        (["--grep", "\x1b[2J"], [4]),
        (["--reverse", "--limit", "2"], [5, 4]),
        (["--sort", "turns", "--reverse"], [1, 5, 2, 3, 4]),
        (["--sort", "success"], [3, 4, 2, 1, 5]),
        (["--sort", "seed", "--no-errors"], [4, 1, 2, 5]),
    ],
)
def test_filters_and_order(show, arguments: list[str], expected: list[int]) -> None:
    """Each condition alone; several hold together."""
    assert numbers(show(*arguments)) == expected


COMMANDS = re.findall(r"^gem show runs/guess.jsonl(.*?)(?:  |$)", README.read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("arguments", COMMANDS)
def test_what_the_readme_shows_can_be_typed(show, arguments: str) -> None:
    """With another file."""
    outcome = show(*shlex.split(arguments))
    assert (outcome.code, bool(outcome.out), outcome.err) == (0, True, "")


def test_one_episode_is_told_turn_by_turn(show) -> None:
    """What was observed, thought, answered, called, reported and rewarded, in this order."""
    out = show("1").out
    places = [
        out.index(part)
        for part in (
            "Episode 1 · maze:Room-v0\nsuccess, return 0.75, 3 turns\nseed: 7\ngroup: g1\n",
            "task: room-7\n",
            "── turn 1 of 3 ─",
            "observation\n  Find a way out",
            "reasoning\n  Where is the door?\n",
            "response  tiny-1 · 120 prompt tokens · 34 sampled tokens · finish reason tool_calls\n  I look around.\n",
            'tool call  python({"code": "print(6 * 7)"})\n',
            "reward  0.25\nfeedback\n  The tool says 42.\n",
            'tool: {"name": "python", "failed": false}\n',
            "── turn 2 of 3 ─",
            "  … 372 characters as in the turn before (--full shows them)\n  The tool says 42.\n  A door.\n",
            "reward  -0.5, cut off at the token limit\n",
            "reward  1, terminated\ncorrect: true\n",
            "final observation\n  You are outside.\nsuccess, return 0.75, 3 turns\n",
        )
    ]
    assert places == sorted(places)
    assert show("1", "--full").out.count("Find a way out") == 12
    assert "error  timeout: no answer in 5 s\n" in show("3").out
    assert "  A picture of the room:\n  [image " in show("5").out


def test_messages_are_told_by_role_and_those_said_before_are_folded() -> None:
    """Lists of messages, with parts inside and tool calls."""
    call = {"function": {"name": "add", "arguments": "{}"}}
    first: Any = [{"role": "user", "content": [{"type": "text", "text": "Hi"}]}]
    second: Any = [
        *first,
        {"role": "assistant", "content": None, "tool_calls": [call]},
        {"role": "user", "content": "Yo"},
    ]
    _, view = turn_views(Episode("toy:A-v0", 1, first, {}, [turn(first, "a"), turn(second, "b")], "end"))
    parts = [(part.kind, part.text) for part in view.blocks[0].parts]
    assert parts[:2] == [("role", "user"), ("text", "Hi")]
    assert parts[2:] == [("role", "assistant"), ("text", "add({})"), ("role", "user"), ("text", "Yo")]
    assert [part.repeated for part in view.blocks[0].parts] == [True] * 2 + [False] * 4


@settings(deadline=None)
@given(ANY_TEXT, ANY_TEXT, ANY_TEXT)
def test_folding_loses_nothing(start: str, one: str, other: str) -> None:
    """The pieces are the observation, whatever it repeats."""
    before, after = start * 10 + one, start * 10 + other
    pieces = parts_of(after, before)
    assert "".join(piece.text for piece in pieces) == after
    assert all(before.startswith(piece.text) for piece in pieces if piece.repeated)


@pytest.mark.parametrize("make", [maze, failed, broken, hostile])
@settings(deadline=None)
@given(text=ANY_TEXT)
def test_no_text_of_others_reaches_the_terminal_as_it_is(make, text: str) -> None:
    """No control character but line feed and tab, no mark that reorders text, no half of a character."""
    episode = make()
    text = f"\x1b[2J{text}"  # which is no colour of our own, wherever it stands unescaped
    episode.transitions[0].action = Response(text, reasoning=text, model=text)
    episode.transitions[0].info[text] = text
    episode.final_observation, episode.id, episode.seed = text, text, text
    for line in plain(episode_lines(episode, 1)):
        assert "\n" not in line
        assert escaped(line) == line
        line.encode("utf-8")


def test_what_is_escaped_stands_as_its_code() -> None:
    """In reverse where there are colours; a list's cell is one line."""
    assert escaped("a\x1b[0m\x9b\u202e\ud800\U000e0041\tb\n") == "a\\x1b[0m\\x9b\\u202e\\ud800\\U000e0041\tb\n"
    assert highlighted("a\x07") == "a\x1b[7m\\x07\x1b[0m"
    assert one_line("a\nb\tc" + "d" * 10, 8) == "a\\nb cd…"
    assert escaped("👩\u200d🔬 naïve 漢字") == "👩\u200d🔬 naïve 漢字"


def test_json_lists_what_fits(show) -> None:
    """For programs, with the number that opens the episode; a filter that nothing fits gives an empty list."""
    (found,) = json.loads(show("--failure", "--json").out)
    assert found == {
        "number": 2, "id": "maze:Room-v0", "success": False, "return": 0.25, "turns": 2, "error": None, "seed": 7,
        "group": "g1", "model": None, "cut_off": None,
    }  # fmt: skip
    assert json.loads(show("2", "--json").out)["final_observation"] == "Night falls."
    assert show("--group", "none", "--json") == (0, "[]\n", "")
    assert show("--group", "none").err.count("\n") == 1


@pytest.mark.parametrize(
    ("content", "code"), [(b"", 1), (b"\n\n", 1), (b"hello\nworld\n", 1), (b'{"a": 1}\n', 1), (None, 2)]
)
def test_what_is_no_file_of_episodes_gets_one_line(show, content: bytes | None, code: int) -> None:
    path = Path("run.jsonl")
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    outcome = show()
    assert (outcome.code, outcome.out, outcome.err.count("\n"), "run.jsonl" in outcome.err) == (code, "", 1, True)


@pytest.mark.parametrize(
    ("arguments", "value"),
    [
        (["6"], "which has 5"),
        (["--html", "x.html", "--json"], "--json"),
        (["--html", "run.jsonl"], "run.jsonl"),
        (["--html", "x.html", "--env", "zz"], "no page"),
        (["--return", "high"], "'high'"),
        (["--return", ">>1"], "'>>1'"),
    ],
)
def test_what_is_asked_wrongly_gets_one_line_and_exit_code_2(show, arguments: list[str], value: str) -> None:
    outcome = show(*arguments)
    assert (outcome.code, outcome.out, outcome.err.count("\n"), value in outcome.err) == (2, "", 1, True)
    assert not Path("x.html").exists()


def test_damaged_lines_are_named_and_the_rest_is_shown(show) -> None:
    """In the list and in the page; asked for by number it is an error."""
    lines = Path("run.jsonl").read_text("ascii").splitlines(keepends=True)
    record = json.loads(lines[0])
    del record["transitions"][1]["action"]
    Path("run.jsonl").write_text("".join([json.dumps(record) + "\n", *lines[1:], "nonsense\n", '{"id": "cut']), "ascii")
    outcome = show()
    assert (outcome.code, len(outcome.out.splitlines())) == (0, 5)
    assert ("line 1:" in outcome.err, "3" in outcome.err) == (True, True)
    assert show("--html", "x.html").err == outcome.err
    assert "3 lines of the file hold no whole episode." in Path("x.html").read_text("utf-8")
    assert show("7").code == 1


def test_colours_stand_in_a_terminal_alone(tmp_path: Path) -> None:
    """And escape sequences of others nowhere; ``NO_COLOR`` switches colours off."""
    path = write_all(tmp_path / "run.jsonl")
    seen = []
    for environment in ({}, {"NO_COLOR": "1"}):
        controller, terminal = pty.openpty()
        clean = {name: value for name, value in os.environ.items() if name not in ("NO_COLOR", "LESS")}
        command = [sys.executable, "-m", "gem_core", "show", str(path), "4"]
        env = {**clean, "TERM": "xterm", "PAGER": "cat", **environment}
        subprocess.run(command, stdout=terminal, stderr=terminal, stdin=terminal, env=env, timeout=60, check=True)
        os.close(terminal)
        seen.append(os.read(controller, 65536).decode())
        os.close(controller)
    assert "\x1b[37munscored" in seen[0]
    assert "\x1b[2J" not in seen[0]
    assert "\x1b" not in seen[1]


def test_the_folder_of_a_run_is_shown_as_a_file_is(show, tmp_path: Path) -> None:
    """The list, the filters, one episode and the page."""
    with RunWriter(tmp_path / "run") as writer:
        writer.write_info({})
        for number, episode in enumerate([maze(), failed(), hostile()]):
            episode.key, episode.agent = str(number), "openai:m"
            writer.write(episode, {"model": "openai:m"})
    assert numbers(show("--grep", "night falls", file="run")) == [2]
    assert numbers(show("--group", "g1", file="run")) == [1, 2]
    assert numbers(show("--model", "openai", file="run")) == [1, 2, 3]
    assert "Where is the door?" in show("1", file="run")[1]
    assert show("9", file="run").code == 2
    assert show("--html", "page.html", file="run")[1] == "3 episodes written to page.html\n"
