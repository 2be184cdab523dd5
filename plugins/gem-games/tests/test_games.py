"""What every game promises: its parameters, states, observations and random actions; and that it can be won."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gem_core as gem
from gem_core.errors import AgentError
from gem_games.agents import BisectionAgent, HanoiAgent, MastermindAgent
from gem_games.game import quote, whole_number, whole_numbers
from gem_games.guess_the_number import GuessTheNumberEnv
from gem_games.mastermind import MastermindEnv
from gem_games.tower_of_hanoi import TowerOfHanoiEnv

# The parameters and turn limits of gem-llm, and our own id without a variant.
PARAMETERS: dict[str, dict[str, Any]] = {
    "game:GuessTheNumber-v0": {"min_number": 1, "max_number": 50, "max_turns": 10},
    "game:GuessTheNumber-v0-easy": {"min_number": 1, "max_number": 10, "max_turns": 4},
    "game:GuessTheNumber-v0-hard": {"min_number": 1, "max_number": 50, "max_turns": 7},
    "game:GuessTheNumber-v0-random": {"min_number": None, "max_number": None, "max_turns": None},
    "game:Mastermind-v0-easy": {"code_length": 2, "num_numbers": 6, "max_turns": 10},
    "game:Mastermind-v0-hard": {"code_length": 4, "num_numbers": 8, "max_turns": 30},
    "game:Mastermind-v0-random": {"code_length": None, "num_numbers": None, "max_turns": None},
    "game:TowerofHanoi-v0-easy": {"num_disks": 3, "max_turns": 10},
    "game:TowerofHanoi-v0-hard": {"num_disks": 5, "max_turns": 35},
    "game:TowerofHanoi-v0-random": {"num_disks": None, "max_turns": None},
}
IDS = list(PARAMETERS)
SOLVERS = {"GuessTheNumber": BisectionAgent(), "Mastermind": MastermindAgent(), "TowerofHanoi": HanoiAgent()}


def solver(env_id: str) -> Any:
    return SOLVERS[env_id.removeprefix("game:").partition("-")[0]]


def played(env: Any, seed: int, agent: Any = None) -> list[Any]:
    """Play an episode and return all that it gave."""
    observation, info = env.reset(seed=seed)
    records: list[Any] = [(observation, info)]
    over = False
    while not over:
        result = env.step(agent(observation) if agent else env.sample_random_action())
        observation, over = result[0], result[2]
        records.append(result)
    return records


def test_registered_ids_and_parameters() -> None:
    """Every id has the parameters that published baselines were measured with."""
    specs = [gem.spec(env_id) for env_id in IDS]
    assert {spec.id: dict(spec.kwargs) for spec in specs} == PARAMETERS


def test_the_guide_lists_the_registered_ids() -> None:
    """All but TextArena's, of which it tells how they are named."""
    from gem_games._plugin import gem_register_agents, gem_register_envs

    guide = Path(__file__).parents[3].joinpath("docs", "games.md").read_text(encoding="utf-8")
    table = [line.split("`")[1] for line in guide.splitlines() if line.startswith("| `")]
    games = [spec.id for spec in gem_register_envs() if spec.namespace == "game"]
    declared = games + [spec.name for spec in gem_register_agents()]
    assert table == declared


