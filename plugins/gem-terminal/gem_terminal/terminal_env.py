"""``TerminalEnv``: a task, a terminal in a machine of its own, and the tests that judge what the agent leaves there."""

from __future__ import annotations

import functools
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from gem_core.data import chosen_index
from gem_core.env import Env
from gem_core.errors import ArgumentError, ResetNeededError, StateNotSupported
from gem_core.suggestions import did_you_mean
from gem_core.types import Concurrency, ResetResult, StepResult
from gem_terminal import reporting
from gem_terminal.acting import how_to_act, tool_schemas
from gem_terminal.actions import Action, Bash, Finish, Keys, Malformed, read_action
from gem_terminal.backends.docker.backend import shared_backend
from gem_terminal.episode import Episode
from gem_terminal.errors import MachineError, MachineLostError
from gem_terminal.pool import Holdings, shared_pool
from gem_terminal.selecting import GivenVariables, select_tasks
from gem_terminal.settings import Settings
from gem_terminal.tasks.staging import SOLUTION_S, as_command
from gem_terminal.verifying.verdict import RewardRule, goes_on, reward_of

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Backend
    from gem_terminal.tasks.task import Task
    from gem_terminal.verifying.verify import Where

logger = logging.getLogger(__name__)

_HARMLESS = ("pwd", "ls -la", "id -un", "env | wc -l", "head -n 2 /etc/os-release", "date -u")


@functools.cache
def _warn(words: str) -> None:
    logger.warning("gem-terminal: %s", words)


EndedBy = Literal["finish", "turns", "agent_timeout", "episode_timeout", "malformed", "machine_lost"]


