"""Which rewards teach a policy to use a tool where it is needed, and only there?

    python examples/paper/rewards.py --seeds 3

Half of the questions are sums of two digits, half are products of two numbers from 11 to 30. An answer ends the
episode; before it, the Python tool of gem-tools may be called up to three times. The policy first imitates a player
that calls the tool three times in ten, whatever is asked, and again one time in five; without it, that player is right
about nine sums in ten and no product. So the tool is needed for products alone.

Compared are REINFORCE with rewards of 0 and 1, REINFORCE with -1 and 1, and Return Batch Normalization (ReBN) of 0 and
1. A call is a turn, and the discount from turn to turn is 0.8: a right answer after a call returns 0.8 to it.
"""

import re
from statistics import fmean

import click
import numpy as np
from matplotlib.figure import Figure

import gem_core as gem
from gem_core.env import stable_hash
from gem_train import TrainOptions
from gem_train.reporting import mean_interval
from gem_train.studies import evaluated, plot_seeds, print_rows, run_all, study_options, train_measured

# Settings: the algorithm, and the reward of a wrong answer; that of a right one is 1.
SETTINGS = {
    "REINFORCE, 0 and 1": ("reinforce", 0.0),
    "REINFORCE, -1 and 1": ("reinforce", -1.0),
    "ReBN, 0 and 1": ("rebn", 0.0),
}
KINDS = {"sums": " + ", "products": " * "}
MEASURES = ("success", "with_tool", "calls")
EVERY = 10  # updates between measurements

# The task: about as many sums as products; there are 81 different sums and 400 products.
SUMS = [(f"{left} + {right}", left + right) for left in range(1, 10) for right in range(1, 10)] * 5
PRODUCTS = [(f"{left} * {right}", left * right) for left in range(11, 31) for right in range(11, 31)]
# The policy learns of the tool from the player that it imitates; instructions would only be more to read.
WRAPPERS = ("python", ("tools", {"max_tool_uses": 3, "instructions": False}))

gem.register(
    "study:SumsAndProducts-v0",
    gem.DatasetEnv,
    rows=[{"question": f"What is {text}?", "answer": str(value)} for text, value in (*SUMS, *PRODUCTS)],
    summary="A sum of two digits, or a product of two numbers from 11 to 30.",
)


QUESTION = re.compile(r"(\d+) ([+*]) (\d+)", re.ASCII)
RESULT = re.compile(r"^Output of python:\n(\d+)$", re.ASCII | re.MULTILINE)
USES_TOOL, ASKS_AGAIN, RIGHT_SUMS = 0.3, 0.2, 0.9


def tool_player(observation, context):
    r"""Answer a sum or a product of two numbers, three times in ten with the tool ``python``, whatever is asked.

    By itself it is right about nine sums in ten, and never knows a product: it says that of any two such numbers. What
    the tool said it answers, but one time in five it runs the same code again.
    """
    left, sign, right = QUESTION.findall(str(observation))[0]
    shown = str(context.observation)
    random = np.random.default_rng(stable_hash(context.info.get("seed"), context.episode, context.turn, shown))
    result = RESULT.search(shown)
    if random.random() < (ASKS_AGAIN if result else USES_TOOL):
        return f"<python>{left} {sign} {right}</python>"
    if result:
        answer = result[1]
    elif sign == "*":
        answer = str(random.integers(11, 31) * random.integers(11, 31))
    else:
        slip = 0 if random.random() < RIGHT_SUMS else random.integers(-3, 4)
        answer = str(max(int(left) + int(right) + slip, 0))
    return f"\\boxed{{{answer}}}"


def options_of(setting, seed):
    """Return the options of one run."""
    algorithm, failure_reward = SETTINGS[setting]
    return TrainOptions(
        env=("study:SumsAndProducts-v0",),
        wrappers=WRAPPERS,
        algorithm=algorithm,
        failure_reward=failure_reward,
        gamma=0.8,
        seed=seed,
        updates=50,
        episodes=192,
        learning_rate=7e-4,
        max_tokens=16,
        context=128,
        imitate=f"{__name__}:tool_player",
        imitate_episodes=2500,
        imitate_steps=500,
        eval_episodes=256,
    )


def measure(training):
    """Return success, the share of episodes with the tool, and the mean calls, of sums and of products."""
    played, measured = evaluated(training), {}
    for kind, sign in KINDS.items():
        seats = [seat for seat in played if sign in str(seat.turns[0].shown)]
        calls = [len(seat.turns) - 1 for seat in seats]
        measured[kind] = {
            "success": fmean(seat.success == 1.0 for seat in seats),
            "with_tool": fmean(call > 0 for call in calls),
            "calls": fmean(calls),
        }
    return measured


def run(setting, seed):
    """Train one policy."""
    return train_measured(options_of(setting, seed), measure, every=EVERY)


def report(results, folder):
    """Draw the figure, and return the table."""
    rows = []
    figure = Figure(figsize=(11, 5), layout="constrained")
    panels = figure.subplots(len(KINDS), len(MEASURES))
    for setting in SETTINGS:
        runs = [result["measured"] for result in results if result["setting"] == setting]
        steps = [measured["update"] for measured in runs[0]]
        for row, kind in enumerate(KINDS):
            values = {name: [[measured[kind][name] for measured in each] for each in runs] for name in MEASURES}
            for column, name in enumerate(MEASURES):
                plot_seeds(panels[row, column], steps, values[name], setting)
                panels[row, column].set(title=kind, xlabel="update", ylabel=name.replace("_", " "))
            success, with_tool, calls = (mean_interval([each[-1] for each in values[name]]) for name in MEASURES)
            rows.append(
                {
                    "setting": setting,
                    "questions": kind,
                    "success": success.mean,
                    "low": success.low,
                    "high": success.high,
                    "with_tool": with_tool.mean,
                    "tool_low": with_tool.low,
                    "tool_high": with_tool.high,
                    "calls": calls.mean,
                }
            )
    panels[0, 0].legend()
    figure.savefig(folder / "figure.png", dpi=160)
    return rows


@click.command(help=__doc__)
@study_options("rewards")
def main(quick, seeds, workers, folder):
    """Run what is asked for, and show it."""
    gem.make("study:SumsAndProducts-v0", wrappers=WRAPPERS).close()  # says what to install if the tool is missing
    settings = [{"setting": setting, "seed": seed} for seed in range(seeds) for setting in SETTINGS]
    print_rows(report(run_all(run, settings, folder, workers=workers), folder))


if __name__ == "__main__":
    main()
