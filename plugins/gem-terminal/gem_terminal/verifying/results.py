"""From what the tests left behind to a verdict."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from gem_terminal.verifying.output_parsers import NoResultError, parse_output
from gem_terminal.verifying.reports import read_report
from gem_terminal.verifying.reward_files import MOST_BYTES, REWARD_FILES, RewardFileError, read_rewards, score_of
from gem_terminal.verifying.verdict import TestResult, Verdict

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Completed, Machine
    from gem_terminal.tasks.task import Verifier

MOST_OUTPUT = 4_000_000
"""Bytes of the tests' output that are read; beyond them its middle is missing."""

_LOGS = "/logs/verifier"
_MOST_REPORTS = 10_000_000
_MOST_SHOWN = 20_000
_MOST_SOURCE = 5_000_000


def read_result(machine: Machine, verifier: Verifier, completed: Completed) -> Verdict:
    """Return the verdict of tests that have run.

    Tests that ran out of time have no result, whatever they left: they may have been cut off before they failed.

    Raises:
        MachineLostError: The machine is gone.
    """
    output = completed.output.decode("utf-8", "replace")
    if completed.exit_code is None:
        detail = f"the tests took longer than {verifier.timeout_s:g} seconds, and were killed"
        verdict = Verdict(False, 0.0, problem="timeout", detail=detail)
    elif verifier.result == "output":
        verdict = _from_output(verifier, output)
    else:
        verdict = _from_files(machine, verifier)
    return replace(
        verdict,
        tests=tuple(replace(test, weight=_weight(verifier, test)) for test in verdict.tests),
        output=_cut(output, completed.dropped),
        info={**verdict.info, "exit_code": completed.exit_code},
    )


def _from_output(verifier: Verifier, output: str) -> Verdict:
    try:
        tests = parse_output(verifier.parser, output)
    except NoResultError as error:
        return Verdict(False, 0.0, problem="no_result", detail=str(error))
    passed = all(test.passed for test in tests)
    return Verdict(passed, float(passed), tests)


def _from_files(machine: Machine, verifier: Verifier) -> Verdict:
    files = machine.get(_LOGS, most_bytes=_MOST_REPORTS)
    for name in REWARD_FILES:  # asked for by themselves where a large log left no room for them
        if name not in files:
            found = machine.get(f"{_LOGS}/{name}", most_bytes=MOST_BYTES + 1)
            files |= {name: found[""]} if "" in found else {}
    try:
        rewards = read_rewards(files, json_written=_mentions(verifier, b"reward.json"))
    except RewardFileError as error:
        return Verdict(False, 0.0, read_report(files), problem="unreadable", detail=str(error))
    if rewards is None:
        detail = f"the tests wrote neither {_LOGS}/reward.json nor {_LOGS}/reward.txt"
        return Verdict(False, 0.0, read_report(files), problem="no_result", detail=detail)
    score = score_of(rewards)
    return Verdict(score >= 1.0, score, read_report(files), rewards)


def _mentions(verifier: Verifier, word: bytes) -> bool:
    """Return whether a file of the tests has a word; true as well where the files are too large to look."""
    looked = 0
    for path in verifier.files.values():
        for file in [path] if path.is_file() else sorted(path.rglob("*")):
            if not file.is_file():
                continue
            looked += file.stat().st_size
            if looked > _MOST_SOURCE or word in file.read_bytes():
                return True
    return not verifier.files


def _weight(verifier: Verifier, test: TestResult) -> float:
    weight = verifier.weights.get(test.name, 0.0) if verifier.weights else 1.0
    return weight if math.isfinite(weight) and weight >= 0 else 0.0


def _cut(output: str, dropped: int) -> str:
    half = _MOST_SHOWN // 2
    if len(output) <= _MOST_SHOWN:
        return output
    left_out = len(output) - _MOST_SHOWN + dropped
    return f"{output[:half]}\n... {left_out:,} characters left out ...\n{output[-half:]}"
