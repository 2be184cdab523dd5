"""The course of a verification, on machines of a few dictionaries; ``test_verifying_real.py`` has the real ones."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from verifying_toys import ToyBackend, ToyMachine, task

from gem_terminal.backends.interface import Completed, Limits
from gem_terminal.errors import EngineError, MachineLostError, TaskError
from gem_terminal.tasks.staging import solve
from gem_terminal.tasks.task import Collect, Container, Environment, Solution
from gem_terminal.verifying.verify import verify

if TYPE_CHECKING:
    from gem_terminal.verifying.verdict import Verdict


def writes(**files: bytes) -> Any:
    """Make tests that write files to the folder of results."""

    def tests(machine: ToyMachine) -> Completed:
        machine.files |= {f"/logs/verifier/{name.replace('_', '.')}": content for name, content in files.items()}
        return Completed(0, b"ran")

    return tests


SOLVED = writes(reward_txt=b"1")
NOTHING = writes()
PREPARED = {"setup": ("prepare", "it")}


def judged(
    tmp_path: Path,
    tests: Any,
    *,
    machine: Any = None,
    backend: Any = None,
    limits: Any = Limits(),  # noqa: B008 - immutable
    how: dict[str, Any] | None = None,
    **said: Any,
) -> Verdict:
    """Verify the step of a task of its own."""
    made = task(tmp_path, **said)
    backend, machine = backend or ToyBackend(SOLVED), machine or ToyMachine(tests)
    return verify(machine, made, made.steps[0], backend=backend, limits=limits, **(how or {}))


JUDGE = {"where": "judge", "artifacts": ("/app",)}


def test_tests_run_in_the_agents_machine_as_the_task_says(tmp_path: Path) -> None:
    machine = ToyMachine(SOLVED)
    verdict = judged(tmp_path, None, machine=machine, env={"A": "b"}, user="tester")
    assert (verdict.passed, verdict.score, verdict.problem, verdict.blame) == (True, 1.0, None, None)
    assert (verdict.output, verdict.info["where"], machine.log) == ("ran", "machine", ["agent: tests"])
    assert (machine.said["env"], machine.said["user"], machine.said["timeout_s"]) == ({"A": "b"}, "tester", 5.0)


@pytest.mark.parametrize(
    ("declared", "carried"), [((), {"/app/out/a", "/app/one.txt"}), (("/etc/one/", "/none"), {"/etc/one"})]
)
def test_judge_gets_what_the_task_declares_or_else_the_artifacts(
    tmp_path: Path, declared: tuple[str, ...], carried: set[str]
) -> None:
    """In a fresh machine that was made ready for the step, nothing else of the agent's; it is removed afterwards."""
    machine, backend = ToyMachine(NOTHING), ToyBackend(SOLVED)
    machine.files = {"/app/out/a": b"1", "/app/one.txt": b"2", "/etc/one": b"3", "/logs/verifier/reward.json": b"1"}
    verdict = judged(tmp_path, None, machine=machine, backend=backend, step=PREPARED, artifacts=declared, how=JUDGE)
    assert (verdict.passed, verdict.info["where"]) == (True, "judge")
    assert {path for path in backend.started[0].files if not path.startswith(("/tests", "/logs"))} == carried
    assert backend.log == ["start", *(f"fresh: {what}" for what in ("pwd", "prepare", "tests", "gone"))]
    assert "agent: gone" not in machine.log


@pytest.mark.parametrize("where", ["machine", "judge"])
def test_environment_of_its_own_gets_what_the_task_declares_and_nothing_else(tmp_path: Path, where: str) -> None:
    """In both modes; what only runs is noted in files before, and a command that fails is told of."""

    def dumps(machine: ToyMachine) -> Completed:
        machine.files["/app/out/a"] = b"state"
        return Completed(3, b"")

    machine, backend, own = ToyMachine(dumps), ToyBackend(SOLVED), Environment(Container())
    machine.files = {"/app/secret": b"2", "/app/one.txt": b"3"}
    said: dict[str, Any] = {"environment": own, "artifacts": ("/app/out/", "/app/one.txt", "/app/none")}
    said |= {"collect": (Collect(("dump",)),), "how": {**JUDGE, "where": where}}
    verdict = judged(tmp_path, None, machine=machine, backend=backend, **said)
    assert (verdict.passed, verdict.info["where"]) == (True, "separate")
    assert verdict.info["collected"] == [{"command": "dump", "exit_code": 3}]
    assert backend.environments == [own]
    assert {path for path in backend.started[0].files if path.startswith("/app")} == {"/app/out/a", "/app/one.txt"}


