"""The command line: what it prints, where, and with which exit code."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import click
import pytest

import gem_core as gem
from gem_core.records.files import read_episodes

COUNTDOWN = "toy:Countdown-v0"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", COUNTDOWN, "--agent"], "Option '--agent' requires an argument. Run 'gem --help'\n"),
        (["lst"], "no command 'lst'. Did you mean 'list'? There are: list, info, play, run, plugins"),
        (["run", "toy:Cuntdown-v0"], "no environment 'toy:Cuntdown-v0'. Did you mean 'toy:Countdown-v0'"),
        (["run", "toy:nothing*"], "no environment matches 'toy:nothing*'"),
        (["run", COUNTDOWN, "--out", "-"], "--out takes the name of a file, not '-'"),
        (["run", COUNTDOWN, "--agent", "randon"], "no agent 'randon'. Did you mean 'random'?"),
        (["run", COUNTDOWN, "--backend", "proces"], "no vector backend 'proces'. Did you mean 'process'?"),
        (["run", COUNTDOWN, "--resume", "a", "--out", "b"], "leave --out out"),
        (["run", COUNTDOWN, "--resume", "a"], "there is no file a;"),
        (["run"], "Missing argument 'ID...'"),
        (["list", "tooy"], "no environment matches 'tooy'. Did you mean 'toy'"),
        (["plugins", "cre"], "no plugin 'cre'. Did you mean 'core'? Installed: core"),
    ],
)
def test_what_is_asked_wrongly_gets_one_line_and_exit_code_2(run_gem, arguments: list[str], message: str) -> None:
    """The line names the nearest right answer, and nothing goes to standard output."""
    outcome = run_gem(*arguments)
    assert outcome.code == 2
    assert outcome.out == ""
    assert outcome.err.count("\n") == 1
    assert outcome.err.startswith("gem: ")
    assert message in outcome.err


def test_list_finds_by_namespace_part_and_glob(run_gem) -> None:
    """Plain lines when piped, the id first."""
    assert COUNTDOWN in run_gem("list").out
    in_toy = [line.split()[0] for line in run_gem("list", "toy").out.splitlines()]
    assert in_toy == [COUNTDOWN, "toy:Echo-v0", "toy:Sums-v0"]
    found = [line.split()[0] for line in run_gem("list", "countd").out.splitlines()]
    assert COUNTDOWN in found
    assert all("countd" in env_id.lower() for env_id in found)
    assert run_gem("list", "toy:*-v0").out.count("\n") == 3
    (entry,) = json.loads(run_gem("list", "toy:countd", "--json").out)
    assert entry["id"] == COUNTDOWN
    assert entry["deterministic"] is True


def test_info_describes_and_shows_the_first_observation(run_gem) -> None:
    """All that a person wants to know before running it."""
    out = run_gem("info", COUNTDOWN).out
    for part in ("toy:Countdown-v0", "accepts:", "longest: ", "Ends after as many turns", "Count down.\nLeft:"):
        assert part in out
    assert json.loads(run_gem("info", COUNTDOWN, "--json").out)["unmet"] == {}


def test_run_prints_a_table_and_writes_the_episodes(run_gem) -> None:
    """The path is in the last line, and the file holds every episode."""
    outcome = run_gem("run", COUNTDOWN, "toy:Sums-v0", "-n", "5", "--num-envs", "3", "--seed", "1")
    assert outcome.code == 0
    lines = outcome.out.splitlines()
    headers = "environment episodes success mean return mean turns turns/s"
    assert lines[0].split() == headers.split()
    assert [line.split()[0] for line in lines[1:4]] == [COUNTDOWN, "toy:Sums-v0", "all"]
    path = Path(lines[-1].rpartition(" ")[2])
    assert path.parent == Path("runs")
    assert len(list(read_episodes(path))) == 10


def test_an_existing_file_is_not_overwritten_unasked(run_gem) -> None:
    """The error says how to."""
    run_gem("run", COUNTDOWN, "-n", "2", "-o", "a.jsonl")
    outcome = run_gem("run", COUNTDOWN, "-n", "3", "-o", "a.jsonl")
    assert outcome.code == 2
    assert "add --overwrite" in outcome.err
    run_gem("run", COUNTDOWN, "-n", "3", "-o", "a.jsonl", "--overwrite")
    assert len(list(read_episodes("a.jsonl"))) == 3


def test_a_glob_leaves_out_what_cannot_run_here(run_gem, own_registry) -> None:
    """It says so in one line; with --json too, standard output holds nothing else."""
    register_open_and_closed()
    outcome = run_gem("run", "half:*", "--seed", "1", "--episodes", "1", "--json")
    assert outcome.code == 0
    assert outcome.err.count("\n") == 1
    assert outcome.err.endswith(": half:Closed-v0, half:Shut-v0\n")
    assert [row["id"] for row in json.loads(outcome.out)["environments"]] == ["half:Open-v0"]


@pytest.mark.parametrize("ids", [["half:Closed-v0"], ["half:Closed*"], ["half:*", "half:Closed-v0"]])
def test_what_cannot_run_here_and_is_asked_for_itself_is_an_error(run_gem, own_registry, ids: list[str]) -> None:
    """Named outright, or by a glob that finds nothing else; the exit code is that of a missing requirement."""
    register_open_and_closed()
    outcome = run_gem("run", *ids, "--episodes", "1")
    assert outcome.code == 1
    assert outcome.out == ""
    assert outcome.err.splitlines()[-1] == "gem: half:Closed-v0 cannot run here: it is under repair"


def register_open_and_closed() -> None:
    """Register an environment that runs and two that cannot."""
    gem.register("half:Open-v0", "toys:CountdownEnv")
    gem.register("half:Closed-v0", "toys:CountdownEnv", requires=("never:it is under repair",))
    gem.register("half:Shut-v0", "toys:CountdownEnv", requires=("never:it is shut",))


def test_errors_are_counted_apart_and_give_exit_code_1(run_gem) -> None:
    """The first is named on standard error."""
    gem.register("toy:Broken-v0", "toys:CountdownEnv", fail="step")
    outcome = run_gem("run", "toy:Broken-v0", COUNTDOWN, "-n", "3", "-k", "2", "--json")
    report = json.loads(outcome.out)
    assert outcome.code == 1
    assert [(row["episodes"], row["errors"]) for row in report["environments"]] == [(0, 3), (3, 0), (3, 3)]
    assert "gem: 3 episodes had an error; the first: toy:Broken-v0, seed " in outcome.err


def test_faults_without_end_stop_with_a_table(run_gem) -> None:
    """What was finished is counted and written."""
    gem.register("toy:Broken-v1", "toys:CountdownEnv", fail="reset")
    outcome = run_gem("run", "toy:Broken-v1", "-n", "100")
    assert outcome.code == 1
    assert "17 faults in a row without one finished episode" in outcome.err
    assert "toy:Broken-v1" in outcome.out


def test_a_reader_that_has_seen_enough_is_no_error(tmp_path: Path) -> None:
    """As with ``gem list | head -1``."""
    program = "from toys import register_toys; register_toys(); from gem_core.cli import main; main(['list', '--json'])"
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=env, cwd=tmp_path
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait() == 0


def test_unexpected_errors_are_one_line_and_whole_with_traceback(run_gem) -> None:
    """An agent that raises is the program's mistake; the line names it, behind the table of what was finished."""
    Path("bad_agent.py").write_text("def act(observation): raise EOFError('my bug')\n")
    done = run_gem("run", COUNTDOWN, "-a", "bad_agent:act")
    assert (done.code, done.err.count("\n")) == (1, 1)
    assert done.err.startswith("gem: EOFError: my bug (bad_agent.py:1, in act: ")
    with pytest.raises(EOFError):  # Python shows the whole
        run_gem("--traceback", "run", COUNTDOWN, "-a", "bad_agent:act")


