"""REINFORCE, ReBN, PPO and GRPO on seven small tasks: the benchmark of the paper at the size of a CPU.

    python examples/paper/algorithms.py --quick

Four algorithms learn seven tasks, each from the same warm start, for the same number of updates and episodes:
REINFORCE takes returns as they are; Return Batch Normalization (ReBN) normalizes them over all turns of the batch; PPO
has a critic (GAE) and takes eight clipped, smaller steps on each batch; GRPO compares eight episodes with one start,
and gives all turns of an episode the same advantage.

Before it learns, the policy imitates valid actions drawn at random, and thereby knows the form of an answer; it
imitates the players of the other studies in GuessTheNumber (any number of the interval that is left) and with the tool
(three times in ten, whatever is asked). In the table, "imitation" is that policy before it learns, and "random" are
valid actions.

The policy has about 150,000 parameters and learns for a minute or two: what stays at the level of imitation here says
that it is hard for so small a policy in so short a time, not that the algorithm fails. REINFORCE is at a disadvantage
where most rewards are above 0, since it makes everything likelier that was done.
"""

from statistics import fmean

import click
from matplotlib.figure import Figure
from rewards import WRAPPERS  # registers study:SumsAndProducts-v0

from gem_train import TrainOptions
from gem_train.learner.imitation import record_episodes
from gem_train.learner.training import describe
from gem_train.reporting import mean_interval
from gem_train.studies import evaluated, plot_seeds, print_rows, run_all, study_options, train_measured

ALGORITHMS = {
    "REINFORCE": {"algorithm": "reinforce"},
    "ReBN": {"algorithm": "rebn"},
    # Eight steps on each batch, so smaller ones.
    "PPO": {"algorithm": "ppo", "epochs": 2, "minibatches": 4, "learning_rate": 7e-4},
    "GRPO": {"algorithm": "grpo"},
}
SHARED = {
    "learning_rate": 1.5e-3,
    "entropy": 0.005,
    "memory": 0,
    "max_tokens": 8,
    "imitate": "random",
    "imitate_episodes": 1000,
    "imitate_steps": 200,
    "eval_episodes": 256,
}
TASKS = {
    # 6 turns are enough for bisection.
    "GuessTheNumber": {
        "env": ("game:GuessTheNumber-v0",),
        "env_kwargs": {"max_turns": 6},
        "updates": 50,
        "episodes": 512,
        "gamma": 0.9,
        "feedback": True,
        "memory": 1,
        "max_tokens": 10,
        "context": 64,
        "imitate": "gem_train.gamma_study:interval_player",
        "imitate_steps": 400,
    },
    "Mastermind": {
        "env": ("game:Mastermind-v0-easy",),
        "updates": 40,
        "episodes": 128,
        "gamma": 0.9,
        "max_tokens": 10,
        "context": 224,
    },
    # On 3x3 cells a first reveal that is safe leaves no room for a mine.
    "Minesweeper": {
        "env": ("game:Minesweeper-v0-easy",),
        "env_kwargs": {"rows": 4, "cols": 4, "num_mines": 2, "max_turns": 10},
        "updates": 50,
        "episodes": 256,
        "gamma": 0.9,
        "context": 192,
    },
    # 7 turns are needed.
    "TowerofHanoi": {
        "env": ("game:TowerofHanoi-v0-easy",),
        "env_kwargs": {"max_turns": 20},
        "updates": 40,
        "episodes": 256,
        "gamma": 0.9,
        "context": 96,
    },
    "Sudoku": {
        "env": ("game:Sudoku-v0-easy",),
        "env_kwargs": {"clues": 10},
        "updates": 40,
        "episodes": 128,
        "gamma": 0.5,
        "context": 192,
    },
    "Addition": {
        "env": ("rg:basic_arithmetic",),
        "env_kwargs": {
            "min_terms": 2,
            "max_terms": 2,
            "min_digits": 1,
            "max_digits": 1,
            "operators": ["+"],
            "allow_parentheses": False,
            "allow_negation": False,
        },
        "updates": 150,
        "episodes": 512,
        "gamma": 1.0,
        "context": 48,
    },
    "Python tool": {
        "env": ("study:SumsAndProducts-v0",),
        "wrappers": WRAPPERS,
        "updates": 50,
        "episodes": 192,
        "gamma": 0.8,
        "learning_rate": 7e-4,
        "memory": None,
        "max_tokens": 16,
        "context": 128,
        "imitate": "rewards:tool_player",
        "imitate_episodes": 2500,
        "imitate_steps": 500,
    },
}
QUICK_TASKS, QUICK_ALGORITHMS = ("Minesweeper", "TowerofHanoi", "Addition"), ("REINFORCE", "ReBN")
RANDOM_EPISODES = 512
MEASUREMENTS = 8  # while learning


def options_of(task, algorithm, seed):
    """Return the options of one run."""
    return TrainOptions(**(SHARED | TASKS[task] | ALGORITHMS[algorithm]), seed=seed)


def measure(training):
    """Return the success and the return of the evaluation."""
    described = describe(evaluated(training))
    return {name: described[name] for name in ("success", "return")}


def random_player(task):
    """Return the success of valid actions drawn at random."""
    options = options_of(task, "ReBN", 0)
    played = record_episodes(options, options.env, "random", RANDOM_EPISODES)
    return fmean(episode.success is True for episode in played if not episode.error)


def run(task, algorithm, seed):
    """Train one policy."""
    options = options_of(task, algorithm, seed)
    return train_measured(options, measure, every=-(-options.updates // MEASUREMENTS))


def report(results, folder):
    """Draw the figure, and return the table."""
    rows = []
    tasks = list(dict.fromkeys(result["task"] for result in results))
    figure = Figure(figsize=(11, 2.5 * -(-len(tasks) // 4) + 0.3), layout="constrained")
    panels = figure.subplots(-(-len(tasks) // 4), min(len(tasks), 4), squeeze=False).flat
    for axes, task in zip(panels, tasks, strict=False):
        by_chance = random_player(task)
        for algorithm in dict.fromkeys(result["algorithm"] for result in results):
            named = {"task": task, "algorithm": algorithm}
            runs = [result["measured"] for result in results if named.items() <= result.items()]
            plot_seeds(
                axes,
                [measured["update"] for measured in runs[0]],
                [[measured["success"] for measured in each] for each in runs],
                algorithm,
            )
            success = mean_interval([each[-1]["success"] for each in runs])
            rows.append(
                {
                    **named,
                    "success": success.mean,
                    "low": success.low,
                    "high": success.high,
                    "return": fmean(each[-1]["return"] for each in runs),
                    "imitation": fmean(each[0]["success"] for each in runs),
                    "random": by_chance,
                }
            )
        axes.set(title=task, xlabel="update", ylabel="success")
    for unused in panels[len(tasks) :]:
        unused.remove()
    figure.axes[0].legend()
    figure.savefig(folder / "figure.png", dpi=160)
    return rows


@click.command(help=__doc__)
@study_options("algorithms", seeds=1)
def main(quick, seeds, workers, folder):
    """Run what is asked for, and show it."""
    settings = [
        {"task": task, "algorithm": algorithm, "seed": seed}
        for seed in range(seeds)
        for task in (QUICK_TASKS if quick else TASKS)
        for algorithm in (QUICK_ALGORITHMS if quick else ALGORITHMS)
    ]
    print_rows(report(run_all(run, settings, folder, workers=workers), folder))


if __name__ == "__main__":
    main()
