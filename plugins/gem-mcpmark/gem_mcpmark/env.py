"""``PostgresEnv``: an agent works on a PostgreSQL database by MCP tools, and a script verifies it."""

from __future__ import annotations

import copy
import dataclasses
import json
import os
import shutil
import sys
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

from gem_core import Env, ToolEnv
from gem_core.data import chosen_index
from gem_core.errors import ArgumentError, GradingError, StateNotSupported
from gem_core.suggestions import did_you_mean
from gem_core.tools import CALL_CLOSE, CALL_OPEN, Tool
from gem_core.types import TERMINAL_STATE, Concurrency, ResetResult, StepResult
from gem_mcpmark.episode import EpisodeDatabase
from gem_mcpmark.tasks import Task, read_tasks
from gem_tools.mcp.tool import McpTool, make_mcp

_PROMPT = (
    "{description}\n\n"
    "You reach the PostgreSQL database only through your tools, which are connected to it. Nobody can answer "
    "questions. Once the work in the database is done, write a response without a tool call: it ends the task, and the "
    "database is then checked."
)
_OWN_SERVER = {"command": sys.executable, "args": ["-m", "gem_tools.mcp.sql_server"]}
_SERVE = ("-m", "gem_mcpmark.serve")
_NO_DATABASE = {"DATABASE_URI": "postgresql://nobody@127.0.0.1:1/none"}
_CONNECT_S = 60.0
_RANDOM_SQL = ("SELECT 1", "SELECT count(*) FROM pg_class", "CREATE TABLE made_at_random (id int)", "SELECT")


class PostgresEnv(ToolEnv):
    """An agent does a task in a PostgreSQL database, by the tools of an MCP server.

    Each episode has a database of its own, copied from one that is restored once, and the agent a role of its own that
    may do everything in this database and nothing elsewhere. A response without a tool call ends the episode: then
    ``verify.py`` of the task looks at the database, in a process and as a role of its own. The reward is 1.0 if it
    exits with 0, else 0.0; a verifier that cannot be run is ``info["error"]``. Afterwards the database is dropped, and
    with it the roles that the task made.

    The server is that of the environment variable ``GEM_MCPMARK_POSTGRES``, or a private one that is started from the
    system's programs when it is first needed, shared by all environments of the process, and stopped with it.

    ``reset(options={"task": name})`` or ``{"index": i}`` takes that task. The last info has ``verifier``, with the
    ``exit_code`` of ``verify.py`` and the end of its ``output``.

    Args:
        path: A task's folder as MCPMark has it, or one that holds such folders at any depth, as its
            ``tasks/postgres/easy``; ``"gem_mcpmark:sample"`` are the plugin's own tasks.
        tasks: Names of tasks, or patterns such as ``"chinook/*"``; None for all.
        databases: Folder of the databases' dumps, ``chinook.backup`` (of ``pg_dump``), ``chinook.sql`` or
            ``chinook.sql.gz``; None for the folder ``postgres_state`` beside or above the tasks, where MCPMark has
            them. Without a dump the named server's database ``chinook`` is copied, and else an empty one is filled by
            the task's ``prepare_environment.py``.
        mcp_server: Another MCP server to offer: its ``command``, ``args`` and ``env``. It finds the database by the
            variables ``DATABASE_URI`` and ``DATABASE_URL``, or ``POSTGRES_HOST``, ``…_PORT``, ``…_DATABASE``,
            ``…_USERNAME`` and ``…_PASSWORD``; ``{DATABASE_URI}`` in an argument stands for its value. None for our own,
            with the tools ``execute_sql``, ``list_schemas``, ``list_objects`` and ``get_object_details``.
        max_tool_uses: Tool calls in an episode; the response after the last one ends it.
        call_timeout_s: Seconds that a tool call may take.
        verify_timeout_s: Seconds that the verifier may take.

    Raises:
        TaskError: The folder has no task.
        ArgumentError: A name that no task has, or an argument of the wrong form.
        PostgresError: At a reset: the server or the task's data cannot be used, whatever the agent would have done.

    Source: MCPMark, arXiv:2509.24002.
    """

    hidden_in_spec = True  # it is the environment itself, and no wrapper that was put around one

    def __init__(
        self,
        path: str | Path,
        *,
        tasks: str | Sequence[str] | None = None,
        databases: str | Path | None = None,
        mcp_server: Mapping[str, Any] | None = None,
        max_tool_uses: int = 50,
        call_timeout_s: float = 60.0,
        verify_timeout_s: float = 300.0,
    ) -> None:
        task = PostgresTask(path, tasks, databases, _launcher(mcp_server), verify_timeout_s)
        try:
            super().__init__(task, task.make_tools(call_timeout_s), max_tool_uses=max_tool_uses)
        except BaseException:
            task.close()
            raise