@pytest.fixture
def shown(terminal) -> Callable[..., str]:
    """Return what a command writes to a terminal."""

    def show(*arguments: str, columns: int = 120, **options: str) -> str:
        session = terminal(*arguments, COLUMNS=str(columns), **options)
        assert session.end() == 0
        return session.output

    return show


def test_no_color_is_heeded_in_a_terminal(shown) -> None:
    """See no-color.org."""
    assert "\x1b[36m" in shown("list", "toy")
    assert "\x1b" not in shown("list", "toy", NO_COLOR="1")


def test_list_in_a_terminal_has_a_line_for_each_namespace(shown) -> None:
    """With their number, what all of a namespace lacks here, and their names; then the names of tools and the like."""
    needs = "summary='Shut.', requires=('never:it is under repair',)"
    shut = "; ".join(f"gem_core.register('shut:{name}', 'toys:EchoEnv', {needs})" for name in ("A-v0", "A-v1", "B-v0"))
    listed = click.unstyle(shown("list", code=f"import gem_core; {shut}"))
    assert re.search(r"^shut: +3  \[it is under repair\] A, B$", listed, re.MULTILINE)
    assert re.search(r"^toy: +3  Countdown, Echo, Sums$", listed, re.MULTILINE)
    assert re.search(r"^backends  async, auto, process", listed, re.MULTILINE)
    assert COUNTDOWN not in listed
    every = click.unstyle(shown("list", "--all", code=f"import gem_core; {shut}"))
    assert {COUNTDOWN, "shut:A-v1"} <= set(every.split())


