"""Hostile answers: they end within the limit, run no code, leave nothing behind, and spoil no verdict after them."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_core.errors import GradingError
from gem_math import grading
from gem_math.grading import formulas, grade
from gem_math.grading.readings import compare_texts
from gem_math.grading.text import clean
from gem_math.processes import Pool

# What a process is asked.
ASKED = (r"\sum_{k=1}^{10} k", "55")
HOSTILE = {
    "tower": "9^{9^{9^{9}}}",
    "long sum": r"\sum_{i=1}^{10000} \frac{1}{i^3}",
    "factorials": "((((10!)!)!)!)!",
    "integral": r"\int \frac{e^{x^2}\sin(\tan x)}{\ln(\ln x)} dx",
    "binomial": r"\binom{10^9}{5\cdot 10^8}",
    "roots": r"\sqrt{" * 300 + "2" + "}" * 300,
    "minuses": "-" * 3900 + "1",
    "gamma": r"\Gamma(10^{10^{10}})",
}
QUICK = {
    "braces": "{" * 1_000_000,
    "brackets": "(" * 1900 + "1" + ")" * 1900,
    "fractions": r"\frac{" * 300 + "1" + "}{2}" * 300,
    "digits": "1" * 3999,
    "decimals": "0." + "3" * 3900,
    "list": "1," * 1900 + "1",
    "power of a sum": "(x+y+z+w)^{500}",
    "nothing": "\x00\ud800",
    "texts": r"\text{" * 600,
    "colons": "a:b" * 900,
    "unions": r"(1,2)\cup" * 300 + "(1,2)",
    "signs": r"\pm" * 500,
    "equalities": "1=" * 900 + "1",
    "letters": "x" * 3999,
    "floors": r"\lfloor" * 500,
    "cells": r"\begin{pmatrix}" + "1&" * 900 + r"1\end{pmatrix}",
    "words": "is " * 1300,
    "units": "5 cm " * 700,
    "megabyte": "word " * 200_000,
    "marks": "5" + ",;" * 1900,
    "groups": "{" * 1900 + "5" + "}" * 1900,
}


def boxed(answer: str) -> str:
    return f"\\boxed{{{answer}}}"


def test_a_process_is_asked_and_answers():
    """The pair that the tests below use."""
    assert grade(boxed(ASKED[0]), ASKED[1], timeout_s=30).correct
    assert not grade(boxed(ASKED[0]), "54", timeout_s=30).correct


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.few(3)
def test_hostile_answer_is_wrong_and_the_next_is_right(name: str):
    """An answer that would compute forever is wrong by the limit, and no verdict after it suffers."""
    before = time.process_time()
    verdict = grade(boxed(HOSTILE[name]), "6", timeout_s=0.5)
    assert verdict.correct is False
    assert time.process_time() - before < 5.0  # what this process itself computed, whatever the machine does
    assert grade(boxed(ASKED[0]), ASKED[1], timeout_s=30).correct


@pytest.mark.parametrize("name", QUICK)
@pytest.mark.few(7)
def test_long_and_odd_answers_are_wrong(name: str):
    """The work in this process is bounded too."""
    before = time.process_time()
    for gold in ("6", r"\{1, 2\}", "x+1", r"\text{yes}"):
        assert grade(boxed(QUICK[name]), gold, timeout_s=0.5).correct is False
    assert time.process_time() - before < 20.0


@pytest.mark.parametrize("name", ["tower", "long sum", "factorials", "binomial"])
@pytest.mark.few(1)
def test_hostile_gold_answer_is_compared_as_text(name: str):
    """Where it is the gold answer that takes too long, another answer is wrong, and the reason says so."""
    found = grade(boxed("6"), HOSTILE[name], timeout_s=0.5)
    assert not found.correct
    assert found.reason == (
        "it is not written like the reference, and cannot be compared otherwise: it took more than 0.5 s"
    )


@pytest.mark.parametrize("gold", ["", " ", None, [], [""], {"a": 1}, [["1"]], [None]])
def test_gold_answer_that_is_none_is_an_error(gold: object):
    """A gold answer that is no text and no number says what it is."""
    with pytest.raises(GradingError, match="the gold answer must be a text, a number or a list of these"):
        grade(boxed("6"), gold)


def test_a_fault_of_the_grader_is_an_error(monkeypatch: pytest.MonkeyPatch):
    """It is no verdict: nobody gets a reward of 0 for it, wherever it happens."""
    pool = Pool("gem_math.grading.worker", "the grader", GradingError, 1)
    assert pool.ask({"gold": None, "answer": "x", "partial_credit": False}, 5)["raised"].startswith("TypeError")
    pool.end()
    monkeypatch.setattr(grading, "clean", lambda text: None)
    with pytest.raises(GradingError, match=r"the grader failed with TypeError: .* Please report the gold answer 'x'"):
        grade(boxed("y"), "x")


@pytest.mark.parametrize(
    "wrapped",
    ["{}", r"\text{{{}}}", "${}$", r"\operatorname{{{}}}", "x = {}", "({}, 1)", r"\frac{{{}}}{{2}}",
     r"\sum_{{k=1}}^{{3}} {}"],
)  # fmt: skip
@pytest.mark.parametrize(
    "code",
    [
        "__import__('os').system('touch {}')",
        "exec(\"import os; os.system('touch {}')\")",
        "().__class__.__base__.__subclasses__()[1]('{}')",
        "open('{}','w').write('x')",
        "lambda: __import__('pathlib').Path('{}').touch()",
        "eval(compile('open(\\'{}\\',\\'w\\')','','exec'))",
    ],
)  # fmt: skip
def test_an_answer_runs_no_code(tmp_path: Path, code: str, wrapped: str):
    """Python in an answer, or in a gold answer, is read as text or formula, and never run."""
    target = tmp_path / "touched"
    answer = wrapped.format(code.format(target))
    assert grade(boxed(answer), "6", timeout_s=5).correct is False
    assert grade(boxed("6"), answer, timeout_s=5).correct is False
    # And without the sandbox around the process.
    compare_texts(clean(answer), "1", False, formulas)
    compare_texts("1", clean(answer), False, formulas)
    assert not target.exists()


def test_the_process_writes_no_file_and_starts_no_program(tmp_path: Path):
    """If a formula ran code in spite of all, it could not write: the kernel and an audit hook stand in the way."""
    script = f"""
