"""``gem eval``: the table, the JSON, exit codes, and what is said when something goes wrong."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from gem_core.cli import cli, main
from gem_eval import open_run

GAME = "game:GuessTheNumber-v0-easy"


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def gem_eval(*arguments: str) -> Result:
    return CliRunner().invoke(cli, ["eval", *arguments])


def failure(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    """Return the exit code and what is said on standard error."""
    with pytest.raises(SystemExit) as caught:
        main(["eval", *arguments])
    return int(caught.value.code or 0), capsys.readouterr().err


def test_the_scores_are_printed_as_the_table_of_gem_run() -> None:
    """With intervals, and where the record is."""
    done = gem_eval(GAME, "--model", "random", "-n", "10", "-e", "2", "--out", "run")
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    headers = "task model episodes rows success [95 %] pass@2 pass^2 return [95 %] errors"
    assert " ".join(lines[0].split()) == headers
    assert lines[1].split()[:4] == [GAME, "random", "20", "10"]
    assert lines[-1] == "The record is in run; look at it with: gem view run"
    command = open_run("run").info["command"].split(" ", 1)[1]
    assert command == f"eval {GAME} --model random -n 10 -e 2 --out run"


def test_episodes_count_for_each_id_and_are_10_by_default() -> None:
    """As in ``gem run``, whether an environment has rows or seeds alone."""
    for options, counts in (((), [10, 2]), (("-n", "1"), [1, 1])):
        Path("two.jsonl").write_text('{"question": "1", "answer": "1"}\n' * 2)
        done = gem_eval(GAME, "two.jsonl", "--model", "random", "--new", "--json", *options)
        scores = json.loads(done.stdout)["scores"]
        assert [score["rows"] for score in scores if score["metric"] == "success"][:2] == counts


def test_json_has_the_form_that_is_promised() -> None:
    """For each task, model and metric."""
    done = gem_eval(GAME, "math:Sample", "--limit", "4", "--model", "random", "--json")
    scores = json.loads(done.stdout)["scores"]
    assert [(score["id"], score["metric"]) for score in scores] == [
        (GAME, "success"), (GAME, "return"), ("math:Sample", "success"), ("math:Sample", "return"),
        ("all", "success"), ("all", "return"),
    ]  # fmt: skip
    promised = ["id", "model", "metric", "mean", "stderr", "low", "high", "episodes", "rows", "pass_at", "errors"]
    assert list(scores[0])[: len(promised) + 2] == [*promised, "truncated", "unscored"]
    assert scores[2]["rows"] == 4


def test_options_go_over_what_a_suite_says(tmp_path: Path) -> None:
    """Those of rows, tools, arguments and sampling."""
    (tmp_path / "mine.yaml").write_text(f"tasks: [{{id: '{GAME}', episodes: 50}}]\nmodels: [random]\nseed: 3")
    done = gem_eval(
        "mine.yaml", "-n", "2", "--wrappers", "concat", "--set", "max_turns=1", "--seed", "4", "--out", "run"
    )
    assert done.exit_code == 0, done.output
    run = open_run("run")
    episode = run.episode(run.rows[0])
    assert (len(run.rows), [name for name, _ in episode.wrappers], episode.kwargs) == (2, ["concat"], {"max_turns": 1})
    assert run.info["seed"] == 4


FAULTY = """
from gem_core.errors import RequestError
def agent(observation):
    raise RequestError("no", cause="server")
"""


def test_errors_are_told_and_make_the_exit_code_1() -> None:
    """With how to play them again."""
    Path("faulty.py").write_text(FAULTY)
    done = gem_eval(GAME, "--model", "faulty:agent", "-n", "2", "--out", "run")
    assert done.exit_code == 1
    assert "gem: 2 episodes had an error; the first, " in done.stderr
    assert done.stderr.rstrip().endswith(": agent: no. Play them again with --retry-errors")


def test_a_limit_of_the_run_is_named_as_its_option() -> None:
    """With how to go on."""
    done = gem_eval(GAME, "--model", "random", "-n", "2", "--run-time", "1e-9", "--out", "run")
    assert done.exit_code == 1
    assert "gem: the limit --run-time was reached after 0 of 2 episodes; the same command with a" in done.stderr


ONCE_FAULTY = """
from gem_core.errors import RequestError
faults = [RequestError("no")]
def agent(observation):
    if faults:
        raise faults.pop()
    return "no"
"""


def test_pass_at_k_is_shown_for_the_planned_epochs() -> None:
    """A row that lost one to an error is left out, which is said."""
    Path("once_faulty.py").write_text(ONCE_FAULTY)
    tasks = (GAME, "math:Sample", "--limit", "1", "--epochs", "3")
    done = gem_eval(*tasks, "--model", "once_faulty:agent", "--out", "run")
    assert "pass@3" in done.stdout.splitlines()[0]
    assert "of once_faulty:agent at all leave out 1 row with fewer than 3 episodes that count" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "gem eval --list"),
        ([GAME], "--model"),
        (["gmaes", "--model", "random"], "no suite 'gmaes'. Did you mean 'games'?"),
        (["game:GuesTheNumber-v0", "--model", "random"], "no environment 'game:GuesTheNumber-v0'. Did you mean"),
        ([GAME, "--model", "randon"], "no agent 'randon'. Did you mean 'random'?"),
        ([GAME, "--model", "random", "--role", "user"], "ROLE=AGENT"),
        ([GAME, "--model", "random", "--temperature", "1"], "temperature"),
        (["math:Sample", "--model", "random", "--where", "x ="], "'x ='"),
    ],
)
def test_wrong_arguments_are_told_in_one_line(
    capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    """With exit code 2, and no folder left behind."""
    code, said = failure(capsys, *arguments)
    assert (code, len(said.splitlines())) == (2, 1)
    assert message in said
    assert not os.path.exists("runs")


SLOW = """
import asyncio
async def agent(observation):
    print("asked", flush=True)
    await asyncio.Event().wait()
"""


def test_ctrl_c_says_how_to_go_on(tmp_path: Path) -> None:
    """And ends at once, with exit code 130."""
    Path("hangs.py").write_text(SLOW)
    command = [sys.executable, "-m", "gem_core", "eval", GAME, "--model", "hangs:agent", "-n", "2", "--out", "run"]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with child:
        assert child.stdout is not None
        child.stdout.readline()
        child.send_signal(signal.SIGINT)
        _, said = child.communicate(timeout=60)
    assert child.returncode == 130
    assert "gem: interrupted after 0 of 2 episodes; the same command goes on" in said
