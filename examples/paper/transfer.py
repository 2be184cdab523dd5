"""What carries over to environments that a policy was not trained on?

    python examples/paper/transfer.py --seeds 3

The policy learns GuessTheNumber, and is evaluated on four tasks while it learns: numbers from 1 to 50 in 7 guesses,
from 1 to 10 in 4, a range that is drawn for each game, and Mastermind, a game of other rules that is answered in the
same form. Half of the runs learn 1 to 50 alone, the other half any range. Before that, each imitates a player that
writes down the interval that is left and names any number of it, on the environment that it will learn; so the values
at update 0 are those of imitation.
"""

from statistics import fmean

import click
from matplotlib.figure import Figure

from gem_train import TrainOptions
from gem_train.reporting import mean_interval
from gem_train.studies import evaluated, plot_seeds, print_rows, run_all, study_options, train_measured

TRAINED = {"1 to 50": "game:GuessTheNumber-v0-hard", "any range": "game:GuessTheNumber-v0-random"}
EVALUATED = {
    "1 to 50": "game:GuessTheNumber-v0-hard",
    "1 to 10": "game:GuessTheNumber-v0-easy",
    "any range": "game:GuessTheNumber-v0-random",
    "Mastermind": "game:Mastermind-v0-easy",
}
EVERY = 20  # updates between evaluations


def options_of(trained, seed):
    """Return the options of one run."""
    return TrainOptions(
        env=(TRAINED[trained],),
        eval_envs=tuple(EVALUATED.values()),
        algorithm="rebn",
        gamma=0.9,
        seed=seed,
        updates=80,
        episodes=256,
        learning_rate=1.5e-3,
        feedback=True,
        memory=1,
        max_tokens=10,
        context=128,
        imitate="gem_train.gamma_study:interval_player",
        imitate_steps=500,
        eval_episodes=512,
    )


def measure(training):
    """Return the success on each environment."""
    return {
        name: fmean(seat.success == 1.0 for seat in evaluated(training, env_id)) for name, env_id in EVALUATED.items()
    }


def run(trained, seed):
    """Train one policy."""
    return train_measured(options_of(trained, seed), measure, every=EVERY)


def report(results, folder):
    """Draw the figure, and return the table."""
    rows = []
    figure = Figure(figsize=(11, 3), layout="constrained")
    panels = figure.subplots(1, len(EVALUATED), sharey=True)
    for trained in TRAINED:
        runs = [result["measured"] for result in results if result["trained"] == trained]
        steps = [measured["update"] for measured in runs[0]]
        for axes, name in zip(panels, EVALUATED, strict=True):
            values = [[measured[name] for measured in each] for each in runs]
            plot_seeds(axes, steps, values, f"trained on {trained}")
            axes.set(title=name, xlabel="update")
            end = mean_interval([each[-1] for each in values])
            start = fmean(each[0] for each in values)
            row = {"trained": trained, "evaluated": name, "imitation": start, "success": end.mean}
            rows.append({**row, "low": end.low, "high": end.high})
    panels[0].set_ylabel("success")
    panels[0].legend()
    figure.savefig(folder / "figure.png", dpi=160)
    return rows


@click.command(help=__doc__)
@study_options("transfer")
def main(quick, seeds, workers, folder):
    """Run what is asked for, and show it."""
    settings = [{"trained": trained, "seed": seed} for seed in range(seeds) for trained in TRAINED]
    print_rows(report(run_all(run, settings, folder, workers=workers), folder))


if __name__ == "__main__":
    main()
