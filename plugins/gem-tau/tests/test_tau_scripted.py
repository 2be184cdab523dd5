"""The scripted users and assistants, and the heat map that they make."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import gem_core as gem
from gem_core.errors import AgentError, ArgumentError
from gem_core.rollouts import load_agent
from gem_tau.command import command
from gem_tau.heatmap import heat_map
from gem_tau.prompts import STOP

USERS = ["tau-user:patient", "tau-user:forgetful", "tau-user:terse"]
ASSISTANTS = ["tau-assistant:careful", "tau-assistant:hasty", "tau-assistant:passive"]


def test_strength_of_both_seats_decides_the_success() -> None:
    """In the ten tasks of the sample; every cell plays each of them once."""
    rows = heat_map(["tau:Sample"], USERS, ASSISTANTS)
    assert [[cell.successes for cell in row] for row in rows] == [[10, 8, 1], [10, 0, 1], [4, 3, 1]]
    assert {(cell.judged, cell.errors) for row in rows for cell in row} == {(10, 0)}


def test_conversation_of_forgetful_and_careful() -> None:
    """The user gives a wrong number, the assistant does not find it in the account, asks, confirms and acts."""
    agents = {"assistant": "tau-assistant:careful", "user": "tau-user:forgetful"}
    (joint,) = gem.rollout("tau:Sample", agents=agents, episodes=1)
    said = [f"{seat}: {turn.action}" for seat, turn in joint.transcript() if turn.action]
    assert said == [
        "user: I want to cancel an order. The order is #1024.",
        "assistant: What is the email address of your account?",
        "user: My email address is ines.castro@example.com.",
        "assistant: There is no order #1024 in your account. What is the right order number?",
        "user: The order is #1042.",
        "assistant: What is the reason: is it no longer needed, or was it ordered by mistake?",
        "user: The reason is: ordered by mistake.",
        "assistant: I will cancel order #1042, with the reason 'ordered by mistake'. Is that right? Please answer yes "
        "or no.",
        "user: Yes, please.",
        "assistant: Done. Is there anything else that I can do for you?",
        "user: ###STOP###",
    ]
    called = [turn.action.tool_calls[0]["function"]["name"] for _, turn in joint.transcript() if turn.action.tool_calls]
    assert called == ["find_customer", "get_order", "get_order", "cancel_order"]
    assert joint.returns == {"assistant": 1.0, "user": 0.0}


def test_unknown_characters_are_refused() -> None:
    """With the names of those that there are."""
    with pytest.raises(ArgumentError, match=r"^there is no tau-user:rude; there are: patient, forgetful, terse$"):
        load_agent("tau-user:rude")
    with pytest.raises(ArgumentError, match=r"^there is no tau-assistant:lazy; there are: careful, hasty, passive$"):
        load_agent("tau-assistant:lazy")


@pytest.mark.parametrize(
    ("agent", "message"), [(USERS[0], "plays only the user"), (ASSISTANTS[0], "plays only the assistant")]
)
def test_scripted_agents_keep_to_their_seat(agent: str, message: str) -> None:
    """One agent for both seats would score 0 without a word."""
    with pytest.raises(AgentError, match=message):
        list(gem.rollout("tau:Sample", agents=agent, episodes=1))


@pytest.mark.parametrize("text", ["a" * 500_000, "1" * 500_000, "1 a " * 100_000, "a@a" + "." * 500_000])
def test_long_messages_of_a_user_are_read_soon(text: str) -> None:
    """Whatever is in them: reading takes time in proportion to their length."""

    def user(observation: str, context: gem.Context) -> str:
        return STOP if context.turn else f"Change the address to {text}"

    agents = {"assistant": "tau-assistant:careful", "user": user}
    (joint,) = gem.rollout("tau:Sample", agents=agents, episodes=1)
    assert joint.error is None


def test_heatmap_prints_and_writes(tmp_path: Path) -> None:
    """A table of rates with their errors and numbers, and the same as JSON."""
    numbers = tmp_path / "map.json"
    chosen = ["--users", USERS[0], "--assistants", ",".join(ASSISTANTS[1:]), "--episodes", "6"]
    done = CliRunner().invoke(command, ["heatmap", *chosen, "--out", str(numbers)])
    assert done.exit_code == 0
    assert done.output.splitlines()[1].split() == ["user", *ASSISTANTS[1:]]
    assert " ".join(done.output.splitlines()[2].split()) == "tau-user:patient 83.3 ± 14.9 (6) 0.0 ± 7.1 (6)"
    first, _ = json.loads(numbers.read_text(encoding="utf-8"))
    assert (first["user"], first["assistant"], first["episodes"]) == ("tau-user:patient", "tau-assistant:hasty", 6)
    assert first["success_rate"] == pytest.approx(5 / 6)


def test_failed_episodes_are_in_no_rate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the user's server does not answer, the cell says so, and the exit code is 1."""
    (tmp_path / "broken_user.py").write_text(
        "from gem_core.errors import RequestError\n"
        "def user(observation, context):\n"
        "    if context.turn:\n"
        "        raise RequestError('no answer')\n"
        "    return 'Hello.'\n"
    )
    monkeypatch.chdir(tmp_path)
    chosen = ["--users", "broken_user:user", "--assistants", "tau-assistant:passive", "--episodes", "2"]
    done = CliRunner().invoke(command, ["heatmap", *chosen])
    assert done.exit_code == 1
    assert " ".join(done.output.splitlines()[2].split()) == "broken_user:user - (0, 2 failed)"
