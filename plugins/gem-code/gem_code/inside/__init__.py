"""What runs inside the sandbox, as text that is sent there: the standard library alone, and nothing of GEM.

``solution`` runs the program under test and calls its functions; ``checks`` runs the tests. The two never share a
process: see ``gem_code.function_form``.
"""

from __future__ import annotations

import functools
from pathlib import Path

_HERE = Path(__file__).parent


@functools.cache
def program(name: str) -> str:
    """Return one of the programs, ``"solution"`` or ``"checks"``, as one text with the codec in front.

    Where it is sent there is no folder to import from; so the import of the codec is cut out.
    """
    codec, main = (path.read_text(encoding="utf-8") for path in (_HERE / "codec.py", _HERE / f"{name}.py"))
    future = "from __future__ import annotations\n"
    kept = [line for line in main.replace(future, "").splitlines() if not line.startswith("from gem_code.inside.codec")]
    return codec + "\n".join(kept) + "\n\nmain()\n"
