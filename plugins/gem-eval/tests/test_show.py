"""gem show: lists, filters, one episode, games of several agents, and what it says of files that are none."""

from __future__ import annotations

import json
import os
import pty
import re
import shlex
import subprocess
import sys
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded import HOSTILE, broken, broken_duel, duel, failed, hostile, maze, seat_of_duel, turn, write_all

from gem_core import Episode, JointEpisode, Response, write_episodes
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


@pytest.fixture
def games(show):
    """Call gem show on four episodes of several agents, but the third, which is of one."""
    write_episodes("games.jsonl", [duel(), duel("black", 7), failed(), broken_duel()])
    return partial(show, file="games.jsonl")


def test_a_list_of_games_names_the_agents_with_their_returns(games) -> None:
    """One line for each episode; the column of returns is that of episodes of one agent."""
    _, out, _ = games()
    assert [" ".join(line.split()) for line in out.splitlines()] == [
        "number environment outcome return turns seed group agents and returns error",
        "1 duel:Words-v0 split 3 4 g2 white=openai:tiny 0.5, black=random 0.5",
        "2 duel:Words-v0 split 3 7 g2 white=openai:tiny 0.5, black=random 0.5",
        "3 maze:Room-v0 failure 0.25 2 7 g1",
        "4 duel:Words-v0 error 1 5 white=openai:tiny 0.5, black=random 2 agent: no route",
    ]
    assert "return" not in games("--env", "duel")[1].splitlines()[0].split()[:4]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--success"], [1, 2]),
        (["--failure"], [3]),
        (["--seat", "white", "--success"], [1]),
        (["--return", ">=1"], [1, 2, 4]),
        (["--seat", "black", "--return", ">1"], [4]),
        (["--sort", "return", "--reverse"], [4, 1, 2, 3]),
        (["--grep", "pears beat", "--seat", "black"], [1, 2]),
        (["--grep", "pear", "--seat", "white", "--limit", "1"], [1]),
    ],
)
def test_filters_and_order_of_games(games, arguments: list[str], expected: list[int]) -> None:
    """Without a seat, success is that of one of them and the return is the sum; with one, both are its own."""
    assert numbers(games(*arguments)) == expected


def test_one_episode_is_told_in_the_order_of_play(games) -> None:
    """Each turn with its seat and agent: what it saw, what it responded, and its reward."""
    _, out, _ = games("1")
    places = [
        out.index(part)
        for part in (
            "Episode 1 · duel:Words-v0\nwhite=openai:tiny: success, return 0.5, 2 turns\n"
            "black=random: failure, return 0.5, 2 turns\nseed: 4\ngroup: g2\n",
            "── turn 1 of 3 · white (openai:tiny) ──",
            "observation\n  Say a word.\nresponse\n  apple\nreward up to its next turn  0.5\n",
            "── turn 2 of 3 · black (random) ──",
            "  White said apple.\nreasoning\n  Pears beat apples.\nresponse\n  pear\n"
            "reward up to its next turn  -0.5\n",
            "── turn 3 of 3 · white (openai:tiny) ──",
            "  Black said pear.\nresponse\n  plum\nreward up to its next turn  0, terminated\n",
            "── turn 3 of 3 · black (random) ──",
            "reward up to its next turn  1, terminated\n",
            "final observation of white\n  You have won.\nfinal observation of black\n  You have lost.\nwhite=",
        )
    ]
    assert places == sorted(places)
    assert json.loads(games("1", "--json")[1])["order"] == [["white"], ["black"], ["white", "black"]]
    # A seat that never acted has its observation and its reward.
    _, out, _ = games("4")
    assert "black=random: error, return 2 (2 before the first turn), 0 turns\n" in out
    assert "observation of black\n  Wait.\n" in out
    assert "\nerror: agent: no route\n" in out


def test_one_seat_is_shown_as_an_episode_of_its_own(games) -> None:
    """With its own turns and nothing of the other seat."""
    _, out, _ = games("1", "--seat", "black")
    assert out.startswith("Episode 1 · duel:Words-v0\nblack=random: failure, return 0.5, 2 turns\n")
    assert "── turn 1 of 2 ──" in out
    assert "Say a word." not in out
    assert json.loads(games("1", "--seat", "black", "--json")[1])["seat"] == "black"
    _, row = games("--seat", "black")[1].splitlines()[:2]
    assert row.split() == ["1", "duel:Words-v0", "failure", "0.5", "2", "4", "g2", "black=random"]


def test_hostile_names_of_seats_and_agents_are_escaped() -> None:
    """As all text of others."""
    hostile = seat_of_duel(HOSTILE, HOSTILE, [turn(HOSTILE, HOSTILE)])
    joint = JointEpisode(HOSTILE, 1, seats={HOSTILE: hostile}, order=[[HOSTILE]])
    for line in episode_lines(joint, 1):
        plain = line.replace("\x1b[", "[")  # colours of our own
        assert escaped(plain) == plain


@pytest.mark.parametrize(("name", "value"), [("seats", 7), ("seats", {"white": 7}), ("order", 7), ("agents", None)])
def test_damaged_joint_line_is_passed_over(games, name: str, value: Any) -> None:
    lines = Path("games.jsonl").read_text().splitlines(keepends=True)
    Path("games.jsonl").write_text(json.dumps({**json.loads(lines[0]), name: value}) + "\n" + lines[1])
    code, out, err = games()
    assert (code, len(out.splitlines()), "line 1" in err) == (0, 2, True)


def test_page_holds_the_turns_of_all_seats(games) -> None:
    """In the order of play, each with its seat; with ``--seat`` those of one."""

    def episodes(*arguments: str) -> list[dict[str, Any]]:
        assert games("--html", "page.html", *arguments)[0] == 0
        _, _, rest = Path("page.html").read_text("utf-8").partition('id="data">')
        found: list[dict[str, Any]] = json.loads(rest.partition("</script>")[0])["episodes"]
        return found

    first, _, third, last = episodes()
    white, black = "white (openai:tiny)", "black (random)"
    turns = [(each["number"], each["seat"]) for each in first["turns"]]
    assert turns == [(1, white), (2, black), (3, white), (3, black)]
    assert (first["outcome"], first["count"], first["returns"]) == (
        "split", 3, "white=openai:tiny 0.5, black=random 0.5",
    )  # fmt: skip
    assert first["start"]["white"] == "openai:tiny, success, return 0.5, 2 turns"
    assert [part["text"] for part in first["final"]] == ["white", "You have won.", "black", "You have lost."]
    assert (third["returns"], third["turns"][0]["seat"], last["error"]) == ("", "", "agent: no route")
    (first, *_) = episodes("--seat", "black")
    assert [each["blocks"][-1]["parts"][0]["text"] for each in first["turns"]] == ["pear", "fig"]
