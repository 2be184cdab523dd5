"""Reward files, reports and output of tests, and the rewards they bring: right, wrong, forged, and any bytes at all."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from memory_backend import plain_task

from gem_core.errors import UsageError
from gem_terminal.errors import TaskError
from gem_terminal.verifying.output_parsers import PARSERS, NoResultError, parser_named
from gem_terminal.verifying.results import RewardFileError, read_report, read_rewards
from gem_terminal.verifying.verdict import TestResult, Verdict, goes_on, reward_of, reward_of_steps


@pytest.mark.parametrize(
    ("content", "value"), [(b" 0.5\n", 0.5), (b"-2", -2.0), (b"\xef\xbb\xbf1.0\r\n", 1.0), (b"1e-3", 0.001)]
)
def test_reward_txt_is_one_number(content: bytes, value: float) -> None:
    assert read_rewards({"reward.txt": content}) == {"reward": value}


def test_reward_json_takes_precedence_over_reward_txt() -> None:
    assert read_rewards({"reward.txt": b"1", "reward.json": b'{"reward": 0}'}) == {"reward": 0.0}


NO_NUMBERS = [b"", b"  \n", b"\xef\xbb\xbf", b"yes", b"1 2", b"nan", b"-inf", b"1e999", b"[1]", b"\xff\xfe", b"1,0"]
NO_OBJECTS = [b"", b"{}", b"[1]", b"1", b'{"reward": "1"}', b'{"reward": {"reward": 1}}', b'{"reward": null}']
NO_OBJECTS += [b'{"reward": NaN}', b'{"a": 1, "b": -Infinity}', b'{"reward": 1e999}', b"{'a': 1}", b"[" * 100_000]
NO_OBJECTS += [b'{"a":' * 100_000, b'{"reward": 1' + b"0" * 400 + b"}", b'{"reward": ' + b"9" * 5000 + b"}"]


@pytest.mark.parametrize("content", [*NO_NUMBERS, b"9" * 2_000_000, *NO_OBJECTS])
def test_what_is_no_reward_cannot_be_read(content: bytes) -> None:
    """Also where another file would be right."""
    files = {"reward.txt": content}
    if content in NO_OBJECTS:
        files = {"reward.json": content, "reward.txt": b"1"}
    with pytest.raises(RewardFileError, match=f"^{next(iter(files))} "):
        read_rewards(files)


@given(
    st.binary(max_size=60)
    | st.recursive(st.floats() | st.text() | st.none(), st.lists).map(lambda v: json.dumps(v).encode())
)
def test_any_bytes_give_finite_numbers_or_the_error_of_reward_files(content: bytes) -> None:
    assert isinstance(read_report({"ctrf.json": content}), tuple)
    for name in ("reward.json", "reward.txt"):
        try:
            rewards = read_rewards({name: content})
        except RewardFileError:
            continue
        assert rewards
        assert all(math.isfinite(value) for value in rewards.values())


def test_ctrf_names_the_tests_and_a_name_that_failed_once_has_failed() -> None:
    said = [("test_a", "passed"), ("test_b", "failed"), ("test_c", "skipped"), ("test_a", "failed"), (3, "passed")]
    rows = [*({"name": name, "status": status, "message": "x"} for name, status in said), "nonsense"]
    tests = read_report({"ctrf.json": json.dumps({"results": {"tests": rows}}).encode()})
    assert [(test.name, test.passed) for test in tests] == [("test_a", False), ("test_b", False), ("test_c", True)]
    assert [test.message for test in tests] == ["x", "x", ""]
    for broken in (b"", b"[" * 100_000, b"[1]", b'{"results": {"tests": 5}}'):
        assert read_report({"ctrf.json": broken}) == ()
    assert read_report({}) == ()


HEAD = "=========================== short test summary info ============================\n"
END = "========================= 1 failed, 2 passed in 0.05s =========================\n"


def results(text: str, parser: str = "pytest") -> dict[str, bool]:
    return {test.name: test.passed for test in parser_named(parser)(text)}


REAL_TESTS = """
import pytest
@pytest.mark.parametrize('x', ['plain', 'two words', 'a] - b', 'é☃'])
def test_good(x): pass
@pytest.mark.parametrize('x', ['two words', 'a - b'])
def test_bad(x): raise ValueError('one - two - three')
class TestGroup:
    def test_in(self): pass
