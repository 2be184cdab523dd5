"""``gem run`` with several agents: who sits where, the table, resuming, and what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import gem_core as gem
from gem_core import JointEpisode
from gem_core.records import read_records

if TYPE_CHECKING:
    from command_calls import RunGem

HEAP, ALONE = "seats:Countdown-v0", "seats:Alone-v0"

AGENTS = r"""
def one(observation):
    return "\\boxed{1}"

class Warm:
    def __init__(self, temperature):
        print(temperature)
    prepare = lambda self: print("prepared")
    close = lambda self: print("closed")
    def __call__(self, observation):
        return "\\boxed{2}"
"""


@pytest.fixture(autouse=True)
def _registered(tmp_path: Path) -> None:
    (tmp_path / "seat_agents.py").write_text(AGENTS)
    if HEAP not in gem.list_envs():
        gem.register(HEAP, "joint_toys:CountdownEnv", seats=("first", "second"))
        gem.register(ALONE, "toys:CountdownEnv")


def played(path: str | Path) -> list[JointEpisode]:
    """The joint records of a file, in the order of the plan."""
    records = [record for record in read_records(path) if isinstance(record, JointEpisode)]
    return sorted(records, key=lambda record: int(record.key))


def at_first_seat(run_gem: RunGem, *arguments: str) -> list[str]:
    """Which agent has the first seat in each of four episodes."""
    outcome = run_gem("run", HEAP, "-n", "4", "-s", "1", "-o", "a.jsonl", "--overwrite", *arguments)
    assert (outcome.code, outcome.err) == (0, "")
    return [joint.agents["first"] for joint in played("a.jsonl")]


def test_one_agent_plays_all_seats(run_gem: RunGem) -> None:
    """By default the random one; the table has a row for each seat, and counts each episode once."""
    outcome = run_gem("run", HEAP, "-n", "10", "-s", "1", "-o", "a.jsonl")
    assert (outcome.code, outcome.err) == (0, "")
    lines = outcome.out.splitlines()
    assert [line.split()[1:3] for line in lines[1:3]] == [["first=random", "10"], ["second=random", "10"]]
    assert lines[3].startswith("10 episodes in ")
    assert len(played("a.jsonl")) == 10


def test_agents_sit_where_they_are_told(run_gem: RunGem) -> None:
    """``SEAT=AGENT`` fixes the seats."""
    by_seat = ["--agent", "second=random", "--agent", "first=seat_agents:one"]
    assert at_first_seat(run_gem, *by_seat) == ["seat_agents:one"] * 4


def test_agents_without_seats_change_them(run_gem: RunGem) -> None:
    """The first named begins in the first seat; as JSON there are the numbers of each agent at all its seats."""
    listed = ["--agent", "seat_agents:one", "--agent", "random"]
    assert at_first_seat(run_gem, *listed) == ["seat_agents:one", "random"] * 2
    report = json.loads(run_gem("run", HEAP, "-n", "4", *listed, "--json").out)
    assert (report["episodes"], report["errors"]) == (4, 0)
    rows = {(row["seat"], row["agent"]): row for row in report["environments"]}
    assert len(rows) == 6
    assert [rows[None, agent]["episodes"] for agent in ("random", "seat_agents:one")] == [4, 4]
    assert sum(row["total_return"] for row in rows.values()) == 0
    won = rows["first", "random"]
    assert won["success_rate"] == (won["mean_return"] + 1) / 2


def test_each_agent_is_made_and_closed_once(run_gem: RunGem) -> None:
    """Also where it has several seats; with the options that it takes."""
    out = run_gem("run", HEAP, "-n", "2", "-a", "seat_agents:Warm", "--temperature", "0.5").out
    told = re.findall("^(0.5|prepared|closed)$", out, re.MULTILINE)
    assert (told[0], {*told[1:-1]}, told[-1]) == ("0.5", {"prepared"}, "closed")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([HEAP, "-a", "randm", "-a", "random", "--temperature", "1"], "Did you mean 'random'"),
        ([HEAP, "-a", "frst=random", "-a", "second=random"], f"{HEAP} has no seat 'frst'. Did you mean 'first'?"),
        ([HEAP, "-a", "first=random"], "write --agent first=AGENT --agent second=AGENT"),
        ([HEAP, "-a", "first=random", "-a", "first=random"], "write --agent first=AGENT --agent second=AGENT"),
        ([HEAP, "-a", "random", "-a", "random", "-a", "random"], "or 2 that change seats"),
        ([ALONE, "-a", "first=random"], f"{ALONE} is registered without seats"),
        ([HEAP, ALONE], f"{ALONE} is for one agent"),
        (
            [HEAP, "-a", "first=random", "-a", "second=seat_agents:one", "--temperature", "1"],
            "random, seat_agents:one takes the option temperature",
        ),
        ([HEAP, "-a", "first=human", "-a", "second=random", "-k", "3"], "use --num-envs 1, not 3"),
    ],
)
def test_agents_that_do_not_fit_are_refused(run_gem: RunGem, arguments: list[str], message: str) -> None:
    """In one line that names the seats and what to type, before anything is run."""
    outcome = run_gem("run", *arguments)
    assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1)
    assert message in outcome.err


def test_glob_means_environments_of_one_kind(run_gem: RunGem) -> None:
    """By how the agents are given; what is left out is named."""
    alone = run_gem("run", "seats:A[l]*", "seats:Cou*", "-n", "1")
    assert alone.code == 2  # each glob matches one kind, and they are asked for
    outcome = run_gem("run", "seats:[AC][lo]*", "-n", "1", "--json")
    assert outcome.err.endswith(f": {HEAP}\n")
    assert [row["id"] for row in json.loads(outcome.out)["environments"]] == [ALONE]
    outcome = run_gem("run", "seats:[AC][lo]*", "-n", "1", "-a", "random", "-a", "random", "--json")
    assert outcome.err.endswith(f": {ALONE}\n")
    assert {row["id"] for row in json.loads(outcome.out)["environments"]} == {HEAP}


def test_resumed_run_has_the_same_agents(run_gem: RunGem) -> None:
    """Games of others would be counted as finished ones of these."""
    run_gem("run", HEAP, "-n", "2", "-s", "1", "-a", "random", "-a", "seat_agents:one", "-o", "a.jsonl")
    outcome = run_gem("run", HEAP, "-n", "3", "-a", "random", "--resume", "a.jsonl")
    assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1)
    assert '["random", "seat_agents:one"], and now it is ["random"]' in outcome.err
    assert len(played("a.jsonl")) == 2


def test_info_names_the_seats(run_gem: RunGem) -> None:
    """With what each seat that begins sees first; ``gem list --json`` names the seats as well."""
    out = run_gem("info", HEAP).out
    assert "  seats:        first, second\n" in out
    assert "\nThe first observation of first, with seed 0:\nThe heap has " in out
    assert json.loads(run_gem("info", HEAP, "--json").out)["seats"] == ["first", "second"]
    assert json.loads(run_gem("list", ALONE, "--json").out)[0]["seats"] == []