import os, sys
from gem_math.grading import worker
worker.load()
worker.guard()
for attempt in (lambda: os.system("touch {tmp_path}/a"), lambda: open("{tmp_path}/b", "w"),
                lambda: __import__("subprocess").run(["touch", "{tmp_path}/c"]), lambda: os.fork(),
                lambda: __import__("socket").socket()):
    try:
        attempt()
    except PermissionError as error:
        print("refused")
    else:
        print("allowed")
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == ["refused"] * 5, done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.thorough
def test_limit_holds_in_many_threads():
    """Hostile and good answers from many threads at once: each gets its own verdict."""
    jobs = [(boxed("9^{9^{9^{9}}}"), "6", False), (boxed(ASKED[0]), ASKED[1], True), (boxed("1/2"), "0.5", True)] * 4

    def run(job: tuple[str, str, bool]) -> bool:
        answer, gold, right = job
        return grade(answer, gold, timeout_s=0.4 if not right else 60).correct is right

    with ThreadPoolExecutor(12) as threads:
        assert list(threads.map(run, jobs)) == [True] * 12


@pytest.mark.thorough
def test_processes_are_bounded_and_threads_none():
    """Hostile answers leave as many processes and descriptors as there were, and no thread."""
    threads = threading.active_count()
    assert grade(boxed(ASKED[0]), ASKED[1], timeout_s=60).correct
    before = len(children()), len(os.listdir("/proc/self/fd"))
    for _ in range(6):
        grade(boxed("9^{9^{9^{9}}}"), "6", timeout_s=0.05)
    assert threading.active_count() == threads
    gc.collect()
    assert (len(children()), len(os.listdir("/proc/self/fd"))) == before


def children(of: int | None = None) -> list[int]:
    """Return the processes of graders that a process has, dead ones included."""
    own = str(of or os.getpid())
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            text = stat.read_text(encoding="utf-8")
            command = stat.with_name("cmdline").read_bytes()
        except OSError:
            continue
        if text.rpartition(")")[2].split()[1] == own and (b"grading.worker" in command or not command):
            found.append(int(stat.parent.name))
    return found


