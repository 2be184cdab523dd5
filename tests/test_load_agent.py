"""Agents that are named on the command line or in code, and their options."""

from __future__ import annotations

from pathlib import Path

import pytest

from gem_core.errors import ArgumentError, UnknownAgentError
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
    assert load_agent(f"{module}:Mine", temperature=0.5)("x", CONTEXT) == "0.5"
    with pytest.raises(ArgumentError, match=rf"{name}.*{accepted}"):
        load_agent(name, tempo=1)
