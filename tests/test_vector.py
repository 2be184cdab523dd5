"""Vector environments: order, autoreset, faults, plans and seeds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from toys import CountdownEnv

import gem_core as gem
from gem_core.errors import (
    ArgumentError,
    FaultBudgetError,
    ResetNeededError,
    UnknownBackendError,
    UnknownEnvError,
)

COUNTDOWN = "toy:Countdown-v0"


def make(num_envs: int = 2, **options: Any) -> gem.VectorEnv:
    return gem.make_vec(COUNTDOWN, num_envs, seed=options.pop("seed", 5), **options)


def lasting(turns: int, count: int) -> list[gem.PlanItem]:
    return [gem.PlanItem(options={"left": turns})] * count


def test_reset_and_step_give_lists_and_arrays_in_order() -> None:
    """Texts and infos are lists, numbers are arrays."""
    vector = make(3, plan=lasting(5, 3))
    observations, infos = vector.reset()
    assert observations == ["Count down.\nLeft: 5."] * 3
    assert [info["suffix"] for info in infos] == ["Left: 5."] * 3
    step = vector.step(["a", "b", "c"])
    assert step.observations == [f"You said {action!r}.\nLeft: 4." for action in "abc"]
    assert step.rewards.dtype == np.float64
    assert step.rewards.tolist() == [1.0, 1.0, 1.0]
    assert step.terminated.dtype == step.truncated.dtype == np.bool_
    assert len(vector) == vector.num_envs == 3


def test_a_mapping_steps_some_slots_in_the_order_asked() -> None:
    """The others stand still."""
    vector = make(3, plan=lasting(5, 3))
    vector.reset()
    assert vector.step({2: "c", 0: "a"}).observations == ["You said 'c'.\nLeft: 4.", "You said 'a'.\nLeft: 4."]
    assert vector.step(["x", "y", "z"]).rewards.tolist() == [2.0, 1.0, 2.0]
    assert vector.step({}).observations == []


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (["a"], "1 actions"),
        ("ab", "string"),
        ((word for word in "ab"), "generator"),
        ({"a": "a"}, "no slot 'a'"),
        ({-1: "a"}, "no slot -1"),
        (["a", None], "slot 1"),
    ],
)
def test_actions_that_do_not_fit_are_refused(actions: Any, message: str) -> None:
    """Nothing is stepped."""
    vector = make()
    vector.reset()
    with pytest.raises(ArgumentError, match=message):
        vector.step(actions)


def test_step_before_reset_is_refused() -> None:
    """The error says what to call."""
    with pytest.raises(ResetNeededError, match="reset"):
        make().step(["a", "b"])


def test_exhausted_plan_leaves_the_slot_idle() -> None:
    """Its actions are ignored, and its flags are false."""
    vector = make(2, plan=lasting(1, 1))
    assert vector.reset()[1][1] == {"idle": True}
    assert vector.start_of(1) is None
    step = vector.step(["a", "b"])
    assert step.observations == [gem.TERMINAL_STATE] * 2
    assert step.infos[0]["idle"] is True
    assert step.infos[0]["final_info"]["correct"] is False
    assert (step.terminated.tolist(), step.truncated.tolist()) == ([True, False], [False, False])
    assert vector.step(["a", "b"]).infos == [{"idle": True}] * 2


def test_every_episode_can_be_replayed_alone_from_its_seed() -> None:
    """``info["seed"]`` starts it in an environment of its own."""
    vector = make(3)
    observations, infos = vector.reset()
    for observation, info in zip(observations, infos, strict=True):
        assert gem.make(COUNTDOWN).reset(seed=info["seed"])[0] == observation


def test_the_same_seed_gives_the_same_run_and_reset_with_it_starts_over() -> None:
    """And another seed another run."""
    first, second, third = make(4, seed=1), make(4, seed=1), make(4, seed=2)
    start = first.reset()
    assert start == second.reset()
    assert start != third.reset()
    first.step(["a"] * 4)
    assert first.reset(seed=1) == start


def test_the_seed_that_was_drawn_is_reported() -> None:
    """A run without a seed can be repeated."""
    vector = gem.make_vec(COUNTDOWN, 2)
    assert gem.make_vec(COUNTDOWN, 2, seed=vector.seed).reset() == vector.reset()


def test_mixed_batch_and_per_item_arguments() -> None:
    """Slots take ids in turn; a plan item may ask for another id and other arguments."""
    vector = gem.make_vec([COUNTDOWN, "toy:Echo-v0"], 3, seed=0)
    assert vector.ids == [COUNTDOWN, "toy:Echo-v0", COUNTDOWN]
    plan = [gem.PlanItem(id=COUNTDOWN, kwargs={"longest": 1}), gem.PlanItem(id="toy:Echo-v0"), gem.PlanItem()]
    mixed = gem.make_vec("toy:Echo-v0", 1, seed=0, plan=plan)
    assert mixed.reset()[0] == ["Count down.\nLeft: 1."]
    assert mixed.describe(0) == {"id": COUNTDOWN, "kwargs": {"longest": 1}, "wrappers": []}
    assert mixed.step(["a"]).observations == ["Say something."]
    assert mixed.step(["stop"]).observations == ["Say something."]
    assert mixed.step(["stop"]).infos[0]["idle"] is True


def test_slots_may_have_keyword_arguments_of_their_own() -> None:
    """Over those of the run; a plan item of the slot's own id goes over both, and the default plan keeps them."""
    ids = [COUNTDOWN, (COUNTDOWN, {"longest": 1}), ("toy:Echo-v0", {})]
    vector = gem.make_vec(ids, 5, seed=0)
    vector.reset()
    assert vector.ids == [COUNTDOWN, COUNTDOWN, "toy:Echo-v0", COUNTDOWN, COUNTDOWN]
    assert [vector.describe(slot)["kwargs"] for slot in range(5)] == [{}, {"longest": 1}, {}, {}, {"longest": 1}]
    episodes = gem.rollout(gem.make_vec(ids[:2], 1, seed=0), lambda observation: "a", episodes=3)
    assert [dict(episode.kwargs) for episode in episodes] == [{}, {"longest": 1}] * 3
    with pytest.raises(ArgumentError, match="not 3"):
        gem.make_vec([COUNTDOWN, 3])  # type: ignore[list-item]  # that is the point


