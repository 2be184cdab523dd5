"""What runs inside the sandbox, as text that is sent there: the standard library alone, and nothing of GEM.

``solution`` runs the program under test and calls its functions with given arguments; ``checks`` runs tests, and the
program beside them in a process of its own. See ``gem_code.function_form``.
"""

from __future__ import annotations

import functools
from pathlib import Path

_HERE = Path(__file__).parent
_MAIN = {"solution": "answer_calls", "checks": "run_tests"}


@functools.cache
def program(name: str) -> str:
    """Return one of the programs, ``"solution"`` or ``"checks"``, as one text with the modules that it needs.

    Where it is sent there is no folder to import from; so the imports of each other are cut out.
    """
    modules = ("codec", "pipe", "solution", "names", "checks")
    wanted = modules[: modules.index(name) + 1]
    text = "".join((_HERE / f"{module}.py").read_text(encoding="utf-8") for module in wanted)
    future = "from __future__ import annotations\n"
    kept = [line for line in text.replace(future, "").splitlines() if not line.startswith("from gem_code.inside.")]
    return "\n".join([future, *kept, "", f"{_MAIN[name]}()", ""])
