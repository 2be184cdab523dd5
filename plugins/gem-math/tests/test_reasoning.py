"""The tasks of ReasoningGym: their rows are the library's, drawn by seed, and its scorers decide."""

from __future__ import annotations

import json
import os
import pickle
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

import gem_core as gem
from gem_core.errors import ArgumentError, EnvFaultError
from gem_core.testing import check_env
from gem_math import processes
from gem_math.reasoning.env import LONGEST_ANSWER, PROMPT
from gem_math.reasoning.library import EndedError, LibraryError, ask, pool
from gem_math.reasoning.listing import TASKS

pytest.importorskip("reasoning_gym", reason="rg:* needs gem-math[reasoning-gym], which needs a C compiler")

EVERY = bool(os.environ.get("GEM_EVERY_REASONING_TASK"))
SAMPLE = ["boxnet", "countdown", "gsm_symbolic", "isomorphic_strings", "leg_counting", "pool_matrix", "composite"]
ROOT = Path(__file__).parents[3]

THEIRS = """
import json, random, sys
import numpy
from reasoning_gym import create_dataset
from reasoning_gym.composite import CompositeConfig, CompositeDataset, DatasetSpec
from reasoning_gym.factory import DATASETS
import contextlib
found = {}
with contextlib.redirect_stdout(sys.stderr):
    for name, (_, config) in sorted(DATASETS.items()):
        if name != "composite":
            for seed in (42, 47):
                rows = create_dataset(name, seed=seed, size=5)
                random.seed(seed + 1)  # list_functions and some programs of codeio draw from the global generators
                numpy.random.seed(seed + 1)
                row = rows[1]
                found[f"{name} {seed}"] = [row["question"], row["answer"]]
    parts = [DatasetSpec("leg_counting", 2, {}), DatasetSpec("chain_sum", 1, {"max_terms": 3})]
    mixed = CompositeDataset(CompositeConfig(size=20, seed=7, datasets=parts))
    found["composite"] = [row["question"] for row in mixed]
print(json.dumps(found))
"""


def asked(env: Any, index: int) -> str:
    """Return the question of a row, without what the prompt adds."""
    observation, _ = env.reset(options={"index": index})
    return str(observation).removesuffix(PROMPT.removeprefix("{question}"))


def rounded(text: str | None) -> str:
    """Leave the last digits of long fractions out: programs of ``codeio`` add them up in no fixed order."""
    return re.sub(r"(\d\.\d{10})\d+", r"\1", str(text))


def silent(observation: str) -> str:
    """Give no answer."""
    return ""


@pytest.fixture(scope="module")
def theirs() -> dict[str, Any]:
    """What the library itself returns, in a process with the hash seed that ours fixes."""
    done = subprocess.run(
        [sys.executable, "-c", THEIRS], capture_output=True, check=True, env={**os.environ, **processes.FIXED}
    )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.thorough
def test_the_table_of_tasks_is_that_of_the_installed_library() -> None:
    """And so is every id; the script that made it makes it again."""
    script = ROOT / "scripts" / "list_reasoning_tasks.py"
    if script.exists():
        made = subprocess.run([sys.executable, str(script)], capture_output=True, check=True, text=True).stdout
        assert json.loads(made) == TASKS
    ids = set(gem.list_envs("rg"))
    assert ids == {f"rg:{name}" for name in TASKS} | {"rg:composite"}
    assert len(ids) == 106