@pytest.mark.parametrize(
    ("asked", "overruled", "where"),
    [("public", "task", "judge"), ("none", "task", "machine"), ("public", "public", "machine")],
)
def test_network_of_its_own_is_that_of_a_judge(tmp_path: Path, asked: str, overruled: str, where: str) -> None:
    """A running machine cannot be given another; where the caller overrules it, there is but one."""
    backend = ToyBackend(SOLVED)
    verdict = judged(tmp_path, SOLVED, backend=backend, limits=Limits(network=overruled), network=asked)
    assert (verdict.passed, verdict.info["where"]) == (True, where)
    assert [given and given.network for given in backend.environments] == ["public"] * (where == "judge")


def hang(machine: ToyMachine) -> Completed:
    """Write the reward, and run out of time."""
    machine.files["/logs/verifier/reward.txt"] = b"1"
    return Completed(None, b"still at it")


def lose(by_agent: bool | None) -> Any:
    """Lose the machine while the tests run."""

    def tests(machine: ToyMachine) -> Completed:
        machine.lost = MachineLostError("its memory was full", by_agent=by_agent)
        raise MachineLostError("the machine is gone")

    return tests


@pytest.mark.parametrize(
    ("tests", "options", "problem", "blame"),
    [
        (NOTHING, {}, "no_result", "agent"),
        (NOTHING, {"backend": ToyBackend(NOTHING)}, "no_result", "task"),
        (NOTHING, {"how": {"control": False}}, "no_result", None),
        (NOTHING, {"how": JUDGE, "limits": Limits(storage_mb=1)}, "machine", "agent"),
        (hang, {}, "timeout", "agent"),
        (writes(reward_txt=b"full marks"), {}, "unreadable", "agent"),
        (lose(True), {}, "machine", "agent"),
        (lose(False), {}, "machine", None),
        (lose(None), {}, "machine", None),
    ],
)
def test_tests_without_a_verdict_are_blamed_on_whom_that_is_known_of(
    tmp_path: Path, tests: Any, options: Any, problem: str, blame: str | None
) -> None:
    """By a trial on an untouched machine; what the agent wrote before the tests counts for nothing."""
    machine = ToyMachine(tests)
    forged = {"/logs/verifier/reward.json": b'{"reward": 1}', "/tests/test.sh": b"echo forged"}
    machine.files = {"/app/big": b"x" * 3_000_000} | ({} if tests is hang else forged)
    verdict = judged(tmp_path, None, machine=machine, **options)
    assert (verdict.passed, verdict.problem, verdict.blame) == (False, problem, blame)
    if "how" not in options:
        assert machine.files["/tests/test.sh"] == b"echo 1 > /logs/verifier/reward.txt\n"


def test_trial_on_an_untouched_machine_is_made_once_for_a_version_of_a_task(tmp_path: Path) -> None:
    """By one of several threads, on a machine that is made ready for the step."""
    backend = ToyBackend(SOLVED)
    with ThreadPoolExecutor(4) as pool:
        one = partial(judged, tmp_path, NOTHING, backend=backend, step=PREPARED)
        verdicts = list(pool.map(lambda _: one(), range(8)))
    assert {verdict.blame for verdict in verdicts} == {"agent"}
    assert backend.log == ["start", "fresh: pwd", "fresh: prepare", "fresh: tests", "fresh: gone"]


@pytest.mark.parametrize(
    ("rewards", "score", "passed"),
    [
        (b'{"reward": 0.25, "other": 1.0}', 0.25, False),
        (b'{"accuracy": 0.5}', 0.5, False),
        (b'{"a": 1.0, "b": 0.0}', 0.5, False),
        (b'{"a": 1.7e308, "b": 1.7e308}', 1.7e308, True),
    ],
)
def test_score_is_the_reward_or_the_only_number_or_the_mean(
    tmp_path: Path, rewards: bytes, score: float, passed: bool
) -> None:
    """A large log beside it does not hide it."""
    verdict = judged(tmp_path, writes(reward_json=rewards, reward_txt=b"1", log=b"x" * 11_000_000))
    assert (verdict.score, verdict.passed) == (score, passed)


