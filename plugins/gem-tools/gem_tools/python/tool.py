"""The tool ``python``: what an agent writes, runs, and reads of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import pydantic

from gem_core.errors import ArgumentError, GemError
from gem_core.tools import ToolResult
from gem_tools.configured import ConfiguredTool
from gem_tools.python.limits import Limits
from gem_tools.python.pool import Pool, Session, shared_pool
from gem_tools.python.starting import interpreter

if TYPE_CHECKING:
    from gem_tools.python.outcome import Outcome

TRACEBACKS = ("last_line", "full")

PACKAGES: tuple[str, ...] = ("numpy", "scipy", "sympy", "mpmath", "gmpy2", "pandas", "matplotlib", "sklearn")
PACKAGES += ("networkx", "statsmodels", "shapely", "z3", "ortools", "pulp", "cvxpy", "numba", "PIL", "cv2", "skimage")
PACKAGES += ("bs4", "lxml", "yaml")
"""Packages that the description names where they are installed, with those of ``preload``; by import name."""

_DESCRIPTION = (
    "Runs Python{version} code in a sandbox and shows what it prints, the value of its last expression, and its errors."
    "{packages} There is no network, no input, and nothing can be installed. {memory} A call may take {wall_s:g} s and "
    "{memory_mb} MB of memory."
)
_STATELESS = "Each call starts anew: write complete scripts, with their imports, and print what you want to see."
_PERSISTENT = "Variables, imports and files are kept from call to call."
_LOST = "The session has ended: its variables are lost, and the next call starts anew."
# What the built-in input() raises.
_NO_INPUT = "EOFError: EOF when reading a line"
_TOLD_NO_INPUT = "There is no input: nobody answers input(). Write the values into the code."


def make_python(
    *,
    sandbox: str = "auto",
    persistent: bool = False,
    timeout_s: float = 5.0,
    cpu_s: float | None = None,
    memory_mb: int = 512,
    max_processes: int = 32,
    max_open_files: int = 128,
    max_output_bytes: int = 10_000,
    max_file_mb: int = 64,
    max_folder_mb: int = 64,
    traceback: str = "last_line",
    preload: Sequence[str] = (),
    num_workers: int | None = None,
    image: str | None = None,
    name: str = "python",
    description: str | None = None,
    instructions: str | None = None,
) -> PythonTool:
    """Return a Python tool.

    Code finds the packages of the environment that GEM runs in, without GEM's plugins; on the level ``docker`` those of
    the image, which are the same on every machine. The agent is told which Python it is, and which of the well-known
    packages and of ``preload`` are there.

    Args:
        sandbox: ``"bubblewrap"``, ``"docker"`` or ``"process"``; ``"auto"`` for the first of these that works.
        persistent: Whether the calls of an episode share their variables, imports and files.
        timeout_s: Wall-clock limit of a call, in seconds.
        cpu_s: Limit of its processor time, in seconds; by default as ``timeout_s``.
        memory_mb: Limit of its memory, in megabytes beyond the interpreter's own.
        max_processes: Processes and threads at once.
        max_open_files: Open files of a process.
        max_output_bytes: What is shown of each stream; of more, the middle is left out.
        max_file_mb: Limit of one file, in megabytes.
        max_folder_mb: Limit of the private folder, in megabytes.
        traceback: ``"last_line"`` for an exception and the last line of the code that it passed, or ``"full"``.
        preload: Modules that are imported once, ahead of all calls, as in ``["numpy", "sympy"]``.
        num_workers: Calls that run at once; by default one for each processor, but two to eight.
        image: Image of the level ``docker``.
        name: What the agent calls it by, and its tag.
        description: What it is, in the instructions and the schema.
        instructions: The line that explains the tool to an agent, in place of the usual one.

    Raises:
        ArgumentError: An option that cannot be right.
    """
    options = dict(locals())
    limits = Limits(
        wall_s=timeout_s,
        cpu_s=cpu_s,
        memory_mb=memory_mb,
        processes=max_processes,
        open_files=max_open_files,
        output_bytes=max_output_bytes,
        file_mb=max_file_mb,
        folder_mb=max_folder_mb,
        value_chars=max_output_bytes,
    )
    if traceback not in TRACEBACKS:
        raise ArgumentError(f"traceback must be one of {', '.join(TRACEBACKS)}, not {traceback!r}")
    pool = shared_pool(sandbox, preload=tuple(preload), num_workers=num_workers, folder_mb=max_folder_mb, image=image)
    tool = PythonTool(pool, limits, persistent=persistent, traceback=traceback)
    tool.description = tool.described() if description is None else description
    return tool.configured(make_python, options)


class PythonTool(ConfiguredTool):
    """Runs an agent's code.

    ``info["tool"]`` holds ``sandbox`` (the level), ``status``, ``exit_code``, ``wall_s`` and ``cpu_s`` of a call; and
    ``fault``, where a sandbox failed and not the code.

    Args:
        pool: Where code runs.
        limits: Of each call.
        persistent: Whether the calls of an episode share their variables.
        traceback: ``"last_line"`` or ``"full"``.
    """

    name = "python"
    fences = ("python", "py", "python3")

    class Parameters(pydantic.BaseModel):
        """What is run."""

        code: str = pydantic.Field(description="the Python code to run")

    def __init__(self, pool: Pool, limits: Limits, *, persistent: bool = False, traceback: str = "last_line") -> None:
        self.pool, self.limits, self.persistent, self.traceback = pool, limits, persistent, traceback

    def described(self) -> str:
        """Return what the tool does, with the Python and the packages that code finds."""
        version = packages = ""
        python = interpreter(self.pool.sandbox, self.pool.options["image"])
        if python is not None:
            version = f" {python['python']}"
            wanted = [name.partition(".")[0] for name in (*PACKAGES, *self.pool.options["preload"])]
            found = [name for name in dict.fromkeys(wanted) if name in python["modules"]]
            packages = f" It has the standard library{' and ' if found else ' alone'}{', '.join(found)}."
        return _DESCRIPTION.format(
            version=version,
            packages=packages,
            memory=_PERSISTENT if self.persistent else _STATELESS,
            wall_s=self.limits.wall_s,
            memory_mb=self.limits.memory_mb,
        )

    async def call(self, arguments: Any, session: Any) -> ToolResult:
        """Run the code and show its output."""
        code = arguments.code
        if code.lstrip().startswith("```"):  # in a JSON or native call; elsewhere it is taken off already
            code = self.unfenced(code)
        if not code.strip():
            return ToolResult("There is no code to run.", failed=True)
        try:
            if isinstance(session, Session):
                outcome = await session.arun(code)
            else:
                outcome = await self.pool.arun(code, limits=self.limits, value=True)
        except GemError as fault:
            text = f"The sandbox failed: {fault}. This is no fault of your code."
            text += f" {_LOST}" if isinstance(session, Session) else ""
            info = {"sandbox": self.pool.level, "fault": str(fault)}
            return ToolResult(text, failed=True, info=info, fault=str(fault))
        return ToolResult(self.shown(outcome), failed=not outcome.ok, info=_told(outcome))

    def open(self) -> Session | None:
        """Return a session for an episode; nothing starts before its first call."""
        return self.pool.session(self.limits) if self.persistent else None

    async def close(self, session: Any) -> None:
        """End a session, its processes and its files."""
        if isinstance(session, Session):
            await session.aclose()

    def shown(self, outcome: Outcome) -> str:
        """Return what the agent reads of an outcome."""
        told = outcome.traceback if self.traceback == "full" else outcome.short_traceback
        parts = [outcome.stdout, outcome.stderr, outcome.value or "", told or outcome.error or ""]
        if _NO_INPUT in parts[-1]:
            parts.append(_TOLD_NO_INPUT)
        if told and outcome.status == "memory":
            parts.append(f"The limit of {self.limits.memory_mb} MB of memory was reached.")
        if outcome.session_lost and self.persistent:
            parts.append(_LOST)
        text = "".join(part if part.endswith("\n") else f"{part}\n" for part in parts if part)
        # What no chat template can encode is shown by its code.
        text = text.replace("\0", "\\x00").encode("utf-8", "backslashreplace").decode("utf-8")
        return text or "The code ran and printed nothing.\n"


def _told(outcome: Outcome) -> dict[str, Any]:
    told = {
        "sandbox": outcome.sandbox,
        "status": outcome.status,
        "exit_code": outcome.exit_code,
        "wall_s": round(outcome.wall_s, 6),
        "cpu_s": round(outcome.cpu_s, 6),
        "dropped_bytes": outcome.dropped_bytes,
    }
    return {**told, "session_lost": True} if outcome.session_lost else told
