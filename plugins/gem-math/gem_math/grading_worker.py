"""Compares formulas by math-verify, in a process of its own: run as ``python -m gem_math.grading_worker``.

It reads lines of JSON from its standard input, ``{"gold": …, "answer": …, "cpu_s": …}``, and writes one line with
the verdict for each. It ends with its input, or when it needs
more processor time than was granted, which the kernel sees to: the process of a caller that died ends by itself.
"""

from __future__ import annotations

import json
import math
import os
import sys
from typing import Any

MAX_MEMORY_BYTES = 2 << 30
_MAX_TEXT = 4000
# What no comparison does. Formulas are read by a grammar that runs no code; this is the second wall.
_FORBIDDEN = (
    "os.system", "os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.spawn", "os.startfile", "subprocess.",
    "socket.", "os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.chmod", "os.chown", "os.link", "os.symlink",
    "os.truncate", "shutil.", "ctypes.", "urllib.", "http.", "ftplib.", "smtplib.", "pty.", "os.putenv", "os.kill",
)  # fmt: skip


def main() -> None:
    """Serve until the input ends."""
    replies = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what a library prints must not pass for a reply
    _limit_resources()
    _warm_up()
    sys.addaudithook(_refuse)
    replies.write('"ready"\n')
    for line in sys.stdin:
        replies.write(json.dumps(_answer(json.loads(line))) + "\n")


def _answer(request: dict[str, Any]) -> dict[str, Any]:
    _grant(request["cpu_s"])
    gold_text, answer_text = str(request["gold"])[:_MAX_TEXT], str(request["answer"])[:_MAX_TEXT]
    try:
        real = _is_real(gold_text, answer_text)
        return {"same": _verified(_parsed(gold_text, real), _parsed(answer_text, real))}
    except Exception as error:  # noqa: BLE001  # sympy raises whatever; the caller is told
        return {"failed": f"{type(error).__name__}: {error}"[:300]}


def _is_real(gold_text: str, answer_text: str) -> bool:
    """Whether letters stand for real numbers; for both texts alike, since a real n and a complex n are two."""
    from math_verify.grader import should_treat_as_complex  # type: ignore[import-untyped]

    return not (should_treat_as_complex(gold_text) or should_treat_as_complex(answer_text))


def _parsed(text: str, real: bool) -> Any:
    # None of these packages has types.
    from latex2sympy2_extended import latex2sympy  # type: ignore[import-untyped]
    from latex2sympy2_extended.math_normalization import (  # type: ignore[import-untyped]
        NormalizationConfig,
        normalize_latex,
    )

    # Units and boxes are ours; taking away "units" would take letters from formulas.
    config = NormalizationConfig(
        basic_latex=True, units=False, malformed_operators=True, nits=False, boxed="none", equations=False
    )
    return latex2sympy(
        normalize_latex(text, config),
        is_real=real,
        convert_degrees=False,
        normalization_config=None,
    )


def _verified(gold: Any, answer: Any) -> bool:
    import sympy  # type: ignore[import-untyped]
    from math_verify import verify  # type: ignore[import-untyped]

    for value in (gold, answer):
        if isinstance(value, sympy.Basic) and value.has(sympy.nan, sympy.zoo):
            return False
    # The sum of the first n numbers is n(n+1)/2 once it is carried out, which math-verify does late, or not at all.
    unfinished = (sympy.Sum, sympy.Product, sympy.Integral, sympy.Limit, sympy.Derivative)
    pair = (gold, answer)
    if all(isinstance(one, sympy.Expr) for one in pair) and any(one.has(*unfinished) for one in pair):
        done = [one.doit() for one in pair]
        if not any(one.has(*unfinished, sympy.nan, sympy.zoo) for one in done):
            return bool(verify(*done, timeout_seconds=None, raise_on_error=True))
    return bool(verify(gold, answer, timeout_seconds=None, raise_on_error=True))


def _warm_up() -> None:
    """Load what the first comparison would have to, and fill the caches of the grammar."""
    import importlib
    import logging

    # sympy imports it when it first adds up a series, and it sets variables of the environment: refused by then.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    importlib.import_module("numpy")
    logging.disable(logging.CRITICAL)
    for gold, answer in (
        (r"\frac{1}{2}", "0.5"),
        (r"\sqrt{x^2+1}", r"(x+1)^{2}"),
        (r"\sum_{k=1}^{3} k", r"\sin(1)+\ln 2"),
    ):
        _verified(_parsed(gold, True), _parsed(answer, True))
    sys.setrecursionlimit(3000)
    if hasattr(sys, "set_int_max_str_digits"):
        sys.set_int_max_str_digits(20_000)


def _limit_resources() -> None:
    try:
        import resource
    except ImportError:  # not on Windows
        return
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _grant(cpu_s: float) -> None:
    """Let the kernel end this process when one comparison takes more processor time than this."""
    try:
        import resource
    except ImportError:
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    soft = math.ceil(used.ru_utime + used.ru_stime + cpu_s) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (soft, resource.RLIM_INFINITY))


def _refuse(event: str, arguments: tuple[Any, ...]) -> None:
    if event.startswith(_FORBIDDEN):
        raise PermissionError(f"a comparison of formulas has no business with {event}")
    if event == "open" and len(arguments) > 1 and isinstance(arguments[1], str) and set(arguments[1]) & set("wax+"):
        raise PermissionError("a comparison of formulas writes no file")


if __name__ == "__main__":
    main()
