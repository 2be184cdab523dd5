"""One policy at both seats of a game, measured against perfect play while it learns.

    python examples/paper/self_play.py --seeds 3

The policy learns by REINFORCE from what each seat wins (gamma 1). A baseline for each role, a moving mean of the
returns of its seat, is subtracted in half of the runs.

KuhnPoker: exploitability is what a best response wins from the policy in a game on average, in chips, over both seats;
it is 0 at an equilibrium and above 0 elsewhere. The policy's strategy is computed from the probabilities of its texts,
and the best response by trying each. Before it learns, the policy imitates a player that bets the more the higher its
card is. What self-play learns answers the opponent of the moment, and may go round an equilibrium. So beside the policy
stands the mean of its strategies so far (at each decision, all measurements alike).

TicTacToe: the share of games that are lost against a player that never loses, as many from each seat. Before it learns,
the policy imitates random moves.
"""

import re
from collections import Counter
from fractions import Fraction
from functools import cache
from statistics import fmean

import click
import numpy as np
import torch
from matplotlib.figure import Figure

import gem_core as gem
from gem_core.env import stable_hash
from gem_games.kuhn_poker import KuhnPokerEnv, legal_moves
from gem_games.kuhn_strategy import exploitability
from gem_train import TokenBatch, TrainOptions
from gem_train.learner.playing import next_piece
from gem_train.learner.policy_loss import score
from gem_train.learner.vocabulary import ANSWER, END
from gem_train.reporting import mean_interval
from gem_train.studies import evaluated, plot_seeds, print_rows, run_all, study_options, train_measured

# Contexts are as long as the situation and the response: the rules are dropped.
GAMES = {
    "KuhnPoker": {
        "imitate": f"{__name__}:kuhn_player",
        "imitate_steps": 150,
        "updates": 80,
        "episodes": 384,
        "learning_rate": 3e-4,
        "context": 11,
    },
    "TicTacToe": {
        "imitate": "random",
        "imitate_steps": 500,
        "updates": 100,
        "episodes": 128,
        "learning_rate": 1e-3,
        "context": 56,
        "eval_episodes": 256,
    },
}
EVERY = {"KuhnPoker": 4, "TicTacToe": 20}  # updates between measurements
MEASURES = {
    "KuhnPoker": ("exploitability", "mean_exploitability"),
    "TicTacToe": ("lost", "drawn", "won_against_random"),
}
HISTORIES = (), ("check",), ("bet",), ("check", "bet")
SEEDS_WITH_ALL_CARDS = 30

for seat in ("X", "O"):
    for opponent in ("tictactoe", "random"):
        gem.register(
            f"study:TicTacToe-v0-{seat}-{opponent}",
            "gem_core.rollouts:single_agent",
            env="game:TicTacToe-v0",
            seat=seat,
            others=opponent,
        )


HAND = re.compile(r"player and hold the (jack|queen|king)\. Moves so far: ([a-z, ]+)\.")
CHIPS = {"jack": 0.25, "queen": 0.5, "king": 0.75}


def kuhn_player(observation, context):
    r"""Play KuhnPoker: bet or call with the king three times of four, with the queen twice, with the jack once."""
    shown = str(context.observation)
    card, played = HAND.findall(shown)[-1]
    random = np.random.default_rng(stable_hash(context.info.get("seed"), context.episode, context.turn, shown))
    puts_in = random.random() < CHIPS[card]
    if played.endswith("bet"):
        return "\\boxed{call}" if puts_in else "\\boxed{fold}"
    return "\\boxed{bet}" if puts_in else "\\boxed{check}"


def options_of(game, baselines, seed):
    """Return the options of one run."""
    return TrainOptions(
        env=(f"game:{game}-v0",),
        algorithm="reinforce",
        gamma=1.0,
        role_baselines=baselines,
        seed=seed,
        memory=0,
        max_tokens=4,
        imitate_episodes=1000,
        **GAMES[game],
    )


@cache
def information_sets():
    """Return what a seat of KuhnPoker is shown before each of its 12 decisions, by its card and the moves so far."""
    env, shown = KuhnPokerEnv(), {}
    for seed in range(SEEDS_WITH_ALL_CARDS):
        for history in HISTORIES:
            observations, _ = env.reset(seed=seed)
            for move in history:
                observations, *_ = env.step(dict.fromkeys(observations, f"\\boxed{{{move}}}"))
            ((seat, text),) = observations.items()
            shown[env.cards[seat], history] = str(text)
    return shown


