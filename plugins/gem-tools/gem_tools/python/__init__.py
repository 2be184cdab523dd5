r"""Python for agents: a pool of warm sandboxes, and the tool ``python`` on top of it.

The pool is there for other plugins too::

    from gem_tools.python import Limits, shared_pool

    outcome = shared_pool().run("print(int(input()) + 1)", stdin="41", limits=Limits(wall_s=2))
    outcome.status, outcome.stdout  # ("ok", "42\n")
"""

from __future__ import annotations

from gem_core.errors import refuse_windows

refuse_windows("the tool 'python'")

from gem_tools.python.errors import SandboxError  # noqa: E402 - what follows needs what Windows lacks
from gem_tools.python.limits import Limits  # noqa: E402
from gem_tools.python.outcome import Outcome  # noqa: E402
from gem_tools.python.pool import Pool, Session, shared_pool  # noqa: E402
from gem_tools.python.tool import PythonTool, make_python  # noqa: E402

__all__ = ["Limits", "Outcome", "Pool", "PythonTool", "SandboxError", "Session", "make_python", "shared_pool"]
