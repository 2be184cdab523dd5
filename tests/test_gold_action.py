"""``gold_action``: a response that solves the task, for audits and never for agents."""

from __future__ import annotations

from typing import Any

import gymnasium
import pytest

import gem_core as gem


class GivesAwayEnv(gem.MultiAgentEnv):
    """One seat writes the number that the audit knows; the other does nothing."""

    possible_agents = ("writer", "reader")

    def begin_episode(self, options: dict[str, Any] | None) -> dict[str, dict[str, Any]]:
        """Begin."""
        return {}

    def observe(self, agent: str) -> str:
        """Return nothing of interest."""
        return "?"

    def process_actions(self, actions: dict[str, str]) -> Any:
        """End."""
        return {"writer": float(actions["writer"] == "7")}, dict.fromkeys(self.agents, True), {}, {}

    def gold_action(self, agent: str) -> str | None:  # type: ignore[override]
        """Return what the writer has to write."""
        return "7" if agent == "writer" else None


def test_unknown_unless_an_environment_says_it() -> None:
    """The base class knows no solution."""
    assert gem.Env().gold_action() is None


@pytest.mark.parametrize(
    ("answer", "gold"),
    [("4", "\\boxed{4}"), (4, "\\boxed{4}"), ("a}b", "<answer>a}b</answer>"), ("  ", None), (None, None)],
)
def test_rows_answer_with_what_their_own_grading_takes(answer: Any, gold: str | None) -> None:
    """It is the answer of the present row, in a form that survives its braces; none where the row has none."""
    env = gem.DatasetEnv([{"question": "?", "answer": "other"}, {"question": "?", "answer": answer}])
    env.reset(options={"index": 1})
    assert env.gold_action() == gold
    if gold is not None:
        assert env.step(gold)[1] == 1.0


def test_wrappers_pass_it_on() -> None:
    """Those of ours, and those of Gymnasium."""
    env = gem.make("game:GuessTheNumber-v0", wrappers="concat")
    env.reset(seed=3)
    wrapped = gymnasium.wrappers.TimeLimit(env, 5)
    gold = env.gold_action()
    assert gold == wrapped.get_wrapper_attr("gold_action")() == env.unwrapped.gold_action()
    assert env.step(gold)[1] == 1.0


def test_a_seat_has_its_own() -> None:
    """Alone at a seat, an environment of several agents gives that of the seat, wrapped or not."""
    joint = GivesAwayEnv()
    assert gem.single_agent(joint, "writer", {"reader": "random"}).gold_action() == "7"
    assert gem.single_agent(joint, "reader", {"writer": "random"}).gold_action() is None
