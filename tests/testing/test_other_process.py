"""The other process is one, is kept apart from this one, and is replaced when it hangs or dies."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from broken_envs import ChattyEnv, OtherProcessEnv, PidEnv
from reference_envs import CountingWrapper, GoodEnv

from gem_core.testing import ContractError, check_env
from gem_core.testing.conformance import promises_for

OF_ONE = {promise.slug for promise in promises_for(several=False)}


def other_pids(file: Path) -> list[int]:
    """Return the processes besides this one in which a ``PidEnv`` was made, in order."""
    return [int(pid) for pid in dict.fromkeys(file.read_text().split()) if int(pid) != os.getpid()]


def test_one_process_serves_many_checks_and_a_killed_one_is_replaced(tmp_path: Path) -> None:
    pids = tmp_path / "pids"
    check_env(PidEnv(str(pids)))
    check_env(CountingWrapper(PidEnv(str(pids))))
    (first,) = other_pids(pids)
    os.kill(first, signal.SIGKILL)
    os.waitid(os.P_PID, first, os.WEXITED | os.WNOWAIT)
    assert set(check_env(PidEnv(str(pids))).kept) == OF_ONE
    assert len(other_pids(pids)) == 2


def test_prints_do_not_disturb_it() -> None:
    """An environment that prints to standard output, with or without Python's streams, keeps its promises."""
    report = check_env(ChattyEnv, skip={"hostile-actions": "240 lines are enough"})
    assert "process-determinism" in report.kept


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("deed", "seen"),
    [
        ("die", "the process ended with exit code 3"),
        ("leave", "it raised SystemExit: 4"),
        ("hang", "it gave no answer within 2 s"),
    ],
)
def test_what_goes_wrong_there_breaks_the_promise(deed: str, seen: str) -> None:
    """And not the check, nor the next one."""
    with pytest.raises(ContractError) as caught:
        check_env(OtherProcessEnv(os.getpid(), deed), step_timeout_s=2.0)
    broken = caught.value.report.broken
    assert set(broken) - {"hostile-actions"} == {"process-determinism", "state-process"}
    assert seen in broken["process-determinism"]
    assert set(check_env(GoodEnv).kept) == OF_ONE


MODULE = """
from reference_envs import GoodEnv

class MineEnv(GoodEnv):
    def hint(self, guess):
        return f"{super().hint(guess)} {HINT}"
"""
SCRIPT = f"{MODULE}\nfrom gem_core.testing import check_env\nprint(check_env(MineEnv))"


def run_script(hint: str, **variables: str) -> str:
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT.replace("HINT", hint)],
        env={**os.environ, "PYTHONPATH": path, **variables},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout + done.stderr


def test_a_class_of_a_script_is_tried_there_too() -> None:
    """It needs no ``if __name__ == "__main__"``."""
    assert run_script("'Mine.'") == f"MineEnv keeps all {len(OF_ONE)} promises that were tried\n"


def test_strings_hash_differently_there() -> None:
    """Also where this process has a fixed hash seed."""
    assert "  process-determinism: " in run_script("hash('number')", PYTHONHASHSEED="1")


class EnvOfATest(GoodEnv):
    """In a module that only pytest can import by its name, with ``--import-mode=importlib``."""


def test_classes_that_cannot_be_imported_there_are_sent_by_value() -> None:
    """Those of a function, and of a test module."""

    class LocalEnv(GoodEnv):
        pass

    for env in (LocalEnv, EnvOfATest):
        assert set(check_env(env).kept) == OF_ONE


def test_modules_of_one_name_are_not_confused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The process that has imported the first is replaced when the path has changed."""
    for hint in ("One.", "Two."):
        folder = tmp_path / hint
        folder.mkdir()
        (folder / "gem_mine_env.py").write_text(MODULE.replace("HINT", repr(hint)))
        monkeypatch.syspath_prepend(folder)
        monkeypatch.delitem(sys.modules, "gem_mine_env", raising=False)
        assert set(check_env(importlib.import_module("gem_mine_env").MineEnv).kept) == OF_ONE


def test_arguments_that_cannot_be_pickled_are_a_reason_to_skip() -> None:
    report = check_env(OtherProcessEnv(os.getpid(), threading.Lock()))  # type: ignore[arg-type]
    assert set(report.skipped) == {"process-determinism", "state-process"}
    assert report.skipped["state-process"] == (
        "its arguments cannot be handed to another process: TypeError: cannot pickle '_thread.lock' object"
    )


def test_it_ends_with_its_parent() -> None:
    """A parent that is killed leaves no process behind: what holds standard output open has ended."""
    code = (
        "import os, signal; from gem_core.testing.interpreter import Interpreter\n"
        "interpreter = Interpreter(stdout=1); os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, timeout=60, check=False)
    assert done.returncode == -signal.SIGKILL