def test_groups_share_a_start_and_are_named() -> None:
    """All members of a group see the same first observation."""
    vector = make(4, plan=[gem.PlanItem(repeat=4)])
    observations, infos = vector.reset()
    assert len(set(map(str, observations))) == 1
    assert [info["group"] for info in infos] == ["0"] * 4
    assert len({vector.sample_random_action(slot) for slot in range(4)}) > 1


def test_fault_in_reset_uses_its_plan_item_up() -> None:
    """It is listed with what it should have started from, and the next item begins."""
    vector = make(1, plan=[gem.PlanItem(kwargs={"fail": "reset"}), *lasting(3, 1)])
    observations, infos = vector.reset()
    assert observations == ["Count down.\nLeft: 3."]
    failed = infos[0]["failed_resets"]
    assert [entry["key"] for entry in failed] == ["0"]
    assert failed[0]["error"]["message"] == "reset raised RuntimeError: broken in reset"


def test_faults_without_end_stop_with_one_clear_error() -> None:
    """The budget counts faults in a row; an episode that ends by itself resets it."""
    vector = make(1, fail="reset")
    for _ in range(2):  # a new run has the whole budget
        with pytest.raises(FaultBudgetError, match=r"^17 faults in a row") as caught:
            vector.reset()
        assert isinstance(caught.value.__cause__, RuntimeError)
    with pytest.raises(FaultBudgetError, match=r"^4 faults"):
        make(1, fail="reset", max_faults=3).reset()
    plan = [item for _ in range(40) for item in (gem.PlanItem(kwargs={"fail": "step"}), *lasting(1, 1))]
    vector = make(1, plan=plan)
    vector.reset()
    while vector.start_of(0) is not None:
        vector.step(["a"])
    assert vector.faults == 40


@pytest.mark.parametrize("error", ["out of order", {"kind": "out of order"}])
def test_a_reported_error_of_any_form_spends_the_budget(error: Any) -> None:
    """A plain text is one too, and one without a message is shown whole."""

    class Terse(CountdownEnv):
        def step(self, action: str) -> Any:
            return gem.TERMINAL_STATE, 0.0, False, True, {"error": error}

    vector = gem.VectorEnv.from_env(Terse(), seed=0)
    vector.reset()
    for _ in range(16):
        vector.step(["a"])
    with pytest.raises(FaultBudgetError, match="out of order"):
        vector.step(["a"])


@pytest.mark.parametrize("where", ["reset", "step"])
def test_malformed_results_are_faults(where: str) -> None:
    """Also of an environment that ``make`` did not make."""
    env = CountdownEnv()
    setattr(env, where, lambda *args, **kwargs: None)
    (episode,) = gem.rollout(env, lambda observation: "a", plan=lasting(1, 1))
    assert episode.error["message"].startswith(f"{where} raised TypeError: {where} must return")