def kuhn_strategy(learner):
    """Return how likely a policy puts in a chip at each of the 12 decisions of KuhnPoker.

    This is computed from the probabilities of the texts, so nothing is drawn. It leaves out what else the policy may
    say: that does nothing, and the policy answers again.
    """
    vocabulary = learner.vocabulary
    decisions = [(key, move) for key in information_sets() for move in sorted(legal_moves(key[1]))]
    shown = [[*vocabulary.encode(information_sets()[key]), ANSWER] for key, _ in decisions]
    batch = TokenBatch.from_turns(
        contexts=[next_piece(learner.options, ids, (), 0, view=False)[0] for ids in shown],
        responses=[[*vocabulary.encode(f"\\boxed{{{move}}}", phrases=False), END] for _, move in decisions],
        episode=range(len(decisions)),
        rewards=[0.0] * len(decisions),
        terminated=[True] * len(decisions),
    )
    with torch.no_grad():
        scored = score(learner.policy, torch.from_numpy(batch.tokens), torch.from_numpy(batch.token_mask))
    # In the order of the alphabet, the move that puts a chip in is the first: bet, check; call, fold.
    pairs = scored.logprobs.double().sum(dim=1).view(-1, 2)
    return dict(zip(information_sets(), torch.sigmoid(pairs[:, 0] - pairs[:, 1]).tolist(), strict=True))


def exploitability_of(strategy):
    """Return the exploitability of a strategy; fractions make the search for the best response exact."""
    return float(exploitability({key: Fraction(chip).limit_denominator(10**6) for key, chip in strategy.items()}))


class Kuhn:
    """Measures one run of KuhnPoker: the policy as it is, and the mean of its strategies so far."""

    def __init__(self):
        self.count, self.total = 0, Counter()

    def __call__(self, training):
        """Return both exploitabilities."""
        strategy = kuhn_strategy(training.learner)
        self.count += 1
        self.total.update(strategy)
        mean = {key: chips / self.count for key, chips in self.total.items()}
        return {"exploitability": exploitability_of(strategy), "mean_exploitability": exploitability_of(mean)}


def measure_tictactoe(training):
    """Return how the policy's games of TicTacToe end, as shares of as many games at each seat."""

    def returns(opponent):
        ids = [f"study:TicTacToe-v0-{seat}-{opponent}" for seat in ("X", "O")]
        return [game.episode_return for env_id in ids for game in evaluated(training, env_id)]

    perfect = returns("tictactoe")
    return {
        "lost": fmean(each < 0 for each in perfect),
        "drawn": fmean(each == 0 for each in perfect),
        "won_against_random": fmean(each > 0 for each in returns("random")),
    }


def run(game, baselines, seed):
    """Train one policy."""
    measure = Kuhn() if game == "KuhnPoker" else measure_tictactoe
    return train_measured(options_of(game, baselines, seed), measure, every=EVERY[game])


def report(results, folder):
    """Draw the figure, and return the table."""
    rows = []
    figure = Figure(figsize=(13, 3), layout="constrained")
    panels = iter(figure.subplots(1, sum(map(len, MEASURES.values()))))
    for game, names in MEASURES.items():
        for name in names:
            axes = next(panels)
            for baselines in (True, False):
                named = {"game": game, "baselines": baselines}
                runs = [result["measured"] for result in results if named.items() <= result.items()]
                values = [[measured[name] for measured in each] for each in runs]
                label = f"{'with' if baselines else 'without'} baselines"
                plot_seeds(axes, [measured["update"] for measured in runs[0]], values, label)
                end = mean_interval([each[-1] for each in values])
                row = {**named, "measure": name, "start": fmean(each[0] for each in values), "end": end.mean}
                rows.append({**row, "low": end.low, "high": end.high})
            axes.set(title=f"{game}: {name.replace('_', ' ')}", xlabel="update")
    figure.axes[0].legend()
    figure.savefig(folder / "figure.png", dpi=160)
    return rows


@click.command(help=__doc__)
@study_options("self-play")
def main(quick, seeds, workers, folder):
    """Run what is asked for, and show it."""
    settings = [
        {"game": game, "baselines": baselines, "seed": seed}
        for seed in range(seeds)
        for game in GAMES
        for baselines in (True, False)
    ]
    print_rows(report(run_all(run, settings, folder, workers=workers), folder))


if __name__ == "__main__":
    main()