def test_failing_engine_or_an_unknown_parser_is_an_error_and_no_verdict(tmp_path: Path) -> None:
    def fail(_: ToyMachine) -> Completed:
        raise EngineError("the engine does not answer")

    with pytest.raises(EngineError):
        judged(tmp_path, fail)
    machine = ToyMachine(SOLVED)
    with pytest.raises(TaskError, match="'nose'"):
        judged(tmp_path, None, machine=machine, result="output", parser="nose")
    assert not machine.log


def test_report_names_the_tests_beside_the_reward(tmp_path: Path) -> None:
    report = b'{"results": {"tests": [{"name": "a", "status": "passed"}, {"name": "b", "status": "failed"}]}}'
    verdict = judged(tmp_path, writes(reward_txt=b"0", ctrf_json=report), weights={"a": 3.0})
    assert [(test.name, test.passed, test.weight) for test in verdict.tests] == [("a", True, 3.0), ("b", False, 0.0)]


def test_output_is_read_with_the_parser_of_the_task_and_its_exit_code_does_not_matter(tmp_path: Path) -> None:
    """What is kept of it is cut in the middle."""
    said = b"\n== short test summary info ==\nPASSED a::b\nFAILED a::c - no\n== 1 failed ==\n"
    verdict = judged(tmp_path, lambda _: Completed(1, b"a" * 30_000 + said, dropped=5), result="output")
    assert [(test.name, test.passed) for test in verdict.tests] == [("b", True), ("c", False)]
    assert (verdict.passed, verdict.score, verdict.problem, verdict.info["exit_code"]) == (False, 0.0, None, 1)
    left_out = f"{10_005 + len(said):,}"
    kept = "a" * (10_000 - len(said)) + said.decode()
    assert verdict.output == "a" * 10_000 + f"\n... {left_out} characters left out ...\n" + kept


@pytest.mark.parametrize(
    ("asks", "where", "expected"),
    [(True, "machine", "shell"), (False, "machine", "machine"), (True, "judge", "judge")],
)
def test_agents_own_shell_runs_the_tests_of_a_task_that_asks_for_it(
    tmp_path: Path, asks: bool, where: str, expected: str
) -> None:
    asked: list[tuple[tuple[str, ...], float]] = []
    machine = ToyMachine(SOLVED)

    def in_shell(command: Any, seconds: float) -> Completed:
        asked.append((tuple(command), seconds))
        return SOLVED(machine)

    verdict = judged(tmp_path, None, machine=machine, how={"same_shell": in_shell, "where": where}, same_shell=asks)
    assert (verdict.passed, verdict.info["where"]) == (True, expected)
    assert asked == [(("bash", "/tests/test.sh"), 5.0)] * (expected == "shell")


def test_tests_are_taken_away_when_the_agent_goes_on_to_a_next_step(tmp_path: Path) -> None:
    made, machine, backend = task(tmp_path, steps=2), ToyMachine(SOLVED), ToyBackend(SOLVED)
    for step, expected in zip(made.steps, (False, True), strict=True):
        verify(machine, made, step, backend=backend, limits=Limits())
        assert any(path.startswith("/tests") for path in machine.files) is expected


def test_solution_runs_as_a_command_or_line_by_line_and_leaves_no_file(tmp_path: Path) -> None:
    (tmp_path / "solve.sh").write_text("true\n")
    machine = ToyMachine(lambda toy: Completed(0, b"".join(sorted(toy.files.values()))))
    by_file = Solution({"/solution/solve.sh": tmp_path / "solve.sh"}, ("bash", "/solution/solve.sh"))
    assert solve(machine, task(tmp_path, step={"solution": by_file}).steps[0]).output == b"true\n"
    assert not machine.files
    typed = Solution(typed=(("cd /tmp", 1.0), ("echo 'a b'", 2.0)))
    solve(machine, task(tmp_path, step={"solution": typed}).steps[0])
    lines = ("bash", "-c", "eval 'cd /tmp'\neval 'echo '\"'\"'a b'\"'\"''")
    assert machine.commands[-1][-3:] == lines
    with pytest.raises(TaskError, match="no reference solution"):
        solve(machine, task(tmp_path).steps[0])
