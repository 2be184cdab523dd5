"""The readers of what tests print: right results, wrong ones, forged ones, and any text at all."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_terminal.errors import TaskError
from gem_terminal.verifying.output_parsers import PARSERS, NoResultError, parser_named

HEAD = "=========================== short test summary info ============================\n"
END = "========================= 1 failed, 2 passed in 0.05s =========================\n"


def results(text: str, parser: str = "pytest") -> dict[str, bool]:
    return {test.name: test.passed for test in parser_named(parser)(text)}


def test_real_pytest_output_is_read_with_every_status(tmp_path: Path) -> None:
    """What the installed pytest prints with -rA gives each test its result, parameters of any kind included."""
    (tmp_path / "test_all.py").write_text(
        "import pytest\n"
        "@pytest.mark.parametrize('x', ['plain', 'two words', 'a - b', 'a] - b', 'é☃'])\n"
        "def test_good(x): pass\n"
        "@pytest.mark.parametrize('x', ['plain', 'two words', 'a - b'])\n"
        "def test_bad(x): raise ValueError('one - two - three')\n"
        "def test_silent(): raise ValueError\n"
        "class TestGroup:\n"
        "    def test_in(self): pass\n"
        "@pytest.mark.skip(reason='not now')\n"
        "def test_skipped(): pass\n"
        "@pytest.mark.xfail(reason='known')\n"
        "def test_xfail(): assert False\n"
        "@pytest.mark.xfail(reason='known')\n"
        "def test_xpass(): pass\n"
        "@pytest.fixture\n"
        "def broken(): raise OSError('gone')\n"
        "def test_error(broken): pass\n"
    )
    command = [sys.executable, "-I", "-m", "pytest", "-rA", "--color=yes", "-p", "no:cacheprovider", "test_all.py"]
    shown = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert results(shown.stdout) == {
        "test_good[plain]": True,
        "test_good[two words]": True,
        "test_good[a - b]": True,
        "test_good[a] - b]": True,
        "test_good[\\xe9\\u2603]": True,
        "test_bad[plain]": False,
        "test_bad[two words]": False,
        "test_bad[a - b]": False,
        "test_silent": False,
        "TestGroup::test_in": True,
        "[1] test_all.py:9: not now": True,
        "test_xfail": True,
        "test_xpass": False,
        "test_error": False,
    }


def test_message_of_a_failure_is_kept_apart_from_its_name() -> None:
    """A file that cannot be collected fails under its own name."""
    text = f"{HEAD}FAILED a.py::test_x[1 - 2] - assert 1 == 2 - really\nERROR tests/test_x.py - ImportError: no\n{END}"
    tests = parser_named("pytest")(text)
    assert [(test.name, test.message) for test in tests] == [
        ("test_x[1 - 2]", "assert 1 == 2 - really"),
        ("tests/test_x.py", "ImportError: no"),
    ]


@pytest.mark.parametrize(
    "text", ["", "PASSED a.py::b\n", HEAD, HEAD + END, HEAD + "nothing known\n" + END, "a short test summary info b\n"]
)
def test_output_without_a_result_is_said_to_have_none(text: str) -> None:
    with pytest.raises(NoResultError, match="short test summary info"):
        parser_named("pytest")(text)


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


def test_unknown_parser_is_an_error_that_names_those_there_are() -> None:
    with pytest.raises(TaskError, match="pytest, swebench, swelancer, mlebench, sweperf"):
        parser_named("junit")


MARKED = {
    "swebench": ("SWEBench results starts here", "PASSED", "SWEBench results ends here"),
    "sweperf": ("SWE-Perf results starts here", "PASSED", "SWE-Perf results ends here"),
    "mlebench": ("MLEBench results starts here", "ALL TESTS PASSED", "MLEBench results ends here"),
}


@pytest.mark.parametrize("parser", MARKED)
def test_marked_results_pass_with_the_word_alone(parser: str) -> None:
    begin, word, end = MARKED[parser]
    assert results(f"log\n{begin}\n{word}\n{end}\nmore", parser) == {"tests": True}
    assert results(f"{begin}\nFAILED\n{end}", parser) == {"tests": False}
    assert results(f"{begin}\n{word}\n{end}\n{begin}\nFAILED\n{end}", parser) == {"tests": False}
    assert results(f"{begin}\nnot {word}\n{end}", parser) == {"tests": False}
    with pytest.raises(NoResultError, match="starts here"):
        parser_named(parser)(word)


def test_swelancer_is_read_by_its_words_and_two_contradictory_ones_fail() -> None:
    assert results("... SWE Lancer SUCCESS", "swelancer") == {"swelancer_task": True}
    assert results("swe lancer failure", "swelancer") == {"swelancer_task": False}
    assert results("swe lancer success, swe lancer failure", "swelancer") == {"swelancer_task": False}
    assert results("user_tool has completed", "swelancer") == {"swelancer_task": True}
    with pytest.raises(NoResultError):
        parser_named("swelancer")("completed")


LINES = st.one_of(
    st.text(max_size=30),
    st.sampled_from(
        [HEAD.strip(), END.strip(), "=", "==", "PASSED", "PASSED ::", "FAILED a::b[ - ", "ERROR - ", "\x1b[31m"]
    ),
    st.builds("{} a.py::{}".format, st.sampled_from(["PASSED", "FAILED", "ERROR:", "XPASS"]), st.text(max_size=20)),
)


@given(st.lists(LINES, max_size=20).map("\n".join), st.sampled_from(sorted(PARSERS)))
def test_any_text_gives_tests_with_names_or_no_result(text: str, parser: str) -> None:
    try:
        tests = parser_named(parser)(text)
    except NoResultError:
        return
    assert tests
    assert all(test.name for test in tests)
    assert len({test.name for test in tests}) == len(tests)


@given(st.lists(LINES, max_size=10).map("\n".join), st.lists(LINES, max_size=10).map("\n".join))
def test_nothing_printed_before_or_after_makes_a_failed_test_pass(before: str, after: str) -> None:
    """Whatever text stands around a real summary with a failure, that failure stays."""
    text = f"{before}\n{HEAD}FAILED a.py::hidden - no\n{END}{after}\n"
    assert results(text)["hidden"] is False


@pytest.mark.parametrize(
    "piece", ["=", "[", " - ", "] - [", "\x1b[", "\x1b[31", "PASSED a::b[ - \n", "FAILED ", HEAD, "::", "0;"]
)
def test_megabytes_of_one_piece_take_no_more_than_linear_work(piece: str) -> None:
    """A reader that took quadratic time over four megabytes would take hours, and the run would end this test."""
    text = HEAD + "FAILED " + piece * (4_000_000 // len(piece))
    try:
        assert parser_named("pytest")(text)
    except NoResultError:
        assert piece != "PASSED a::b[ - \n"
