"""The study of self-play: one policy at both seats of a game, measured against perfect play while it learns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import cache
from itertools import product
from operator import itemgetter
from pathlib import Path
from statistics import fmean
from typing import Any

import torch

import gem_core as gem
from gem_games.kuhn_poker import KuhnPokerEnv, legal_moves
from gem_games.kuhn_strategy import History, exploitability
from gem_train.learner.learning import Learner
from gem_train.learner.options import TrainOptions
from gem_train.learner.playing import next_piece
from gem_train.learner.policy_loss import score
from gem_train.learner.training import Training
from gem_train.learner.vocabulary import ANSWER, END
from gem_train.reporting import Curve, curves_with_bands, write_study_page
from gem_train.studies.jobs import Job, Measure, run_jobs
from gem_train.studies.measured import Run, evaluated, last_interval, measured_curve
from gem_train.tokens import TokenBatch

_HISTORIES: tuple[History, ...] = (), ("check",), ("bet",), ("check", "bet")
_SEEDS_WITH_ALL_CARDS = 30
_LARGEST = 1_000_000
"""Denominator of a probability: exact sums of fractions stay quick."""

GAMES: dict[str, dict[str, Any]] = {
    "KuhnPoker": {
        "imitate": "gem_train.players:kuhn_player",
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
"""Options of each game. Contexts are as long as the situation and the response: the rules are dropped."""

_EVERY = {"KuhnPoker": 4, "TicTacToe": 20}
"""Updates between measurements."""

TEXT = """\
One policy plays both seats of a game and learns by REINFORCE from what each seat wins (gamma 1). A baseline for each
role, a moving mean of the returns of its seat, is subtracted in half of the runs.

KuhnPoker: exploitability is what a best response wins from the policy in a game on average, in chips, over both seats;
it is 0 at an equilibrium and above 0 elsewhere. The policy's strategy is computed from the probabilities of its texts,
and the best response by trying each. Before it learns, the policy imitates a player that bets the more the higher its
card is. What self-play learns answers the opponent of the moment, and may go round an equilibrium. So beside the policy
stands the mean of its strategies so far (at each decision, all measurements alike).

TicTacToe: the share of games that are lost against a player that never loses, as many from each seat. Before it learns,
the policy imitates random moves.

Intervals are of the mean over seeds, 95 %, Student's t; of one seed there are none.
"""


def options_of(game: str, baselines: bool, seed: int) -> TrainOptions:
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
def information_sets() -> Mapping[tuple[str, History], str]:
    """Return what a seat of KuhnPoker is shown before each of its 12 decisions, by its card and the moves so far."""
    env, shown = KuhnPokerEnv(), {}
    for seed in range(_SEEDS_WITH_ALL_CARDS):
        for history in _HISTORIES:
            observations, _ = env.reset(seed=seed)
            for move in history:
                observations, *_ = env.step(dict.fromkeys(observations, f"\\boxed{{{move}}}"))
            ((seat, text),) = observations.items()
            shown[env.cards[seat], history] = str(text)
    return shown


def kuhn_strategy(learner: Learner) -> tuple[dict[tuple[str, History], Fraction], float]:
    """Return the strategy of a policy in KuhnPoker, and the least probability that it gives to both moves together.

    The strategy is computed from the probabilities of the texts, so nothing is drawn. It leaves out what else the
    policy may say: that does nothing, and the policy answers again.

    Args:
        learner: That reads nothing but the observation (``memory=0``).
    """
    vocabulary, options = learner.vocabulary, learner.options
    decisions = [(key, move) for key in information_sets() for move in sorted(legal_moves(key[1]))]
    shown = [[*vocabulary.encode(information_sets()[key]), ANSWER] for key, _ in decisions]
    batch = TokenBatch.from_turns(
        contexts=[next_piece(options, ids, (), 0, view=False)[0] for ids in shown],
        responses=[[*vocabulary.encode(f"\\boxed{{{move}}}", phrases=False), END] for _, move in decisions],
        episode=range(len(decisions)),
        rewards=[0.0] * len(decisions),
        terminated=[True] * len(decisions),
    )
    with torch.no_grad():
        scored = score(learner.policy, torch.from_numpy(batch.tokens), torch.from_numpy(batch.token_mask))
    # In the order of the alphabet, the move that puts a chip in is the first: bet, check; call, fold.
    pairs = scored.logprobs.double().sum(dim=1).view(-1, 2)
    chips = torch.sigmoid(pairs[:, 0] - pairs[:, 1]).tolist()
    strategy = {
        key: Fraction(chip).limit_denominator(_LARGEST) for key, chip in zip(information_sets(), chips, strict=True)
    }
    return strategy, float(pairs.exp().sum(dim=1).min())


def measure_kuhn(training: Training) -> dict[str, Any]:
    """Return the exploitability of the policy's strategy in KuhnPoker, in chips a game: 0 at an equilibrium."""
    strategy, valid = kuhn_strategy(training.learner)
    return {
        "exploitability": float(exploitability(strategy)),
        "valid": valid,
        "chips": {f"{card} {' '.join(history)}".strip(): float(chip) for (card, history), chip in strategy.items()},
    }