@pytest.mark.skip(reason='not now')
def test_skipped(): pass
@pytest.mark.xfail
def test_xfail(): assert False
@pytest.mark.xfail
def test_xpass(): pass
@pytest.fixture
def broken(): raise OSError('gone')
def test_error(broken): pass
"""


def test_real_pytest_output_is_read_with_every_status(tmp_path: Path) -> None:
    """What the installed pytest prints with -rA gives each test its result, parameters of any kind included."""
    (tmp_path / "test_all.py").write_text(REAL_TESTS)
    command = [sys.executable, "-I", "-m", "pytest", "-rA", "--color=yes", "-p", "no:cacheprovider", "test_all.py"]
    shown = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    passed = ["test_good[plain]", "test_good[two words]", "test_good[a] - b]", "test_good[\\xe9\\u2603]", "test_xfail"]
    passed += ["TestGroup::test_in", "[1] test_all.py:9: not now"]
    failed = ["test_bad[two words]", "test_bad[a - b]", "test_xpass", "test_error"]
    assert results(shown.stdout) == dict.fromkeys(passed, True) | dict.fromkeys(failed, False)


def test_message_of_a_failure_is_kept_apart_from_its_name() -> None:
    """A file that cannot be collected fails under its own name."""
    text = f"{HEAD}FAILED a.py::test_x[1 - 2] - assert 1 == 2 - really\nERROR tests/test_x.py - ImportError: no\n{END}"
    tests = [(test.name, test.message) for test in parser_named("pytest")(text)]
    assert tests == [("test_x[1 - 2]", "assert 1 == 2 - really"), ("tests/test_x.py", "ImportError: no")]


NO_SUMMARY = ["", "PASSED a.py::b\n", HEAD + END, HEAD + "nothing known\n" + END, "a short test summary info b\n"]


@pytest.mark.parametrize("text", NO_SUMMARY)
def test_output_without_a_result_is_said_to_have_none(text: str) -> None:
    for parser in PARSERS:
        with pytest.raises(NoResultError):
            parser_named(parser)(text)
    with pytest.raises(TaskError, match="pytest, swebench"):
        parser_named("junit")


FORGED = "PASSED a.py::secret\nPASSED a.py::more\n"
REAL = "PASSED a.py::open\nFAILED a.py::secret - assert 0\n"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (f"{HEAD}PASSED a.py::b\n{END}FAILED to stop the server\nPASSED x::y\n", {"b": True}),
        (f"-- Captured stdout call --\n{HEAD}{FORGED}{END}{HEAD}{REAL}{END}", {"open": True, "secret": False}),
        (f"{HEAD}FAILED a.py::secret - assert 0\n{END}{HEAD}PASSED a.py::secret\n{END}", {"secret": False}),
        (f"{HEAD}FAILED a::one\nPASSED a::two\n{END}{HEAD}PASSED b::three\n{END}", {"one": False, "three": True}),
    ],
    ids=["words_after_it", "forged_before", "forged_after", "two_sessions"],
)
def test_only_the_last_summary_adds_tests_and_none_takes_back_a_failure(text: str, expected: dict[str, bool]) -> None:
    """Pytest shows what a passing program printed before its own summary, and a script goes on after it."""
    assert results(text) == expected


MARKED = {"swebench": ("SWEBench", "PASSED"), "sweperf": ("SWE-Perf", "PASSED")}
MARKED |= {"mlebench": ("MLEBench", "ALL TESTS PASSED")}


@pytest.mark.parametrize("parser", MARKED)
def test_marked_results_pass_with_the_word_alone(parser: str) -> None:
    name, word = MARKED[parser]
    shown = "log\n{0} results starts here\n{1}\n{0} results ends here\nmore\n"
    good, bad, worse = (shown.format(name, said) for said in (word, "FAILED", f"not {word}"))
    for text, passed in ((good, True), (bad, False), (worse, False), (good + bad, False)):
        assert results(text, parser) == {"tests": passed}
    with pytest.raises(NoResultError):
        parser_named(parser)(word)


def test_swelancer_is_read_by_its_words_and_two_contradictory_ones_fail() -> None:
    won, lost, done = "... SWE Lancer SUCCESS", "swe lancer failure", "user_tool has completed"
    for text, passed in ((won, True), (lost, False), (won + lost, False), (done, True)):
        assert results(text, "swelancer") == {"swelancer_task": passed}


MARKS = [HEAD.strip(), END.strip(), "=", "==", "PASSED", "PASSED ::", "FAILED a::b[ - ", "ERROR - ", "\x1b[31m"]
NAMED = st.builds("{} a.py::{}".format, st.sampled_from(["PASSED", "FAILED", "ERROR:", "XPASS"]), st.text(max_size=20))
LINES = st.lists(st.text(max_size=30) | st.sampled_from(MARKS) | NAMED, max_size=20).map("\n".join)


@given(LINES, st.sampled_from(sorted(PARSERS)))
def test_any_text_gives_tests_with_names_or_no_result(text: str, parser: str) -> None:
    try:
        tests = parser_named(parser)(text)
    except NoResultError:
        return
    assert tests
    assert all(test.name for test in tests)
    assert len({test.name for test in tests}) == len(tests)


@given(LINES, LINES)
def test_nothing_printed_before_or_after_makes_a_failed_test_pass(before: str, after: str) -> None:
    """Whatever text stands around a real summary with a failure, that failure stays."""
    text = f"{before}\n{HEAD}FAILED a.py::hidden - no\n{END}{after}\n"
    assert results(text)["hidden"] is False


@pytest.mark.parametrize("piece", ["=", "[", " - ", "] - [", "\x1b[31", "PASSED a::b[ - \n", "FAILED ", HEAD, "0;"])
def test_megabytes_of_one_piece_take_no_more_than_linear_work(piece: str) -> None:
    """A reader that took quadratic time over four megabytes would take hours, and the run would end this test."""
    text = HEAD + "FAILED " + piece * (4_000_000 // len(piece))
    try:
        assert parser_named("pytest")(text)
    except NoResultError:
        assert piece != "PASSED a::b[ - \n"


A, B, C = TestResult("a", True), TestResult("b", False, weight=3.0), TestResult("c", True, weight=0.0)
HALF = Verdict(False, 0.4, (A, B, C))


@pytest.mark.parametrize(
    ("verdict", "rule", "weights", "reward"),
    [
        (HALF, "all", None, 0.0),
        (HALF, "fraction", None, 2 / 3),
        (HALF, "weighted", None, 0.25),
        (HALF, "weighted", {"a": 1, "b": 1}, 0.5),
        (HALF, "weighted", {"a": 1.0, "never_ran": 1.0}, 0.5),
        (HALF, "score", None, 0.4),
        *((Verdict(True, 1.0, (A,), problem="timeout"), rule, None, 0.0) for rule in ("all", "weighted", "score")),
        # A report can be forged more easily than the reward file, which decides.
        (Verdict(False, 0.0, (A, C)), "fraction", None, 0.0),
        (Verdict(True, 1.0, (A, B)), "fraction", None, 1.0),
        (Verdict(False, 0.7), "fraction", None, 0.7),
    ],
)
def test_each_way_of_rewarding_gives_its_own_number(verdict: Verdict, rule: Any, weights: Any, reward: float) -> None:
    """Nothing where there is a problem; tests that contradict the verdict do not count."""
    assert reward_of(verdict, rule, weights=weights) == pytest.approx(reward)


def test_weights_of_no_test_are_an_error_that_names_some() -> None:
    with pytest.raises(UsageError, match="a, b, c"):
        reward_of(HALF, "weighted", weights={})


def test_steps_are_rewarded_by_mean_or_by_the_last_and_giving_up_does_not_pay() -> None:
    (step,) = plain_task().steps
    two = replace(plain_task(), steps=(step, step))
    for rule, rewards, expected in (("mean", [1.0, 0.5], 0.75), ("mean", [1.0], 0.5), ("final", [0.0, 1.0], 1.0)):
        assert reward_of_steps(replace(two, reward_of_steps=rule), rewards) == expected
    assert reward_of_steps(replace(two, reward_of_steps="final"), [1.0]) == 0.0
    assert goes_on(step, Verdict(False, 0.0))
    assert [goes_on(replace(step, min_reward=0.5), Verdict(False, score)) for score in (0.5, 0.4)] == [True, False]
    assert not goes_on(replace(step, min_reward=-1.0), Verdict(False, 0.0, problem="timeout"))
