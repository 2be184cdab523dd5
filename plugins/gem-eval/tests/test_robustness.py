"""gem robustness: the score without and with perturbations on the same rows, and its difference."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from perturbed import register

import gem_core as gem
from gem_core.cli import main
from gem_core.errors import RequestError
from gem_core.rollouts import Context, as_agent
from gem_eval.robustness.flaky_agent import FlakyAgent
from gem_eval.robustness.scoring import stacked

register()

DICE = ("perturbed:Dice-v0", "--model", "perturbed:reads_to_the_end", "--tools", "distractor_tools")


class Outcome(NamedTuple):
    """What one call of the command did."""

    code: int
    out: str
    err: str

    def scores(self) -> dict[tuple[str, str], dict[str, Any]]:
        """The scores of ``--json``, by environment and perturbation."""
        return {(score["id"], score["perturbation"]): score for score in json.loads(self.out)["scores"]}


@pytest.fixture
def robustness(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Call gem robustness in this process, in a folder of its own."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> Outcome:
        with pytest.raises(SystemExit) as caught:
            main(["robustness", *arguments])
        return Outcome(int(caught.value.code or 0), *capsys.readouterr())

    return call


def test_a_score_falls_by_what_disturbs_the_agent(robustness: Any) -> None:
    """An agent that gives up after a failed call loses every row, and one that does not read the task loses none."""
    outcome = robustness(*DICE, "-n", "4", "-p", "tool_429:rate=1", "-p", "typos,paraphrase", "--json")
    assert outcome.code == 0
    scores = outcome.scores()
    plain, failing, worded = (
        scores["perturbed:Dice-v0", name] for name in ("none", "tool_429:rate=1", "typos,paraphrase")
    )
    assert plain["difference"] is None
    assert (plain["mean"], plain["rows"], plain["metric"], plain["model"]) == (
        1.0, 4, "success", "perturbed:reads_to_the_end",
    )  # fmt: skip
    assert (failing["mean"], failing["difference"]["mean"], failing["difference"]["rows"]) == (0.0, -1.0, 4)
    assert (worded["mean"], worded["difference"]["mean"]) == (1.0, 0.0)


def test_the_table_has_a_line_for_each_perturbation_and_for_all_environments(robustness: Any) -> None:
    """Plain lines when piped: score, difference, interval, rows and errors."""
    outcome = robustness(
        "perturbed:Echo-v0", "perturbed:Dice-v0", "--model", "perturbed:literal", "-n", "3", "-p", "paraphrase"
    )  # fmt: skip
    lines = [line.split("  ") for line in outcome.out.splitlines()]
    cells = [[cell.strip() for cell in line if cell.strip()] for line in lines]
    assert cells[0] == [
        "environment", "perturbation", "metric", "score [95 %]", "difference", "95 % interval", "rows", "errors",
    ]  # fmt: skip
    assert [row[:2] for row in cells[1:]] == [
        [env_id, name]
        for env_id in ("perturbed:Echo-v0", "perturbed:Dice-v0", "all")
        for name in ("none", "paraphrase")
    ]
    assert cells[2][4] == "-100.0"
    assert cells[6][4] == "-50.0"


def test_the_rows_are_the_same_with_and_without(robustness: Any) -> None:
    """Seeds and epochs of the episodes agree, file by file; a second call gives the same."""
    for out in ("one", "two"):
        robustness(*DICE, "-n", "3", "--epochs", "2", "-p", "typos", "-p", "cut_outputs", "--out", out)
    files = sorted(path.name for path in Path("one").iterdir())
    assert files == ["0-none.jsonl", "1-typos.jsonl", "2-cut_outputs.jsonl"]
    starts = {}
    for name in files:
        ours, again = (list(gem.read_episodes(Path(folder, name))) for folder in ("one", "two"))
        assert ours == again
        starts[name] = sorted((each.key, each.repeat, each.seed) for each in ours)
    assert len(set(map(tuple, starts.values()))) == 1


def test_the_default_leaves_out_what_does_not_fit(robustness: Any) -> None:
    """Without tools the perturbations of tools are named on standard error; the others are scored."""
    outcome = robustness("perturbed:Echo-v0", "--model", "perturbed:literal", "-n", "2", "--json")
    assert [name for _, name in outcome.scores()] == ["none", "cut_outputs", "distractor_tools", "paraphrase", "typos"]
    assert outcome.err.startswith(
        "gem: perturbed:Echo-v0: left out tool_429, tool_timeout, renamed_parameters: Tool429 changes tools"
    )
    assert outcome.code == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("-p", "tool_429"), "gem: no perturbation fits perturbed:Echo-v0; name others by --perturb"),
        (("-p", "tool_430"), "gem: no wrapper or tool 'tool_430'"),
        (("-p", "typos:much=2"), "gem: wrapper 'typos': got an unexpected keyword argument 'much'. It accepts: rate"),
        (("-p", "server_429:rate=2"), "gem: the rate of server_429 must be a number from 0 to 1, not 2"),
        (("-p", "server_429:often=1"), "gem: server_429 has no option 'often'; it takes rate and retries"),
        (("-p", "typos:2"), "gem: --perturb: '2' is no option of 'typos'"),
    ],
)
def test_a_wrong_perturbation_is_told_in_one_line(robustness: Any, arguments: Any, message: str) -> None:
    """Nothing is run, and the exit code is 2."""
    outcome = robustness("perturbed:Echo-v0", "--model", "perturbed:literal", *arguments)
    assert outcome.code == 2
    assert outcome.err.splitlines()[-1].startswith(message)
    assert outcome.out == ""


def test_failing_requests_cost_episodes_and_no_score(robustness: Any) -> None:
    """They are counted as errors, apart from the score; retries save some."""
    arguments = ("perturbed:Echo-v0", "--model", "perturbed:literal", "-n", "40", "--json")
    often, seldom = "server_429:rate=0.5,retries=0", "server_429:rate=0.5,retries=3"
    outcome = robustness(*arguments, "-p", often, "-p", seldom)
    lost, kept = (outcome.scores()["perturbed:Echo-v0", name] for name in (often, seldom))
    assert 10 < lost["errors"] < 30
    assert kept["errors"] < 8
    assert lost["rows"] == 40 - lost["errors"]
    assert (lost["mean"], lost["difference"]["mean"], outcome.code) == (1.0, 0.0, 0)


def test_a_flaky_agent_says_how_often_it_tried() -> None:
    """The error is that of a server, which rollouts record as an episode's."""
    context = Context("0.0", "perturbed:Echo-v0", None, 0, {}, [], [])
    with pytest.raises(RequestError) as error:
        FlakyAgent(as_agent(lambda observation: "x"), "server_timeout", rate=1.0)("", context)
    assert str(error.value) == "the server did not answer in time (injected), 3 times"