class TerminalEnv(Env):
    """Gives an agent a task and a terminal of a machine of its own; the tests of the task judge what it leaves.

    A task is a folder in the format of Terminal-Bench (``task.yaml``) or Harbor (``task.toml``). ``reset`` draws one,
    all equally likely; ``reset(options={"task": name})`` or ``{"index": i}`` takes that one.

    A response is a command in ``<bash>…</bash>`` or a fenced block, keys for a program in ``<keys>…</keys>``, the same
    as a tool call in any form that models write, or ``<finish/>``. The first complete one counts, and the agent is told
    how many more were ignored. The tests run after ``<finish/>``, at the end of the budget of turns, and when the
    agent's time is over.

    ``info`` says ``task_id``, ``index``, ``parsed_action``, ``terminal`` (``backend``, ``exit_code``,
    ``timed_out``, ``workdir`` and more), at reset ``tools``, after the tests ``verifier`` with each of them, and at the
    end ``correct``. What the agent can cause (a killed machine, a full memory, tests that hang because of it) is
    scored; a missing engine, an image that cannot be built, tests that give no verdict on an untouched machine either
    are ``info["error"]`` and truncate.

    Args:
        path: A task's folder, a folder of them, or a list of both; ``"package:data/tasks"`` names one that a package
            ships.
        tasks: Names of the tasks to use, or patterns such as ``"git-*"``; None for all.
        backend: ``"docker"`` for Docker or Podman, or an object with the interface of ``backends/interface.py``.
        reward: ``"all"``: 1 when the task is solved, else 0. ``"fraction"``: the part of the tests that passed.
            ``"weighted"``: the same by the tests' weights. ``"score"``: the number of the task's own reward file.
        weights: Weights of tests by name for ``"weighted"``; None for the task's.
        command_timeout_s: Seconds of a command that asks for no limit of its own.
        most_command_timeout_s: Seconds that a command may ask for.
        agent_timeout_s: Seconds of the agent for a step, its thinking included; ``"task"`` for the task's limit, None
            for that of the episode.
        episode_timeout_s: Seconds after which the machine is removed, whatever runs in it; None for what the task's
            limits add up to, and 2 minutes.
        max_turns: Responses of an episode; None for no limit.
        malformed_penalty: Reward of a response that holds no action.
        max_malformed: Such responses in a row that end the episode; None for no limit.
        max_output: Characters of a command's output that are shown; the middle is cut out.
        show_time: Whether observations say how much of the agent's time is left; the same actions then no longer give
            the same observations.
        columns: Width of the terminal.
        lines: Its height.
        cpus: Processors of the machine. None gives what the task asks for, up to what the computer has, and 1 where it
            does not ask; with a number, a task gets that many, or fewer where it asks for fewer. What a task does not
            get of this and the two below is told in ``info["terminal"]["shortfall"]`` at reset, and in a warning.
        memory_mb: Megabytes of memory, as ``cpus``; 2048 where the task does not ask.
        processes: Processes and threads at once.
        storage_mb: Megabytes written, as ``cpus``; 4096 where the task does not ask.
        network: ``"task"`` for what the task asks for, and none where it says nothing; ``"none"``; ``"public"``.
        verify_in: Where the tests run: ``"machine"`` is the agent's, as in Harbor and Terminal-Bench; ``"judge"`` a
            fresh one of the same task, to which only ``artifacts`` are carried, for training: agents learn to cheat.
        artifacts: Files and folders, by absolute paths, that are carried to a judge where the task names none itself;
            without any, the task's working directory.
        pool_size: Machines of each task that are kept ready; 0 for none.
        prestart: Whether to begin at once to make machines ready.
        build_args: Arguments for the build of images.
        variables: Environment variables that tasks take from their host: a mapping of names to values, or a list of
            ``"NAME=value"`` and of ``"NAME"`` for the value that this process has; no others are looked at.

    Raises:
        TaskError: There is no task there, or one that cannot be read.
        ArgumentError: A value that is not accepted.
        EngineError: No container engine answers; the message says how to start one.

    Source: the formats are those of Terminal-Bench, https://www.tbench.ai, and Harbor.
    """

    concurrency: ClassVar[Concurrency] = "thread"
    answer_fences: ClassVar[tuple[str, ...]] = ("bash", "sh", "shell")
    answer_tags: ClassVar[tuple[str, ...]] = ("bash", "keys", "finish")
    num_tasks: int

    def __init__(
        self,
        path: str | Path | Sequence[str | Path] | None = None,
        tasks: str | Sequence[str] | None = None,
        *,
        backend: str | Backend = "docker",
        reward: RewardRule = "all",
        weights: Mapping[str, float] | None = None,
        command_timeout_s: float = 60.0,
        most_command_timeout_s: float = 900.0,
        agent_timeout_s: float | Literal["task"] | None = "task",
        episode_timeout_s: float | None = None,
        max_turns: int | None = 50,
        malformed_penalty: float = -0.1,
        max_malformed: int | None = 5,
        max_output: int = 10_000,
        show_time: bool = False,
        columns: int = 120,
        lines: int = 40,
        cpus: float | None = None,
        memory_mb: int | None = None,
        processes: int = 1024,
        storage_mb: int | None = None,
        network: str = "task",
        verify_in: Where = "machine",
        artifacts: Sequence[str] = (),
        pool_size: int = 1,
        prestart: bool = False,
        build_args: Mapping[str, str] | None = None,
        variables: GivenVariables = None,
    ) -> None:
        super().__init__()
        self.settings = Settings(
            reward=reward,
            weights=weights,
            command_timeout_s=command_timeout_s,
            most_command_timeout_s=most_command_timeout_s,
            agent_timeout_s=agent_timeout_s,
            episode_timeout_s=episode_timeout_s,
            max_turns=max_turns,
            malformed_penalty=malformed_penalty,
            max_malformed=max_malformed,
            max_output=max_output,
            show_time=show_time,
            columns=columns,
            lines=lines,
            cpus=cpus,
            memory_mb=memory_mb,
            processes=processes,
            storage_mb=storage_mb,
            network=network,
            verify_in=verify_in,
            artifacts=(artifacts,) if isinstance(artifacts, str) else tuple(artifacts),
            pool_size=pool_size,
        )
        self.return_range = self.settings.return_range
        self.tasks = select_tasks(path, tasks, variables)
        self.num_tasks = len(self.tasks)
        if isinstance(backend, str) and backend != "docker":
            raise ArgumentError(f"backend must be 'docker' or an object that makes machines, not {backend!r}")
        self.backend: Backend = shared_backend(build_args) if isinstance(backend, str) else backend
        self._holdings = Holdings(self, shared_pool())
        self._episode: Episode | None = None
        self._index = 0
        if prestart:
            for task in self.tasks:
                self.backend.check(task)
                self._holdings.prestart(self.backend, task, self.settings.limits, max(1, pool_size))

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        raise StateNotSupported(
            "a running machine cannot be copied; make another environment, reset it with the same seed and options, "
            "and repeat the actions"
        )

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Begin a task on a machine that nothing has touched.

        Args:
            seed: See ``Env.reset``.
            options: ``{"task": name}`` or ``{"index": i}`` takes that task.

        Raises:
            ArgumentError: An option that does not exist.
            TaskError: The backend cannot run the task.
            MachineError: The machine could not be started, whatever the agent would have done.
        """
        super().reset(seed=seed)
        self._end_episode()
        self._index = self._chosen(options) if options else int(self.np_random.integers(self.num_tasks))
        task, settings = self.tasks[self._index], self.settings
        self.backend.check(task)
        machine = self._holdings.take(self.backend, task, settings.limits, settings.pool_size)
        holdings = self._holdings
        episode = self._episode = Episode(task, machine, self.backend, settings, lambda: holdings.give_back(machine))
        try:
            episode.begin_step()
        except BaseException:
            self._end_episode()
            raise
        instructions = {"text": self._how_to_act(episode), "native": self._how_to_act(episode, natively=True)}
        info = self._info(
            {
                "tools": tool_schemas(),
                "tool_instructions": instructions,
                "difficulty": task.difficulty,
                "category": task.category,
            }
        )
        feedback, suffix = reporting.first_words(task, 0, instructions["text"]), self._suffix(episode)
        info |= {"feedback": feedback, "suffix": suffix}
        info["terminal"]["shortfall"] = self._shortfall(task)
        return feedback + suffix, info

    def step(self, action: str) -> StepResult:
        """Do what the response says, and return what it showed."""
        episode = self._episode
        if episode is None:
            raise ResetNeededError("there is no episode: call reset() first")
        episode.turns += 1
        read = read_action(action)
        info = self._info({"parsed_action": None if isinstance(read, Malformed) else read.text})
        try:
            if episode.turns == 1:
                episode.check_machine()
            result = self._act(episode, read, info)
        except MachineError as error:
            result = self._without_machine(episode, error, info)
        if read.call_id is not None:
            info["messages"] = reporting.messages_of(read, str(result[0]))
        return result

    def close(self) -> None:
        """Remove the machine, and those that were made ready for this environment alone."""
        self._end_episode()
        self._holdings.release()
        super().close()

    def sample_random_action(self) -> str:
        """Return a command that changes nothing; once in a while, the end."""
        if self.action_random.random() < 0.2:
            return "<finish/>"
        return f"<bash>{_HARMLESS[int(self.action_random.integers(len(_HARMLESS)))]}</bash>"

    def gold_action(self) -> str | None:
        """Return a command that does what the reference solution of the step does, and then the end."""
        episode = self._episode
        if episode is None or episode.turns_of_step:
            return None if episode is None else "<finish/>"
        command = as_command(episode.step)
        return None if command is None else f'<bash timeout="{SOLUTION_S:g}">{command}</bash>'

    def _act(self, episode: Episode, action: Action, info: dict[str, Any]) -> StepResult:
        if episode.agent_left_s() <= 0:
            return self._step_over(episode, "agent_timeout", reporting.TOO_LATE, 0.0, info)
        ended: EndedBy | None = None
        reward = 0.0
        if isinstance(action, Malformed):
            episode.malformed += 1
            reward, feedback = self.settings.malformed_penalty, action.reason
            if episode.malformed == self.settings.max_malformed:
                ended = "malformed"
        else:
            episode.malformed = 0
            feedback = self._execute(episode, action, info)
            if isinstance(action, Finish):
                ended = "finish"
        if ended is None and episode.turns == self.settings.max_turns:
            ended = "turns"
        if ended is None and episode.agent_left_s() <= 0:
            ended = "agent_timeout"
        if ended is not None:
            return self._step_over(episode, ended, feedback, reward, info)
        return self._going_on(episode, feedback, reward, info)

    def _execute(self, episode: Episode, action: Action, info: dict[str, Any]) -> str:
        """Run a command or press keys; return what it showed, and how many further actions were ignored."""
        shown = ""
        if isinstance(action, Keys):
            screen = episode.press(action.keys, action.wait_s)
            info["terminal"] |= reporting.screen_info(screen)
            shown = screen.text()
        elif isinstance(action, Bash):
            result = episode.run(action.command, action.timeout_s)
            info["terminal"] |= reporting.command_info(result)
            shown = result.text()
        return "\n".join(filter(None, [shown, reporting.of_ignored(action.ignored)]))

    def _going_on(self, episode: Episode, feedback: str, reward: float, info: dict[str, Any]) -> StepResult:
        suffix = self._suffix(episode)
        info |= {"feedback": feedback, "suffix": suffix}
        return feedback + suffix, reward, False, False, info

    def _step_over(
        self, episode: Episode, by: EndedBy, feedback: str, reward: float, info: dict[str, Any]
    ) -> StepResult:
        """Run the tests; then comes the next step of the task, or the end."""
        info["terminal"]["ended_by"] = by
        if episode.is_overdue:
            return self._overdue(feedback, reward, info)
        verdict = episode.verify()
        info["verifier"] = reporting.verdict_info(verdict)
        if verdict.problem is not None and episode.is_overdue:
            return self._overdue(feedback, reward, info)
        if verdict.problem is not None and verdict.blame != "agent":
            return self._error("verifier", verdict.detail or "the tests gave no verdict", reward, info)
        reward += episode.note(verdict, reward_of(verdict, self.settings.reward, weights=self.settings.weights))
        feedback = "\n".join(filter(None, [feedback, reporting.of_verdict(verdict)]))
        if episode.is_last_step or by not in ("finish", "agent_timeout") or not goes_on(episode.step, verdict):
            return self._over(feedback, reward, episode.is_solved, info)
        episode.number += 1
        episode.begin_step()
        del info["terminal"]["ended_by"]
        info["terminal"]["next_step"] = episode.step.name
        feedback = f"{feedback}\n\n{reporting.first_words(episode.task, episode.number, self._how_to_act(episode))}"
        return self._going_on(episode, feedback, reward, info)

    def _without_machine(self, episode: Episode, error: MachineError, info: dict[str, Any]) -> StepResult:
        if episode.is_overdue:
            return self._overdue("", 0.0, info)
        lost = error if isinstance(error, MachineLostError) else episode.machine.why_lost()
        if lost is None or not lost.by_agent:
            kind = "machine" if isinstance(error, MachineLostError) else "engine"
            return self._error(kind, str(error), 0.0, info)
        info["terminal"] |= {"ended_by": "machine_lost", "lost": str(lost)}
        return self._over(f"The machine is lost: {lost}", 0.0, False, info)

    def _overdue(self, feedback: str, reward: float, info: dict[str, Any]) -> StepResult:
        info["terminal"]["ended_by"] = "episode_timeout"
        return self._over("\n".join(filter(None, [feedback, "The time of the episode is over."])), reward, False, info)

    def _over(self, feedback: str, reward: float, correct: bool, info: dict[str, Any]) -> StepResult:
        self._end_episode()
        info |= {"correct": correct, "feedback": feedback, "suffix": ""}
        return feedback, reward, True, False, info

    def _error(self, kind: str, message: str, reward: float, info: dict[str, Any]) -> StepResult:
        self._end_episode()
        info["error"] = {"kind": kind, "message": message}
        return "The episode was broken off: its machine or its tests have failed.", reward, False, True, info

    def _end_episode(self) -> None:
        episode, self._episode = self._episode, None
        if episode is not None:
            episode.end()

    def task_row(self, index: int) -> dict[str, Any]:
        """Return the name of a task as ``task_id``; see ``Env.task_row``."""
        return {"task_id": self.tasks[index].name}

    def _how_to_act(self, episode: Episode, *, natively: bool = False) -> str:
        return how_to_act(self.settings, episode.agent_limit_s(), self._turns_left(episode), natively=natively)

    def _shortfall(self, task: Task) -> list[str]:
        """Return what a task asks for and does not get, and warn of it once in a process."""
        found = self.settings.limits.shortfall(task, self.backend.resources())
        for words in found:
            _warn(f"{task.name}: {words}")
        return found

    def _turns_left(self, episode: Episode) -> int | None:
        return self.settings.max_turns and self.settings.max_turns - episode.turns

    def _suffix(self, episode: Episode) -> str:
        left_s = episode.agent_left_s() if self.settings.show_time else None
        return reporting.status(episode.workdir, self._turns_left(episode), left_s)

    def _info(self, more: dict[str, Any]) -> dict[str, Any]:
        episode = self._episode
        terminal: dict[str, Any] = {"backend": self.backend.name}
        if episode is not None and len(episode.task.steps) > 1:
            terminal["step"] = episode.step.name
        return {"task_id": self.tasks[self._index].name, "index": self._index, "terminal": terminal, **more}

    def _chosen(self, options: dict[str, Any]) -> int:
        wrong = [name for name in options if name not in ("task", "index")]
        if wrong or len(options) > 1:
            hint = did_you_mean(wrong[0], ["task", "index"]) if wrong else ""
            raise ArgumentError(f"options are {', '.join(options)}; expected one of task and index.{hint}")
        if "index" in options:
            return chosen_index(options, self.num_tasks)
        name, names = options["task"], [task.name for task in self.tasks]
        if name not in names:
            hint = did_you_mean(str(name), names)
            raise ArgumentError(f"options['task']: there is no task {name!r} among {len(names)}.{hint}")
        return names.index(name)
