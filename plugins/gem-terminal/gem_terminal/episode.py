"""``Episode``: one machine, the agent's shell in it, the clocks that run, and the verdicts of its steps."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from gem_terminal.errors import MachineError, MachineLostError, TaskError
from gem_terminal.shell import CommandResult, ScreenResult, Shell
from gem_terminal.tasks.staging import stage, wait_until_healthy
from gem_terminal.verifying.verdict import reward_of_steps
from gem_terminal.verifying.verify import run_in_shell, verify

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Backend, Completed, Machine
    from gem_terminal.settings import Settings
    from gem_terminal.tasks.task import Step, Task
    from gem_terminal.verifying.verdict import Verdict

_LEAST_S = 0.5
_KEYS_S = 1.0
"""Seconds for a screen to become quiet, unless the agent asks for others."""
_UNLIMITED_AGENT_S = 3600.0
"""What a step counts for in the time limit of an episode where its agent has none."""
_AROUND_S = 120.0
"""Seconds of an episode for all that is neither the agent's nor the tests'."""


class Episode:
    """What runs between a reset and the end.

    Its limits nest: a command's ends before the agent's for the step, and that before the episode's, at which the
    machine is removed whatever runs in it.

    Args:
        task: The task.
        machine: The machine, which nothing has touched.
        backend: Where it comes from.
        settings: How it runs.
        remove: Removes the machine.
    """

    def __init__(
        self, task: Task, machine: Machine, backend: Backend, settings: Settings, remove: Callable[[], object]
    ) -> None:
        self.task, self.machine, self.backend, self.settings = task, machine, backend, settings
        self.number = 0
        self.turns = 0
        self.malformed = 0
        self._turns_before_step = 0
        self._rewards: list[float] = []
        self._passed: list[bool] = []
        self._remove = remove
        self._shell: Shell | None = None
        self._earlier: list[Shell] = []
        self._artifacts: tuple[str, ...] = ()
        began = self._step_began = time.monotonic()
        self.limit_s = settings.episode_timeout_s or _limit_of(task, settings)
        # The limits inside end a little before, so that their end can still be told.
        self._inner_end = began + self.limit_s - min(5.0, self.limit_s / 20)
        self._deadline = threading.Timer(min(self.limit_s, threading.TIMEOUT_MAX), remove)
        self._deadline.daemon = True
        self._deadline.start()

    @property
    def step(self) -> Step:
        """The step that the agent is at."""
        return self.task.steps[self.number]

    @property
    def turns_of_step(self) -> int:
        """Responses since the step began."""
        return self.turns - self._turns_before_step

    @property
    def is_last_step(self) -> bool:
        """Whether none comes after it."""
        return self.number + 1 == len(self.task.steps)

    @property
    def workdir(self) -> str:
        """Where the agent's shell is; empty where that is not known."""
        return "" if self._shell is None else self._shell.workdir

    def begin_step(self) -> None:
        """Make the machine ready for the step, and open the agent's shell.

        Raises:
            TaskError: A judge is asked for, and there is no folder to carry to it.
            MachineError: The machine is not ready.
        """
        stage(self.machine, self.step)
        if (check := self.step.healthcheck) is not None:
            # What the agent did in the steps before may be why it fails, and may not.
            what = f"the task {self.task.name}, before its step {self.step.name!r},"
            run = partial(self.machine.run, check.command, timeout_s=check.timeout_s)
            wait_until_healthy(check, run, what, by_agent=None, until=self._inner_end)
        self._step_began = time.monotonic()
        self._turns_before_step = self.turns
        self._open_shell()
        if self.number == 0:
            self._artifacts = self.settings.artifacts or (self.workdir,)
        if self.settings.verify_in == "judge" and not self.step.verifier.artifacts and self._artifacts[0] in ("", "/"):
            where = self._artifacts[0] or "no known folder"
            raise TaskError(
                f"the task {self.task.name} works in {where}, which cannot be carried to a judge. Name what "
                "its tests look at with artifacts=[…], or use verify_in='machine'."
            )

    def check_machine(self) -> None:
        """Check that the machine is there before the agent's first action: until then its end is not the agent's doing.

        Raises:
            MachineLostError: It is gone, as where the command of its image ended by itself.
        """
        lost = self.machine.why_lost()
        if lost is not None:
            raise MachineLostError(f"{lost}, before the agent did anything", by_agent=False)

    def run(self, command: str, timeout_s: float | None) -> CommandResult:
        """Run a command in the agent's shell.

        Args:
            command: The command.
            timeout_s: Seconds that it asks for; None where it does not. It gets no more than the agent has left.

        Raises:
            MachineError: The machine is gone, or its engine does not answer.
        """
        return self._open_shell().run(command, self._command_limit_s(timeout_s))

    def press(self, keys: str, wait_s: float | None) -> ScreenResult:
        """Type keys, and read the screen.

        Raises:
            MachineError: The machine is gone, or its engine does not answer.
        """
        return self._open_shell().press(keys, self._command_limit_s(_KEYS_S if wait_s is None else wait_s))

    def verify(self) -> Verdict:
        """Run the tests of the step; those of the last step end the agent's shell.

        The shell stays open while they run, as the terminal of an agent does in Harbor and Terminal-Bench: a hang-up
        would end the jobs that it has in the background.

        Raises:
            MachineError: No verdict can be had, whatever the agent did.
        """
        step, limit, settings = self.step, self.step.verifier.timeout_s, self.settings
        left, task = self._inner_end - time.monotonic(), self.task
        if limit > left:
            step = replace(step, verifier=replace(step.verifier, timeout_s=max(_LEAST_S, left)))
            task = replace(task, steps=(*task.steps[: self.number], step, *task.steps[self.number + 1 :]))
        try:
            return verify(
                self.machine,
                task,
                step,
                backend=self.backend,
                limits=settings.limits,
                where=settings.verify_in,
                artifacts=self._artifacts,
                # A lack of time that is the episode's needs no trial of the tests.
                control=limit <= left,
                same_shell=self._run_tests,
            )
        finally:
            if self.is_last_step:
                self.close_shell()
            elif self._shell is not None:
                # What the agent left running in it goes on in the next step, which has a shell of its own.
                self._earlier.append(self._shell)
                self._shell = None

    def note(self, verdict: Verdict, reward: float) -> float:
        """Note the verdict and reward of the step; return what that adds to the reward of the whole task."""
        before = reward_of_steps(self.task, self._rewards)
        self._rewards.append(reward)
        self._passed.append(verdict.passed)
        return reward_of_steps(self.task, self._rewards) - before

    @property
    def is_solved(self) -> bool:
        """Whether the task is solved: all of its steps, or the last one where that alone counts."""
        if len(self._passed) < len(self.task.steps):
            return False
        return self._passed[-1] if self.task.reward_of_steps == "final" else all(self._passed)

    def agent_left_s(self) -> float:
        """Return the seconds that the agent has left for this step; below 0 when its time is over."""
        now = time.monotonic()
        limit = _agent_limit_s(self.step, self.settings)
        of_step = float("inf") if limit is None else self._step_began + limit - now
        return min(of_step, self._inner_end - now)

    def agent_limit_s(self) -> float:
        """Return the seconds that the agent has for this step."""
        return min(_agent_limit_s(self.step, self.settings) or self.limit_s, self.limit_s)

    @property
    def is_overdue(self) -> bool:
        """Whether the time of the whole episode is over."""
        return time.monotonic() >= self._inner_end

    def close_shell(self) -> None:
        """End the agent's shell, and those of earlier steps."""
        shells = [*self._earlier, *filter(None, [self._shell])]
        self._shell, self._earlier = None, []
        for shell in shells:
            with contextlib.suppress(MachineError):  # the machine is gone already
                shell.close()

    def end(self) -> None:
        """Remove the machine."""
        self._deadline.cancel()
        try:
            self.close_shell()
        finally:
            self._remove()

    def _command_limit_s(self, wanted_s: float | None) -> float:
        settings = self.settings
        asked = settings.command_timeout_s if wanted_s is None else wanted_s
        return max(_LEAST_S, min(asked, settings.longest_command_s, self.agent_left_s()))

    def _open_shell(self) -> Shell:
        if self._shell is None:
            settings, main = self.settings, self.task.environment.main
            self._shell = Shell(
                self.machine,
                user=self.step.agent_user or main.user,
                workdir=main.workdir,
                columns=settings.columns,
                lines=settings.lines,
                most_output=settings.max_output,
                again=bool(self._earlier),
            )
            self._shell.open()
        return self._shell

    def _run_tests(self, command: Sequence[str], timeout_s: float) -> Completed:
        """Run the tests in the agent's own shell."""
        return run_in_shell(self.machine, self._open_shell(), command, timeout_s)


def _agent_limit_s(step: Step, settings: Settings) -> float | None:
    limit = settings.agent_timeout_s
    return step.agent_timeout_s if limit == "task" else limit


def _limit_of(task: Task, settings: Settings) -> float:
    """Return what an episode may take where nobody has said it: what its steps may, and something for the rest."""
    agents = [_agent_limit_s(step, settings) for step in task.steps]
    agent_s = sum(_UNLIMITED_AGENT_S if limit is None else limit for limit in agents)
    return agent_s + sum(step.verifier.timeout_s for step in task.steps) + _AROUND_S
