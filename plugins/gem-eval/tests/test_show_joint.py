"""gem show on episodes of several agents: the list, one as a transcript, one seat of it, the page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from recorded import HOSTILE, broken_duel, duel, failed, seat_of_duel, turn

from gem_core import JointEpisode, write_episodes
from gem_core.cli import main
from gem_eval.show.lines import episode_lines
from gem_eval.show.text import escaped


@pytest.fixture
def show(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Call gem show on a file of four episodes, the third of one agent; return the code and what it wrote."""
    monkeypatch.chdir(tmp_path)
    write_episodes("run.jsonl", [duel(), duel("black", 7), failed(), broken_duel()])

    def call(*arguments: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as caught:
            main(["show", "run.jsonl", *arguments])
        return int(caught.value.code or 0), *capsys.readouterr()

    return call


def numbers(outcome: tuple[int, str, str]) -> list[int]:
    """The numbers of the episodes of a list."""
    assert (outcome[0], outcome[2]) == (0, "")
    return [int(line.split()[0]) for line in outcome[1].splitlines()[1:]]


def test_list_names_the_agents_with_their_returns(show) -> None:
    """One line for each episode; the column of returns is that of episodes of one agent."""
    _, out, _ = show()
    assert [" ".join(line.split()) for line in out.splitlines()] == [
        "number environment outcome return turns seed group agents and returns error",
        "1 duel:Words-v0 split 3 4 g2 white=openai:tiny 0.5, black=random 0.5",
        "2 duel:Words-v0 split 3 7 g2 white=openai:tiny 0.5, black=random 0.5",
        "3 maze:Room-v0 failure 0.25 2 7 g1",
        "4 duel:Words-v0 error 1 5 white=openai:tiny 0.5, black=random 2 agent: no route",
    ]
    assert "return" not in show("--env", "duel")[1].splitlines()[0].split()[:4]


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
def test_filters_and_order(show, arguments: list[str], expected: list[int]) -> None:
    """Without a seat, success is that of one of them and the return is the sum; with one, both are its own."""
    assert numbers(show(*arguments)) == expected


def test_one_episode_is_told_in_the_order_of_play(show) -> None:
    """Each turn with its seat and agent: what it saw, what it responded, and its reward."""
    _, out, _ = show("1")
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
    assert json.loads(show("1", "--json")[1])["order"] == [["white"], ["black"], ["white", "black"]]
    # A seat that never acted has its observation and its reward.
    _, out, _ = show("4")
    assert "black=random: error, return 2 (2 before the first turn), 0 turns\n" in out
    assert "observation of black\n  Wait.\n" in out
    assert "\nerror: agent: no route\n" in out


def test_one_seat_is_shown_as_an_episode_of_its_own(show) -> None:
    """With its own turns and nothing of the other seat."""
    _, out, _ = show("1", "--seat", "black")
    assert out.startswith("Episode 1 · duel:Words-v0\nblack=random: failure, return 0.5, 2 turns\n")
    assert "── turn 1 of 2 ──" in out
    assert "Say a word." not in out
    assert json.loads(show("1", "--seat", "black", "--json")[1])["seat"] == "black"
    _, row = show("--seat", "black")[1].splitlines()[:2]
    assert row.split() == ["1", "duel:Words-v0", "failure", "0.5", "2", "4", "g2", "black=random"]


def test_hostile_names_of_seats_and_agents_are_escaped() -> None:
    """As all text of others."""
    hostile = seat_of_duel(HOSTILE, HOSTILE, [turn(HOSTILE, HOSTILE)])
    joint = JointEpisode(HOSTILE, 1, seats={HOSTILE: hostile}, order=[[HOSTILE]])
    for line in episode_lines(joint, 1):
        plain = line.replace("\x1b[", "[")  # colours of our own
        assert escaped(plain) == plain


@pytest.mark.parametrize(("name", "value"), [("seats", 7), ("seats", {"white": 7}), ("order", 7), ("agents", None)])
def test_damaged_joint_line_is_passed_over(show, name: str, value: Any) -> None:
    lines = Path("run.jsonl").read_text().splitlines(keepends=True)
    Path("run.jsonl").write_text(json.dumps({**json.loads(lines[0]), name: value}) + "\n" + lines[1])
    code, out, err = show()
    assert (code, len(out.splitlines()), "line 1" in err) == (0, 2, True)


def test_page_holds_the_turns_of_all_seats(show) -> None:
    """In the order of play, each with its seat; with ``--seat`` those of one."""

    def episodes(*arguments: str) -> list[dict[str, Any]]:
        assert show("--html", "page.html", *arguments)[0] == 0
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