def test_process_that_was_killed_is_replaced():
    """Something else kills the idle processes: the next pair is compared by another."""
    assert grade(boxed(ASKED[0]), ASKED[1], timeout_s=30).correct
    for pid in children():
        os.killpg(pid, signal.SIGKILL)
    assert grade(boxed(ASKED[0]), ASKED[1], timeout_s=30).correct


@pytest.mark.thorough
def test_processes_end_with_a_caller_that_is_killed():
    """A caller that is killed outright leaves no process, not even one that is in the middle of a tower of powers."""
    script = """
from gem_math.grading import grade
grade(r"\\boxed{\\sum_{k=1}^{10} k}", "55", timeout_s=60)
print("ready", flush=True)
grade(r"\\boxed{9^{9^{9^{9}}}}", "6", timeout_s=2)
"""
    caller = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert caller.stdout is not None
    assert caller.stdout.readline() == "ready\n"
    pids = [child for pid in children(caller.pid) for child in (pid, *children(pid))]
    assert len(pids) >= 2
    caller.kill()
    caller.wait()
    caller.stdout.close()
    deadline = time.monotonic() + 60
    while any(Path(f"/proc/{pid}").exists() and not _is_zombie(pid) for pid in pids) and time.monotonic() < deadline:
        os.sched_yield()
    assert all(not Path(f"/proc/{pid}").exists() or _is_zombie(pid) for pid in pids)


def _is_zombie(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


@pytest.mark.thorough
def test_grading_works_after_a_fork():
    """A forked process has its own processes, and the parent's go on."""
    assert grade(boxed(ASKED[0]), ASKED[1], timeout_s=60).correct
    script = """
import os, sys
from gem_math.grading import grade
pair = (r"\\boxed{\\sum_{k=1}^{10} k}", "55")
assert grade(*pair, timeout_s=60).correct
child = os.fork()
if child == 0:
    os._exit(0 if grade(*pair, timeout_s=60).correct else 1)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
assert grade(*pair, timeout_s=60).correct
print("right")
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=240)
    assert done.stdout == "right\n", done.stderr


def test_ctrl_c_ends_a_grading_and_the_next_verdict_is_right():
    """Ctrl-C at a terminal goes to all of its programs at once: it reaches the caller alone, and the next is graded."""
    script = """
import os, signal, threading
from gem_math.grading import grade
pair = (r"\\boxed{\\sum_{k=1}^{10} k}", "55")

def interrupt():
    os.killpg(0, signal.SIGINT)

for _ in range(2):
    assert grade(*pair, timeout_s=60).correct
    thread = threading.Thread(target=interrupt)
    try:
        thread.start()
        grade(r"\\boxed{9^{9^{9^{9}}}}", "6", timeout_s=600)
    except KeyboardInterrupt:
        print("interrupted")
    thread.join()
print(grade(*pair, timeout_s=60).correct)
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=240, start_new_session=True
    )
    assert done.stdout.splitlines() == ["interrupted"] * 2 + ["True"], done.stderr


@given(st.text(max_size=60), st.sampled_from(["6", r"\frac{1}{2}", r"\{1,2\}", "(0,1)", "x+1", r"\text{yes}", "x=3"]))
def test_any_text_gets_a_verdict(answer: str, gold: str):
    """Whatever an answer is, it is right or wrong, and never an error."""
    assert isinstance(grade(boxed(answer), gold, timeout_s=2).correct, bool)


_PIECES = st.sampled_from(
    ["1", "2", "x", r"\frac", "{", "}", "(", ")", "[", "]", ",", "=", "<", r"\sqrt", "^", "_", r"\text{", "cm", r"\pm",
     "-", "+", r"\cup", r"\{", r"\}", r"\le", ":", "!", "|", "%",
     r"\begin{pmatrix}", r"\end{pmatrix}", "&", r"\\", " ", r"\infty",
     r"\begin{cases}", r"\end{cases}", r"\text{ if }", "x=1", "y=2", ";", "or", "k", r"\pi", r"\in\mathbb{Z}", "0,"]
)  # fmt: skip


@given(st.lists(_PIECES, max_size=14).map("".join), st.sampled_from(["6", r"\{1,2\}", r"\frac{x}{2}", "[0,1)"]))
def test_any_pieces_of_latex_get_a_verdict(answer: str, gold: str):
    """Broken LaTeX too."""
    assert isinstance(grade(boxed(answer), gold, timeout_s=2).correct, bool)
