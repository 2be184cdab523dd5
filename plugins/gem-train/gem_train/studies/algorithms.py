"""The study of algorithms: REINFORCE, ReBN, PPO and GRPO on seven small tasks, the benchmark of the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

from gem_train.learner.imitation import record_episodes
from gem_train.learner.options import Algorithm, TrainOptions
from gem_train.learner.training import Training, describe
from gem_train.reporting import curves_with_bands, write_study_page
from gem_train.studies import rewards
from gem_train.studies.jobs import Job, run_jobs
from gem_train.studies.measured import Run, evaluated, last_interval, measured_curve

TEXT = """\
Four algorithms learn seven tasks, each from the same warm start, for the same number of updates and episodes:

REINFORCE takes returns as they are; Return Batch Normalization (ReBN) normalizes them over all turns of the batch; PPO
has a critic (GAE) and takes eight clipped, smaller steps on each batch; GRPO compares eight episodes
with one start, and gives all turns of an episode the same advantage.

GuessTheNumber: 1 to 50 in 6 turns, which is enough for bisection. Mastermind: 2 numbers of 6 in 10 turns. Minesweeper:
4x4 cells and 2 mines, since on 3x3 a first reveal that is safe leaves no room for a mine. TowerofHanoi: 3 disks in 20
turns; 7 are needed. Sudoku: 4x4 with 6 empty cells in 15 turns. Addition: ReasoningGym's basic arithmetic with two
digits. Python tool: sums of two digits and products of two numbers up to 30, with up to 3 calls.

Before it learns, the policy imitates valid actions drawn at random, and thereby knows the form of an answer; it
imitates players of gem_train.players in GuessTheNumber (any number of the interval that is left) and with the tool
(three times in ten, whatever is asked). In the results, "imitation" is that policy before it learns, and "random" are
valid actions.

The policy has about 150,000 parameters and learns for a minute or two: what stays at the level of imitation here says
that it is hard for so small a policy in so short a time, not that the algorithm fails. REINFORCE is at a disadvantage
where most rewards are above 0, since it makes everything likelier that was done.

