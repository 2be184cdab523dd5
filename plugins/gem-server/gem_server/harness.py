"""``Harness``: a program that owns its loop plays a task; each time it asks the model is a turn of the episode."""

from __future__ import annotations

import asyncio
import os
import shlex
import shutil
import signal
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Self, cast

from gem_core import Observation, Response
from gem_core.background import in_thread, on_library_loop, run_or_schedule, run_sync
from gem_core.env import AnyEnv, Messages, Wrapper, reset_async, step_async, texts_of
from gem_core.errors import ArgumentError, EnvFaultError, StateNotSupported
from gem_core.types import TERMINAL_STATE, ResetResult, StepResult
from gem_server.endpoint import Endpoint, Pending, Session, SessionEndedError
from gem_server.recipes import RECIPES, VARIABLES

if TYPE_CHECKING:
    from gem_server.asked import Asked

_MOST_OUTPUT = 256 << 10
"""Bytes of a program's output that are kept, from its end."""

_ENDED, _OVER = "ended", "was told that the episode is over"
"""Why there is no next request, as part of a sentence."""

_endpoint = Endpoint()


class Harness(Wrapper):
    """A program that asks a model plays the task.

    The agent of the episode is the model behind it: the observation of a turn is what the program asks, as a list of
    messages, and the response is the reply that it gets. So every agent, limit, price and trainer of GEM works with
    every program. The rewards of a turn are those of what the program did before it asked again; the program's end is
    the end of the episode.

    The program is told the task by ``{instruction}`` in its command, by the variable ``GEM_INSTRUCTION`` and on its
    standard input. It finds the model at ``OPENAI_BASE_URL`` and ``ANTHROPIC_BASE_URL`` with the key in
    ``OPENAI_API_KEY`` and ``ANTHROPIC_API_KEY``, which is good for this episode alone. It acts in the task by
    ``POST GEM_ACT_URL`` with ``{"action": text}`` and the same key; or, if it never does, by what it prints: its output
    is then the only action.

    It runs as a process of this machine, in an empty folder that is also its home. That is no sandbox: it can read what
    you can read.

    Args:
        env: The task.
        command: The program and its arguments, as a list or as one text that is split like a shell's; or the name of
            one in ``gem_server.recipes``: ``"codex"``, ``"claude-code"``, ``"mini-swe-agent"``.
        variables: More environment variables.
        timeout_s: Seconds until the program is killed; the episode is then cut off.

    Raises:
        ArgumentError: The command is empty.
    """

    needs = "async"

    def __init__(
        self,
        env: AnyEnv,
        command: str | Sequence[str],
        *,
        variables: Mapping[str, str] | None = None,
        timeout_s: float = 1800.0,
    ) -> None:
        super().__init__(env)
        name = command if isinstance(command, str) else ""
        self.command = RECIPES.get(name) or (shlex.split(command) if isinstance(command, str) else list(command))
        if not self.command:
            raise ArgumentError("command must name a program, as in 'python my_agent.py'")
        self.variables, self.timeout_s = {**VARIABLES.get(name, {}), **(variables or {})}, timeout_s
        self.observation_space = Messages()
        self._session: Session | None = None
        self._process: asyncio.subprocess.Process | None = None
        self._folder: str | None = None
        self._tail = bytearray()
        """The end of the program's output."""
        self._exit_code: int | None = None
        self._results: list[StepResult] = []
        """What the task returned in this turn."""
        self._failure: Exception | None = None
        """What the task raised."""
        self._acted, self._over = False, False
        self._segment = 0
        self._before: list[dict[str, Any]] = []
        """The messages of the request before."""
        self._acting = asyncio.Lock()

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        raise StateNotSupported(f"{self.command[0]} is a running program, which cannot be copied")

    # The episode.

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Start the program, and return what it asks first."""
        return run_sync(self.reset_async(seed, options))

    def step(self, action: str) -> StepResult:
        """Reply to the program, and return what it asks next."""
        return run_sync(self.step_async(action))

    async def reset_async(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """``reset`` for code that runs in an event loop.

        Raises:
            EnvFaultError: The program ended, or vanished, before it asked the model.
        """
        await on_library_loop(self._stop("another episode has begun"))
        observation, info = await reset_async(self.env, seed, options)
        return await on_library_loop(self._begin(observation, info))

    async def step_async(self, action: str) -> StepResult:
        """``step`` for code that runs in an event loop."""
        return await on_library_loop(self._reply(Response.of(action)))

    async def _begin(self, observation: Observation, info: dict[str, Any]) -> ResetResult:
        self._tail, self._exit_code, self._results, self._failure = bytearray(), None, [], None
        self._acted, self._over, self._segment, self._before = False, False, 0, []
        session = await _endpoint.open(self._act)
        self._session = session
        await self._start("\n".join(texts_of(observation)), session)
        first = await self._next(session)
        if isinstance(first, str):
            tail = self._tail[-500:].decode("utf-8", "replace").replace(session.key, "[key]").strip()
            code = "" if self._exit_code is None else f" with exit code {self._exit_code}"
            raise EnvFaultError(f"{self.command[0]} {first}{code} before it asked the model: {tail or 'no output'}")
        self._pending = first
        return first.asked.messages, {**info, "view": "harness", "tools": first.asked.tools, **self._note(first.asked)}

    async def _reply(self, response: Response) -> StepResult:
        session = cast("Session", self._session)
        if not self._pending.reply.done():
            self._pending.reply.set_result(response)
        next_one = await self._next(session)
        if isinstance(next_one, Pending):
            self._pending = next_one
            results, self._results = self._results, []
            info = results[-1][4] if results else {}
            return next_one.asked.messages, _reward(results), False, False, {**info, **self._note(next_one.asked)}

        # The end: of the task, or of the program. One that never acted has answered by what it printed.
        if next_one == _ENDED and not self._acted:
            with suppress(SessionEndedError):
                await self._act(self._tail.decode("utf-8", "replace").strip())
        told: dict[str, Any] = {} if self._exit_code is None else {"exit_code": self._exit_code}
        await self._stop("the episode is over")
        if self._failure is not None:
            raise self._failure
        nothing: StepResult = (TERMINAL_STATE, 0.0, False, False, {})
        observation, _, terminated, truncated, info = self._results[-1] if self._results else nothing
        reward = _reward(self._results)
        if terminated or truncated:
            return observation, reward, terminated, truncated, {**info, **({"harness": told} if told else {})}
        told["cut_off"] = f"the program {next_one}"
        return TERMINAL_STATE, reward, False, True, {**info, "cut_off": "harness", "harness": told}

    async def _act(self, action: str) -> dict[str, Any]:
        """Hand an action to the task; return what the program is told."""
        async with self._acting:
            if self._over:
                raise SessionEndedError("the episode is over")
            self._acted = True
            try:
                result = await step_async(self.env, action)
            except Exception as error:
                self._failure, self._over = error, True
                session = cast("Session", self._session)
                session.requests.put_nowait(_OVER)
                raise SessionEndedError("the environment failed, and the episode is over") from error
            self._results.append(result)
            observation, _, terminated, truncated, _ = result
            self._over = bool(terminated or truncated)
            if self._over and self._session is not None:
                self._session.requests.put_nowait(_OVER)
            return {"observation": "\n".join(texts_of(observation)), "over": self._over}

    def _note(self, asked: Asked) -> dict[str, Any]:
        """Return what the record says of a request besides its messages."""
        if asked.messages[: len(self._before)] != self._before:
            self._segment += 1  # the program shortened what it shows the model, or began anew
        self._before = asked.messages
        return {"request": {"model": asked.model, "sampling": asked.sampling, "segment": self._segment}}

    # The program.

    async def _start(self, instruction: str, session: Session) -> None:
        self._folder = await in_thread(tempfile.mkdtemp, None, "gem-harness-")
        address = _endpoint.address
        variables = {
            **{name: os.environ[name] for name in ("PATH", "LANG", "LC_ALL", "TZ") if name in os.environ},
            "HOME": self._folder,
            "OPENAI_BASE_URL": f"{address}/v1",
            "OPENAI_API_BASE": f"{address}/v1",
            "OPENAI_API_KEY": session.key,
            "ANTHROPIC_BASE_URL": address,
            "ANTHROPIC_API_KEY": session.key,
            "GEM_ACT_URL": f"{address}/act",
            "GEM_INSTRUCTION": instruction,
            **self.variables,
        }
        command = [part.replace("{instruction}", instruction).replace("{base_url}", address) for part in self.command]
        try:
            self._process = process = await asyncio.create_subprocess_exec(
                *command,
                cwd=self._folder,
                env=variables,
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT,
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            raise EnvFaultError(f"{self.command[0]} cannot be started: {error}") from error
        self._deadline = asyncio.get_running_loop().time() + self.timeout_s
        self._reading = asyncio.create_task(self._read(process, instruction, session))

    async def _read(self, process: asyncio.subprocess.Process, instruction: str, session: Session) -> None:
        """Keep the end of the program's output, and tell of its end."""
        given, output = cast("asyncio.StreamWriter", process.stdin), cast("asyncio.StreamReader", process.stdout)
        with suppress(OSError):
            given.write(instruction.encode("utf-8", "replace") + b"\n")
            given.close()
        while chunk := await output.read(1 << 16):
            self._tail = (self._tail + chunk)[-_MOST_OUTPUT:]
        self._exit_code = await process.wait()
        session.requests.put_nowait(_ENDED)

    async def _next(self, session: Session) -> Pending | str:
        """Return the next request that waits; or why there is none."""
        try:
            async with asyncio.timeout_at(self._deadline):
                while True:
                    found = await session.requests.get()
                    if self._over or isinstance(found, str):
                        return _OVER if self._over else found
                    if not found.reply.done():  # its client may have gone
                        return found
        except TimeoutError:
            return f"took longer than {self.timeout_s:g} s"

    async def _stop(self, why: str) -> None:
        """End the session, and kill the program with all that it started."""
        session, self._session = self._session, None
        process, self._process = self._process, None
        folder, self._folder = self._folder, None
        if session is not None:
            _endpoint.close(session, why)
        if process is not None:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            await process.wait()
            self._reading.cancel()
        if folder is not None:
            await in_thread(shutil.rmtree, folder, True)

    def close(self) -> None:
        """Kill the program, and close the task."""
        run_or_schedule(self._stop("the environment was closed"))
        super().close()


def _reward(results: Sequence[StepResult]) -> float:
    return float(sum(result[1] for result in results))
