"""The course of a verification, on machines of a few dictionaries; ``test_verifying_attacks.py`` has the real ones."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
from verifying_toys import DONE, ToyBackend, ToyMachine, as_backend, as_machine, task, verifier

from gem_core.errors import UsageError
from gem_terminal.backends.interface import Completed, Limits, Process
from gem_terminal.errors import EngineError, MachineLostError, TaskError
from gem_terminal.tasks.task import Collect, Container, Environment, Solution
from gem_terminal.verifying.controls import CONTROLS, Controls
from gem_terminal.verifying.solutions import solve
from gem_terminal.verifying.verdict import Verdict
from gem_terminal.verifying.verify import verify

SERVER = Process(7, 1, 100, "python3 server.py", 7)


def writes(**files: bytes) -> object:
    """Make tests that write files to the folder of results."""

    def tests(machine: ToyMachine) -> Completed:
        machine.files |= {f"/logs/verifier/{name.replace('_', '.')}": content for name, content in files.items()}
        return Completed(0, b"ran")

    return tests


SOLVED = writes(reward_txt=b"1")
NOTHING = writes()


def judged(tmp_path: Path, tests, untouched=SOLVED, *, machine=None, more=None, **said) -> Verdict:  # type: ignore[no-untyped-def]
    """Verify one step of a task of its own."""
    CONTROLS.forget()
    machine = machine or ToyMachine(tests)
    made = task(tmp_path, verifier(tmp_path, **said))
    return verify(
        as_machine(machine),
        made,
        made.steps[0],
        backend=as_backend(ToyBackend(untouched)),
        limits=Limits(),
        **(more or {}),
    )


def test_solved_task_passes_in_the_agents_machine_when_nothing_is_left_running(tmp_path: Path) -> None:
    machine = ToyMachine(SOLVED)
    verdict = judged(tmp_path, None, machine=machine, env={"A": "b"})
    assert (verdict.passed, verdict.score, verdict.problem, verdict.blame) == (True, 1.0, None, None)
    assert verdict.output == "ran"
    assert verdict.info["where"] == "machine"
    assert verdict.info["put_back"] == []
    assert machine.log == ["agent: remove /tests /logs/verifier", "agent: tests"]
    assert machine.env == {"A": "b"}


def test_what_the_agent_left_running_moves_the_tests_to_a_copy(tmp_path: Path) -> None:
    machine = ToyMachine(SOLVED)
    machine.left = [SERVER]
    machine.changes = {"/usr/bin/bash": "changed"}
    verdict = judged(tmp_path, None, machine=machine)
    assert verdict.info["put_back"] == ["/usr/bin/bash"]
    assert verdict.passed
    assert (verdict.info["where"], verdict.info["left"]) == ("judge", ["python3 server.py"])
    assert machine.log == [
        "agent: judge None",
        "judge: put back /usr/bin/bash",
        "judge: begins",
        "judge: remove /tests /logs/verifier",
        "judge: tests",
        "judge: gone",
    ]


def test_what_could_be_left_without_being_seen_moves_the_tests_to_a_copy(tmp_path: Path) -> None:
    machine = ToyMachine(SOLVED)
    machine.can_hide = True
    assert judged(tmp_path, None, machine=machine).info["where"] == "judge"


def test_copy_is_told_who_runs_the_tests_in_it(tmp_path: Path) -> None:
    machine = ToyMachine(SOLVED)
    machine.left = [SERVER]
    assert judged(tmp_path, None, machine=machine, user="tester").passed
    assert machine.log[0] == "agent: judge None as tester"


@pytest.mark.parametrize(("where", "left"), [("machine", [SERVER]), ("judge", [])])
def test_caller_may_force_where_the_tests_run(tmp_path: Path, where: str, left: list[Process]) -> None:
    machine = ToyMachine(SOLVED)
    machine.left = left
    assert judged(tmp_path, None, machine=machine, more={"where": where}).info["where"] == where


def test_network_of_its_own_moves_the_tests_to_a_copy(tmp_path: Path) -> None:
    machine = ToyMachine(SOLVED)
    judged(tmp_path, None, machine=machine, network="public")
    assert machine.log[0] == "agent: judge public"


def test_result_of_before_the_tests_counts_for_nothing(tmp_path: Path) -> None:
    machine = ToyMachine(NOTHING)
    machine.files = {"/logs/verifier/reward.json": b'{"reward": 1}', "/tests/test.sh": b"echo forged"}
    verdict = judged(tmp_path, None, machine=machine)
    assert (verdict.passed, verdict.problem, verdict.blame) == (False, "no_result", "agent")
    assert machine.files["/tests/test.sh"] == b"echo 1 > /logs/verifier/reward.txt\n"


def test_environment_of_its_own_gets_the_artifacts_and_nothing_else(tmp_path: Path) -> None:
    backend = ToyBackend(SOLVED)
    machine = ToyMachine(NOTHING)
    machine.files = {"/app/out/a": b"1", "/app/secret": b"2", "/app/one.txt": b"3"}
    said = verifier(
        tmp_path, environment=Environment(Container()), artifacts=("/app/out/", "/app/one.txt", "/app/none")
    )
    made = task(tmp_path, said)
    verdict = verify(as_machine(machine), made, made.steps[0], backend=as_backend(backend), limits=Limits())
    assert verdict.passed
    assert verdict.info["where"] == "separate"
    own = backend.started[0]
    assert {path for path in own.files if path.startswith("/app")} == {"/app/out/a", "/app/one.txt"}
    assert own.removed
    assert not machine.log


def test_tests_that_run_out_of_time_do_not_pass_whatever_they_wrote(tmp_path: Path) -> None:
    def hang(machine: ToyMachine) -> Completed:
        machine.files["/logs/verifier/reward.txt"] = b"1"
        return Completed(None, b"still at it")

    verdict = judged(tmp_path, hang)
    assert (verdict.passed, verdict.problem, verdict.blame) == (False, "timeout", "agent")
    assert verdict.detail == "the tests took longer than 5 seconds, and were killed"


def test_unreadable_result_is_a_problem_in_words(tmp_path: Path) -> None:
    verdict = judged(tmp_path, writes(reward_txt=b"full marks"))
    assert (verdict.problem, verdict.detail) == ("unreadable", "reward.txt has 'full marks'; it must be one number")


def test_task_is_to_blame_when_an_untouched_machine_gives_no_verdict_either(tmp_path: Path) -> None:
    verdict = judged(tmp_path, NOTHING, NOTHING)
    assert (verdict.blame, verdict.info["control"]) == ("task", "no_result")


def test_trial_on_an_untouched_machine_is_made_once_for_a_version_of_a_task(tmp_path: Path) -> None:
    CONTROLS.forget()
    backend = ToyBackend(SOLVED)
    made = task(tmp_path, verifier(tmp_path))
    with ThreadPoolExecutor(4) as pool:
        verdicts = list(
            pool.map(
                lambda _: verify(
                    as_machine(ToyMachine(NOTHING)), made, made.steps[0], backend=as_backend(backend), limits=Limits()
                ),
                range(8),
            )
        )
    assert {verdict.blame for verdict in verdicts} == {"agent"}
    assert backend.log.count("start untouched") == 1
    assert backend.started[0].removed


def test_nobody_is_blamed_without_a_trial(tmp_path: Path) -> None:
    verdict = judged(tmp_path, NOTHING, more={"control": False})
    assert (verdict.problem, verdict.blame) == ("no_result", None)


def test_trial_that_raises_is_made_again() -> None:
    controls = Controls()
    tries: list[int] = []

    def attempt() -> Verdict:
        tries.append(1)
        if len(tries) == 1:
            raise EngineError("the engine is down")
        return Verdict(True, 1.0)

    with pytest.raises(EngineError):
        controls.get(("a", "b", "c"), attempt)
    assert controls.get(("a", "b", "c"), attempt).passed
    assert controls.get(("a", "b", "c"), attempt).passed
    assert len(tries) == 2


@pytest.mark.parametrize(("by_agent", "blame"), [(True, "agent"), (False, None), (None, None)])
def test_lost_machine_is_the_agents_fault_only_where_that_is_known(
    tmp_path: Path, by_agent: bool | None, blame: str | None
) -> None:
    def lose(machine: ToyMachine) -> Completed:
        machine.lost = MachineLostError("its memory was full", by_agent=by_agent)
        raise MachineLostError("the machine is gone")

    verdict = judged(tmp_path, lose)
    assert (verdict.passed, verdict.problem, verdict.blame) == (False, "machine", blame)
    assert verdict.detail == "its memory was full"


def test_failing_engine_is_an_error_and_no_verdict(tmp_path: Path) -> None:
    def fail(_: ToyMachine) -> Completed:
        raise EngineError("the engine does not answer")

    with pytest.raises(EngineError):
        judged(tmp_path, fail)


def test_what_the_tests_left_running_is_ended_before_the_result_is_read(tmp_path: Path) -> None:
    forger = Process(99, 1, 200, "forge", 99)

    def tests(machine: ToyMachine) -> Completed:
        machine.left.append(forger)
        machine.files["/logs/verifier/reward.txt"] = b"0"
        return DONE

    machine = ToyMachine(tests)
    assert judged(tmp_path, None, machine=machine).score == 0.0
    assert machine.killed == [forger]


def test_reward_json_of_a_program_under_test_does_not_beat_the_tests_own_txt(tmp_path: Path) -> None:
    """``test.sh`` writes ``reward.txt``, as its text shows; the other file would take precedence."""
    verdict = judged(tmp_path, writes(reward_txt=b"0", reward_json=b'{"reward": 1}'))
    assert (verdict.passed, verdict.score) == (False, 0.0)


def test_report_names_the_tests_beside_the_reward(tmp_path: Path) -> None:
    report = b'{"results": {"tests": [{"name": "a", "status": "passed"}, {"name": "b", "status": "failed"}]}}'
    verdict = judged(tmp_path, writes(reward_txt=b"0", ctrf_json=report), weights={"a": 3.0})
    assert [(test.name, test.passed, test.weight) for test in verdict.tests] == [("a", True, 3.0), ("b", False, 0.0)]


def test_large_log_beside_the_reward_does_not_hide_it(tmp_path: Path) -> None:
    assert judged(tmp_path, writes(log=b"x" * 11_000_000, reward_txt=b"0.5")).score == 0.5


def test_output_is_read_with_the_parser_of_the_task_and_its_exit_code_does_not_matter(tmp_path: Path) -> None:
    def tests(_: ToyMachine) -> Completed:
        return Completed(1, b"== short test summary info ==\nPASSED a::b\nFAILED a::c - no\n== 1 failed ==\n")

    verdict = judged(tmp_path, tests, result="output")
    assert [(test.name, test.passed) for test in verdict.tests] == [("b", True), ("c", False)]
    assert (verdict.passed, verdict.score, verdict.problem) == (False, 0.0, None)
    assert verdict.info["exit_code"] == 1


def test_unknown_parser_is_an_error_before_anything_is_done(tmp_path: Path) -> None:
    machine = ToyMachine(SOLVED)
    with pytest.raises(TaskError, match="no parser is called 'nose'"):
        judged(tmp_path, None, machine=machine, result="output", parser="nose")
    assert not machine.log


def test_agents_own_shell_runs_the_tests_only_if_both_task_and_caller_say_so(tmp_path: Path) -> None:
    asked: list[tuple[tuple[str, ...], float]] = []
    machine = ToyMachine(SOLVED)

    def in_shell(command, seconds: float) -> Completed:  # type: ignore[no-untyped-def]
        asked.append((tuple(command), seconds))
        return SOLVED(machine)

    for same_shell, expected in ((False, "machine"), (True, "shell")):
        verdict = judged(tmp_path, None, machine=machine, more={"same_shell": in_shell}, same_shell=same_shell)
        assert (verdict.passed, verdict.info["where"]) == (True, expected)
    assert asked == [(("bash", "/tests/test.sh"), 5.0)]
    assert judged(tmp_path, None, machine=machine, same_shell=True).info["where"] == "machine"


def test_tests_are_taken_away_when_the_agent_goes_on_to_a_next_step(tmp_path: Path) -> None:
    made = task(tmp_path, verifier(tmp_path), steps=2)
    machine = ToyMachine(SOLVED)
    for step, expected in zip(made.steps, (False, True), strict=True):
        verify(as_machine(machine), made, step, backend=as_backend(ToyBackend(SOLVED)), limits=Limits())
        assert any(path.startswith("/tests") for path in machine.files) is expected


@pytest.mark.parametrize("more", [{"where": "here"}, {"tools": "mine"}])
def test_unknown_choice_is_an_error_that_names_those_there_are(tmp_path: Path, more: dict[str, str]) -> None:
    with pytest.raises(UsageError, match=r"is not known; use '\w+'"):
        judged(tmp_path, SOLVED, more=more)


def test_long_output_is_cut_in_the_middle(tmp_path: Path) -> None:
    verdict = judged(tmp_path, lambda _: Completed(0, b"a" * 30_000 + b"b" * 30_000, dropped=5))
    assert verdict.output == "a" * 10_000 + "\n... 40,005 characters left out ...\n" + "b" * 10_000


def test_threads_wait_for_one_trial_of_the_same_task_and_not_for_others() -> None:
    controls, inside, go_on = Controls(), threading.Event(), threading.Event()

    def slow() -> Verdict:
        inside.set()
        assert go_on.wait(60)
        return Verdict(True, 1.0)

    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(controls.get, ("a", "", "toy"), slow)
        assert inside.wait(60)
        assert controls.get(("b", "", "toy"), lambda: Verdict(False, 0.0)).score == 0.0
        go_on.set()
        assert first.result(60).passed


def test_solution_runs_as_a_command_or_line_by_line_and_leaves_no_file(tmp_path: Path) -> None:
    (tmp_path / "solve.sh").write_text("true\n")
    machine = ToyMachine(lambda toy: Completed(0, b"".join(sorted(toy.files.values()))))
    files = {"/solution/solve.sh": tmp_path / "solve.sh"}
    by_file = task(tmp_path, verifier(tmp_path), solution=Solution(files, ("bash", "/solution/solve.sh")))
    assert solve(as_machine(machine), by_file.steps[0]).output == b"true\n"
    assert not machine.files
    typed = task(tmp_path, verifier(tmp_path), solution=Solution(typed=(("cd /tmp", 1.0), ("echo 'a b'", 2.0))))
    solve(as_machine(machine), typed.steps[0])
    assert machine.commands[-1] == ("bash", "-c", "eval 'cd /tmp'\neval 'echo '\"'\"'a b'\"'\"''")
    with pytest.raises(TaskError, match="has no reference solution"):
        solve(as_machine(machine), task(tmp_path, verifier(tmp_path)).steps[0])


def test_what_only_runs_is_noted_in_files_before_artifacts_are_taken(tmp_path: Path) -> None:
    """One that fails is told of; the tests judge what is there."""

    def dumps(machine: ToyMachine) -> Completed:
        machine.files["/out/dump"] = b"state"
        return Completed(3, b"")

    def looks(machine: ToyMachine) -> Completed:
        machine.files["/logs/verifier/reward.txt"] = b"1" if machine.files.get("/out/dump") == b"state" else b"0"
        return DONE

    said = {"environment": Environment(Container()), "artifacts": ("/out",), "collect": (Collect(("dump",)),)}
    verdict = judged(tmp_path, dumps, looks, **said)
    assert verdict.passed
    assert verdict.info["collected"] == [{"command": "dump", "exit_code": 3}]


def test_untouched_machine_of_the_trial_is_made_ready_for_the_step(tmp_path: Path) -> None:
    CONTROLS.forget()
    made = task(tmp_path, verifier(tmp_path))
    step = replace(made.steps[0], setup=("prepare", "it"))
    backend = ToyBackend(SOLVED)
    machine = as_machine(ToyMachine(NOTHING))
    assert verify(machine, made, step, backend=as_backend(backend), limits=Limits()).blame == "agent"
    assert ("prepare", "it") in backend.started[0].commands