Success and return are of 256 episodes that are the same for all algorithms; intervals are of the mean over seeds, 95 %,
Student's t, and there is none for one seed.
"""


class Task(NamedTuple):
    """A task of the study.

    Args:
        name: In tables and figures.
        env: Id of the environment.
        env_kwargs: Its arguments.
        options: Of a run, where they are not those that all tasks share; see ``TrainOptions``.
    """

    name: str
    env: str
    env_kwargs: dict[str, Any]
    options: dict[str, Any]


_ADDITION = {"min_terms": 2, "max_terms": 2, "min_digits": 1, "max_digits": 1, "operators": ["+"]}
_ADDITION |= {"allow_parentheses": False, "allow_negation": False}

TASKS = (
    Task(
        "GuessTheNumber",
        "game:GuessTheNumber-v0",
        {"max_turns": 6},
        {
            "updates": 50,
            "episodes": 512,
            "gamma": 0.9,
            "feedback": True,
            "memory": 1,
            "max_tokens": 10,
            "context": 64,
            "imitate": "gem_train.players:interval_player",
            "imitate_steps": 400,
        },
    ),
    Task(
        "Mastermind",
        "game:Mastermind-v0-easy",
        {},
        {
            "updates": 40,
            "episodes": 128,
            "gamma": 0.9,
            "max_tokens": 10,
            "context": 224,
        },
    ),
    Task(
        "Minesweeper",
        "game:Minesweeper-v0-easy",
        {"rows": 4, "cols": 4, "num_mines": 2, "max_turns": 10},
        {"updates": 50, "episodes": 256, "gamma": 0.9, "context": 192},
    ),
    Task(
        "TowerofHanoi",
        "game:TowerofHanoi-v0-easy",
        {"max_turns": 20},
        {"updates": 40, "episodes": 256, "gamma": 0.9, "context": 96},
    ),
    Task(
        "Sudoku",
        "game:Sudoku-v0-easy",
        {"clues": 10},
        {"updates": 40, "episodes": 128, "gamma": 0.5, "context": 192},
    ),
    Task(
        "Addition",
        "rg:basic_arithmetic",
        _ADDITION,
        {"updates": 150, "episodes": 512, "gamma": 1.0, "context": 48},
    ),
    Task(
        "Python tool",
        rewards.ENV_ID,
        {},
        {
            "updates": 50,
            "episodes": 192,
            "gamma": 0.8,
            "learning_rate": 7e-4,
            "memory": None,
            "max_tokens": 16,
            "context": 128,
            "wrappers": rewards.WRAPPERS,
            "imitate": "gem_train.players:tool_player",
            "imitate_episodes": 2500,
            "imitate_steps": 500,
        },
    ),
)

_SHARED = {
    "learning_rate": 1.5e-3,
    "entropy": 0.005,
    "memory": 0,
    "max_tokens": 8,
    "imitate": "random",
    "imitate_episodes": 1000,
    "imitate_steps": 200,
    "eval_episodes": 256,
}

ALGORITHMS: dict[Algorithm, dict[str, Any]] = {
    "reinforce": {},
    "rebn": {},
    # Eight steps on each batch, so smaller ones.
    "ppo": {"epochs": 2, "minibatches": 4, "learning_rate": 7e-4},
    "grpo": {},
}
LABELS = {"reinforce": "REINFORCE", "rebn": "ReBN", "ppo": "PPO", "grpo": "GRPO"}

_QUICK_TASKS, _QUICK_ALGORITHMS = ("Minesweeper", "TowerofHanoi", "Addition"), ("reinforce", "rebn")
_RANDOM_EPISODES = 512
_MEASUREMENTS = 8


def options_of(task: Task, algorithm: Algorithm, seed: int) -> TrainOptions:
    """Return the options of one run."""
    own: dict[str, Any] = _SHARED | task.options | ALGORITHMS[algorithm]
    return TrainOptions(env=(task.env,), env_kwargs=task.env_kwargs, algorithm=algorithm, seed=seed, **own)


def measure(training: Training) -> dict[str, Any]:
    """Return the success and the return of the evaluation."""
    described = describe(evaluated(training))
    return {name: described[name] for name in ("success", "return")}


def random_player(task: Task) -> dict[str, float]:
    """Return the success and the return of valid actions drawn at random."""
    options = options_of(task, "rebn", 0)
    played = [
        episode for episode in record_episodes(options, options.env, "random", _RANDOM_EPISODES) if not episode.error
    ]
    return {
        "success": sum(episode.success is True for episode in played) / len(played),
        "return": sum(episode.episode_return for episode in played) / len(played),
    }


def run(folder: Path, *, quick: bool, seeds: int, workers: int | None, quiet: bool) -> list[dict[str, Any]]:
    """Run the study, write its page and figure, and return its results.

    Args:
        folder: Where everything is kept; runs that are there are not made again.
        quick: Three tasks, two algorithms.
        seeds: Number of seeds.
        workers: Processes; None for one a processor.
        quiet: Show no progress.

    Raises:
        GemError: A distribution that a task needs is not there; the message says what to install.
    """
    tasks = [task for task in TASKS if not quick or task.name in _QUICK_TASKS]
    algorithms = [name for name in ALGORITHMS if not quick or name in _QUICK_ALGORITHMS]
    by_chance = {task.name: random_player(task) for task in tasks}
    jobs = {
        (task.name, algorithm): [_job(task, algorithm, seed) for seed in range(seeds)]
        for task in tasks
        for algorithm in algorithms
    }
    runs = run_jobs(jobs, folder, workers=workers, quiet=quiet)
    table = [_row(task, algorithm, some, by_chance[task]) for (task, algorithm), some in runs.items()]
    curves = {
        task.name: {
            LABELS[algorithm]: measured_curve(runs[task.name, algorithm], itemgetter("success"))
            for algorithm in algorithms
        }
        for task in tasks
    }
    drawn = curves_with_bands(curves, folder / "curves.png", unit="success", percent=True)
    write_study_page(
        folder / "index.html",
        "Four algorithms, seven tasks",
        TEXT,
        figures=[("Success of the evaluation while learning; at 0, that of the policy that only imitates.", drawn)],
        table=table,
    )
    return table


def _job(task: Task, algorithm: Algorithm, seed: int) -> Job:
    options = options_of(task, algorithm, seed)
    name = f"{task.name.replace(' ', '-').lower()}-{algorithm}-{seed}"
    return Job(name, options, measure, every=-(-options.updates // _MEASUREMENTS))


def _row(task: str, algorithm: Algorithm, runs: Sequence[Run], by_chance: Mapping[str, float]) -> dict[str, Any]:
    success = last_interval(runs, itemgetter("success"))
    started = {name: fmean(run["measured"][0][name] for run in runs) for name in ("success", "return")}
    return {
        "task": task,
        "algorithm": LABELS[algorithm],
        "success": success.mean,
        "low": success.low,
        "high": success.high,
        "return": last_interval(runs, itemgetter("return")).mean,
        "imitation_success": started["success"],
        "imitation_return": started["return"],
        "random_success": by_chance["success"],
        "random_return": by_chance["return"],
        "seconds": sum(run["seconds"] for run in runs),
    }
