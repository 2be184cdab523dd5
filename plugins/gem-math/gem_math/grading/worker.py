"""What the processes of the pool do for grading: compare two texts, with limits on what else they may do."""

from __future__ import annotations

import logging
import resource
import sys
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


def load() -> None:
    """Fill the caches of the grammar: the first formula of a kind takes a tenth of a second."""
    logging.disable(logging.CRITICAL)
    sys.setrecursionlimit(3000)
    sys.set_int_max_str_digits(20_000)
    for gold, answer in _TYPICAL:
        compare_texts(gold, answer, False, formulas)


def guard() -> None:
    """Let this process write no file and start no program from now on."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sys.addaudithook(_refuse)


def handle(request: dict[str, Any]) -> dict[str, Any]:
    """Compare ``gold`` with ``answer``; return the reward and a note."""
    reward, note = compare_texts(request["gold"], request["answer"], request["partial_credit"], formulas)
    return {"reward": reward, "note": note}


def _refuse(event: str, arguments: tuple[Any, ...]) -> None:
    """Stop what runs a program, reaches the network or writes a file."""
    writes = event == "open" and len(arguments) > 1 and set(str(arguments[1])) & set("wax+")
    if writes or event.startswith(_FORBIDDEN):
        raise PermissionError(f"a comparison of formulas has no business with {event}")
