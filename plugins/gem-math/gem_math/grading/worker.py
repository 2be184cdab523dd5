"""What the processes of the pool do for grading: compare two texts, with limits on what else they may do."""

from __future__ import annotations

import logging
import resource
import sys
from collections.abc import Callable
from typing import Any

from gem_math.grading import formulas
from gem_math.grading.readings import compare_texts

_TYPICAL = [
    (r"\frac{1}{2}", r"\sqrt{x^2+1}"),
    (r"2\sqrt{3}-\frac{\pi}{4}", r"(x_{1}+1)^{2}(x-3)"),
    (r"\sum_{k=1}^{3} k", r"\sin(1)+\ln 2"),
    (r"e^{-x}", r"\log_{2}(x)!"),
    ("2x<4", r"(-\infty,2)"),
]
# What no comparison does. Formulas are read by a grammar that runs no code; this is the second wall.
_FORBIDDEN = (
    "os.system", "os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.spawn", "os.startfile", "subprocess.",
    "socket.", "os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.chmod", "os.chown", "os.link", "os.symlink",
    "os.truncate", "shutil.", "ctypes.", "urllib.", "http.", "ftplib.", "smtplib.", "pty.", "os.putenv", "os.kill",
)  # fmt: skip


def load() -> Callable[[dict[str, Any]], dict[str, Any]]:
    """Return what answers requests: ``{"gold": …, "answer": …, "partial_credit": …}`` with a reward and a note."""
    logging.disable(logging.CRITICAL)
    sys.setrecursionlimit(3000)
    sys.set_int_max_str_digits(20_000)
    # The grammar fills its caches as it reads: the first formula of a kind takes a tenth of a second.
    for gold, answer in _TYPICAL:
        compare_texts(gold, answer, False, formulas)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    return _Handler()


class _Handler:
    """Answers requests, guarded from the first one on, which the child alone takes: its parent has to fork."""

    def __init__(self) -> None:
        self.guarded = False

    def __call__(self, request: dict[str, Any]) -> dict[str, Any]:
        if not self.guarded:
            sys.addaudithook(refuse)
            self.guarded = True
        reward, note = compare_texts(request["gold"], request["answer"], request["partial_credit"], formulas)
        return {"reward": reward, "note": note}


def refuse(event: str, arguments: tuple[Any, ...]) -> None:
    """Stop what runs a program, reaches the network or writes a file.

    Raises:
        PermissionError: It would.
    """
    if event.startswith(_FORBIDDEN):
        raise PermissionError(f"a comparison of formulas has no business with {event}")
    if event == "open" and len(arguments) > 1 and isinstance(arguments[1], str) and set(arguments[1]) & set("wax+"):
        raise PermissionError("a comparison of formulas writes no file")
