"""``gem compare``: pairs, what is left out, tests, flips, cautions, and few false alarms."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from indexed_runs import verdicts, write_index

import gem_eval
from gem_core.cli import cli
from gem_core.errors import ArgumentError
from gem_eval.statistics import mcnemar, paired_difference

if TYPE_CHECKING:
    from gem_eval.comparing.comparison import Comparison

ID = "game:GuessTheNumber-v0"


def call(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["compare", *map(str, arguments)])


def compared(path: Path, a: str, b: str, **options: Any) -> Comparison:
    paths = [write_index(path / name, verdicts(solved)) for name, solved in (("a", a), ("b", b))]
    return gem_eval.compare(*paths, **options)


def test_rows_of_one_epoch_are_tested_by_mcnemar(tmp_path: Path) -> None:
    """With the difference of the pairs, and its interval."""
    found = compared(tmp_path, "1110000000", "0011111110").overall
    assert (found.rows, found.a, found.b, found.only_a, found.only_b) == (10, 0.3, 0.7, 2, 6)
    assert (found.test, found.p) == ("mcnemar", mcnemar(2, 6))
    rows = [[[float(letter)] for letter in solved] for solved in ("0011111110", "1110000000")]
    assert found.difference == paired_difference(*rows, within=(0, 1))
    assert found.verdict == "undecided"
    assert found.more_rows
    assert found.more_episodes == found.more_rows


def test_epochs_and_returns_are_tested_by_permutation(tmp_path: Path) -> None:
    """McNemar's test knows no mean of several epochs."""
    twice = [row for epoch in (0, 1) for row in verdicts("1" * 12, epoch=epoch)]
    a = write_index(tmp_path / "a", twice)
    b = write_index(tmp_path / "b", verdicts("0" * 12))
    found = gem_eval.compare(a, b).overall
    assert (found.test, found.verdict, found.p) == ("permutation", "a", 2 / 2**12)
    assert gem_eval.compare(b, a, metric="return").overall.test == "permutation"


def test_what_has_no_value_is_left_out_in_pairs_and_counted(tmp_path: Path) -> None:
    """An error of one side takes the row of the other out as well; what only one has is no pair."""
    found = compared(tmp_path, "1e1u01", "11e10")
    assert (found.overall.rows, found.left_out, found.only_a, found.only_b) == (2, 3, 1, 0)
    assert (found.errors, found.unscored) == ((1, 1), (1, 0))
    returns = gem_eval.compare(tmp_path / "a", tmp_path / "b", metric="return")
    assert (returns.overall.rows, returns.left_out) == (3, 2)


def test_cut_off_counts_as_not_solved_and_is_said_where_it_decides(tmp_path: Path) -> None:
    """Ten rows that one side was cut off in make it worse, and leaving them out does not."""
    found = compared(tmp_path, "1" * 14, "1111" + "c" * 10)
    assert (found.overall.verdict, found.cut_off) == ("a", (0, 10))
    assert found.without_cut_off is not None
    assert found.without_cut_off.verdict == "undecided"
    assert "Without the episodes that a limit cut off, there is no significant difference (4 rows, p = 1.000)." in (
        call(tmp_path / "a", tmp_path / "b").output
    )


def test_what_cannot_be_compared_is_refused(tmp_path: Path) -> None:
    """Runs that share no row, and success of tasks that never tell it: the return is compared."""
    a, b = write_index(tmp_path / "a", verdicts("1")), write_index(tmp_path / "b", verdicts("1", id="t:B"))
    with pytest.raises(ArgumentError, match="'t:A/0'"):
        gem_eval.compare(a, b)
    c, d = (write_index(tmp_path / name, verdicts("uu")) for name in "cd")
    assert gem_eval.compare(c, d).metric == "return"
    with pytest.raises(ArgumentError, match="--metric return"):
        gem_eval.compare(c, d, metric="success")


def test_tasks_that_cannot_differ_are_left_out_of_the_correction(tmp_path: Path) -> None:
    """Of 26 tasks 25 have no row that differs: the p-value of the other stays as it is; Holm alone made it 26-fold."""
    same = [row for number in range(25) for row in verdicts("10", id=f"t:Same{number}")]
    paths = [
        write_index(tmp_path / name, [*verdicts(solved, id="t:A"), *same])
        for name, solved in (("a", "0000000"), ("b", "1111111"))
    ]
    found = gem_eval.compare(*paths)
    assert [(each.p_holm, each.significant) for each in found.tasks[:2]] == [(2 / 2**7, True), (1.0, False)]
    assert "corrected by Holm for 1 test (25 more cannot reach 0.05" in call(*paths).stdout
    assert (found.overall.id, found.overall.rows, found.overall.only_b) == ("all", 57, 7)
    both = [
        write_index(tmp_path / f"{solved} twice", [*verdicts(solved * 7, id="t:A"), *verdicts(solved * 7, id="t:B")])
        for solved in "01"
    ]
    assert [each.shown_p for each in gem_eval.compare(*both).tasks] == [4 / 2**7] * 2
    flip = found.flips[1]
    assert (flip.row, flip.episode_a.number, flip.episode_b.number) == ("t:A/1", 2, 2)
    assert f"gem show {paths[0]} 2; gem show {paths[1]} 2" in call(*paths).stdout