def measure_tictactoe(training: Training) -> dict[str, Any]:
    """Return how the policy's games of TicTacToe end, as shares of as many games at each seat.

    ``"lost"`` and ``"drawn"`` against the perfect player, ``"won_against_random"`` against random moves.
    """
    perfect, random = (
        [returns for seat in ("X", "O") for returns in _returns(training, seat, opponent)]
        for opponent in ("tictactoe", "random")
    )
    return {
        "lost": sum(each < 0 for each in perfect) / len(perfect),
        "drawn": sum(each == 0 for each in perfect) / len(perfect),
        "won_against_random": sum(each > 0 for each in random) / len(random),
    }


def _returns(training: Training, seat: str, opponent: str) -> list[float]:
    """Return what the policy wins at a seat of TicTacToe, in each game of an evaluation."""
    env_id = f"study:TicTacToe-v0-{seat}-{opponent}"
    if env_id not in gem.list_envs("study"):
        gem.register(env_id, "gem_core.rollouts:single_agent", env="game:TicTacToe-v0", seat=seat, others=opponent)
    return [game.episode_return for game in evaluated(training, env_id)]


_JOB_MEASURES: dict[str, Measure] = {"KuhnPoker": measure_kuhn, "TicTacToe": measure_tictactoe}
_COMPARED = (
    ("KuhnPoker", "exploitability"),
    ("KuhnPoker", "mean_exploitability"),
    ("TicTacToe", "lost"),
    ("TicTacToe", "won_against_random"),
)
"""The numbers that are compared."""


def run(folder: Path, *, quick: bool, seeds: int, workers: int | None, quiet: bool) -> list[dict[str, Any]]:
    """Run the study, write its page and figures, and return its results.

    Args:
        folder: Where everything is kept; runs that are there are not made again.
        quick: Changes nothing here.
        seeds: Number of seeds.
        workers: Processes; None for one a processor.
        quiet: Show no progress.
    """
    jobs = {
        (game, baselines): [_job(game, baselines, seed) for seed in range(seeds)]
        for game, baselines in product(GAMES, (True, False))
    }
    by_setting = run_jobs(jobs, folder, workers=workers, quiet=quiet)
    for (game, _), runs in by_setting.items():
        for each in runs if game == "KuhnPoker" else ():
            _add_mean_exploitability(each["measured"])
    table = [
        _row(game, measure, baselines, by_setting[game, baselines])
        for game, measure in _COMPARED
        for baselines in (True, False)
    ]
    _write(folder, table, by_setting)
    return table


def _job(game: str, baselines: bool, seed: int) -> Job:
    name = f"{game}-{'with' if baselines else 'without'}-baselines-{seed}"
    return Job(name, options_of(game, baselines, seed), _JOB_MEASURES[game], every=_EVERY[game])


def _add_mean_exploitability(measured: Sequence[dict[str, Any]]) -> None:
    """Add to each measurement the exploitability of the mean of the strategies so far, at each decision by itself."""
    total: Counter[str] = Counter()
    for count, each in enumerate(measured, start=1):
        total.update(each["chips"])
        mean = {_decision(key): Fraction(chips / count).limit_denominator(_LARGEST) for key, chips in total.items()}
        each["mean_exploitability"] = float(exploitability(mean))


def _decision(key: str) -> tuple[str, History]:
    card, *history = key.split()
    return card, tuple(history)


def _row(game: str, measure: str, baselines: bool, runs: Sequence[Run]) -> dict[str, Any]:
    last = last_interval(runs, itemgetter(measure))
    return {
        "game": game,
        "measure": measure,
        "baselines": baselines,
        "start": fmean(run["measured"][0][measure] for run in runs),
        "end": last.mean,
        "low": last.low,
        "high": last.high,
        "seconds": sum(run["seconds"] for run in runs),
    }


def _write(folder: Path, table: list[dict[str, Any]], by_setting: dict[tuple[str, bool], list[Any]]) -> None:
    def panel(game: str, measure: str) -> dict[str, Curve]:
        return {
            f"{'with' if baselines else 'without'} baselines": measured_curve(
                by_setting[game, baselines], itemgetter(measure)
            )
            for baselines in (True, False)
        }

    kuhn = {
        "the policy": panel("KuhnPoker", "exploitability"),
        "mean of all so far": panel("KuhnPoker", "mean_exploitability"),
    }
    tictactoe = {
        "lost to the perfect player": panel("TicTacToe", "lost"),
        "drawn with it": panel("TicTacToe", "drawn"),
        "won against random moves": panel("TicTacToe", "won_against_random"),
    }
    write_study_page(
        folder / "index.html",
        "Self-play",
        TEXT,
        figures=[
            (
                "KuhnPoker: exploitability in chips a game; 0 is an equilibrium.",
                curves_with_bands(kuhn, folder / "kuhn.png", unit="exploitability"),
            ),
            (
                "TicTacToe: shares of games, as many at each seat.",
                curves_with_bands(tictactoe, folder / "tictactoe.png", unit="games", percent=True),
            ),
        ],
        table=table,
    )