def test_a_table_keeps_id_success_and_return_whole_in_a_narrow_terminal(shown) -> None:
    """What matters least is left out; so are counts that are 0 everywhere. A bar stands there while it runs."""
    columns = 60
    name = "toy:HasANameOf29Letters-v0-ab"
    code = f"import gem_core; gem_core.register({name!r}, 'toys:CountdownEnv')"
    output = shown("run", COUNTDOWN, name, "-n", "2", "-s", "1", "-o", "a.jsonl", code=code, columns=columns)
    closing = output[output.rindex("4 episodes in ") :].splitlines()
    assert max(map(len, closing)) <= columns
    assert " ".join(closing).endswith("(seed 1), written to a.jsonl")
    assert "4/4" in output
    table = click.unstyle(output[output.rindex("environment") :]).splitlines()[:4]
    assert max(map(len, table)) <= columns
    assert [line.split()[0] for line in table] == ["environment", COUNTDOWN, name, "all"]
    assert [line.split()[-1] for line in table] == ["return", *["10.000"] * 3]
    assert "0.0% ± 16.7%" in table[1]


@pytest.mark.parametrize("failure", ["KeyboardInterrupt", "RuntimeError('no')", "SystemExit(3)"])
def test_a_run_that_ends_before_its_first_episode_leaves_no_file(run_gem, failure: str) -> None:
    """And what it was to replace stays."""
    Path("ends_at_once.py").write_text(f"def act(observation):\n    raise {failure}\n")
    Path("old.jsonl").write_text("old\n")
    run = ("run", COUNTDOWN, "-a", "ends_at_once:act", "-n", "2")
    for words in ((), ("-o", "new.jsonl"), ("-o", "old.jsonl", "--overwrite")):
        assert run_gem(*run, *words).code != 0
    assert [str(path) for path in Path().rglob("*.jsonl")] == ["old.jsonl"]
    assert Path("old.jsonl").read_text() == "old\n"


def test_interrupt_while_the_command_is_imported(tmp_path: Path) -> None:
    """Ctrl-C before there is anything to interrupt: no traceback either."""
    (tmp_path / "click.py").write_text("raise KeyboardInterrupt\n")
    env = {**os.environ, "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-m", "gem_core", "list"]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (130, "\ngem: interrupted\n")
