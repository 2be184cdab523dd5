"""Agents that are named on the command line or in code, and their options."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from gem_core.errors import ArgumentError, EntryPointError, UnknownAgentError
from gem_core.rollouts import Context, load_agent

CONTEXT = Context("0.0", "toy:Echo-v0", None, 0, {}, [], [])

MODULE = """
class Mine:
    def __init__(self, temperature=1.0):
        self.temperature = temperature
    def __call__(self, observation):
        return str(self.temperature)

def act(observation):
    return "a"
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    Path("agent_with_options.py").write_text(MODULE, encoding="utf-8")
    return "agent_with_options"


def test_agents_are_found_by_name_and_by_module(module: str) -> None:
    """A registered one, a function, and a class, which is called with the options."""
    assert callable(load_agent("random"))
    assert load_agent(f"{module}:act")("x", CONTEXT) == "a"
    assert load_agent(f"{module}:Mine")("x", CONTEXT) == "1.0"
    assert load_agent(f"{module}:Mine", temperature=0.5)("x", CONTEXT) == "0.5"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("randon", "Did you mean 'random'?"),
        ("no_such_module:act", "no module 'no_such_module'"),
        ("json:dumsp", "Did you mean 'dump' or 'dumps'?"),
        (":x", "MODULE:CALLABLE"),
        ("os:", "MODULE:CALLABLE"),
        ("os:sep", "'os:sep' is a str"),
    ],
)
def test_unknown_agents_name_the_nearest(name: str, message: str) -> None:
    """One line that helps."""
    with pytest.raises(UnknownAgentError) as caught:
        load_agent(name)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("name", "accepted"),
    [("random", "no arguments"), ("agent_with_options:Mine", "temperature"), ("agent_with_options:act", "not a class")],
)
def test_an_option_that_is_not_taken_is_refused(module: str, name: str, accepted: str) -> None:
    """With what would be."""
    with pytest.raises(ArgumentError, match=rf"{name}.*{accepted}"):
        load_agent(name, tempo=1)


def test_the_current_folder_is_searched_only_while_an_agent_is_loaded(module: str) -> None:
    """Whether it can be loaded or not; a class that imports what stands beside it when it is made finds it."""
    Path("beside_it.py").write_text("ANSWER = 'b'", encoding="utf-8")
    Path("late_agent.py").write_text(
        "class Late:\n    def __init__(self):\n        import beside_it\n        self.answer = beside_it.ANSWER\n"
        "    def __call__(self, observation):\n        return self.answer\n",
        encoding="utf-8",
    )
    Path("broken_agent.py").write_text("import nothing_of_this_name", encoding="utf-8")
    before = list(sys.path)
    assert load_agent("late_agent:Late")("x", CONTEXT) == "b"
    for name, kind in (("broken_agent:a", EntryPointError), (f"{module}:missing", UnknownAgentError)):
        with pytest.raises(kind):
            load_agent(name)
    assert sys.path == before