def test_an_interrupt_prints_what_there_is(robustness: Any) -> None:
    """The runs that had ended are in the table, and the exit code is 130."""
    outcome = robustness("perturbed:Echo-v0", "--model", "perturbed:stops_when_reworded", "-n", "2", "-p", "paraphrase")
    assert outcome.code == 130
    assert [line.split()[1] for line in outcome.out.splitlines()[1:]] == ["none"]
    assert outcome.err.endswith("gem: stopped after 2 episodes; runs that had not ended are left out\n")


def test_a_run_that_fails_prints_what_there_is(robustness: Any) -> None:
    """Where every request fails, the run without a perturbation is in the table, and the error is told last."""
    always = "server_429:rate=1"
    outcome = robustness("perturbed:Echo-v0", "--model", "perturbed:literal", "-n", "40", "-p", always)
    assert outcome.code == 1
    assert [line.split()[1] for line in outcome.out.splitlines()[1:]] == ["none"]
    assert "HTTP 429 Too Many Requests (injected), 3 times" in outcome.err.splitlines()[-1]


def test_perturbations_stand_between_tools_and_views() -> None:
    """What comes behind the last tool is inside the views."""
    assert stacked([("distractor_tools", {}), ("concat", {})], [("typos", {})]) == [
        ("distractor_tools", {}), ("typos", {}), ("concat", {}),
    ]  # fmt: skip
    assert stacked([("concat", {})], [("typos", {})]) == [("typos", {}), ("concat", {})]