def test_models_of_one_run_are_compared(tmp_path: Path) -> None:
    """All of it, by --model, or as RUN@MODEL."""
    run = write_index(
        tmp_path / "run",
        [row for m, s in zip("xyz", ("110", "010", "011"), strict=True) for row in verdicts(s, model=m)],
    )
    assert [line.split()[0] for line in call(run).output.splitlines()[3:5]] == ["y", "z"]
    assert json.loads(call(run, "-m", "x", "-m", "y", "--json").output)["comparisons"][0]["overall"]["only_a"] == 1
    found = gem_eval.compare(f"{run}@z", f"{run}@x")
    assert (found.a.label, found.b.label) == ("z", "x")
    with pytest.raises(ArgumentError, match=r"has no model 'w'.* It has x, y, z"):
        gem_eval.compare(f"{run}@w", f"{run}@x")
    with pytest.raises(ArgumentError, match=r"has 3 models: name one, as .*@x or "):
        gem_eval.compare(run, f"{run}@x")


def test_several_are_compared_with_the_first(tmp_path: Path) -> None:
    """With one correction for all pairs; a pair that cannot differ is not counted."""
    paths = [
        write_index(tmp_path / name, verdicts(solved))
        for name, solved in (("a", "1" * 9), ("b", "0" * 9), ("c", "1" * 9), ("d", "0" * 9))
    ]
    lines = [line.split() for line in call(*paths).output.splitlines()]
    assert [line[:5] for line in lines[3:6]] == [
        ["b", "9", "100.0%", "0.0%", "-100.0"],
        ["c", "9", "100.0%", "100.0%", "+0.0"],
        ["d", "9", "100.0%", "0.0%", "-100.0"],
    ]
    told = json.loads(call(*paths, "--json").output)["comparisons"]
    assert [each["overall"]["p_holm"] for each in told] == [4 / 2**9, 1.0, 4 / 2**9]


def test_settings_seeds_and_sampling_that_differ_are_warned_of(tmp_path: Path) -> None:
    """What runs say of hosts and times is no setting."""
    settings = [
        {
            "host": sha,
            "limits": {"episode_turns": heat},
            "tasks": [
                {
                    "id": "t:A",
                    "env": "t:A",
                    "kwargs": {"max_turns": turns},
                    "rows": 2,
                    "data_sha256": sha,
                    "code": {"git": sha},
                }
            ],
            "models": [{"name": "toy", "options": {"temperature": heat}}],
        }
        for turns, sha, heat in ((5, "aa", 0), (9, "bb", 1))
    ]
    a = write_index(tmp_path / "a", verdicts("10"), **settings[0])
    b = write_index(tmp_path / "b", verdicts("10", seed=2), **settings[1])
    assert gem_eval.compare(a, b).cautions == [
        "settings differ: limits.episode_turns 0 and 1; task.t:A.kwargs.max_turns 5 and 9; "
        "task.t:A.data_sha256 aa and bb; code.the task t:A.git aa and bb",
        "the sampling differs: temperature 0 and 1",
        "the seeds differ in 2 of 2 rows that both have",
    ]
    assert "WARNING: a and b may not be comparable: the sampling differs" in call(a, b).stderr


@pytest.mark.parametrize(
    ("epochs", "trials"), [(1, 40), *(pytest.param(epochs, 600, marks=pytest.mark.thorough) for epochs in (1, 4))]
)
def test_two_runs_of_one_model_seldom_differ(tmp_path: Path, epochs: int, trials: int) -> None:
    """In at most 5 %, and what chance adds to that."""
    draws = np.random.default_rng(epochs)
    alarms = 0
    for trial in range(trials):
        rates = draws.beta(0.6, 0.6, 30)
        paths = []
        for name in "ab":
            rows = [
                {"row": f"t:A/{row}", "epoch": epoch, "success": bool(draws.random() < rate)}
                for row, rate in enumerate(rates)
                for epoch in range(epochs)
            ]
            paths.append(write_index(tmp_path / f"{trial}{name}", rows))
        alarms += gem_eval.compare(*paths).overall.significant
    assert alarms <= 0.05 * trials + 2.33 * (0.0475 * trials) ** 0.5