class PostgresTask(Env):
    """The task inside a ``PostgresEnv``, which takes the agent's answer; see there."""

    concurrency: ClassVar[Concurrency] = "thread"
    num_tasks: int

    def __init__(
        self,
        path: str | Path,
        tasks: str | Sequence[str] | None,
        databases: str | Path | None,
        launcher: Mapping[str, Any],
        verify_timeout_s: float,
    ) -> None:
        super().__init__()
        if isinstance(verify_timeout_s, bool) or not isinstance(verify_timeout_s, int | float) or verify_timeout_s <= 0:
            raise ArgumentError(f"verify_timeout_s must be a number of seconds above 0, not {verify_timeout_s!r}")
        self.tasks = read_tasks(path, tasks)
        self.num_tasks = len(self.tasks)
        self._databases = databases
        self._launcher = launcher
        self._verify_timeout_s = verify_timeout_s
        self._episode: EpisodeDatabase | None = None
        self._index = 0
        self._folder = tempfile.mkdtemp(prefix="gem-mcpmark-")
        self._remove_folder = weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        self._launch_file = Path(self._folder) / "server.json"

    @property
    def task(self) -> Task:
        """The task of this episode."""
        return self.tasks[self._index]

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        raise StateNotSupported(
            "a living database cannot be copied; make another environment, reset it with the same seed and options, "
            "and repeat the actions"
        )

    def make_tools(self, call_timeout_s: float) -> list[Tool]:
        """Return the MCP server's tools, which start it on the database of the episode."""
        # The list of tools is asked for once a process, of a server that is the same for all environments.
        args = [*_SERVE, "-", json.dumps(self._launch(_NO_DATABASE))]
        tools = make_mcp(
            command=sys.executable,
            args=args,
            env=self._launcher["env"],
            server_name="postgres",
            connect_timeout_s=_CONNECT_S,
            call_timeout_s=call_timeout_s,
        )
        return [self._tied(tool) for tool in tools]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Make a database for a task; see ``PostgresEnv``."""
        super().reset(seed=seed)
        self._end_episode()
        self._index = self._chosen(options) if options else int(self.np_random.integers(self.num_tasks))
        self._episode = EpisodeDatabase(self.task, self._databases)
        self._write_launch_file(self._launch(self._episode.variables))
        return _PROMPT.format(description=self.task.description), self._info() | {"difficulty": self.task.difficulty}

    def step(self, action: str) -> StepResult:
        """Take the agent's answer: verify the database, and drop it."""
        episode, info = self._episode, self._info()
        if episode is None:
            raise ArgumentError("there is no episode: call reset() first")
        try:
            done = episode.verify(self._verify_timeout_s)
        except GradingError as error:
            info["error"] = {"kind": "grading", "message": str(error)}
            return TERMINAL_STATE, 0.0, False, True, info
        finally:
            self._end_episode()
        solved = done.exit_code == 0
        info |= {
            "correct": solved,
            "parsed_action": str(action),
            "verifier": {"exit_code": done.exit_code, "output": done.output},
        }
        return TERMINAL_STATE, float(solved), True, False, info

    def close(self) -> None:
        """Drop the database."""
        self._end_episode()
        self._remove_folder()
        super().close()

    def sample_random_action(self) -> str:
        """Return a tool call, with SQL that any database takes or refuses; once in a while, the end."""
        if self.action_random.random() < 0.2:
            return "Done."
        statement = _RANDOM_SQL[int(self.action_random.integers(len(_RANDOM_SQL)))]
        return f"{CALL_OPEN}{json.dumps({'name': 'execute_sql', 'arguments': {'sql': statement}})}{CALL_CLOSE}"

    def _end_episode(self) -> None:
        episode, self._episode = self._episode, None
        if episode is not None:
            episode.close()

    def _info(self) -> dict[str, Any]:
        return {"task_id": self.task.name, "index": self._index, "category": self.task.category}

    def _chosen(self, options: dict[str, Any]) -> int:
        if set(options) != {"task"}:
            return chosen_index(options, self.num_tasks)
        names = [task.name for task in self.tasks]
        if options["task"] not in names:
            hint = did_you_mean(str(options["task"]), names)
            raise ArgumentError(f"options['task']: there is no task {options['task']!r} among {len(names)}.{hint}")
        return names.index(options["task"])

    def _tied(self, tool: Tool) -> Tool:
        if not isinstance(tool, McpTool):
            return tool
        tied = copy.copy(tool)
        tied.server = dataclasses.replace(tool.server, args=(*_SERVE, str(self._launch_file)))
        return tied

    def _launch(self, variables: Mapping[str, str]) -> dict[str, Any]:
        """Return how ``gem_mcpmark.serve`` starts the MCP server on a database."""
        args = [word.replace("{DATABASE_URI}", variables["DATABASE_URI"]) for word in self._launcher["args"]]
        return {"command": self._launcher["command"], "args": args, "env": dict(variables)}

    def _write_launch_file(self, launch: Mapping[str, Any]) -> None:
        descriptor = os.open(self._launch_file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        with open(descriptor, "w", encoding="utf-8") as file:
            json.dump(launch, file)


def _launcher(mcp_server: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return how the MCP server is started.

    Raises:
        ArgumentError: It has the wrong form.
    """
    given = dict(_OWN_SERVER if mcp_server is None else mcp_server)
    launcher = {"command": given.pop("command", None), "args": given.pop("args", []), "env": given.pop("env", {})}
    words = [launcher["command"], *launcher["args"]] if isinstance(launcher["args"], list | tuple) else [None]
    named = isinstance(launcher["env"], Mapping) and all(isinstance(value, str) for value in launcher["env"].values())
    if given or not named or not all(isinstance(word, str) for word in words):
        raise ArgumentError(
            'mcp_server must look like {"command": "postgres-mcp", "args": ["--access-mode=unrestricted"], "env": {}}, '
            "a program to start with the variables that lead to the episode's database"
        )
    return launcher