def test_what_cannot_be_right_is_raised_at_once() -> None:
    """A wrong id, backend, argument or number is no fault of an episode."""
    with pytest.raises(UnknownEnvError):
        gem.make_vec("toy:Cuntdown-v0")
    with pytest.raises(UnknownBackendError, match="'sync' or 'async'"):
        gem.make_vec(COUNTDOWN, backend="snc")
    with pytest.raises(ArgumentError, match="Did you mean 'longest'"):
        gem.make_vec(COUNTDOWN, longst=3).reset()
    for count in (0, -1, 1.5):
        with pytest.raises(ArgumentError, match="num_envs"):
            gem.make_vec(COUNTDOWN, count)  # type: ignore[arg-type]  # that is the point
    with pytest.raises(ArgumentError, match="at least one"):
        gem.make_vec([])
    with pytest.raises(ArgumentError, match="not 3"):
        gem.make_vec(3)  # type: ignore[arg-type]  # that is the point
    with pytest.raises(ArgumentError, match="on_error"):
        gem.make_vec(COUNTDOWN, on_error="ignore")
    with pytest.raises(ArgumentError, match=r"PlanItem.* not str"):
        gem.make_vec(COUNTDOWN, plan=COUNTDOWN)  # type: ignore[arg-type]  # that is the point


@pytest.mark.parametrize("backend", [None, ("process",), ("process", 2), {"process": {"workers": 2}}])
def test_backends_that_are_no_name_with_options_are_refused(backend: Any) -> None:
    """The message says what form they have."""
    with pytest.raises(ArgumentError, match="a backend is a name, as 'process'"):
        gem.make_vec(COUNTDOWN, backend=backend)


def test_questions_about_slots_that_are_not_there_are_refused() -> None:
    """Also counted from the end, as no slot is."""
    vector = make(2)
    vector.reset()
    with pytest.raises(ArgumentError, match="slot 2"):
        vector.sample_random_action(2)
    with pytest.raises(ArgumentError, match="slot -1"):
        vector.describe(-1)


def test_options_of_a_reset_are_a_mapping() -> None:
    """What else comes in their place, such as a seed, is refused."""
    with pytest.raises(ArgumentError, match=r"options.* not 5"):
        make(2).reset(None, 5)  # type: ignore[arg-type]  # that is the point


def test_close_closes_every_environment_and_may_be_called_again() -> None:
    """The context manager does it too."""
    env = CountdownEnv()
    with gem.VectorEnv.from_env(env, seed=0) as vector:
        vector.reset()
    vector.close()
    assert env.closed == 1


def test_tasks_of_a_data_set_are_counted() -> None:
    """Other environments have no number of tasks."""
    vector = gem.make_vec(["toy:Sums-v0", COUNTDOWN])
    assert (vector.tasks("toy:Sums-v0"), vector.tasks(COUNTDOWN)) == ((7, False), (None, False))


def test_an_iterator_that_was_drawn_from_cannot_start_over() -> None:
    """It could only go on, which would be another run under the same seed."""
    vector = make(1, plan=iter(lasting(3, 9)))
    start = vector.reset(seed=1)
    assert make(1, plan=lasting(3, 9)).reset(seed=1) == start
    with pytest.raises(ArgumentError, match="iterator"):
        vector.reset(seed=1)
    assert vector.reset()[1][0]["seed"] != start[1][0]["seed"]


def test_slots_may_be_whole_numbers_of_numpy() -> None:
    """As ``np.flatnonzero`` gives them."""
    vector = make(2, plan=lasting(3, 2))
    vector.reset()
    assert vector.step({slot: "a" for slot in np.flatnonzero([False, True])}).rewards.tolist() == [1.0]


def test_dictionary_that_an_environment_uses_again_changes_no_record() -> None:
    """Each turn keeps the info that it had."""

    class Sharing(CountdownEnv):
        def __init__(self) -> None:
            super().__init__()
            self.shared: dict[str, Any] = {}

        def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
            self.shared.update(left=3)
            return super().reset(seed=seed, options=options)[0], self.shared

        def step(self, action: str) -> Any:
            self.shared.update(left=self.left - 1)
            return (*super().step(action)[:4], self.shared)

    (episode,) = gem.rollout(Sharing(), lambda observation: "a", plan=lasting(3, 1))
    assert [episode.info["left"], *(turn.info["left"] for turn in episode.transitions)] == [3, 2, 1, 0]
