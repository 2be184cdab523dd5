"""Tools on the command line: how they are chosen, what is recorded, and what is said of them."""

from __future__ import annotations

import io
import json
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import gem_core as gem
from gem_core.cli.tool_options import parsed_choices, wrapper_stack
from gem_core.errors import ArgumentError
from gem_core.records.files import read_episodes

if TYPE_CHECKING:
    from command_calls import RunGem

COUNTDOWN = "toy:Countdown-v0"

AGENT = """
def caller(observation, context):
    return "7" if context.turn % 2 else "<my_look>north</my_look>"
"""


@pytest.fixture(autouse=True)
def installed(toolbox: Path) -> None:
    """A third party's tools are there: vault, and box, which stands for two."""


@pytest.fixture
def agent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """An agent that calls a tool in every other turn."""
    (tmp_path / "tool_option_agents.py").write_text(AGENT)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "tool_option_agents", raising=False)
    return "tool_option_agents:caller"


@pytest.mark.parametrize(
    ("text", "tools"),
    [
        ("box:prefix=my_", [("box", {"prefix": "my_"})]),
        ("vault,box:prefix=my_,count=2,vault", [("vault", {}), ("box", {"prefix": "my_", "count": 2}), ("vault", {})]),
        ("box:url=http://a:80/x?a=b", [("box", {"url": "http://a:80/x?a=b"})]),
        ('box:on=true,limit=null,rate=0.5,text="7"', [("box", {"on": True, "limit": None, "rate": 0.5, "text": "7"})]),
        ("box:on=False,off=True,limit=None", [("box", {"on": False, "off": True, "limit": None})]),
        ("box:empty=", [("box", {"empty": ""})]),
        ('box:more={"a": [2]}, box', [("box", {"more": {"a": [2]}}), ("box", {})]),
        ("box:open=[1,count=2", [("box", {"open": "[1", "count": 2})]),
        ('["vault", ["box", {"prefix": "a,b"}]]', [("vault", {}), ("box", {"prefix": "a,b"})]),
        ('{"box": {"prefix": "a,b"}, "vault": {}}', [("box", {"prefix": "a,b"}), ("vault", {})]),
        ("", []),
    ],
)
def test_tools_are_read(text: str, tools: list[Any]) -> None:
    """Names with options behind a colon, or JSON where a value holds commas."""
    assert parsed_choices(text, "--tools") == tools
    assert parsed_choices(text, "--wrappers") == tools


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("box:prefix", "'box:prefix' has an option without a value"),
        ("prefix=2", "'prefix=2'"),
        ("[", "--tools is no valid JSON"),
        ("[3]", "--tools"),
        ('[["b", 3]]', "--tools"),
    ],
)
def test_what_cannot_be_read_is_told_with_an_example(text: str, told: str) -> None:
    """With the option's name."""
    with pytest.raises(ArgumentError, match=re.escape(told)):
        parsed_choices(text, "--tools")


def test_the_limit_of_turns_stands_outside_the_tools_and_inside_the_views() -> None:
    """Tools are innermost, wherever they were named; without tools the limit is."""
    limit, concat, box = ("turn_limit", {"max_turns": 3}), ("concat", {}), ("box", {})
    assert wrapper_stack(("concat",), ("box",), None, 3) == [box, limit, concat]
    assert wrapper_stack(("concat,box",), (), None, 3) == [concat, box, limit]
    assert wrapper_stack(("concat",), (), None, 3) == [limit, concat]
    uses = ("tools", {"max_tool_uses": None})
    assert wrapper_stack(("concat", "vault"), ("box",), "none", None) == [uses, box, concat, ("vault", {})]
    with pytest.raises(ArgumentError, match="--max-tool-uses is a limit of tools, and there are none"):
        wrapper_stack(("concat",), (), 3, None)


def test_run_with_tools_records_them(run_gem: RunGem, agent: str) -> None:
    """By name and options, so that the episode can be made again; calls are counted up to the limit."""
    words = ("--tools", "vault,box:prefix=my_", "--tools", "box", "--max-tool-uses", "1", "--wrappers", "concat")
    done = run_gem("run", COUNTDOWN, "-a", agent, "-n", "3", "--seed", "1", "-o", "x.jsonl", *words)
    assert done.code == 0, done.err
    for episode in read_episodes("x.jsonl"):
        assert episode.tools == ["vault", "my_look", "my_count", "look", "count"]
        assert episode.wrappers[0][1]["tools"] == [["vault", {}], ["box", {"prefix": "my_"}], ["box", {}]]
        assert episode.wrappers[0][1]["max_tool_uses"] == 1
        assert [("tool" in turn.info) for turn in episode.transitions[:2]] == [True, False]
        env = gem.make(episode.id, wrappers=episode.wrappers)
        assert env.reset(seed=episode.seed)[0] == episode.observation


def test_a_limit_of_uses_is_a_number_or_none(run_gem: RunGem) -> None:
    """Anything else is a wrong argument; so is an option that a wrapper does not have."""
    assert "-1 is not in the range" in run_gem("run", COUNTDOWN, "--tools", "box", "--max-tool-uses", "-1").err
    assert "'most'" in run_gem("run", COUNTDOWN, "-w", "concat:most=2").err


def test_play_with_tools(run_gem: RunGem, monkeypatch: pytest.MonkeyPatch) -> None:
    """A person calls them as a model does, and is told how to play the same again."""
    monkeypatch.setattr(sys, "stdin", io.StringIO("?\n<look>south</look>\n!quit\n"))
    done = run_gem("play", COUNTDOWN, "--seed", "1", "--tools", "box", "--max-tool-uses", "none")
    assert "A call is sent as you type it." in done.out
    assert "Output of look:\niron\n" in done.out
    assert "gem play toy:Countdown-v0 --seed 1 --tools box --max-tool-uses none\n" in done.out


def test_info_describes_a_tool(run_gem: RunGem) -> None:
    """Its options, who offers it, what is in force here, its docstring, and what an agent is told; also as JSON."""
    out = run_gem("info", "box").out
    for part in "Two tools.", "prefix=''", "gem-toolbox", "level: high, drawers: 2", "<look>lock</look>", "- count: ":
        assert part in out
    assert "\nReturn two tools.\n" in out
    facts = json.loads(run_gem("info", "box", "--json").out)
    assert [schema["function"]["name"] for schema in facts["schemas"]] == ["look", "count"]
    assert (facts["distribution"], facts["options"], facts["problem"]) == ("gem-toolbox", ["prefix=''"], None)
    assert facts["status"] == {"level": "high", "drawers": 2}


@pytest.mark.parametrize(
    ("name", "lines"),
    [
        ("concat", ["  kind:         wrapper", "  options:      max_turns: int | None = None"]),
        ("process", ["  kind:         vector backend", "  options:      workers: int | None = None"]),
        (COUNTDOWN, ["  accepts:      longest: int = 4"]),
    ],
)
def test_info_tells_the_options_of_what_has_a_name(run_gem: RunGem, name: str, lines: list[str]) -> None:
    """With their types as they are written, one in each line."""
    done = run_gem("info", name)
    assert done.code == 0
    assert set(lines) <= set(done.out.splitlines())
    kind = {"concat": "wrappers", "process": "backends"}.get(name, "toy")
    assert name in [each.get("name", each.get("id")) for each in json.loads(run_gem("list", kind, "--json").out)]