def test_listing_the_tasks_imports_no_library() -> None:
    """Nor does making and stepping one: the library runs in a process of its own."""
    code = (
        "import sys, gem_core as gem\n"
        "env = gem.make('rg:leg_counting'); env.reset(seed=1); env.step('<answer>1</answer>')\n"
        "assert 'reasoning_gym' not in sys.modules and 'sympy' not in sys.modules"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.thorough
def test_rows_are_those_of_the_library(theirs: dict[str, Any]) -> None:
    """Of every task, in the first epoch and in the second."""
    for name in TASKS:
        env = gem.make(f"rg:{name}", size=5)
        for index, seed in ((1, 42), (6, 47)):
            question, answer = theirs[f"{name} {seed}"]
            assert rounded(asked(env, index)) == rounded(question), name
            assert rounded(env.unwrapped.present_row()["answer"]) == rounded(answer), name


@pytest.mark.thorough
def test_every_gold_answer_has_the_reward_1(theirs: dict[str, Any]) -> None:
    """Of every task whose rows bring one, in a tag; in a box where it has no braces."""
    without = []
    for name in TASKS:
        env = gem.make(f"rg:{name}", size=5)
        _, answer = theirs[f"{name} 42"]
        if answer is None:
            without.append(name)
            continue
        env.reset(options={"index": 1})
        _, reward, terminated, _, info = env.step(f"I think so.\n<answer>\n{answer}\n</answer>")
        assert (reward, terminated, info["correct"]) == (1.0, True, True), name
        if not set(answer) & set("{}\\"):
            env.reset(options={"index": 1})
            assert env.step(f"so \\boxed{{ {answer} }}")[1] == 1.0, name
    assert without == ["boxnet", "graph_color", "propositional_logic", "rubiks_cube", "rush_hour"]


@pytest.mark.parametrize("name", ["codeio", "list_functions", "pool_matrix"])
@pytest.mark.few(1)
def test_rows_from_global_generators_do_not_depend_on_others(name: str) -> None:
    """The library draws them from state that every row before has changed."""
    spec = pickle.dumps({"task": name, "size": 500})

    def rows(order: Iterable[int]) -> dict[int, str]:
        requests = {row: {"do": "row", "spec": spec, "seed": 9, "row": row} for row in order}
        return {row: rounded(ask(request, 60)["question"]) for row, request in requests.items()}

    first = rows(range(60))
    assert rows(reversed(range(60))) == first
    assert len(set(first.values())) > 50


def test_a_seed_gives_the_same_row_and_epochs_give_others() -> None:
    """No row of the first epoch comes again in the second."""
    env = gem.make("rg:chain_sum", size=20, seed=3)
    assert env.reset(seed=8) == env.reset(seed=8)
    questions = [asked(env, index) for index in range(60)]
    assert len(set(questions)) == 60
    assert asked(gem.make("rg:chain_sum", size=20, seed=23), 0) == questions[20]


def test_reset_draws_from_all_epochs_unless_told() -> None:
    """With ``epochs=1`` from the rows of the first."""
    drawn = {gem.make("rg:chain_sum", size=5).reset(seed=seed)[1]["epoch"] for seed in range(20)}
    assert len(drawn) == 20
    env = gem.make("rg:chain_sum", size=5, epochs=1)
    assert {env.reset(seed=seed)[1]["index"] for seed in range(60)} == {0, 1, 2, 3, 4}


def test_a_run_of_several_epochs_has_fresh_rows() -> None:
    """With ``episodes`` over the size, in every backend alike."""
    episodes = list(gem.rollout(gem.make_vec("rg:chain_sum", 3, size=4), silent, episodes=10, seed=1))
    assert sorted(episode.info["index"] for episode in episodes) == list(range(10))
    assert len({episode.observation for episode in episodes}) == 10
    once = list(gem.rollout(gem.make_vec("rg:chain_sum", 2, size=4), silent, seed=1))
    assert sorted(episode.info["task_id"] for episode in once) == ["42-0", "42-1", "42-2", "42-3"]


def test_info_names_the_row() -> None:
    """The task id is stable: the seed of the epoch, and the row."""
    env = gem.make("rg:leg_counting", size=10, seed=5)
    _, info = env.reset(seed=4, options={"index": 23})
    assert info == {"task_id": "25-3", "index": 23, "epoch": 2, "source": "leg_counting", "seed": 4}


def test_no_answer_is_scored_as_the_library_does() -> None:
    """Countdown gives 0.01 for it, and most give nothing."""
    for name, score in (("countdown", 0.01), ("leg_counting", 0.0)):
        env = gem.make(f"rg:{name}")
        env.reset(seed=1)
        _, reward, terminated, _, info = env.step("I do not know")
        assert (reward, terminated, info["correct"], info["parsed_action"]) == (score, True, False, None)


def test_partial_scores_are_rewards_and_not_correct() -> None:
    """Only a score of 1 counts as solved."""
    env = gem.make("rg:word_sorting")
    env.reset(options={"index": 0})
    words = env.unwrapped.present_row()["answer"].split(", ")
    _, reward, _, _, info = env.step(f"<answer>{', '.join([*words[1:], words[0]])}</answer>")
    assert (reward, info["correct"]) == (0.2, False)


@pytest.mark.parametrize(
    ("task", "arguments", "told"),
    [
        (
            "leg_counting",
            {"num_animal": 3},
            "'num_animal'. Did you mean 'min_animals' or 'max_animals'? There is",
        ),
        ("leg_counting", {"max_animals": -1}, "max_animals must be >= min_animals"),
        ("leg_counting", {"level": 99}, "level must be a whole number from 0 to 35, not 99"),
        ("leg_counting", {"levels": {"legs": 1}}, "no attribute 'legs'. There is: num_animals, num_instances"),
        ("leg_counting", {"levels": {"num_animals": 50}}, "'num_animals' must be a whole number from 0 to 35, not 50"),
        ("leg_counting", {"levels": 3}, "levels must map names of attributes to levels, not 3"),
        ("leg_counting", {"size": 0}, "size must be a whole number from 1 to 1000000, not 0"),
        ("leg_counting", {"seed": -1}, "seed must be a whole number from 0 to 2147483647, not -1"),
        ("leg_counting", {"epochs": 0}, "epochs must be a whole number from 1 to 2147483, not 0"),
        ("leg_counting", {"time_limit_s": 0}, "time_limit_s must be a positive number of seconds, not 0"),
        ("leg_counting", {"max_animals": lambda: 1}, "parameters must be plain data"),
        ("acre", {"level": 1}, "it has no levels"),
        ("word_sorting", {"transformation": "loud"}, "'loud' is not a valid"),
        ("composite", {"datasets": []}, "datasets must be a list of names"),
        ("composite", {"datasets": ["leg_count"]}, "no task 'leg_count'. Did you mean 'leg_counting'"),
        ("composite", {"datasets": [("maze", {"weight": 0})]}, "the weight of 'maze' must be a positive number, not 0"),
        ("composite", {"datasets": [("maze", {"seed": 1})]}, "'seed' is set for the whole of rg:composite"),
        ("composite", {"datasets": [("maze", {"legs": 1})]}, "maze: no parameter 'legs'"),
        ("composite", {"level": 2}, "no 'level' of its own; give it to the tasks"),
        ("composite", {"max_terms": 2}, "no 'max_terms' of its own; give it to the tasks"),
    ],
)
def test_wrong_arguments_are_told(task: str, arguments: dict[str, Any], told: str) -> None:
    """With what there is instead."""
    with pytest.raises(ArgumentError) as caught:
        gem.make(f"rg:{task}", **arguments)
    assert told in str(caught.value)


def test_levels_are_those_of_the_curriculum() -> None:
    """``difficulty`` is another word for ``level``, and parameters go over both."""
    plain = gem.make("rg:chain_sum", level=6)
    same = gem.make("rg:chain_sum", difficulty=6)
    lower = gem.make("rg:chain_sum", level=6, levels={"num_digits": 0})
    own = gem.make("rg:chain_sum", level=6, max_digits=1)
    assert asked(plain, 2) == asked(same, 2) != asked(gem.make("rg:chain_sum"), 2)
    for env, longest in ((plain, 7), (lower, 1), (own, 1)):
        numbers = [number for index in range(20) for number in asked(env, index).split() if number.isdigit()]
        assert max(map(len, numbers)) == longest
    assert asked(gem.make("rg:bitwise_arithmetic", difficulty=4), 1) == asked(
        gem.make("rg:bitwise_arithmetic", level=3), 1
    )


def test_parameters_take_the_forms_that_the_library_has() -> None:
    """Tuples, dates and enumerations are given as such, or as JSON has them."""
    import datetime

    early = datetime.date(1990, 1, 1)
    kwargs = {"task_types": ["date"], "max_date": datetime.date(1991, 1, 1)}
    first = gem.make("rg:time_intervals", min_date=early, **kwargs)
    assert asked(first, 0) == asked(gem.make("rg:time_intervals", min_date="1990-01-01", **kwargs), 0)
    assert "199" in asked(first, 0)
    assert asked(gem.make("rg:word_sorting", transformation="uppercase"), 0).isupper() is False


@pytest.mark.thorough
def test_a_mixture_has_the_rows_of_the_library(theirs: dict[str, Any]) -> None:
    """Each task scores its own."""
    tasks = [("leg_counting", {"weight": 2}), {"name": "rg:chain_sum", "weight": 1, "config": {"max_terms": 3}}]
    env = gem.make("rg:composite", datasets=tasks, seed=7, size=20)
    assert [asked(env, index) for index in range(20)] == theirs["composite"]
    assert {env.reset(options={"index": index})[1]["source"] for index in range(20)} == {"leg_counting", "chain_sum"}
    env.step(f"<answer>{env.unwrapped.present_row()['answer']}</answer>")
    assert env.reset(options={"index": 1})[0] != env.reset(options={"index": 21})[0]


def test_two_difficulties_of_codeio_do_not_disturb_each_other() -> None:
    """In reasoning-gym 0.1.25 the second changes the rows of the first."""
    easy = gem.make("rg:codeio", difficulty=2)
    before = asked(easy, 3)
    asked(gem.make("rg:codeio", difficulty=6), 3)
    assert asked(gem.make("rg:codeio", difficulty=2, size=499), 3) == before


def test_a_scorer_that_takes_too_long_is_the_agents_failure() -> None:
    """In whichever thread; the next right answer is right."""
    env = gem.make("rg:countdown", time_limit_s=0.2)
    results: list[Any] = []

    def play() -> None:
        env.reset(options={"index": 0})
        results.append(env.step("\\boxed{((9**9999)**9999)**9999}"))
        env.reset(options={"index": 0})
        results.append(env.step(f"\\boxed{{{env.unwrapped.present_row()['answer']}}}"))

    thread = threading.Thread(target=play)
    thread.start()
    thread.join()
    _, reward, terminated, truncated, info = results[0]
    assert (reward, terminated, truncated, info["correct"]) == (0.0, True, False, False)
    assert info["reason"] == "the scorer was ended: it took more than 0.2 s"
    assert results[1][1] == 1.0


def test_an_answer_longer_than_any_is_not_scored() -> None:
    """It would only take time."""
    env = gem.make("rg:leg_counting")
    env.reset(seed=1)
    _, reward, terminated, _, info = env.step(f"\\boxed{{{'1' * (LONGEST_ANSWER + 1)}}}")
    assert (reward, terminated, info["reason"]) == (0.0, True, "an answer has at most 1000000 characters")


def test_a_scorer_that_raises_on_any_answer_is_no_failure_of_the_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    """The episode is truncated with an error, and is kept out of training."""
    env = gem.make("rg:leg_counting")
    env.reset(seed=1)
    monkeypatch.setattr("gem_math.reasoning.env.ask", lambda request, limit_s: {"raised": "KeyError: 'answer'"})
    _, reward, terminated, truncated, info = env.step("\\boxed{1}")
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["error"] == {"kind": "grading", "message": "the scorer raises on any answer: KeyError: 'answer'"}


def test_a_row_that_cannot_be_made_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the environment, with what to do."""
    env = gem.make("rg:leg_counting")

    def ended(request: Any, limit_s: float) -> Any:
        raise EndedError("it took more than 120 s")

    monkeypatch.setattr("gem_math.reasoning.env.ask", ended)
    with pytest.raises(EnvFaultError, match="rg:leg_counting: no row was made with these parameters: it took more"):
        env.reset(seed=123456)


def test_a_process_that_cannot_start_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the reason."""
    pool.end()
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(LibraryError, match=r"cannot be loaded \(its process ended at once\)"):
        ask({"do": "check", "spec": b""}, 1)


def test_a_process_that_was_killed_is_replaced() -> None:
    """The next question is answered as if nothing had happened."""
    env = gem.make("rg:leg_counting")
    env.reset(seed=1)
    for worker in pool.idle:
        os.killpg(worker.process.pid, signal.SIGKILL)
        worker.process.wait()
    env.reset(seed=2)
    _, reward, terminated, _, info = env.step("\\boxed{1}")
    assert terminated, info
    assert reward == 0.0


def test_a_process_that_gets_no_time_is_no_failure_of_the_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whose clock ran out while the processor did little: the episode is kept out of training."""
    env = gem.make("rg:countdown", time_limit_s=30)
    env.reset(options={"index": 0})
    monkeypatch.setattr(processes, "_SLACK_S", -30.0)
    _, _, terminated, truncated, info = env.step("\\boxed{((9**9999)**9999)**9999}")
    assert (terminated, truncated, info["error"]["kind"]) == (False, True, "grading")
    assert info["error"]["message"].startswith("reasoning-gym did not answer")
    monkeypatch.undo()
    env.reset(options={"index": 0})
    assert env.step(f"\\boxed{{{env.unwrapped.present_row()['answer']}}}")[1] == 1.0


def test_options_and_states_are_checked() -> None:
    """A restored environment asks the same row."""
    env = gem.make("rg:leg_counting")
    with pytest.raises(ArgumentError, match="no option 'idx'"):
        env.reset(options={"idx": 1})
    with pytest.raises(ArgumentError, match="must be from 0 to 1073741823, not -1"):
        env.reset(options={"index": -1})
    observation, _ = env.reset(seed=5)
    sibling = env.unwrapped.fork()
    assert sibling.present_row()["question"] in observation


@pytest.mark.few(2)
@pytest.mark.parametrize("name", [*TASKS, "composite"] if EVERY else SAMPLE)
def test_the_contract_is_kept(name: str) -> None:
    """``GEM_EVERY_REASONING_TASK=1`` tries every id with every promise."""
    if EVERY:
        check_env(f"rg:{name}")
    else:
        skipped = {} if name == "isomorphic_strings" else {"process-determinism": "one task here tries it"}
        check_env(f"rg:{name}", episodes=1, max_turns=2, skip=skipped)