def test_plugin_declares_without_importing_anything_heavy() -> None:
    """Listing the games loads neither the games nor what they stand on."""
    code = (
        "import sys, gem_games._plugin as plugin\n"
        "ids = [*plugin.gem_register_envs(), *plugin.gem_register_agents()]\n"
        "heavy = {'gymnasium', 'numpy', 'pydantic', 'rich', 'textarena', 'gem_core.env.base', 'gem_games.game'}\n"
        "print(len(ids) > 12, sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True []"


def test_guess_the_number_random_ranges() -> None:
    """The lowest number is 1 to 10, the highest 5 to 50 above it, and the turns follow from the range."""
    env = GuessTheNumberEnv(None, None, None)
    lowest, spans, shares = set(), set(), []
    for seed in range(3_000):
        env.reset(seed=seed)
        span = env.max_number - env.min_number
        assert env.max_turns == math.ceil(math.sqrt(span)) + 1
        assert env.min_number <= env.number <= env.max_number
        lowest.add(env.min_number)
        spans.add(span)
        shares.append((env.number - env.min_number) / span)
    assert lowest == set(range(1, 11))
    assert spans == set(range(5, 51))
    assert sum(shares) / len(shares) == pytest.approx(0.5, abs=0.03)


def test_given_parameters_stay_while_others_are_drawn() -> None:
    env = GuessTheNumberEnv(min_number=100, max_number=None, max_turns=3)
    below = GuessTheNumberEnv(min_number=None, max_number=0, max_turns=3)
    for seed in range(50):
        env.reset(seed=seed)
        below.reset(seed=seed)
        assert (env.min_number, env.max_turns) == (100, 3)
        assert 105 <= env.max_number <= 150
        assert -50 <= below.min_number <= -5
    mastermind = MastermindEnv(num_numbers=3, code_length=None, max_turns=None)
    mastermind.reset(seed=0)
    assert (mastermind.code_length, mastermind.num_numbers, mastermind.max_turns) == (2, 3, 10)


def test_mastermind_sizes_and_codes() -> None:
    """Each size turns up, and codes are of different numbers in range."""
    env = MastermindEnv(None, None, None)
    sizes = set()
    for seed in range(200):
        env.reset(seed=seed)
        sizes.add((env.code_length, env.num_numbers, env.max_turns))
        assert len(set(env.code)) == env.code_length
        assert set(env.code) <= set(range(1, env.num_numbers + 1))
    assert sizes == {(2, 4, 10), (4, 6, 20), (4, 8, 30)}


def test_mastermind_draws_every_code() -> None:
    plain, repeats = MastermindEnv(2, 3, 5), MastermindEnv(2, 3, 5, duplicate_numbers=True)
    codes: list[set[tuple[int, ...]]] = [set(), set()]
    for seed in range(200):
        for env, found in zip((plain, repeats), codes, strict=True):
            env.reset(seed=seed)
            found.add(tuple(env.code))
    assert [len(found) for found in codes] == [6, 9]


def test_hanoi_sizes() -> None:
    env = TowerOfHanoiEnv(None, None)
    sizes = set()
    for seed in range(100):
        env.reset(seed=seed)
        sizes.add((env.num_disks, env.max_turns))
        assert env.pegs == {"A": list(range(env.num_disks, 0, -1)), "B": [], "C": []}
    assert sizes == {(3, 10), (4, 20), (5, 35)}


@pytest.mark.parametrize("env_id", IDS)
def test_solver_wins_many_games(env_id: str, many: int) -> None:
    """Every instance is solvable within its turns, from the latest observation alone."""
    env, agent = gem.make(env_id), solver(env_id)
    for seed in range(many):
        records = played(env, seed, agent)
        assert records[-1][4]["correct"], f"seed {seed}: {records[-1][0]}"
        assert sum(record[1] for record in records[1:]) == pytest.approx(1.0)


@pytest.mark.parametrize("env_id", IDS)
def test_solver_reads_a_history(env_id: str) -> None:
    env = gem.make(env_id, wrappers="concat_with_action")
    assert all(played(env, seed, solver(env_id))[-1][4]["correct"] for seed in range(20))


def test_solvers_are_found_by_name_and_refuse_other_games() -> None:
    from gem_core.registry import registry

    observation, _ = gem.make("game:TowerofHanoi-v0-easy").reset(seed=0)
    guess, _ = gem.make("game:GuessTheNumber-v0").reset(seed=0)
    assert registry().agent("bisect").entry_point == "gem_games.agents:BisectionAgent"
    with pytest.raises(AgentError, match="bisect"):
        BisectionAgent()(observation)
    with pytest.raises(AgentError, match="mastermind"):
        MastermindAgent()(observation)
    with pytest.raises(AgentError, match="hanoi"):
        HanoiAgent()(guess)
    with pytest.raises(AgentError, match="at most 100,000 codes"):
        MastermindAgent()(MastermindEnv(8, 20).reset(seed=0)[0])


def test_solver_reads_content_parts() -> None:
    observation, _ = gem.make("game:GuessTheNumber-v0").reset(seed=0)
    assert BisectionAgent()([{"type": "text", "text": observation}]) == "\\boxed{25}"
    assert BisectionAgent()([{"role": "user", "content": observation}]) == "\\boxed{25}"


def test_random_mastermind_guesses_exhaust_a_tiny_game() -> None:
    """Guesses never repeat, even where nearly all codes were tried."""
    env = gem.make("game:Mastermind-v0-easy", code_length=2, num_numbers=3, max_turns=6)
    assert all(played(env, seed)[-1][4]["correct"] for seed in range(50))


def test_sampling_ends_where_all_numbers_were_guessed() -> None:
    """After a game that was won with the last number left, a sample repeats one."""
    env = GuessTheNumberEnv(1, 2, 5)
    env.reset(seed=0)
    env.number = 2
    env.step("\\boxed{1}")
    env.step("\\boxed{2}")
    assert env.sample_random_action() in ("\\boxed{1}", "\\boxed{2}")


@given(st.integers(-(10**200), 10**200))
def test_whole_number_reads_what_python_writes(number: int) -> None:
    read = whole_number(str(number))
    assert read == number if len(str(number)) <= 100 else abs(read or 0) >= 10**98


@given(st.text(max_size=12))
def test_whole_number_never_fails(text: str) -> None:
    read = whole_number(text)
    assert (read is not None) == bool(re.fullmatch(r"[+-]?[0-9]+", text))
    assert read is None or read == int(text)


@given(st.lists(st.integers(-99, 99), min_size=1), st.sampled_from([" ", "  ", "\n", "\t "]))
def test_whole_numbers_reads_lists(numbers: list[int], space: str) -> None:
    assert whole_numbers(space.join(map(str, numbers))) == numbers


@given(st.text())
def test_quote_is_short_and_can_be_printed(text: str) -> None:
    assert len(quote(text)) < 450
    assert quote(text).encode()
